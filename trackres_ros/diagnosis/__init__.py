# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings and a vehicle come in; differences to the simulation, missing physics and an improved model go out."""

from trackres_ros.diagnosis.base.loading import load_base
from trackres_ros.diagnosis.pipeline import Diagnosis, diagnose, read_recordings
from trackres_ros.diagnosis.preparation import DiagnosisOptions

__all__ = ["Diagnosis", "DiagnosisOptions", "diagnose", "load_base", "read_recordings"]

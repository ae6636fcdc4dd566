# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings and a vehicle in; out come where they part from the simulation, what physics is missing, and a model that has it."""

from trackres_ros.diagnosis.base.loading import load_base
from trackres_ros.diagnosis.pipeline import Diagnosis, diagnose, read_recordings
from trackres_ros.diagnosis.stages.options import DiagnosisOptions

__all__ = ["Diagnosis", "DiagnosisOptions", "diagnose", "load_base", "read_recordings"]

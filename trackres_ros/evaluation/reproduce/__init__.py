# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's figures and tests are run again; out goes what holds of its text and what does not, and why."""

from trackres_ros.evaluation.reproduce.run import reproduce

__all__ = ["reproduce"]

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live estimate: guards, one pure step, snapshot and resume. `estimator.Estimator` is where to begin."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows of results with a measured torque come in; what they tell of the vehicle, and how sure that is, goes out and back into the
step. Begin at `learner.Learner`.
"""

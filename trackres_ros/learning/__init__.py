# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Results with a measured torque come in; parameters of the vehicle and their uncertainty go out and into the step. Begin at
`learner.Learner`.
"""

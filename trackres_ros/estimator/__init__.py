# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The estimator turns measurements into torque and temperature: guards, one pure step, snapshot and resume. Begin at
`estimator.Estimator`.
"""

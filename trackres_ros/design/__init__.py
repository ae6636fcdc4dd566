# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A vehicle and what of it is to change come in; what each change does to torque, temperature and energy goes out."""

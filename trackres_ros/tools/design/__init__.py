# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A vehicle and changes of its values come in; the effects on torque, temperature and energy go out."""

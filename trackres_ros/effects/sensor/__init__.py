# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Each file here is an error of the speed or torque sensor."""

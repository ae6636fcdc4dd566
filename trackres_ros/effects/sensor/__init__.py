# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a sensor makes of speed or torque; one file each."""

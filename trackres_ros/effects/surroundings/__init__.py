# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of site, weather and ground, which are others tomorrow; one file each."""

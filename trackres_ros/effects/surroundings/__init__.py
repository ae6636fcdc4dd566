# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Each file here is an effect of site, weather or ground, which can change from day to day."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What was computed comes in; objects that print themselves and convert to pandas and xarray go out."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What was computed in; out come objects that print themselves in a terminal and in a notebook, and go to pandas and xarray."""

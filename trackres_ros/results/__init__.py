# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computed results come in; objects that print themselves and convert to pandas and xarray go out."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates a vehicle and the compiled step to C99 and an FMU with the same numbers. Begin at `exporting`."""

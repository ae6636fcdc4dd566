# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits come in; where they err, visible effects, errors on the hold-out laps, and the results to write go out."""

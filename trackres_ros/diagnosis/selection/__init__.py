# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits come in; chosen effects go out: visible, with a gain, distinguishable and confirmed by the hold-out laps."""

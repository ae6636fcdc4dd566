# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A simulated fleet whose changes are concealed comes out, and counts of how many were found. It is driven by the truth of the
sealed drives, and reads of the fleet's tools only what they print.
"""

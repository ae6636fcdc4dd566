# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates a fleet with concealed changes, and counts how many are found. It uses the truth of the sealed drives, and of the
fleet's tools only their output.
"""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings in, evenly spaced sessions out, or a line that says what is wrong with units, clocks and torque."""

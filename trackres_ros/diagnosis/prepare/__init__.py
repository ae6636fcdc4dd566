# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings come in; evenly spaced sessions go out, or an error about units, clocks or torque."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings in which a vehicle rolls out come in; what its resistance is, and how well that is known, goes out."""

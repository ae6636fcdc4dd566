# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A recording or a speed profile comes in; results of a replay or a simulation go out."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A recording, or the speed profile of a drive that was never driven, comes in; results of a replay or a simulation go out."""

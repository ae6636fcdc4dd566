# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A recording, or a drive that was never driven, in; results out: replay and simulation."""

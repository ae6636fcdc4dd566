# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A chosen fit comes in; statements go out: where, how much, how certain, and the next drives."""

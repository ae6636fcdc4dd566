# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pages of a fleet: a folder that opens without a network."""

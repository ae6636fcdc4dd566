# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Accepted results come in; vehicle file, surroundings and lines of the topics file go out."""

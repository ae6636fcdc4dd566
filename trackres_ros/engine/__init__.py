# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs independent tasks and yields their results as they finish, from this process or from workers."""

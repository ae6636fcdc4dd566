# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs independent tasks and yields their results as they finish, in this process or by workers; starts Python as a process."""

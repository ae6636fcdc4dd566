# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads bags, tables, measurement files and bus logs into a `Recording` in SI, with its defects."""

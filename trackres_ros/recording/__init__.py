# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags, tables, measurement files and bus logs come in; a `Recording` in SI goes out, with its defects."""

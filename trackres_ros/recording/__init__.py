# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags, tables, measurement files and bus logs come in, with a topics file; a `Recording` in SI goes out, and what is wrong with it."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags and tables: in come files and a topics file, out goes a `Recording` in SI with what was found wrong."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the C of the kernels when the package is built, and compiles some for tests and comparisons."""

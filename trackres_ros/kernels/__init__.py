# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Kernels are written once, in restricted Python. They are translated to C and compiled when the package is built."""

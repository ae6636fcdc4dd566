# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compiles functions of the kernels to machine code, kept in a sealed cache."""

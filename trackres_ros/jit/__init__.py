# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Functions of the kernels come in; machine code, kept in a sealed cache, goes out."""

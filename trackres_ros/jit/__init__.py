# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Machine code of the kernels: in come functions, out go compiled ones, kept in a sealed cache."""

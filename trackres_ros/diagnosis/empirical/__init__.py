# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A fit and its residual come in; descriptive terms without a name go out, chosen like effects of the catalogue."""

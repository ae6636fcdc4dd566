# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A fit and what it leaves go in; terms without a name that describe it come out, chosen as effects of the catalogue are."""

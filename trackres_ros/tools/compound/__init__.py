# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sweep of a DMA instrument comes in; master curve, rubber file, a vehicle with the compound and a picture go out."""

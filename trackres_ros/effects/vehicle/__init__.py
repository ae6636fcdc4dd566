# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Each file here is an effect that stays with the vehicle wherever it drives."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects that stay with the vehicle wherever it drives, one file each."""

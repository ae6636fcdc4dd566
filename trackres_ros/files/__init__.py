# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files that are read whole, our own and the user's: paths in, bounded and checked contents out."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers and tables as people read them: in come values, out goes text or HTML."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Paths of files that are read whole, our own and the user's, come in; bounded and checked contents go out."""

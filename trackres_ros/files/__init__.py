# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Paths of small files come in; contents of checked format and bounded size go out. The current folder changes nothing."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Positions of drives come in; repeated places and their learned values go out."""

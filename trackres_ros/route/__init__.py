# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Positions of drives come in; out come the places that are passed again, and what was learned of them."""

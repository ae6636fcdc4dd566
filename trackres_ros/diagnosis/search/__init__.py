# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Searches for the explanations of what a base model leaves: sets of names, forms and terms that follow clock or place."""

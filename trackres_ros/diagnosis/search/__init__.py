# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Searches explanations of a base model's residual: sets of names, forms and terms of clock or place."""

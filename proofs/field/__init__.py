# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnoses real recordings with concealed channels, and compares the findings with them."""

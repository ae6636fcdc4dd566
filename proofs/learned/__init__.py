# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The proof of the learning: vehicles that are other than their files, drives that are made to mislead, and an age of driving."""

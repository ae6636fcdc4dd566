# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stages of a diagnosis in sequence: prepare, refit, search, judge, conclude."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows of the estimator come in; topics, bags, tables and pictures go out."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Results: in come rows of the estimator, out go topics, bags, tables and pictures."""

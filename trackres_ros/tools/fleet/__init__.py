# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings of many vehicles over months come in; a dataset, pooled values, trends and pages go out."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings of many vehicles over months come in; a dataset with a row for each, what pooling and trends show of it, and pages
go out.
"""

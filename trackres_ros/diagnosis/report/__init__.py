# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A finished diagnosis in, its page, pictures and report.json out."""

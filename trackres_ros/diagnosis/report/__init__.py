# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A finished diagnosis comes in; its page, pictures and report.json go out."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A chosen fit in, statements out: where, how much, how sure, and what to drive next."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real recordings in, the page of what was hidden in them and found out."""

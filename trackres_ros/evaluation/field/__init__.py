# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real recordings come in; the page of what was concealed in them and what was found goes out."""

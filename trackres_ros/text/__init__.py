# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Values come in; readable numbers and tables go out, as text or HTML."""

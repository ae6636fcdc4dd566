# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Values come in; numbers and tables as people read them go out, as text or HTML."""

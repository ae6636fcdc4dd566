# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Independent tasks come in; their results go out as they finish, from this process or from workers."""

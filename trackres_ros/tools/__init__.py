# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Work of a desk: compounds, designs, exports, fleets and coast-downs. Nothing else imports these rooms.

Their commands are plug-ins of `trackres`: entry points of the group `trackres_ros.commands`.
"""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The running application: messages in, torques and statuses out, in time. It is independent of its transports, `ros` and
`dds`.
"""

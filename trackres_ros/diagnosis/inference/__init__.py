# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sessions and a base come in; a fit goes out: values, their uncertainty and the noise."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sessions and a base in, a fit out: values, how sure they are, and the noise."""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sessions and values in, expected torque and temperature out: the models that are fitted."""

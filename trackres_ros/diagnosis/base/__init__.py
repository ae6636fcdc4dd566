# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sessions and values come in; expected torque and temperature go out: the models that are fitted."""

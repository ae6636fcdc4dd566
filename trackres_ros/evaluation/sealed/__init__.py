# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sealed drives of a second simulator in, scores out. The truth shares no code with `model`, `effects` or `diagnosis`."""

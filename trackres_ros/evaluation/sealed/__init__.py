# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Drives of a second simulator whose cause is concealed come in, scores go out. The truth shares no code with `model`, `effects`
or `diagnosis`.
"""

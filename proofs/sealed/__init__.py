# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scores the diagnosis on drives of a second simulator with a concealed cause. The truth shares no code with `model`, `effects`
or `diagnosis`.
"""

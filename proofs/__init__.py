# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sealed drives, real recordings, the paper's test and a control loop come in; tables with a comparison to the truth go out."""

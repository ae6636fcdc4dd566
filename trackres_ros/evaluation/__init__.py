# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sealed drives, real recordings, the paper's test and figures, and a loop with a controller come in; pages that compare the
results with what is true go out.
"""

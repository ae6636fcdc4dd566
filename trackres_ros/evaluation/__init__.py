# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Is it right? Sealed drives, real recordings, the paper's test and figures, and a loop with a controller in; pages out."""

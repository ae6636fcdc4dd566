# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Each file here reads a kind of recording, and registers it by its name `KINDS`."""

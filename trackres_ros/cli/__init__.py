# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Words of a command line in, text, files and an exit code out: the `trackres` command, one file a command, thin."""

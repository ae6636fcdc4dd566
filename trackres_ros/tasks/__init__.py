# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A command line comes in; text, files and an exit code go out. Each command of `trackres` is one thin file."""

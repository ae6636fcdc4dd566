# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The words of a command line come in; text, files and an exit code go out. Each command of `trackres` is one thin file."""

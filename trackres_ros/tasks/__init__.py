# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The tasks of the package: a call or a command line comes in; results, text, files and an exit code go out.

One module has one task: its function, its result and its command. `main` loads a module when its command is run.
"""

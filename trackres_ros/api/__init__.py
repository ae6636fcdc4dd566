# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The front door has one function for each thing to be done with a vehicle and its recordings.

`import trackres_ros as tr` has them all; see docs/api.md. The command line calls these functions and nothing else. Nothing
is loaded before it is used: each function imports what it needs.
"""

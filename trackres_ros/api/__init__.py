# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The public interface: one function for each task with a vehicle and its recordings.

`import trackres_ros as tr` has them all; see docs/api.md. The command line calls only these functions. Each function imports
its modules when it is called.
"""

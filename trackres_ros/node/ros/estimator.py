# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The executable `estimator`. It handles signals before it loads anything else, which takes a second."""

from __future__ import annotations

import sys

from trackres_ros.node.process import REQUESTS

BAD_INPUT = 2


def main() -> None:
    """Run the node; ROS arguments give name, namespace, remappings and parameters."""
    REQUESTS.listen()
    from trackres_ros.errors import InputError

    try:
        from trackres_ros.node.ros.main import run_executable
    except InputError as error:  # no ROS
        print(f"estimator: error: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    sys.exit(run_executable(REQUESTS))


if __name__ == "__main__":
    main()

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command `trackres`, also as `python -m trackres_ros`: sets up signals and Ctrl-C before other modules load."""

import os
import sys

from trackres_ros.tasks.interrupts import INTERRUPTED, insist, interrupt_handled


def main() -> None:
    """Run the command line."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small here: its threads would wait more than they compute
    if next((word for word in sys.argv[1:] if not word.startswith("-")), "") == "live":
        from trackres_ros.node.process import REQUESTS

        REQUESTS.listen()
    else:
        insist()
    try:
        from trackres_ros.files.interpreter import SAFE
        from trackres_ros.tasks.main import main as run
    except KeyboardInterrupt:
        interrupt_handled()
        print("trackres: interrupted before the start", file=sys.stderr)
        sys.exit(INTERRUPTED)
    os.environ.update(SAFE)
    try:
        run()
    except KeyboardInterrupt:  # in the moment in which the command line has just ended
        interrupt_handled()
        from trackres_ros.tasks.terminal import written_so_far

        print(f"trackres: interrupted; {written_so_far()}", file=sys.stderr)
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Entry point of the command `trackres`: handles signals and Ctrl-C before other modules load.

An interrupt is raised until it is handled, then ignored while the command ends.
"""

import os
import signal
import sys

INTERRUPTED = 130
AGAIN_S = 3.0  # longer than any command needs to clean up


def main() -> None:
    """Run the command line."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small here: its threads would wait more than they compute
    if next((word for word in sys.argv[1:] if not word.startswith("-")), "") == "live":
        from trackres_ros.node.signals import REQUESTS

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


def insist() -> None:
    """Raise an interrupt again until it is handled, because Python swallows it in callbacks and destructors."""
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGALRM, _interrupt)


def _interrupt(_number: int, _frame: object) -> None:
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    raise KeyboardInterrupt


def interrupt_handled() -> None:
    """Mark an interrupt as handled: no more are raised while the command ends."""
    # `python -m` ends by the signal if the interrupt met the evaluation of a string, as making a named tuple is one, whoever
    # caught it there (CPython's unhandled_keyboard_interrupt). Evaluating another string makes it forget that.
    exec("")
    if signal.getsignal(signal.SIGINT) is _interrupt:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, signal.SIG_IGN)

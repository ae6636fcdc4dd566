# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Handles Ctrl-C while a command runs: raised until handled, then ignored while the command ends."""

import signal

INTERRUPTED = 130
AGAIN_S = 3.0  # longer than any command needs to clean up


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

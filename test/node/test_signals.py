# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Requests by signals are kept, whether or not the log still has a reader."""

import os
import signal
import sys

import pytest

from trackres_ros.node.signals import SAVE, WHAT, SignalRequests


def test_a_signal_during_start_is_kept_with_the_log_pipe_closed(monkeypatch):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as nobody:
        monkeypatch.setattr(sys, "__stderr__", nobody)
        requests = SignalRequests()
        requests._take(SAVE, None)
        requests._take(signal.SIGTERM, None)
    assert requests._waiting == [SAVE]
    assert requests.to_stop


@pytest.fixture
def handlers():
    """The signal handlers of this process, put back afterwards."""
    before = {number: signal.getsignal(number) for number in WHAT}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_signals_that_end_a_process_end_the_node_in_order(handlers, number):
    signal.signal(number, signal.SIG_DFL)
    requests = SignalRequests()
    requests.listen()
    requests.started()
    os.kill(os.getpid(), number)
    assert requests.to_stop


def test_a_closed_terminal_ends_nothing_under_nohup(handlers):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    requests = SignalRequests()
    requests.listen()
    requests.started()
    os.kill(os.getpid(), signal.SIGHUP)
    assert not requests.to_stop

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Requests by signals are kept, whether or not the log still has a reader."""

import os
import signal
import sys

import pytest

from trackres_ros.node.process import SAVE, WHAT, SignalRequests


def test_a_signal_during_start_is_kept_with_the_log_pipe_closed(monkeypatch):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as nobody:
        monkeypatch.setattr(sys, "__stderr__", nobody)
        requests = SignalRequests()
        requests._note(SAVE, None)
        requests._note(signal.SIGTERM, None)
    assert requests._pending_signals == [SAVE]
    assert requests.to_stop


@pytest.fixture
def handlers():
    """The signal handlers of this process, put back afterwards."""
    result_befores = {number: signal.getsignal(number) for number in WHAT}
    yield
    for number, handler in result_befores.items():
        signal.signal(number, handler)


def test_a_signal_waits_until_all_are_listened_to(handlers, monkeypatch):
    """A process that listens to one of them ends by no other: what is sent in between comes afterwards."""
    for number in WHAT:
        signal.signal(number, signal.SIG_DFL)
    install, pending = signal.signal, set()

    def install_while_another_comes(number, handler):
        install(number, handler)
        signal.raise_signal(SAVE)  # to this thread: at the start of a node there is no other
        pending.update(signal.sigpending())

    monkeypatch.setattr(signal, "signal", install_while_another_comes)
    requests = SignalRequests()
    requests.listen()
    assert pending == {SAVE}
    assert requests._pending_signals == [SAVE]
    assert not signal.sigpending() & set(WHAT)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_signals_that_end_a_process_end_the_node_in_order(handlers, number):
    signal.signal(number, signal.SIG_DFL)
    requests = SignalRequests()
    requests.listen()
    requests.start()
    os.kill(os.getpid(), number)
    assert requests.to_stop


def test_a_closed_terminal_ends_nothing_under_nohup(handlers):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    requests = SignalRequests()
    requests.listen()
    requests.start()
    os.kill(os.getpid(), signal.SIGHUP)
    assert not requests.to_stop

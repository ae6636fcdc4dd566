# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Requests by signals are kept, whether or not the log still has a reader."""

import os
import signal
import sys

from trackres_ros.node.signals import SAVE, SignalRequests


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

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Waiting in tests: for a condition, as long as whoever is to bring it about still works on it; and the pace of what is sent.

In tests of processes nothing else sleeps, see `test_waiting.py`. A fixed time is too long on one machine and too short on
another; a condition is neither.
"""

import os
import signal
import time
from pathlib import Path

POLL_S, FIRST_POLL_S, FIRST_POLLS = 0.01, 0.001, 10  # what answers a message does so within milliseconds
PATIENCE_S = 30.0  # without progress
LEAST_PROGRESS = 0.05  # of a processor, over the time waited: what only idles in its loop uses less
MOST_WORK_S = 600.0  # of processor time: whoever needs more does not come to an end
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def wait_for(holds, patience_s=PATIENCE_S, working=None, meanwhile=None):
    """Wait until something holds.

    Parameters
    ----------
    holds
        The condition, a function.
    patience_s
        How long to wait without any progress [s].
    working
        Process id of who brings it about: as long as it, or what it has started, computes, or is kept from it by others, that is
        progress. So what a fast machine has done in a second may take a slow or a busy one a minute.
    meanwhile
        What to do between two looks; nothing by default.

    Returns
    -------
    Whether it came to hold.
    """
    begun, kept = work_s(working), kept_waiting_s(working)
    used = begun
    until = time.monotonic() + patience_s
    looks = 0
    while not holds():
        looks += 1
        if time.monotonic() > until:
            before, used = used, work_s(working)
            kept_before, kept = kept, kept_waiting_s(working)
            progress = used - before + max(0.0, kept - kept_before)
            if progress <= LEAST_PROGRESS * patience_s or used - begun > MOST_WORK_S:
                return False
            until = time.monotonic() + patience_s
        if meanwhile:
            meanwhile()
        time.sleep(FIRST_POLL_S if looks <= FIRST_POLLS else POLL_S)
    return True


def exit_code(process, patience_s=PATIENCE_S):
    """Exit code of a process that is to end, waited for as long as it works. One that does not come to its end is aborted, and
    shows where each of its threads was, see `faulthandler`.
    """
    if not wait_for(lambda: process.poll() is not None, patience_s, working=process.pid):
        process.send_signal(signal.SIGABRT)
        if process.stderr:
            print(process.stderr.read())
    return process.wait()


def work_s(pid):
    """Processor time of a process and of all it has started, ended ones too [s]; 0 where there is none any more."""
    return sum(family(pid).values()) / _TICKS_PER_S


def family(pid):
    """A process and all it has started, with the clock ticks that each and its ended children have had."""
    if pid is None:
        return {}
    stats = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended meanwhile
            continue
        stats[int(path.parent.name)] = (int(fields[1]), sum(map(int, fields[11:15])))  # parent; of its own and of ended children
    found, newest = {}, {pid}
    while newest:
        found |= {member: stats[member][1] for member in newest if member in stats}
        newest = {member for member, (parent, _) in stats.items() if parent in newest}
    return found


def kept_waiting_s(pid):
    """How long a process and all it has started were ready to compute while others did [s]; 0 where the system does not say."""
    found = 0
    for member in family(pid):
        for path in Path(f"/proc/{member}/task").glob("*/schedstat"):
            try:
                found += int(path.read_text().split()[1])
            except (OSError, IndexError):  # it has ended meanwhile, or the system does not count
                continue
    return found * 1e-9


class Pace:
    """Sends at a rate, independent of the duration of each sending: call `next` after each."""

    def __init__(self, hz):
        self._period_s, self._due = 1.0 / hz, time.monotonic()

    def next(self):
        """Wait until the next one is due; those that are late already are not waited for."""
        self._due += self._period_s
        time.sleep(max(0.0, self._due - time.monotonic()))

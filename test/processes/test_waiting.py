# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Waiting: ends with the condition, continues while there is work, and gives up on an idle process."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import waiting
from waiting import Pace, exit_code, kept_waiting_s, wait_for, work_s

TESTS = Path(__file__).parents[1]
BUSY = "import time\nend = time.process_time() + 1.0\nwhile time.process_time() < end: pass\nopen({!r}, 'w').close()\ninput()"


@pytest.fixture
def start():
    started = []

    def run(program):
        started.append(subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE))
        return started[-1]

    yield run
    for process in started:
        process.kill()
        process.wait()
        process.stdin.close()


def test_it_ends_as_soon_as_it_holds_and_looks_at_least_once():
    looks = iter([False, False, True])
    assert wait_for(lambda: next(looks))
    assert wait_for(lambda: True, patience_s=0.0)
    assert not wait_for(lambda: False, patience_s=0.0)
    done = []
    assert wait_for(lambda: len(done) == 3, meanwhile=lambda: done.append(1))


def test_who_works_is_waited_for_and_who_idles_is_not(start, tmp_path, monkeypatch):
    monkeypatch.setattr(waiting, "LEAST_PROGRESS", 1e-9)  # however little of the processor is left for it here
    there = tmp_path / "there"
    busy = start(f"import subprocess, sys; subprocess.run([sys.executable, '-c', {BUSY.format(str(there))!r}])")
    assert wait_for(there.exists, patience_s=0.5, working=busy.pid)  # others may have all processors for a while
    assert work_s(busy.pid) >= 1.0  # its children's
    assert work_s(None) == 0.0
    assert not wait_for(lambda: False, patience_s=0.2, working=busy.pid)


def test_who_works_without_end_is_given_up(start, monkeypatch):
    monkeypatch.setattr(waiting, "LEAST_PROGRESS", 1e-9)
    monkeypatch.setattr(waiting, "MOST_WORK_S", 0.3)
    assert not wait_for(lambda: False, patience_s=0.2, working=start("while True: pass").pid)


def test_an_exit_code_is_waited_for_and_who_idles_says_where(start, tmp_path, monkeypatch, capfd):
    idle = start("import faulthandler; faulthandler.enable()\ndef dreaming(): input()\ndreaming()")
    assert exit_code(idle, patience_s=0.5) == -signal.SIGABRT
    assert "in dreaming" in capfd.readouterr().err
    monkeypatch.setattr(waiting, "LEAST_PROGRESS", 1e-9)
    busy = start(BUSY.format(str(tmp_path / "there")).replace("input()", "raise SystemExit(3)"))
    assert exit_code(busy, patience_s=0.2) == 3


def test_who_is_kept_from_computing_is_waited_for(start):
    """Two that compute without end on one processor: each waits for the other half of the time."""
    one = min(os.sched_getaffinity(0))
    pair = [start(f"import os; os.sched_setaffinity(0, {{{one}}})\nwhile True: pass") for _ in range(2)]
    if not Path("/proc/self/schedstat").exists():
        pytest.skip("this system does not count who waits for a processor")
    assert wait_for(lambda: all(kept_waiting_s(process.pid) > 0.2 for process in pair), working=pair[0].pid)
    assert kept_waiting_s(None) == 0.0


def test_what_tests_start_heeds_an_interrupt(start, tmp_path):
    idle = start(f"open({str(tmp_path / 'begun')!r}, 'w'); input()")
    assert wait_for((tmp_path / "begun").exists, working=idle.pid)  # an interrupt of a start ends it in another way
    idle.send_signal(signal.SIGINT)
    assert exit_code(idle) == -signal.SIGINT


def test_it_does_so_too_where_tests_run_in_the_background():
    """As `make test &` in a script: a shell without job control lets its background ignore an interrupt."""
    law = f"{__file__}::{test_what_tests_start_heeds_an_interrupt.__name__}"
    command = ["sh", "-c", '"$@" & wait $!', "sh", sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", law]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_pace_is_kept_over_what_takes_longer():
    begin, pace = time.monotonic(), Pace(100.0)
    for _ in range(5):
        pace.next()
    assert time.monotonic() - begin >= 0.05


def test_nothing_else_sleeps_in_tests_of_processes():
    found = [
        f"{path.relative_to(TESTS)}: {line.strip()}"
        for folder in ("processes", "dds", "cli")
        for path in sorted((TESTS / folder).glob("*.py"))
        for line in path.read_text().splitlines()
        if path.name != "waiting.py" and re.search(r"\bsleep\(", line)
    ]
    assert not found

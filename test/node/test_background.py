# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A log that nobody takes keeps no process from its end, with a buffer before it and without."""

import subprocess
import sys

import pytest

STUCK = """
import fcntl, os, sys
read_end, write_end = os.pipe()
fcntl.fcntl(write_end, fcntl.F_SETPIPE_SZ, 4096)
os.dup2(write_end, 2)
from trackres_ros.node.process import ErrorLines
lines = ErrorLines()
for _ in range(100):
    lines.put(200 * "x")
lines.close(0.2)
"""


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_process_ends_though_nobody_takes_its_log(unbuffered, monkeypatch):
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    assert subprocess.run([sys.executable, "-c", STUCK], timeout=60.0, check=False).returncode == 0


def test_all_lines_that_are_taken_arrive_whole():
    text = """
from trackres_ros.node.process import ErrorLines
lines = ErrorLines()
for i in range(50):
    lines.put(f"{i} " + 9000 * "é")
lines.close(30.0)
"""
    process = subprocess.run([sys.executable, "-X", "utf8", "-c", text], capture_output=True, timeout=60.0, check=True)
    lines = process.stderr.decode().splitlines()
    assert lines == [f"{i} " + 9000 * "é" for i in range(50)]

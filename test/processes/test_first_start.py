# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Signals while a node is still starting, its output for programs, and a user without a home."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import TRANSPORTS, environment
from ros_messages import stamped
from waiting import Pace, exit_code, wait_for, work_s

from trackres_ros.files.resources import cache_dir


@pytest.fixture
def begin():
    """Starts a process as `subprocess.Popen` does; none outlives its test."""
    begun = []

    def start(*words, **given):
        begun.append(subprocess.Popen(*words, **given))
        return begun[-1]

    yield start
    for process in begun:
        process.kill()
        process.communicate()  # closes its pipes too


def command(transport, folder, *more):
    words = [sys.executable, "-m", "trackres_ros", "live", "--transport", "dds" if transport == "dds" else "ros", "--quiet"]
    return [*words, "--vehicle", "xgd24d", "-p", f"state_file:={folder / 'state.json'}", *more]


def when_it_listens(process):
    """As soon as python has come to the program's first line: a signal before is the system's."""

    def listens():
        status = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        caught = next(line for line in status if line.startswith("SigCgt"))
        return int(caught.split()[1], 16) & (1 << (signal.SIGUSR1 - 1))

    assert wait_for(listens, working=process.pid), "it never listened"


@pytest.mark.parametrize("transport", TRANSPORTS)
@pytest.mark.parametrize(("number", "further_s"), [(signal.SIGTERM, 0.0), (signal.SIGINT, 0.1), (signal.SIGTERM, 0.3)])
def test_a_stop_signal_during_start_ends_with_exit_code_0(transport, tmp_path, begin, number, further_s):
    """At moments that are as far into the start, by the work done, on any machine."""
    process = begin(
        command(transport, tmp_path),
        env=environment(transport, tmp_path),
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    when_it_listens(process)
    then = work_s(process.pid) + further_s
    assert wait_for(lambda: work_s(process.pid) >= then)
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 0, said
    assert f"{number.name} while starting" in said or "before it is written" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_save_and_reset_signals_act_once_it_runs_and_then_too(transport, tmp_path, begin):
    """There is nothing to save before a speed: each save says so."""
    log = tmp_path / "log"
    with log.open("w") as said:
        process = begin(command(transport, tmp_path), env=environment(transport, tmp_path), stderr=said, stdout=said)
    when_it_listens(process)
    restarts = lambda: log.read_text().count("estimate restarts")  # noqa: E731
    for times in (1, 2):
        for number in (signal.SIGUSR1, signal.SIGUSR2):
            process.send_signal(number)
        assert wait_for(lambda times=times: restarts() >= times or process.poll() is not None, working=process.pid), (
            log.read_text()
        )
        assert process.poll() is None, log.read_text()
        refused = lambda times=times: log.read_text().count("before it is written") >= times  # noqa: E731
        assert wait_for(refused, working=process.pid), log.read_text()
    process.send_signal(signal.SIGTERM)
    assert exit_code(process) == 0
    assert "Traceback" not in log.read_text()


def test_lines_of_json_for_programs(tmp_path, wire, begin):
    speed = wire.publisher("/json/speed", "geometry_msgs/msg/TwistStamped")
    words = [*command("dds", tmp_path, "--json"), "--namespace", "/json"]
    process = begin(words, env=environment("dds", tmp_path), stdout=subprocess.PIPE, text=True)
    lines = []
    while len(lines) < 3:
        if speed.matched:
            pace = Pace(50.0)
            for step in range(20):
                linear = {"x": 8.0 + 0.01 * step, "y": 0.0, "z": 0.0}
                speed.publish(header=stamped(time.time_ns()), twist={"linear": linear})
                pace.next()
        lines.append(json.loads(process.stdout.readline()))
    process.send_signal(signal.SIGTERM)
    lines += [json.loads(line) for line in process.stdout]
    assert exit_code(process) == 0
    assert [line["final"] for line in lines] == [False] * (len(lines) - 1) + [True]
    assert lines[-1]["estimate"]["resistance_torque_nm"] > 1000.0
    assert {given["role"] for given in lines[-1]["inputs"]} == {"speed", "load", "ambient"}


NOBODY = """
import pwd
def unknown(_uid):
    raise KeyError("nobody knows this user")
pwd.getpwuid = unknown
from trackres_ros.__main__ import main
main()
"""


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_without_home_or_user_entry_the_node_runs_and_warns(transport, tmp_path, wire, begin):
    kept = {k: v for k, v in environment(transport, tmp_path).items() if k not in ("HOME", "XDG_STATE_HOME")}
    kept.setdefault("XDG_CACHE_HOME", str(cache_dir().parent))
    log = tmp_path / "log"
    with log.open("w") as said:
        words = [sys.executable, "-c", NOBODY, *command(transport, tmp_path)[3:-2], "--namespace", "/nobody"]
        process = begin(words, env=kept, stderr=said, stdout=said)
    status = wire.subscribe("/nobody/trackres/status", "diagnostic_msgs/msg/DiagnosticArray")

    def said_or_ended():
        return any("STATE_NOT_SAVED" in str(heard.message) for heard in status.update()) or process.poll() is not None

    assert wait_for(said_or_ended, working=process.pid), log.read_text()
    assert process.poll() is None, log.read_text()
    process.send_signal(signal.SIGTERM)
    assert exit_code(process) == 0, log.read_text()
    assert "no home folder" in log.read_text()
    assert "Traceback" not in log.read_text()

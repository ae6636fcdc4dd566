# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The first start on a machine, with nothing compiled yet, and signals while a node is still starting."""

import itertools
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import TRANSPORTS, Node, environment
from waiting import Pace, exit_code, wait_for, work_s

from trackres_ros.files.resources import cache_dir

REFUSALS_AND_ACCEPTED = (
    "accepted",
    "non_finite",
    "out_of_range",
    "duplicate",
    "late",
    "future",
    "backward",
    "implausible",
    "bad_stamp",
)
HZ = 1000


@pytest.fixture
def uncompiled(monkeypatch, tmp_path):
    """An empty cache for every process that is started."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)


@pytest.mark.long
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_two_compiling_nodes_count_all_speeds_and_no_clock_jump(transport, tmp_path, wire, uncompiled):
    nodes = [Node(transport, tmp_path, wire, name=name, namespace=f"/{name}") for name in ("left", "right")]
    try:
        for node in nodes:
            node.started()
        begin, pace = time.monotonic(), Pace(HZ)
        for count in itertools.count():
            for node in nodes:
                node.send("speed", 8.0 + 0.001 * (count % 7))
            pace.next()
            if count % HZ == 0 and count >= 8 * HZ and time.monotonic() - begin > 8.0:
                compiling = [node.notices(max(0, len(node.statuses()) - 3)) for node in nodes]
                if not any("COMPILING" in names for names in compiling) or time.monotonic() - begin > 60.0:
                    break
        for node in nodes:
            sent = node.inputs["speed"].sent

            def found(node=node):
                values = node.values("input speed")
                return {name: int(values.get(name, 0)) for name in (*REFUSALS_AND_ACCEPTED, "dropped", "clock_jump")}

            node.until(lambda sent=sent, found=found: sum(found().values()) >= sent, f"{sent} in the counters")
            assert sum(found().values()) == sent
            assert found()["clock_jump"] == 0
            assert found()["accepted"] > 0
            assert "CLOCK_JUMPED" not in node.notices()
            assert node.stop() == 0, node.log
    finally:
        for node in nodes:
            node.close()


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
@pytest.mark.parametrize("further_s", [0.0, 0.2, 0.6])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_signal_during_start_ends_with_exit_code_0(transport, tmp_path, number, further_s):
    """At moments that are as far into the start, by the work done, on any machine."""
    process = subprocess.Popen(
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
    assert f"{number.name} while starting" in said or "state saved" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_save_and_reset_signals_during_start_act_once_it_runs(transport, tmp_path):
    log = tmp_path / "log"
    with log.open("w") as said:
        process = subprocess.Popen(command(transport, tmp_path), env=environment(transport, tmp_path), stderr=said, stdout=said)
    when_it_listens(process)
    for number in (signal.SIGUSR1, signal.SIGUSR2):
        process.send_signal(number)
    ended_or = lambda holds: holds or process.poll() is not None  # noqa: E731
    assert wait_for(lambda: ended_or("estimate restarts" in log.read_text()), working=process.pid), log.read_text()
    assert process.poll() is None, log.read_text()
    assert (tmp_path / "state.json").exists()
    process.send_signal(signal.SIGTERM)
    assert exit_code(process) == 0
    assert "Traceback" not in log.read_text()


def test_lines_of_json_for_programs(tmp_path, wire):
    node = Node("dds", tmp_path, wire)  # for its publishers
    environment_ = environment("dds", tmp_path)
    process = subprocess.Popen(
        [*command("dds", tmp_path, "--json"), "--namespace", "/json"], env=environment_, stdout=subprocess.PIPE, text=True
    )
    try:
        speed = wire.publisher("/json/speed", "geometry_msgs/msg/TwistStamped")
        lines = []
        while len(lines) < 3:
            if speed.matched:
                pace = Pace(50.0)
                for step in range(20):
                    node.inputs["speed"], kept = speed, node.inputs["speed"]
                    node.send("speed", 8.0 + 0.01 * step)
                    node.inputs["speed"] = kept
                    pace.next()
            lines.append(json.loads(process.stdout.readline()))
        process.send_signal(signal.SIGTERM)
        lines += [json.loads(line) for line in process.stdout]
        assert exit_code(process) == 0
    finally:
        process.stdout.close()
        if process.poll() is None:
            process.kill()
        node.close()
        speed.close()
    assert [line["final"] for line in lines] == [False] * (len(lines) - 1) + [True]
    assert lines[-1]["estimate"]["resistance_torque_nm"] > 1000.0
    assert {given["role"] for given in lines[-1]["inputs"]} == {"speed", "load", "ambient"}


NOBODY = """
import pwd
def unknown(_uid):
    raise KeyError("nobody knows this user")
pwd.getpwuid = unknown
from trackres_ros.cli.entry import main
main()
"""


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_without_home_or_user_entry_the_node_runs_and_warns(transport, tmp_path, wire):
    kept = {k: v for k, v in environment(transport, tmp_path).items() if k not in ("HOME", "XDG_STATE_HOME")}
    kept.setdefault("XDG_CACHE_HOME", str(cache_dir().parent))
    log = tmp_path / "log"
    with log.open("w") as said:
        words = [sys.executable, "-c", NOBODY, *command(transport, tmp_path)[3:-2], "--namespace", "/nobody"]
        process = subprocess.Popen(words, env=kept, stderr=said, stdout=said)
    status = wire.subscribe("/nobody/trackres/status", "diagnostic_msgs/msg/DiagnosticArray")

    def said_or_ended():
        return any("STATE_NOT_SAVED" in str(heard.message) for heard in status.update()) or process.poll() is not None

    assert wait_for(said_or_ended, working=process.pid), log.read_text()
    assert process.poll() is None, log.read_text()
    process.send_signal(signal.SIGTERM)
    assert exit_code(process) == 0, log.read_text()
    assert "no home folder" in log.read_text()
    assert "Traceback" not in log.read_text()

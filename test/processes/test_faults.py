# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Failures outside the step do not affect the torque of a node process; if the process ends, the torque fades first."""

import itertools
import resource
import signal
import time

import pytest
from waiting import exit_code, wait_for

from trackres_ros.node.record import MB
from trackres_ros.tasks.recordings import read

RATE = 4000.0  # Nm/s: so slow that the fade is seen
RUN = "from trackres_ros.tasks.main import main; import sys; main(sys.argv[1:])"
WAIT_FAILS = f"""
from pathlib import Path
def failing(wait):
    def waits(*given, **named):
        if Path("{{flag}}").exists():
            raise OSError(5, "the wire is gone")
        return wait(*given, **named)
    return waits
if "{{transport}}" == "dds":
    from trackres_ros.node.dds.wire import Participant
    waiter = Participant.waiter
    Participant.waiter = lambda self: failing(waiter(self))
else:
    from rclpy.executors import SingleThreadedExecutor
    SingleThreadedExecutor.spin_once = failing(SingleThreadedExecutor.spin_once)
{RUN}
"""
STUCK = f"""
import fcntl, os, sys
# With buffers, whatever PYTHONUNBUFFERED says.
sys.stdout, sys.stderr = (open(number, "w", buffering=1, closefd=False) for number in (1, 2))
kept = []
for number in (1, 2):
    read_end, write_end = os.pipe()
    kept.append(read_end)
    fcntl.fcntl(write_end, fcntl.F_SETPIPE_SZ, 4096)
    os.dup2(write_end, number)
{RUN}
"""


def messages_of(path):
    found = read(path, topics="default")
    return found.series["speed"], [finding.text for finding in found.findings if finding.kind == "structure"]


def test_a_killed_recording_loses_less_than_a_second(node, tmp_path, good):
    n = node(options=("--record", tmp_path / "drive.mcap"))
    n.drive(2.5)
    killed_ns = time.time_ns()
    n.stop(signal.SIGKILL)
    part = tmp_path / "drive.mcap.part"
    assert not (tmp_path / "drive.mcap").exists()
    speed, notes = messages_of(part)
    assert (killed_ns - int(speed.stamp_ns[-1])) * 1e-9 < 1.0
    assert "is unfinished" in notes[0]
    good("recover", part, "-o", tmp_path / "again.mcap")
    again, notes = messages_of(tmp_path / "again.mcap")
    assert len(again) == len(speed) > 60
    assert not notes
    other = node(options=("--record", tmp_path / "drive.mcap"))
    other.drive(0.5)
    assert other.stop() == 0
    assert f"{part} is unfinished" in other.log
    assert len(messages_of(part)[0]) == len(speed)
    assert messages_of(tmp_path / "drive.mcap")[1] == []


def test_a_full_disk_pauses_the_recording_not_the_torque(node, tmp_path):
    most = int(0.3 * MB)
    full = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))  # noqa: E731
    n = node(options=("--record", tmp_path / "drive.mcap"), preexec=full)
    n.noticed("NOT_RECORDED", meanwhile=lambda: n.drive(0.3))
    before = len(n.torques())
    n.drive(2.0)
    assert len(n.torques()) - before > 80
    assert min(n.torques()[-50:]) > 1000.0
    assert n.level() == 1, [(s.level, s.message) for s in n.statuses()[-12:]]
    said = n.status().message
    assert "drive.mcap.part: File too large; lost so far:" in said
    assert n.stop() == 0
    assert "not recorded: " in n.log
    (there,) = tmp_path.glob("drive.mcap*")  # finished, if its end was short enough
    assert len(messages_of(there)[0]) > 20


def test_a_log_and_an_output_that_nobody_takes_hold_nothing_up(transport, node):
    if transport != "dds":
        pytest.skip("the log of ROS 2 waits for who takes it, and what runs there has no output")
    n = node(program=STUCK, options=("--json",)).healthy()
    begun = len(n.statuses())

    def save_in_vain():
        n.process.send_signal(signal.SIGUSR1)
        n.drive(0.02)

    for _ in range(100):  # each is a line of the log; together more than the pipe takes
        save_in_vain()
    enough = lambda: len(n.statuses()) >= begun + 7  # noqa: E731 - and so many lines of output, one a second
    n.until(enough, "lines enough for the pipe", meanwhile=lambda: n.drive(0.2))
    before = len(n.torques())
    n.until(lambda: len(n.torques()) - before > 40, "torques going on", meanwhile=lambda: n.drive(0.3))
    assert n.stop() == 0


@pytest.mark.parametrize("how", ["fault", "signal"])
def test_the_feedforward_fades_before_the_process_ends(transport, node, tmp_path, how):
    flag = tmp_path / "fails"
    n = node(program=WAIT_FAILS.format(flag=flag, transport=transport), feedforward_rate=RATE, feedforward_fade_s=5.0)
    n.drive(2.0)
    highest = max(n.torques())
    assert highest > 1500.0
    began = len(n.torques())
    if how == "fault":
        flag.touch()
        assert exit_code(n.process) == 1
        assert "the main loop failed" in n.log
        assert "the wire is gone" in n.log
    else:
        assert n.stop(signal.SIGTERM) == 0
    assert wait_for(lambda: n.torques()[-1] == 0.0)
    heard = [(h.at_s, h.message.wrench.torque.y) for h in n.out["feedforward"].update()][began - 1 :]
    steps = [before - now for (_, before), (_, now) in itertools.pairwise(heard)]
    assert max(steps) < 0.2 * highest
    assert len([step for step in steps if step > 0.0]) > 10

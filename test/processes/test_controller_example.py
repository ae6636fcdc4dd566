# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""examples/07_controller.py beside a real node: what it adds while the speed is lost, and once the node dies."""

import itertools
import signal
import time

import numpy as np
from waiting import Pace

STALE = 3
RAMP_NM_PER_S, SILENCE_S, LONGEST_ELAPSED_S = 5000.0, 0.2, 0.1  # of the example
HZ = 50.0


class Beside:
    """The example's controller, in a loop of 50 Hz beside the node."""

    def __init__(self, example, node):
        self.drive, self.node, self.taken = example.Drive(), node, 0
        self.ticks = []  # time [s], added torque, torque of the last message [Nm], its level

    def run(self, holds, speed=None, patience_s=60.0):
        """Tick until something holds; send a speed each time, if given."""
        pace, until = Pace(HZ), time.monotonic() + patience_s
        while not holds():
            assert time.monotonic() < until, self.ticks[-20:]
            if speed is not None:
                self.node.send("speed", speed)
            for heard in self.node.out["estimate"].update()[self.taken :]:
                self.taken += 1
                group = heard.message.interface_values[list(heard.message.interface_groups).index("vehicle")]
                found = dict(zip(group.interface_names, group.values, strict=True))
                stamp = heard.message.header.stamp
                self.drive.on_estimate(stamp.sec + stamp.nanosec * 1e-9, found["feedforward_torque_nm"], found["level"])
            now = time.time()
            self.drive.torque(now, 0.0, 0.0)
            self.ticks.append((now, self.drive.used, self.drive.feedforward, self.drive.level))
            pace.next()

    def column(self, i, first=0):
        return np.array([tick[i] for tick in self.ticks[first:]])


def test_the_example_fades_with_the_node_and_ramps_after_it(node, imported):
    running = node()
    running.healthy()
    beside = Beside(imported("examples/07_controller.py"), running)
    drive = beside.drive
    beside.run(lambda: drive.used == drive.feedforward > 2000.0, speed=8.0)
    lost = len(beside.ticks)
    beside.run(lambda: drive.level == STALE and drive.used == 0.0)
    added, given, level = (beside.column(i, lost) for i in (1, 2, 3))
    on_its_way = (level == STALE) & (given > 0.0)
    assert on_its_way.sum() > 10
    assert (added >= given - 1e-6)[on_its_way].mean() > 0.8  # unless the machine keeps the node from its outputs
    beside.run(lambda: drive.used == drive.feedforward > 2000.0, speed=8.0)
    running.process.send_signal(signal.SIGKILL)
    running.process.wait()
    died, begin = len(beside.ticks), drive.used
    beside.run(lambda: drive.used == 0.0)
    elapsed_s = np.minimum(np.diff(beside.column(0, died)), LONGEST_ELAPSED_S).sum()
    assert elapsed_s < SILENCE_S + LONGEST_ELAPSED_S + begin / RAMP_NM_PER_S
    for (before_s, before, *_), (now_s, now, *_) in itertools.pairwise(beside.ticks):
        assert abs(now - before) <= RAMP_NM_PER_S * min(now_s - before_s, LONGEST_ELAPSED_S) + 1e-6

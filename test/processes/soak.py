# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Vehicle time by simulated clock with random faults of every kind; what must hold is counted and checked.

By hand, for as long as wanted: `python test/processes/soak.py --transport dds --minutes 30`.
"""

import argparse
import math
import random
import tempfile
import time
from pathlib import Path

from waiting import Pace

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
HZ = 100
TORQUE_TOPIC = """
speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}
load: {topic: load, type: std_msgs/msg/Float64, field: data}
ambient: {topic: ambient, type: sensor_msgs/msg/Temperature, field: temperature}
torque: {topic: torque, type: geometry_msgs/msg/WrenchStamped, field: wrench.torque.y}
"""
PARAMETERS = {
    "use_sim_time": True,
    "output_rate_hz": 50.0,
    # Nothing may be lost between the processes, as every message is to be found in a counter.
    "input_reliability": "reliable",
    "input_depth": 10000.0,
}
REFUSALS_AND_ACCEPTED = (
    "accepted", "non_finite", "out_of_range", "duplicate", "late", "future", "backward", "implausible", "bad_stamp", "unused",
)  # fmt: skip
FAULTS = (
    "nan", "infinite", "huge", "stamp zero", "stamp repeated", "stamp back", "stamp ahead", "late", "no speed", "no load", "loop",
    "flood", "two publishers", "restart", "trickle", "quantised", "stuck", "load nan", "torque nan",
)  # fmt: skip


class Soak:
    """One run over a node that has started with `PARAMETERS` and `TORQUE_TOPIC`."""

    def __init__(self, node, seed, speedup):
        self.node, self.random, self.speedup = node, random.Random(seed), speedup
        self.now_ns = START_NS
        prefix = node.base.rpartition("/")[0]
        self.torque = node.wire.publisher(f"{prefix}/torque", "geometry_msgs/msg/WrenchStamped")
        self.clock = node.wire.publisher("/clock", "rosgraph_msgs/msg/Clock")
        self.speed_topic = f"{prefix}/speed"
        self.second = None
        self.sent = {"speed": 0, "load": 0, "ambient": 0, "torque": 0}
        self.faults, self.coming = dict.fromkeys(FAULTS, 0), []
        self.outputs, self.memory = 0, []
        node.until(lambda: self.torque.matched and self.clock.matched, "torque and clock to connect")
        node.sees_its_publishers(self.tell_time)

    def run(self, minutes):
        """Drive so many minutes of vehicle time; then check."""
        begin, steps, pace = time.monotonic(), int(minutes * 60 * HZ), Pace(HZ * self.speedup)
        fault, left = None, 0
        for step in range(steps):
            if left == 0:
                fault = None if fault else self.next_fault()
                left = int(HZ * self.random.uniform(0.5, 4.0))
                self.begin(fault)
            left -= 1
            self.step(step, fault)
            pace.next()
            if step % 500 == 0:
                self.collect()
        self.wall_s = time.monotonic() - begin
        self.finish()

    def next_fault(self):
        """All faults in a random order, and again in another."""
        if not self.coming:
            self.coming = self.random.sample(FAULTS, len(FAULTS))
        return self.coming.pop()

    def begin(self, fault):
        """One action of a fault."""
        if self.second:
            self.second.delivered()
            self.second.close()
            self.second = None
        if fault is None:
            return
        self.faults[fault] += 1
        if fault == "loop":
            self.node.inputs["speed"].delivered()
            self.now_ns -= 10 * SECOND_NS
        elif fault == "two publishers":
            self.second = self.node.wire.publisher(self.speed_topic, "geometry_msgs/msg/TwistStamped")
            self.seen(self.second, "the second publisher")
        elif fault == "restart":
            self.node.inputs["speed"].delivered()
            self.node.inputs["speed"].close()
            self.node.inputs["speed"] = self.node.wire.publisher(self.speed_topic, "geometry_msgs/msg/TwistStamped")
            self.seen(self.node.inputs["speed"], "the new publisher")

    def seen(self, publisher, what):
        """Wait until a publisher and the node know each other: earlier messages are not kept."""
        since = len(self.node.statuses())
        # The node looks at who publishes once a second, and tells; it may have looked just before the publisher came.
        told = lambda: len(self.node.statuses()) >= since + 2 and "NO_PUBLISHER" not in self.node.last_remarks()  # noqa: E731
        self.node.until(lambda: publisher.matched and told(), what)

    def tell_time(self):
        """Set the clock."""
        self.clock.publish(clock={"sec": self.now_ns // SECOND_NS, "nanosec": self.now_ns % SECOND_NS})

    def step(self, step, fault):
        """All messages of one hundredth of a second."""
        self.now_ns += SECOND_NS // HZ
        if step % 2 == 0:
            self.tell_time()
            torque = math.nan if fault == "torque nan" else 3000.0 + self.random.gauss(0.0, 200.0)
            self.torque.publish(header=self.header(), wrench={"torque": {"x": 0.0, "y": torque, "z": 0.0}})
            self.sent["torque"] += 1
        if step % 10 == 0 and fault != "no load":
            self.send("load", math.nan if fault == "load nan" else 272e3 * self.random.uniform(0.95, 1.05))
        if step % 100 == 0:
            self.send("ambient", 15.0)
        smooth = 8.0 + 4.0 * math.sin(step / 5000.0) + self.random.gauss(0.0, 0.02)
        value = {
            "nan": math.nan, "infinite": math.inf, "huge": 1e9, "quantised": round(smooth * 3.6) / 3.6, "stuck": 8.0,
        }.get(fault, smooth)  # fmt: skip
        stamp = {
            "stamp zero": 0, "stamp repeated": self.now_ns - self.now_ns % SECOND_NS, "stamp back": self.now_ns - 100 * SECOND_NS,
            "stamp ahead": self.now_ns + 3600 * SECOND_NS, "late": self.now_ns - SECOND_NS // 2,
        }.get(fault, self.now_ns)  # fmt: skip
        if fault == "no speed" or (fault == "trickle" and step % HZ):
            return
        for _ in range(10 if fault == "flood" else 1):
            self.send("speed", value, stamp)
        if self.second:
            self.second.publish(header=self.header(), twist={"linear": {"x": 7.0, "y": 0.0, "z": 0.0}})
            self.sent["speed"] += 1

    def header(self):
        """A header stamped now."""
        return {"stamp": {"sec": self.now_ns // SECOND_NS, "nanosec": self.now_ns % SECOND_NS}, "frame_id": "base_link"}

    def send(self, role, value, stamp=None):
        """A message that counts."""
        self.node.send(role, value, self.now_ns if stamp is None else stamp)
        self.sent[role] += 1

    def collect(self):
        """Look at the outputs so far, let go of them, and see how much memory the node has."""
        self.outputs += len(self.node.torques())
        self.node.check_outputs()
        names = self.node.notices()
        assert "INTERNAL_ERROR" not in names, self.node.log
        for subscription in self.node.out.values():
            del subscription.heard[:-2]
        self.outputs -= len(self.node.out["feedforward"].heard)
        pages = int(Path(f"/proc/{self.node.process.pid}/statm").read_text().split()[1])
        self.memory.append(pages * 4096 / 2**20)

    def counted(self, role):
        """Messages of a role that the node has counted."""
        values = self.node.values(f"input {role}")
        return sum(int(values.get(name, 0)) for name in REFUSALS_AND_ACCEPTED)

    def finish(self):
        """What must hold in the end."""
        if self.second:
            self.second.delivered()
            self.second.close()
        self.node.until(lambda: all(self.counted(role) >= sent for role, sent in self.sent.items()), f"all counted: {self.sent}")
        self.collect()
        assert {role: self.counted(role) for role in self.sent} == self.sent
        rate = self.outputs / self.wall_s
        assert 40.0 < rate < 60.0, f"outputs came at {rate:.1f} Hz"
        third = len(self.memory) // 3
        grown = max(self.memory[2 * third :]) - max(self.memory[third : 2 * third])
        assert grown < 2.0, f"memory has grown by {grown:.1f} MB: {self.memory}"

    def told(self):
        """The run in a few lines."""
        return (
            f"{sum(self.sent.values())} messages sent, all in a counter; "
            f"{self.outputs} outputs, {self.outputs / self.wall_s:.1f} Hz; memory {self.memory[len(self.memory) // 3]:.0f} to "
            f"{self.memory[-1]:.0f} MB; faults: " + ", ".join(f"{number} {name}" for name, number in self.faults.items())
        )


def main():
    """Run it by hand."""
    import conftest
    import peer

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--transport", choices=["dds", "ros", "fast"], default="dds")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--speedup", type=float, default=8.0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wire = peer.Wire(conftest.DOMAIN)
        node = conftest.Node(given.transport, Path(folder), wire, topics=TORQUE_TOPIC, **PARAMETERS).started()
        try:
            soak = Soak(node, given.seed, given.speedup)
            soak.run(given.minutes)
            assert node.stop() == 0, node.log
        finally:
            node.close()
        print(soak.told())


if __name__ == "__main__":
    main()

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A transport that keeps its messages, and a clock that moves only on request: the application without a middleware."""

import math
import shutil
from types import SimpleNamespace

import pytest

from trackres_ros.files.resources import config_dir
from trackres_ros.node.application import Application
from trackres_ros.node.parameters import make_parameters
from trackres_ros.node.transport import input_name
from trackres_ros.output.topics import ESTIMATE_TOPIC

START_NS = 1_700_000_000_000_000_000
SECOND_NS = 1_000_000_000
DISK_PATIENCE_S = 30.0
TOPICS = """
speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}
torque: {topic: torque, type: geometry_msgs/msg/WrenchStamped, field: wrench.torque.y}
"""
SPELLS = """
disturbance:
  form: spells
  level: {{value: {level}, unit: Nm, flag: F, range: [{low}, {high}], reason: found by trackres diagnose}}
  rest: {{value: 0.0, unit: Nm, flag: F, range: [-10.0, 10.0], reason: found by trackres diagnose}}
  mean_there: {{value: 60.0, unit: s, flag: F, range: [30.0, 90.0], reason: found by trackres diagnose}}
  mean_away: {{value: 120.0, unit: s, flag: F, range: [60.0, 180.0], reason: found by trackres diagnose}}
  noise: {{value: 100.0, unit: Nm, flag: F, range: [80.0, 120.0], reason: found by trackres diagnose}}
"""


class Desk:
    """One application, with its time in our hands [s since the start]."""

    def __init__(self, remapped=(), **given):
        self.remapped = dict(remapped)
        self.time_s, self.steady_s, self.simulated_in_a_second = 0.0, 0.0, 1.0
        self.clock_offset_s = 0.0  # of the machine's clock against steady time
        self.published, self.statuses, self.logged = [], [], []
        self.reasons, self.left = [], []  # of each estimate: reasons, and share of the feed-forward
        self.found_peers = {}
        self.found_rivals, self.latched, self.opened = (), [], 0
        self.sim_time = given.get("use_sim_time", False)
        parameters = {"vehicle": "xgd24d", "state_file": "none", "output_rate_hz": 0.0, **given}
        steady_ns, sleep = lambda: int(self.steady_s * SECOND_NS), lambda seconds: self.forward(seconds, tick=False)
        self.app = Application(make_parameters(parameters), self, steady_ns=steady_ns, sleep=sleep)
        self.app.clock.offset_ns = START_NS
        self.app.activate()

    def save(self):
        """Save the state, however busy the disk is; the text for the log."""
        return self.app.save_state(DISK_PATIENCE_S)

    def now_ns(self):
        return START_NS + round((self.time_s + self.clock_offset_s) * SECOND_NS)

    def publish(self, output, stamp_ns, values, reasons):
        self.published.append((self.app.outputs[output].name, stamp_ns, list(values)))
        if self.app.outputs[output] is ESTIMATE_TOPIC:
            self.reasons.append(dict(reasons))
            self.left.append(self.app.filter.share(self.app.clock.steady_ns()))

    def publish_status(self, output, stamp_ns, statuses):
        self.statuses.append((self.app.outputs[output].name, list(statuses)))

    def peers(self, index):
        return self.found_peers.get(self.app.inputs[index].name, ())

    def latch(self, index):
        self.latched.append(self.app.inputs[index].name)

    def rivals(self):
        return self.found_rivals

    def open_outputs(self):
        self.opened += 1

    def record(self, others):
        return [f"# {item.type}" for item in (*self.app.inputs, *others)]

    def topic_name(self, name):
        return self.remapped.get(name, input_name(name, "/"))

    def log(self, level, text):
        self.logged.append((level, text))

    def forward(self, seconds, tick=True):
        """Let time pass in steps of the tick's period."""
        remainder = seconds
        while remainder > 1e-9:
            step = min(remainder, self.app.period_s)
            self.time_s, self.steady_s = self.time_s + step * self.simulated_in_a_second, self.steady_s + step
            remainder -= step
            if tick:
                self.app.tick()

    def index(self, role):
        """Place of the input that feeds a role."""
        return next(i for i, given_values in enumerate(self.app.inputs) if role in given_values.valued)

    def send(self, role, value, stamp_s=None):
        """A message of a role, stamped now or at a time [s since the start]."""
        stamp = self.now_ns() if stamp_s is None else START_NS + round(stamp_s * SECOND_NS)
        self.app.messages.receive(self.index(role), self.message(role, *divmod(stamp, SECOND_NS), value))

    @staticmethod
    def message(role, seconds, nanoseconds, value):
        """A message of a role with a stamp, as a transport decodes it."""
        header = SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds))
        return {
            "speed": SimpleNamespace(header=header, twist=SimpleNamespace(linear=SimpleNamespace(x=value))),
            "load": SimpleNamespace(data=value),
            "ambient": SimpleNamespace(header=header, temperature=value),
            "torque": SimpleNamespace(header=header, wrench=SimpleNamespace(torque=SimpleNamespace(y=value))),
        }[role]

    def drive(self, seconds, speed=8.0, dt=0.02, **others):
        """Speeds every dt, with the given other inputs."""
        for _ in range(round(seconds / dt)):
            self.forward(dt)
            for role, value in others.items():
                self.send(role, value)
            self.send("speed", speed)

    def last(self, name):
        """Stamp and numbers of the last message of an output."""
        return next((stamp, values) for topic, stamp, values in reversed(self.published) if topic == name)

    def names(self):
        """Names of the notices now."""
        return {notice.name for notice in self.app.notices()}

    def all_finite(self):
        return all(math.isfinite(value) for _, _, values in self.published for value in values)


class Wild(Desk):
    """A transport that packs messages as a middleware does, and refuses those it is set to refuse."""

    def __init__(self, **given):
        self.broken, self.own_clock = set(), None
        super().__init__(**given)

    def _may(self, what):
        if what in self.broken:
            raise OSError(f"{what} does not work")

    def now_ns(self):
        self._may("now_ns")
        return super().now_ns() if self.own_clock is None else self.own_clock

    def publish(self, output, stamp_ns, values, reasons):
        self._may("publish")
        assert stamp_ns_fits(stamp_ns)
        super().publish(output, stamp_ns, values, reasons)

    def publish_status(self, output, stamp_ns, statuses):
        self._may("publish_status")
        assert stamp_ns_fits(stamp_ns)
        super().publish_status(output, stamp_ns, statuses)

    def peers(self, index):
        self._may("peers")
        return super().peers(index)

    def log(self, level, text):
        self._may("log")
        super().log(level, text)


def stamp_ns_fits(stamp):
    seconds, nanoseconds = divmod(stamp, SECOND_NS)
    return -(2**31) <= seconds < 2**31 and 0 <= nanoseconds < SECOND_NS


@pytest.fixture(scope="module")
def wild_by_clock():
    """One application on each kind of clock, simulated or not: to make one takes longer than a whole example."""
    made = {sim: Wild(output_rate_hz=rate, use_sim_time=sim) for sim, rate in ((False, 50.0), (True, 0.0))}
    yield made
    for item in made.values():
        item.broken.clear()
        item.app.close()


@pytest.fixture
def wild_desk(tmp_path):
    yield from _desks(Wild, tmp_path)


@pytest.fixture
def desk(tmp_path):
    """Makes an application, with a topics file of some `lines` or the default one."""
    yield from _desks(Desk, tmp_path)


@pytest.fixture(scope="module")
def standing_desk(tmp_path_factory):
    """As `desk`, for what several tests of a module look at."""
    yield from _desks(Desk, tmp_path_factory.mktemp("standing"))


def _desks(kind, folder):
    desks, file = [], folder / "topics.yaml"

    def make(lines="", **given):
        if lines:
            file.write_text(lines)
            given["topics"] = str(file)
        desks.append(kind(**given))
        return desks[-1]

    yield make
    for made in desks:
        made.app.close()


@pytest.fixture(scope="module")
def topics(tmp_path_factory):
    """Topics file with a speed and a torque."""
    file = tmp_path_factory.mktemp("topics") / "topics.yaml"
    file.write_text(TOPICS)
    return str(file)


@pytest.fixture
def disturbed(tmp_path):
    """File of a vehicle with spells of some torque [Nm] to watch for."""

    def made(level):
        vehicle = shutil.copytree(config_dir(), tmp_path / "config") / "disturbed.yaml"
        spells = SPELLS.format(level=level, low=0.9 * level, high=1.1 * level)
        vehicle.write_text((vehicle.parent / "xgd24d.yaml").read_text() + spells)
        return str(vehicle)

    return made

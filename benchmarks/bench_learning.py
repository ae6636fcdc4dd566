# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What learning adds to a node's share of a core: the same drive through the application, with learning off, watching and on.

No middleware is in it: with one the node's own share is larger, and what learning adds to it is less.
"""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from measuring import START_NS, at_most

from trackres_ros.node.application import Application
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.node.parameters import make_parameters
from trackres_ros.node.transport import Level, Peer, Reasons, Status
from trackres_ros.units import SECOND_NS

SECONDS, ROUNDS = 60.0, 5
RATE_HZ = 50.0
TOPICS = """
speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}
torque: {topic: torque, type: geometry_msgs/msg/WrenchStamped, field: wrench.torque.y}
"""
NODE_SHARE = 0.08  # of a core at 50 Hz: what bench_live asks of a node on DDS
TARGETS = {f"learning {mode}: of what a node may take [1]": at_most(0.2) for mode in ("watch", "on")}


class Nobody:
    """A transport to nothing: what is published goes nowhere, and the time is what it is set to."""

    steady_ns = 0

    def now_ns(self) -> int:
        """Set by who drives."""
        return START_NS + self.steady_ns

    def sleep(self, seconds: float) -> None:
        """Without waiting."""
        self.steady_ns += round(seconds * SECOND_NS)

    def publish(self, output: int, stamp_ns: int, values: Sequence[float], reasons: Reasons) -> None:
        """Nowhere."""

    def publish_status(self, output: int, stamp_ns: int, statuses: Sequence[Status]) -> None:
        """Nowhere."""

    def peers(self, index: int) -> Sequence[Peer]:  # noqa: ARG002
        """None."""
        return ()

    def record(self, others: Sequence[InputTopic]) -> Sequence[str | None]:
        """Nothing is recorded."""
        return [None for _ in others]

    def topic_name(self, name: str) -> str:
        """As it is."""
        return name

    def log(self, level: Level, text: str) -> None:
        """To nobody."""


class Drive:
    """One application, driven on."""

    def __init__(self, mode: str, topics: Path) -> None:
        self._transport = Nobody()
        given = {"vehicle": "xgd24d", "topics": str(topics), "state_file": "none", "learning": mode}
        now = lambda: self._transport.steady_ns  # noqa: E731
        self._app = Application(make_parameters(given), self._transport, steady_ns=now, sleep=self._transport.sleep)
        self._app.activate()
        roles = [given.roles[0] for given in self._app.inputs]
        self._torque, self._speed = roles.index("torque"), roles.index("speed")
        self._n = 0

    def on(self, seconds: float) -> float:
        """Drive for a while; the processor time it took [s]."""
        begin, app, transport = time.process_time(), self._app, self._transport
        for _ in range(round(seconds * RATE_HZ)):
            self._n += 1
            transport.steady_ns = round(self._n * SECOND_NS / RATE_HZ)
            now, at = transport.now_ns(), self._n / RATE_HZ
            app.messages.receive_values(self._torque, now, [3000.0 + 40.0 * math.sin(7.7 * self._n)])
            app.messages.receive_values(self._speed, now, [8.0 + 5.0 * math.sin(at / 20.0)])
            app.tick()
        return time.process_time() - begin

    def close(self) -> None:
        """End it."""
        self._app.close()


def run(seconds: float = SECONDS, rounds: int = ROUNDS) -> dict[str, float]:
    """Processor time of a second of driving at 50 Hz, and what learning adds; medians of rounds of some seconds of driving."""
    with tempfile.TemporaryDirectory() as folder:
        topics = Path(folder) / "topics.yaml"
        topics.write_text(TOPICS, encoding="utf-8")
        drives = {mode: Drive(mode, topics) for mode in ("off", "watch", "on")}
        times: dict[str, list[float]] = {mode: [] for mode in drives}
        for drive in drives.values():
            drive.on(min(seconds, 5.0))
        for _ in range(rounds):
            for mode, drive in drives.items():
                times[mode].append(drive.on(seconds))
        for drive in drives.values():
            drive.close()
    result = {f"learning {mode}: of a second of driving [ms]": 1e3 * statistics.median(t) / seconds for mode, t in times.items()}
    for mode in ("watch", "on"):
        ratios = [one / off for one, off in zip(times[mode], times["off"], strict=True)]
        result[f"learning {mode}: processor time over that without, no middleware"] = statistics.median(ratios)
        added = [one - off for one, off in zip(times[mode], times["off"], strict=True)]
        result[f"learning {mode}: of what a node may take [1]"] = max(statistics.median(added), 1e-9) / seconds / NODE_SHARE
    return result

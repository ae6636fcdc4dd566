# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Turns rows of results into messages: values for the wire, and the feed-forward within its rate limit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.feedforward import approach, fade, rate_towards
from trackres_ros.estimator.plausible import towards
from trackres_ros.node.notices import Notice
from trackres_ros.node.transport import Level, Reasons, Status, Transport, nearest_usable
from trackres_ros.output.topics import ESTIMATE_TOPIC, PARAMETERS_TOPIC, OutputTopic
from trackres_ros.units import NANOSECOND

WINDOW_NS = 100_000_000  # a clock ticks several times in it
Row = list[float]
Values = Callable[[Row], list[float]]


class OutputPublisher:
    """Publishes the last estimate through a transport.

    While the speed is old, the last state is still published with its stamp, and the feed-forward fades to zero. So it is safe
    even for receivers that ignore the stamp. Between outputs the feed-forward moves by `feedforward_rate` at most, whatever the
    speeds, their pauses and the settings; only to zero it may be faster. It continues from a step's intermediate value towards
    the last target, and from the faded value when a speed returns. Its time is the controller's, `pace`: a steady clock, or the
    simulated one if that runs faster.

    A topic that cannot be published delays no other one; `failed` names it and the reason.
    """

    def __init__(self, outputs: Sequence[OutputTopic], estimator: Estimator, transport: Transport) -> None:
        self.estimator = estimator
        self.slow_max_age_s = 0.0  # longest age of a speed that comes rarely; 0 for the one of the settings
        self.outputs = outputs
        self.row: Row = []
        self.stamp_ns: int | None = None
        self.published = 0
        self.feedforward = 0.0  # as last published
        self.failed: dict[str, str] = {}
        self.opened = False  # whether the topics below the node's own name are open
        self.sent = 0  # messages that the middleware took, statuses too
        self.on_estimate: Callable[[int, list[float], Reasons], None] | None = None  # each that was published
        self._transport = transport
        self._taken_ns = 0
        self._unfaded, self._left = 0.0, 1.0  # as last published: the feed-forward before its fading, and the share left of it
        self._published_ns: int | None = None
        self._window: tuple[int, int] | None = None  # beginning, by the steady clock and by the pace
        self._rates = 1.0, 1.0  # of the pace against the steady clock, in the last two windows
        self._withdrawn_ns: int | None = None
        index = estimator.column_index
        self._values = [(i, _values(topic, index)) for i, topic in enumerate(outputs) if topic.kind != "status"]

    def begin(self) -> None:
        """Begin to publish: the feed-forward rises from zero."""
        self.feedforward = self._unfaded = 0.0
        self._published_ns = self._withdrawn_ns = self._window = None
        self._rates = 1.0, 1.0

    def withdraw(self, steady: int | None) -> None:
        """Let the feed-forward go to zero from a time on, at its rate, and within the time in which it fades; None lets it back,
        at the next speed.
        """
        self._withdrawn_ns = steady

    def take(self, row: Row, stamp_ns: int, steady: int, waited_ns: int = 0) -> None:
        """Keep a row of results, and the time of its state, whose speed waited in a queue before it came."""
        self.row, self.stamp_ns, self._taken_ns = row, nearest_usable(stamp_ns), steady - waited_ns
        if self.age_s(steady) <= self.max_age_s:
            self._unfaded, self._left = self.feedforward, 1.0

    def age_s(self, steady: int) -> float:
        """Time since the last estimate was made [s]; infinite before the first."""
        return math.inf if self.stamp_ns is None else (steady - self._taken_ns) * NANOSECOND

    @property
    def max_age_s(self) -> float:
        """Longest age of a trusted speed [s]."""
        return max(self.estimator.settings.speed_max_age_s, self.slow_max_age_s)

    def left(self, steady: int) -> float:
        """Share of the feed-forward at the age of the speed. Only a new speed raises it, and it falls no faster than a fading,
        whatever the settings change to.
        """
        settings = self.estimator.settings
        age_s, fade_s = self.age_s(steady), settings.feedforward_fade_s
        since_s = 0.0 if self._withdrawn_ns is None else (steady - self._withdrawn_ns) * NANOSECOND
        share = 0.0 if math.isinf(age_s) else fade(age_s, self.max_age_s, fade_s) * fade(since_s, 0.0, fade_s)
        if self._published_ns is None:
            return share
        return min(self._left, max(share, self._left - (steady - self._published_ns) * NANOSECOND / fade_s))

    def publish(self, steady: int, pace: int, reasons: Callable[[int], Reasons], goal: float, target: float) -> None:
        """Publish the last estimate on all topics of numbers, with the present reasons; nothing before the first one.

        `goal` is the session's feed-forward now, on its way to `target`, see `feedforward.feedforward_at`.
        """
        if self.stamp_ns is None:
            return
        elapsed_s = self._elapsed_s(steady, pace)
        if self._withdrawn_ns is not None:
            goal = target = 0.0
        self._unfaded = self._moved(goal, target, elapsed_s)
        self._left, self._published_ns = self.left(steady), steady
        self.feedforward = self._unfaded * self._left
        row = self.row.copy()
        row[at.Results.feedforward_torque_nm] = self.feedforward
        for output, values in self._values:
            numbers = values(row)
            if not all(map(math.isfinite, numbers)):
                continue
            hold: Reasons = ()
            if self.outputs[output] is ESTIMATE_TOPIC:
                hold = reasons(steady)
                numbers.append(float(max((level for _, level in hold), default=Level.OK)))
            self._send(output, self._transport.publish, self.stamp_ns, numbers, hold)
            if self.outputs[output] is ESTIMATE_TOPIC and self.on_estimate is not None:
                self.on_estimate(self.stamp_ns, numbers, hold)
        self.published += 1

    def _elapsed_s(self, steady: int, pace: int) -> float:
        """Time since the last output [s], in which the feed-forward moves.

        A simulated clock may run fast, and a controller with it. How fast is the slower of two windows: a leap is in one.
        """
        begun, since = self._window = self._window or (steady, pace)
        if steady - begun >= WINDOW_NS:
            self._rates = self._rates[1], (pace - since) / (steady - begun)
            self._window = steady, pace
        passed = 0 if self._published_ns is None else steady - self._published_ns
        return passed * NANOSECOND * max(1.0, min(self._rates))

    def _moved(self, goal: float, target: float, elapsed_s: float) -> float:
        """The feed-forward before its fading, after a time on its way. While the session's goes to zero, so does this one."""
        number, here = self.estimator.constants.number, self._unfaded
        if goal * target > 0.0:
            return approach(number, here, goal, elapsed_s)
        there = goal if min(0.0, here) <= goal <= max(0.0, here) else 0.0
        return towards(here, there, rate_towards(number, 0.0) * elapsed_s)

    def publish_statuses(
        self, statuses: Sequence[Status], now_ns: int, diagnostics: bool, learned: Sequence[Status] = ()
    ) -> None:
        """Publish the first status on the node's own topic, and, on request, all as diagnostics and the learned values."""
        for output, topic in enumerate(self.outputs):
            if topic is PARAMETERS_TOPIC:
                if diagnostics and learned and self.opened:
                    self._send(output, self._transport.publish_status, nearest_usable(now_ns), learned)
            elif topic.kind == "status" and (diagnostics if topic.shared else self.opened):
                shown = statuses if topic.shared else statuses[:1]
                self._send(output, self._transport.publish_status, nearest_usable(now_ns), shown)

    def notices(self) -> list[Notice]:
        """The topics that cannot be published."""
        return [Notice("OUTPUT_FAILED", f"{topic} cannot be published: {error}") for topic, error in self.failed.items()]

    def _send(self, output: int, publish: Callable[..., None], stamp_ns: int, *content: object) -> None:
        name = self.outputs[output].name
        try:
            publish(output, stamp_ns, *content)
        except Exception as error:  # whatever a middleware may raise
            self.failed[name] = f"{type(error).__name__}: {error}"
        else:
            self.sent += 1
            if self.failed:
                self.failed.pop(name, None)


def _values(topic: OutputTopic, index: dict[str, int]) -> Values:
    """A function that picks a topic's numbers out of a row; see `topics.values_of`."""
    columns, signs = [index[name] for name in topic.columns], topic.signs
    if topic.kind == "temperature":
        mean, std = columns
        return lambda row: [row[mean], row[std] ** 2]
    picked = list(zip(columns, signs, strict=True))
    return lambda row: [row[column] * sign + 0.0 for column, sign in picked]

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The outputs: one filter of the feed-forward, and the messages of the last estimate."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.feedforward import approach, fade, feedforward_at, rate_towards
from trackres_ros.estimator.plausible import step_towards
from trackres_ros.node.inputs import NodeClock
from trackres_ros.node.notices import Notice
from trackres_ros.node.transport import Level, Reasons, Status, Transport, nearest_usable
from trackres_ros.output.topics import ESTIMATE_TOPIC, PARAMETERS_TOPIC, OutputTopic
from trackres_ros.units import NANOSECOND

WINDOW_NS = 100_000_000  # a clock ticks several times in it
Row = list[float]
Values = Callable[[Row], list[float]]


class Course(NamedTuple):
    """Where the feed-forward is going at a time."""

    steady_ns: int  # the time by the steady clock [ns]
    pace: int  # and by the controller's [ns]
    present_nm: float  # the session's feed-forward now
    target_nm: float  # what that is on its way to
    stop_reason: int  # the reason why the target is zero, else 0


class FeedforwardFilter:
    """The one filter of the published feed-forward: it alone knows enable, target, rate limit, fade and the controller's clock.

    The session has a feed-forward on its way to a target, which is zero where it is not enabled or the vehicle may stand. The
    filter follows it by `feedforward_rate` at most, whatever the speeds, their pauses and the settings; only to zero it may be
    faster. It continues from a step's intermediate value towards the last target, and from the faded value when a speed returns.
    While the speed is old, and while it is withheld, it fades to zero. So it is safe even for receivers that ignore the stamp.
    Its time is the controller's: a steady clock, or the simulated one if that runs faster.
    """

    def __init__(self, session: Session, clock: NodeClock) -> None:
        self.session = session
        self.torque_nm = 0.0  # as last published
        self._clock = clock
        self._step_ns: int | None = None  # when the speed of the last step came
        self._slow_max_age_s = 0.0  # longest age of a speed that comes rarely
        self._share = 1.0  # left of the feed-forward by fading, as last published
        self.begin()

    def begin(self) -> None:
        """Begin to publish: the feed-forward rises from zero."""
        self.torque_nm = self._full_nm = 0.0
        self._last_move_ns: int | None = None
        self._zero_since_ns: int | None = None
        self._window: tuple[int, int] | None = None  # beginning, by the steady clock and by the pace
        self._rates = 1.0, 1.0  # of the pace against the steady clock, in the last two windows
        self.ends = self._is_withheld = False

    def end(self, steady_ns: int) -> None:
        """Go to zero from a time on, at its rate, and within the time in which it fades."""
        self.ends, self._zero_since_ns = True, steady_ns

    def withhold(self, is_withheld: bool, steady_ns: int) -> bool:
        """As `end` while withheld, and come back at the next speed afterwards; return whether that is new."""
        if is_withheld is self._is_withheld:
            return False
        self._is_withheld = is_withheld
        if not self.ends:
            self._zero_since_ns = steady_ns if is_withheld else None
        return True

    def take(self, steady_ns: int, waited_ns: int) -> None:
        """Take note of a step, whose speed waited in a queue before it came."""
        self._slow_max_age_s = float(self.session.motion[at.Motion.longest_age])
        self._step_ns = steady_ns - waited_ns
        if self.age_s(steady_ns) <= self.max_age_s:
            self._full_nm, self._share = self.torque_nm, 1.0

    def age_s(self, steady_ns: int) -> float:
        """Time since the last step was made [s]; infinite before the first."""
        return math.inf if self._step_ns is None else (steady_ns - self._step_ns) * NANOSECOND

    @property
    def max_age_s(self) -> float:
        """Longest age of a trusted speed [s]."""
        return max(self.session.estimator.settings.speed_max_age_s, self._slow_max_age_s)

    def share(self, steady_ns: int) -> float:
        """Share of the feed-forward at the age of the speed. Only a new speed raises it, and it falls no faster than a fading,
        whatever the settings change to.
        """
        age_s, fade_s = self.age_s(steady_ns), self.session.estimator.settings.feedforward_fade_s
        since_s = 0.0 if self._zero_since_ns is None else (steady_ns - self._zero_since_ns) * NANOSECOND
        share = 0.0 if math.isinf(age_s) else fade(age_s, self.max_age_s, fade_s) * fade(since_s, 0.0, fade_s)
        if self._last_move_ns is None:
            return share
        return min(self._share, max(share, self._share - (steady_ns - self._last_move_ns) * NANOSECOND / fade_s))

    def course(self, steady_ns: int) -> Course:
        """Where it is going now; see `feedforward_at`."""
        pace = self._clock.pace_ns(steady_ns)
        session, arrival = self.session, self._clock.recorded_ns(steady_ns, pace)
        present_nm, target_nm, stop_reason = feedforward_at(session.estimator.constants, session.memory, session.motion, arrival)
        return Course(steady_ns, pace, float(present_nm), float(target_nm), stop_reason)

    def has_to_fall(self, steady_ns: int) -> bool:
        """Whether the last published torque is on its way to zero or through it: that waits for no slow rate of outputs."""
        if self.torque_nm == 0.0:
            return False
        return self.share(steady_ns) < 1.0 or self.torque_nm * self.course(steady_ns).target_nm <= 0.0

    def move(self, course: Course) -> float:
        """The feed-forward [Nm] to publish, on a course of now."""
        elapsed_s = self._elapsed_s(course)
        present_nm, target_nm = (course.present_nm, course.target_nm) if self._zero_since_ns is None else (0.0, 0.0)
        number, last_nm = self.session.estimator.constants.number, self._full_nm
        if present_nm * target_nm > 0.0:
            self._full_nm = approach(number, last_nm, present_nm, elapsed_s)
        else:  # while the session's goes to zero, so does this one
            end_nm = present_nm if min(0.0, last_nm) <= present_nm <= max(0.0, last_nm) else 0.0
            self._full_nm = step_towards(last_nm, end_nm, rate_towards(number, 0.0) * elapsed_s)
        self._share, self._last_move_ns = self.share(course.steady_ns), course.steady_ns
        self.torque_nm = self._full_nm * self._share
        return self.torque_nm

    def _elapsed_s(self, course: Course) -> float:
        """Time since the last output [s], in which the feed-forward moves.

        A simulated clock may run fast, and a controller with it. How fast is the slower of two windows: a leap is in one.
        """
        begin_ns, pace_ns = self._window = self._window or (course.steady_ns, course.pace)
        if course.steady_ns - begin_ns >= WINDOW_NS:
            self._rates = self._rates[1], (course.pace - pace_ns) / (course.steady_ns - begin_ns)
            self._window = course.steady_ns, course.pace
        passed_ns = 0 if self._last_move_ns is None else course.steady_ns - self._last_move_ns
        return passed_ns * NANOSECOND * max(1.0, min(self._rates))


class OutputPublisher:
    """Publishes the last estimate through a transport; while the speed is old, still with the stamp of that estimate.

    A topic that cannot be published delays no other one; `failed` names it and the reason.
    """

    def __init__(self, outputs: Sequence[OutputTopic], estimator: Estimator, transport: Transport) -> None:
        self.row: Row = []
        self.stamp_ns: int | None = None
        self.published = 0
        self.failures: dict[str, str] = {}
        self.is_open = False  # whether the topics below the node's own name are open
        self.message_count = 0  # messages that the middleware took, statuses too
        self.on_estimate: Callable[[int, list[float], Reasons], None] | None = None  # each that was published
        self._outputs, self._transport = outputs, transport
        index = estimator.column_index
        self._values = [(i, _values(topic, index)) for i, topic in enumerate(outputs) if topic.kind != "status"]

    def take(self, row: Row, stamp_ns: int) -> None:
        """Keep a row of results, and the time of its state."""
        self.row, self.stamp_ns = row, nearest_usable(stamp_ns)

    def publish(self, torque_nm: float, reasons: Callable[[], Reasons]) -> None:
        """Publish the last estimate on all topics of numbers, with the feed-forward and reasons of now."""
        if self.stamp_ns is None:
            return
        row = self.row.copy()
        row[at.Results.feedforward_torque_nm] = torque_nm
        for output, values in self._values:
            numbers = values(row)
            if not all(map(math.isfinite, numbers)):
                continue
            hold: Reasons = ()
            if self._outputs[output] is ESTIMATE_TOPIC:
                hold = reasons()
                numbers.append(float(max((level for _, level in hold), default=Level.OK)))
            self._send(output, self._transport.publish, self.stamp_ns, numbers, hold)
            if self._outputs[output] is ESTIMATE_TOPIC and self.on_estimate is not None:
                self.on_estimate(self.stamp_ns, numbers, hold)
        self.published += 1

    def publish_statuses(
        self, statuses: Sequence[Status], now_ns: int, diagnostics: bool, learning_statuses: Sequence[Status] = ()
    ) -> None:
        """Publish the first status on the node's own topic, and, on request, all as diagnostics and the learned values."""
        for output, topic in enumerate(self._outputs):
            if topic is PARAMETERS_TOPIC:
                if diagnostics and learning_statuses and self.is_open:
                    self._send(output, self._transport.publish_status, nearest_usable(now_ns), learning_statuses)
            elif topic.kind == "status" and (diagnostics if topic.shared else self.is_open):
                own_statuses = statuses if topic.shared else statuses[:1]
                self._send(output, self._transport.publish_status, nearest_usable(now_ns), own_statuses)

    def notices(self) -> list[Notice]:
        """The topics that cannot be published."""
        return [Notice("OUTPUT_FAILED", f"{topic} cannot be published: {error}") for topic, error in self.failures.items()]

    def _send(self, output: int, publish: Callable[..., None], stamp_ns: int, *content: object) -> None:
        name = self._outputs[output].name
        try:
            publish(output, stamp_ns, *content)
        except Exception as error:  # whatever a middleware may raise
            self.failures[name] = f"{type(error).__name__}: {error}"
        else:
            self.message_count += 1
            if self.failures:
                self.failures.pop(name, None)


def _values(topic: OutputTopic, index: dict[str, int]) -> Values:
    """A function that picks a topic's numbers out of a row; see `topics.values_of`."""
    columns, signs = [index[name] for name in topic.columns], topic.signs
    if topic.kind == "temperature":
        mean, std = columns
        return lambda row: [row[mean], row[std] ** 2]
    column_signs = list(zip(columns, signs, strict=True))
    return lambda row: [row[column] * sign + 0.0 for column, sign in column_signs]

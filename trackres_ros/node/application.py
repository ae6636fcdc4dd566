# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The running application: receives messages, keeps the estimate, publishes at its rate, and reports when not to trust it.

A message passes five things in a row: `inputs` decodes it, the guards of the session judge its samples, a step makes an estimate,
the filter of `output` makes the feed-forward of now, and the publisher sends. It depends on neither ROS nor DDS: a transport
passes it messages, calls `tick` every `period_s`, and publishes. All calls come from one thread.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Estimate
from trackres_ros.estimator.settings import settings_for
from trackres_ros.estimator.snapshot import LONGEST_OFF, content
from trackres_ros.node.inputs import Arrival, Inbox, InputReader, MessageHandler, NodeClock, SpeedSources
from trackres_ros.node.measured_torque import Comparison, LiveLearning
from trackres_ros.node.notices import Guard, Notice, level_of
from trackres_ros.node.output import FeedforwardFilter, OutputPublisher
from trackres_ros.node.parameters import Parameters, changed_parameters, read_setup
from trackres_ros.node.process import RESET, RESET_LEARNING, SAVE, ServiceManager, SignalRequests, steady_ns
from trackres_ros.node.state_keeper import StateKeeper, state_path
from trackres_ros.node.status import STARTING_NS, Overview, Watch, bare_status, contest_notice, statuses, two_speeds
from trackres_ros.node.transport import (
    InputTopic,
    KeepMessage,
    Level,
    Peer,
    Reasons,
    Transport,
    input_topics,
    live_topics,
    other_topics,
    without_effect,
)
from trackres_ros.units import NANOSECOND, SECOND_NS

ACCEPTED, IMPLAUSIBLE = int(at.Count.ACCEPTED), int(at.Count.IMPLAUSIBLE)
SPEED_IMPLAUSIBLE, LOAD_DOUBTED = int(at.Reason.SPEED_IMPLAUSIBLE), int(at.Reason.LOAD_DOUBTED)
LOOK_NS = 200_000_000  # between two looks for other publishers of the feed-forward
LONGEST_PERIOD_S = 0.1  # between two looks at the age of the speed, and between two outputs
SAVING_ON_REQUEST_S, SAVING_AT_THE_END_S = 0.1, 10.0  # longest wait for a disk
REASONS_KEPT_NS = 200_000_000  # a full check takes longer than publishing; an old speed and new reasons are handled at once
MUST_BE_FINITE = (at.Results.resistance_torque_nm, at.Results.resistance_std_nm, at.Results.feedforward_torque_nm)


class Application:
    """The live estimate of one vehicle. Raises InputError if vehicle, topics file or parameters cannot be used."""

    def __init__(
        self,
        parameters: Parameters,  # checked; `vehicle` must be given
        transport: Transport,  # before the first call of `tick` or `receive` only its topic names are used
        node: str = "trackres",  # its name, for the state file and the statuses
        namespace: str = "/",
        steady_ns: Callable[[], int] = steady_ns,  # a monotonic clock, of all ages
        sleep: Callable[[float], None] = time.sleep,  # by it [s]
    ) -> None:
        self.parameters = parameters
        self.node, self.namespace = node, namespace
        setup = read_setup(parameters)
        self.topics, self.vehicle = setup.topics, setup.vehicle
        self.estimator = Estimator(self.vehicle, setup.settings)
        self.inputs = input_topics(self.topics, bool(self.vehicle.route), self.estimator.channels)
        self.outputs = live_topics(self.vehicle, self.topics)
        has_torque = any("torque" in topic.valued for topic in self.inputs)
        self._diagnose = parameters.diagnose_command()
        self.comparison = Comparison(parameters.mismatch(), self.vehicle.disturbance if has_torque else None)
        file = state_path(parameters.text("state_file"), parameters.sim_time, node, namespace, self.vehicle.name)
        self.keeper = StateKeeper(*file, steady_ns=steady_ns)
        self.active = False
        self.on_estimate: Callable[[list[float], int, int], None] | None = None  # row, stamp, arrival
        self.on_published: Callable[[int, list[float], Reasons, int], None] | None = None  # stamp, numbers, reasons, time
        self.on_restored: Callable[[bytes, int], None] | None = None  # file of the state that the first speed found, arrival
        self.recording_notices: Callable[[], list[Notice]] = list
        self.guard = Guard(self._report_fault, steady_ns)
        self.clock = NodeClock(transport, parameters.sim_time, steady_ns, self.guard)
        self._transport, self._sleep = transport, sleep
        reader = InputReader(self.inputs, self.estimator.channels, self.topics.bindings)
        self.sources = SpeedSources(
            self.estimator.constants.number.max_acceleration, lambda: self.estimator.settings.speed_max_age_s
        )
        self.messages = MessageHandler(self.inputs, reader, self.sources, self.clock, self.guard, self._step)
        self.learning = LiveLearning(self.estimator, parameters.text("learning"), has_torque)
        self.session, self.began_with = self.keeper.load(self.estimator, self.learning)
        self.filter = FeedforwardFilter(self.session, self.clock)
        self._publisher = OutputPublisher(self.outputs, self.estimator, transport)
        self._publisher.on_estimate = self._keep_published
        self._service = ServiceManager()
        if idle := without_effect(self.topics, self.estimator.channels, bool(self.estimator.assemblies)):
            self.began_with += f"; the vehicle has no belt or wheel for {', '.join(idle)} of the topics file: without effect"
        self._state_at = self.keeper.holds_at
        self._topic_names = [transport.topic_name(topic.name) for topic in self.inputs]
        inputs = [replace(topic, name=name) for topic, name in zip(self.inputs, self._topic_names, strict=True)]
        self._watch = Watch(self.estimator, inputs)
        self._last_reasons: tuple[int, bool, Reasons] | None = None  # time, whether the speed was old, reasons
        self._peers: list[Sequence[Peer]] = [()] * len(self.inputs)
        self._latched: set[int] = set()  # inputs that also receive what their publishers keep
        self._rivals: Sequence[str] = ()
        now_ns = steady_ns()
        self._next_second_ns, self._next_output_ns, self._next_save_ns = now_ns, now_ns, now_ns + self._save_period_ns()
        self._next_look_ns, self._started_ns = now_ns, now_ns

    @property
    def publishes(self) -> bool:
        """Whether it is active, and no other publisher of the feed-forward was found before its own outputs were opened."""
        return self.active and self._publisher.is_open

    @property
    def _on_speed(self) -> bool:
        return self.parameters.values["output_rate_hz"] == 0.0

    @property
    def period_s(self) -> float:
        """Period of `tick` [s]."""
        between_s = self._between_outputs_s
        return between_s / math.ceil(between_s / LONGEST_PERIOD_S - 1e-9)

    @property
    def _between_outputs_s(self) -> float:
        """Longest time between two outputs."""
        return LONGEST_PERIOD_S if self._on_speed else 1.0 / self.parameters.number("output_rate_hz")

    def inbox(self, take: Callable[[int], Iterable[Any]], deliver: Callable[[int, Any, Arrival], None]) -> Inbox:
        """The queue of a transport: `take` fetches what waits at an input, `deliver` passes a message on with its arrival."""
        fetches = [self.guard.taking(f"reading {name}", partial(take, index)) for index, name in enumerate(self._topic_names)]
        return Inbox(fetches, deliver, self.clock.arrival, self.messages.count_drop, self.parameters.count("input_depth"))

    def record(self, keep: KeepMessage) -> list[tuple[InputTopic, str]]:
        """Record every message on all topics of the topics file; return these topics and the texts that define their types.

        Messages come with their place in that list.
        """
        other_inputs = other_topics(self.topics, self.inputs)
        texts = self._transport.record(other_inputs)
        pairs = list(zip((*self.inputs, *other_inputs), texts, strict=True))
        for topic, text in pairs:
            if text is None:
                name = self._transport.topic_name(topic.name)
                self._log(Level.WARN, f"{name} is not recorded: its type {topic.type} is unknown")
        topics = [(topic, text) for topic, text in pairs if text is not None]
        places = {index: topics.index((topic, text)) for index, (topic, text) in enumerate(pairs) if text is not None}
        self.messages.keep_raw = lambda index, raw, arrival_ns: keep(places[index], raw, arrival_ns) if index in places else None
        return topics

    # The way of a sample: guards and step, filter, publisher

    def _step(self, channel: int, stamp: int, value: float, steady_ns: int, now_ns: int, arrival: int) -> None:
        """Have the guards judge a sample; an accepted speed makes a step."""
        state_file = None
        if channel == at.SPEED and self._publisher.stamp_ns is None:
            self.guard("cooling the restored belts", self._rest_unused_belts)
            state_file = self.guard("recording", self._restored_state) if self.on_restored else None
        counters = self.session.memory.counters
        accepted_count, doubtful_count = counters[channel, ACCEPTED], counters[channel, IMPLAUSIBLE]
        estimate = self.session.feed(channel, stamp, arrival, value)
        if counters[channel, ACCEPTED] != accepted_count:
            self._watch.accepted_ns[channel] = steady_ns - self._waited_ns(channel, arrival)
        elif counters[channel, IMPLAUSIBLE] != doubtful_count:
            self._show(SPEED_IMPLAUSIBLE if channel == at.SPEED else LOAD_DOUBTED)
        if estimate is not None:
            if state_file and self.on_restored:
                self.guard("recording", self.on_restored, state_file, arrival)
            self._use_estimate(estimate, steady_ns, now_ns, arrival)

    def _use_estimate(self, estimate: Estimate, steady_ns: int, now_ns: int, arrival: int) -> None:
        """Hand an estimate to the filter and the publisher, then to all that only look at it."""
        values = estimate.row.tolist()
        if bad_columns := [self.estimator.columns[column] for column in MUST_BE_FINITE if not math.isfinite(values[column])]:
            raise ArithmeticError(f"not finite: {', '.join(bad_columns)}")  # without values: a new text each time floods the log
        stamp, waited_ns = int(self.session.memory.times[at.SPEED, at.Times.last_stamp]), self._waited_ns(at.SPEED, arrival)
        set_ns = 0 if self.messages.reader.clock_shifts_ns else self.clock.set_by_ns(now_ns, arrival)
        self.filter.take(steady_ns, waited_ns)
        self._publisher.take(values, stamp + set_ns)
        offset = now_ns - waited_ns - stamp - set_ns
        new_reasons = self.guard("watching the reasons", self._watch.count_step, int(values[at.Results.reasons]), offset)
        if new_reasons:
            self._last_reasons = None
        if self.publishes and self._on_speed:
            self._next_output_ns = steady_ns + int(LONGEST_PERIOD_S * SECOND_NS)
            self.guard.essential("publishing", self._publish, self.clock.steady_ns())
        self._state_at = time.time() - waited_ns * NANOSECOND
        news = self.guard("the comparison with the measured torque", self.comparison.take, stamp, values, arrival, set_ns)
        if news:
            self._last_reasons = None
            self._log(Level.OK, news)
        if new_reasons and self.active:
            self._publish_status(self.clock.steady_ns())
        self.guard("learning", self.learning.take, stamp, values, self.session)  # it acts from the next step on
        if self.on_estimate:
            record = self.on_estimate
            self.guard("recording", lambda: record([*values, *self.learning.columns(values, self.session)], stamp, arrival))

    def _publish(self, steady_ns: int) -> None:
        """Publish the last estimate, with the feed-forward and the reasons of now; before the first one only a reason."""
        course = self.filter.course(steady_ns)
        self._show(course.stop_reason)
        if self._publisher.stamp_ns is not None:
            self._publisher.publish(self.filter.move(course), lambda: self._reasons_or_fault(steady_ns))

    def _waited_ns(self, channel: int, arrival: int) -> int:
        """How long the last accepted message waited in a queue before it came, as while this process was stopped.

        The steady clock does not know how long a simulated time is.
        """
        return 0 if self.clock.simulated else arrival - int(self.session.memory.times[channel, at.Times.last_arrival])

    def _keep_published(self, stamp: int, numbers: list[float], reasons: Reasons) -> None:
        if self.on_published:
            self.guard("recording", self.on_published, stamp, numbers, reasons, self.clock.present_ns(self.clock.steady_ns()))

    def _restored_state(self) -> bytes | None:
        """State file from which a replay of all messages gives the live estimates; None for a start without a past."""
        if not self.session.has_past:
            return None
        session = self.estimator.session()  # without the messages until now, which are in the replay
        session.begin(self.session.state)
        session.motion[:] = self.session.motion
        return content(session, self._state_at, self.learning.stored())

    # Reasons

    def _report_fault(self, text: str) -> None:
        self._last_reasons = None
        self._log(Level.ERROR, text)

    def _log(self, level: Level, text: str) -> None:
        try:
            self._transport.log(level, text)
        except KeyboardInterrupt:
            raise
        except BaseException:  # the failure to report cannot be reported
            pass

    def _show(self, reasons: int) -> None:
        """Publish reasons between two estimates, at once where they are new."""
        if self.guard("watching the reasons", self._watch.note, reasons):
            self._show_change()

    def _show_change(self) -> None:
        self._last_reasons = None
        if self.active:
            self._publish_status(self.clock.steady_ns())

    def _reasons_or_fault(self, steady_ns: int) -> Reasons:
        hold = self.guard("the reasons", self._reasons, steady_ns)
        return (("PART_FAILED", Level.WARN),) if hold is None else hold

    def _reasons(self, steady_ns: int) -> Reasons:
        """All present notices, each name once."""
        is_old = self.filter.age_s(steady_ns) > self.filter.max_age_s
        last = self._last_reasons
        if last is None or is_old is not last[1] or not 0 <= steady_ns - last[0] < REASONS_KEPT_NS:
            hold = tuple({notice.name: notice.level for notice in self.notices(steady_ns)}.items())
            self._last_reasons = last = steady_ns, is_old, hold
        return last[2]

    # Outputs

    def activate(self) -> None:
        """Begin to publish, once nobody else publishes the feed-forward. The estimate runs whether it is published or not."""
        self.filter.begin()
        self.active, self._last_reasons = True, None
        self.guard("looking for other publishers", self._watch_publishers, self.clock.steady_ns())

    def deactivate(self, error: BaseException | None = None, on_wait: Callable[[], None] = lambda: None) -> None:
        """Ramp the feed-forward to zero at its rate limit, and stop publishing; log and report the fault behind it, if any.

        It takes `feedforward_fade_s` at most, and calls `on_wait` every `period_s`. It never raises: where nothing can be
        published, nothing can be done.
        """
        if error is not None:
            self.guard.report("the main loop", error, is_essential=True)
        if not self.active:
            return
        self._last_reasons = None
        self.filter.end(self.clock.steady_ns())
        self._publish_status(self.clock.steady_ns(), diagnostics=True)
        with suppress(Exception):
            while self._publisher.is_open and self._publisher.stamp_ns is not None:
                self._publish(self.clock.steady_ns())
                if self.filter.torque_nm == 0.0:
                    break
                self._sleep(self.period_s)
                on_wait()
        self._publish_status(self.clock.steady_ns(), diagnostics=True)
        self.active = False

    def tick(self) -> None:
        """Publish, check ages and peers, and save the state, each when due; to be called every `period_s`.

        It never raises: a part that fails is named on the status, and the others run.
        """
        steady_ns = self.clock.steady_ns()
        age_s, max_age_s = self.filter.age_s(steady_ns), self.filter.max_age_s
        turned_old = self.guard("watching the age of the speed", self._watch.look_at_age, age_s, max_age_s)
        self.guard.essential("taking late messages", self.messages.handle_late, steady_ns)
        if steady_ns >= self._next_look_ns:
            self._next_look_ns = steady_ns + LOOK_NS
            self.guard("looking for other publishers", self._watch_publishers, steady_ns)
        self.guard("withholding the feed-forward", self._withhold, steady_ns)
        self.guard.essential("publishing", self._publish_due, steady_ns)
        if steady_ns >= self._next_second_ns:
            self._next_second_ns += SECOND_NS * (1 + (steady_ns - self._next_second_ns) // SECOND_NS)
            self._every_second(steady_ns)
        elif turned_old and self.active:
            self._publish_status(steady_ns)
        self.guard("saving the state", self._save_due, steady_ns)
        self.guard("the service manager", self._service.alive, self._publisher.message_count, self.active, steady_ns)

    def _watch_publishers(self, steady_ns: int) -> None:
        """Open the outputs where nobody else publishes the feed-forward; receive what publishers keep, soon after the start."""
        rivals = self._transport.rivals()
        if self.active and not self._publisher.is_open and rivals is not None and not rivals:
            self._transport.open_outputs()
            self._publisher.is_open = True
        if rivals is not None and set(rivals) != set(self._rivals):
            self._rivals, self._last_reasons = tuple(dict.fromkeys(rivals)), None
        if steady_ns - self._started_ns < STARTING_NS:
            for index, topic in enumerate(self.inputs):
                if topic.stands and index not in self._latched:
                    self._latch(index, self._transport.peers(index))

    def _latch(self, index: int, peers: Sequence[Peer]) -> None:
        """Receive what publishers of an input keep, if one does. Others would warn of a subscriber that asks for too much."""
        if any(peer.latched and peer.type == self.inputs[index].type and peer.defines_alike for peer in peers):
            self._transport.latch(index)
            self._latched.add(index)

    def _withhold(self, steady_ns: int) -> None:
        """Let the feed-forward go to zero while another gives the torque or the speed too, or there is no time."""
        disagree = self.sources.disagreeing(self.clock.present_ns(steady_ns))
        if self.filter.withhold(bool(self._rivals or disagree or self.clock.lack(steady_ns)), steady_ns):
            self._show_change()

    def _publish_due(self, steady_ns: int) -> None:
        early_ns = 0 if self._on_speed else int(0.5 * self.period_s * SECOND_NS)
        if self.publishes and steady_ns >= self._next_output_ns - early_ns:
            between_ns = int(self._between_outputs_s * SECOND_NS)
            self._next_output_ns = max(self._next_output_ns + between_ns, steady_ns)
            self._publish(steady_ns)
        elif self.publishes and self._between_outputs_s > LONGEST_PERIOD_S and self.filter.has_to_fall(steady_ns):
            self._publish(steady_ns)

    def _save_due(self, steady_ns: int) -> None:
        if steady_ns >= self._next_save_ns:
            self._next_save_ns = steady_ns + self._save_period_ns()
            self.keeper.save_soon(self.session, self._state_at, self.learning)

    def _every_second(self, steady_ns: int) -> None:
        self.guard("watching the inputs", self._look, steady_ns)
        self.guard("the log", self._log_notices, steady_ns)
        if self.active:
            self._publish_status(steady_ns, diagnostics=True)

    def _look(self, steady_ns: int) -> None:
        self._peers = [()] * len(self.inputs)
        self.messages.misread_inputs = ()
        try:
            self._peers = [self._transport.peers(i) for i in range(len(self.inputs))]
            self._watch_peers()
        finally:  # rates and refusals are of interest without peers too
            arrival = self.clock.present_ns(steady_ns)
            self._watch.every_second(self.session, self.messages.reader, self._peers, steady_ns, arrival)
            self._last_reasons = None

    def _watch_peers(self) -> None:
        """Treat each input as its present publishers require."""
        self.messages.misread_inputs = [
            i for i, publishers in enumerate(self._peers) if any(peer.is_misread for peer in publishers)
        ]
        mixed_inputs = []
        for index, (topic, publishers) in enumerate(zip(self.inputs, self._peers, strict=True)):
            sending = [peer for peer in publishers if peer.compatible and peer.type == topic.type]
            if len(sending) > 1:
                mixed_inputs.append(index)
            if not topic.stands:
                continue
            if index not in self._latched:
                self._latch(index, publishers)
            self.messages.repeat(index, {peer.source for peer in sending if peer.latched})
        self.messages.mixed_inputs = mixed_inputs

    def _log_notices(self, steady_ns: int) -> None:
        notices = self.notices(steady_ns)
        texts = "; ".join(notice.text for notice in notices) or "no warnings"
        self.guard("the service manager", self._service.status, f"{level_of(notices).name.lower()}: {texts}")
        entry = self._watch.to_log(notices, steady_ns)
        if entry:
            self._log(*entry)

    def _publish_status(self, steady_ns: int, diagnostics: bool = False) -> None:
        self.guard("publishing statuses", self._publish_statuses, steady_ns, diagnostics)

    def _publish_statuses(self, steady_ns: int, diagnostics: bool) -> None:
        name = f"{self.namespace.rstrip('/')}/{self.node}".lstrip("/")
        node_statuses = self.guard("the statuses", lambda: statuses(self.overview(steady_ns), name, self.vehicle.name))
        learning_statuses = self.guard("the statuses of learning", self.learning.statuses, name, self.vehicle.name)
        bare_statuses = [] if node_statuses else [bare_status(self.notices(steady_ns), name, self.vehicle.name)]
        self._publisher.publish_statuses(
            node_statuses or bare_statuses, self.clock.now_ns(steady_ns), diagnostics, learning_statuses or ()
        )

    def notices(self, steady_ns: int | None = None) -> list[Notice]:
        """All present notices, most severe first."""
        steady_ns = self.clock.steady_ns() if steady_ns is None else steady_ns
        notices = [
            *(self.guard("watching the inputs", self._input_notices, steady_ns) or []),
            *(self.guard("the comparison with the measured torque", self.comparison.notices, self._diagnose) or []),
            *(self.guard("learning", self.learning.notices) or []),
            *(self.guard("publishing statuses", self._publisher.notices) or []),
            *(self.guard("saving the state", self.keeper.notices) or []),
            *(self.guard("recording", self.recording_notices) or []),
            *self.guard.notices(steady_ns),
        ]
        if self.filter.ends and all(notice.name != "INTERNAL_ERROR" for notice in notices):  # which says why it ends
            notices.append(Notice("INACTIVE", "the node is deactivated or ends, and the feed-forward goes to zero"))
        return sorted(notices, key=lambda notice: -notice.level)

    def _input_notices(self, steady_ns: int) -> list[Notice]:
        notices = self._watch.notices(
            age_s=self.filter.age_s(steady_ns),
            max_age_s=self.filter.max_age_s,
            period_s=int(self.session.memory.times[at.SPEED, at.Times.period]) * NANOSECOND,
            no_clock=self.clock.lack(steady_ns),
        )
        if self._rivals:
            notices.append(contest_notice(self._rivals, self._publisher.is_open))
        speeds = self.sources.disagreeing(self.clock.present_ns(steady_ns))
        if speeds:
            index = next(index for index, topic in enumerate(self.inputs) if "speed" in topic.valued)
            notices.append(two_speeds(self._topic_names[index], speeds, self._peers[index]))
        return notices

    def overview(self, steady_ns: int | None = None) -> Overview:
        """Snapshot for statuses and the terminal."""
        steady_ns = self.clock.steady_ns() if steady_ns is None else steady_ns
        notices, keeper, row = self.notices(steady_ns), self.keeper, self._publisher.row
        return Overview(
            level=level_of(notices),
            notices=tuple(notices),
            stamp_ns=self._publisher.stamp_ns,
            age_s=self.filter.age_s(steady_ns),
            steps_hz=self._watch.steps_hz,
            published=self._publisher.published,
            left=self.filter.share(steady_ns),
            feedforward_nm=self.filter.torque_nm,
            values=dict(zip(self.estimator.columns, row, strict=True)) if row else {},
            assemblies=self.estimator.assemblies,
            inputs=self._watch.inputs(steady_ns),
            mismatch=self.comparison.verdict,
            disturbance=self.comparison.belief,
            learning=self.learning.text,
            state_file=str(keeper.path or ""),
            saved_s_ago=math.nan if keeper.saved_ns is None else (steady_ns - keeper.saved_ns) * NANOSECOND,
            state_error=keeper.error,
            state_unused=keeper.unused_reason,
        )

    # Requests of a transport or a signal

    def change(self, values: Mapping[str, object]) -> None:
        """Change parameters while running; the temperatures stay.

        Raises InputError as `checked_change` does; then nothing is changed.
        """
        parameters, estimator = self._prepare_change(values)
        self.comparison.change(parameters.mismatch())
        self.learning.change(parameters.text("learning"), self.session)
        if parameters.number("save_period_s") != self.parameters.number("save_period_s"):
            self._next_save_ns = self.clock.steady_ns()
        if parameters.number("output_rate_hz") != self.parameters.number("output_rate_hz"):
            self._next_output_ns = self.clock.steady_ns()
        self.parameters = parameters
        if estimator is not self.estimator:
            self._continue_with(estimator)

    def checked_change(self, values: Mapping[str, object]) -> Parameters:
        """The parameters after a change, which is not made.

        Raises InputError as `changed_parameters` does, and for settings that the vehicle file does not allow.
        """
        return self._prepare_change(values)[0]

    def _prepare_change(self, values: Mapping[str, object]) -> tuple[Parameters, Estimator]:
        """The parameters after a change, and the estimator with them; one that needs no other goes on."""
        parameters = changed_parameters(self.parameters, values, self.topics)
        settings = settings_for(parameters.settings(), self.topics)
        return parameters, self.estimator if settings == self.estimator.settings else Estimator(self.vehicle, settings)

    def carry_out(self, requests: SignalRequests) -> None:
        """Carry out pending requests by signals, and log what became of each."""
        do: dict[int, Callable[[], str]] = {SAVE: self.save_state, RESET: self.reset, RESET_LEARNING: self.reset_learning}
        for request in requests.pending():
            try:
                self._log(Level.OK, do[request]())
            except InputError as error:
                self._log(Level.WARN, str(error))

    def reset(self) -> str:
        """Start cold, with belts at the ambient temperature; inputs stay. Return a text for the log."""
        self.session.start_cold(is_driving=self.filter.age_s(self.clock.steady_ns()) <= self.filter.max_age_s)
        self._forget()
        text = f"the estimate restarts with cold {'belts' if self.estimator.assemblies else 'effects'} at the next speed"
        self._log(Level.WARN, f"reset: {text}")
        return text

    def reset_learning(self) -> str:
        """Reset the learned parameters; return a text for the log."""
        text = self.learning.reset(self.session)
        self._log(Level.WARN, f"reset of learning: {text}")
        return text

    def save_state(self, patience_s: float = SAVING_ON_REQUEST_S) -> str:
        """Save the state now, waiting for the disk at most for some time [s]; return a text for the log.

        Raises InputError if no state is kept or it cannot be written.
        """
        return self.keeper.save(self.session, self._state_at, self.learning, patience_s)

    def time_went_back(self, back_ns: int) -> None:
        """Restart after a backward jump of the simulated clock by more than `clock_jump_s`; the next estimate reports it."""
        if back_ns <= self.estimator.settings.clock_jump_s * SECOND_NS:
            return
        self.messages.time_went_back()
        self.session.start_anew()
        self._forget()
        self._log(Level.WARN, "time went back: the estimate restarts")

    def _forget(self) -> None:
        self.comparison.restart()
        self.learning.restart(self.session)

    def close(self) -> str:
        """Save the state and end other threads; return a text for the log."""
        self.deactivate()
        self.messages.close()
        self.guard("the log", self._log_counts)
        try:
            return self.save_state(SAVING_AT_THE_END_S) if self.keeper.path else "no state is saved"
        except InputError as error:
            return str(error)
        except BaseException as error:  # whatever fails, it is to end
            return f"the state is not saved because of a bug: {type(error).__name__}: {error}"
        finally:
            self.guard("saving the state", self.keeper.close)

    def _log_counts(self) -> None:
        counts = [f"{name} {count.name.lower()} {number}" for name, count, number in self.session.counts()]
        for kind, numbers in self.messages.reader.counts().items():
            names = self._topic_names if kind == "dropped" else self.estimator.channels
            counts += [f"{name} {kind} {n}" for name, n in zip(names, numbers, strict=True) if n]
        self._log(Level.OK, f"messages: {', '.join(counts) or 'none'}")

    def _continue_with(self, estimator: Estimator) -> None:
        session = estimator.session()
        session.copy_from(self.session)
        self.estimator, self.session, self.filter.session = estimator, session, session

    def _rest_unused_belts(self) -> None:
        """Belts from a state file cool and learned values wear until the first speed: a clock set before that tells how long."""
        off_s = max(0.0, time.time() - self._state_at)
        if self.session.started:
            self.session.begin(self.estimator.rest(self.session.state, None, min(off_s, LONGEST_OFF)))
        self.learning.wear(off_s)
        self._state_at += off_s

    def _save_period_ns(self) -> int:
        return int(self.parameters.number("save_period_s") * SECOND_NS)

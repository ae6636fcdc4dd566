# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The running application: receives messages, keeps the estimate, publishes at its rate, and reports when not to trust it.

It depends on neither ROS nor DDS. A transport passes it messages and calls `tick` every `period_s`; it publishes through the
transport. All calls come from one thread.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.feedforward import feedforward_at
from trackres_ros.estimator.records import Estimate
from trackres_ros.estimator.settings import settings_for
from trackres_ros.estimator.snapshot import LONGEST_OFF, content
from trackres_ros.node.clock import NodeClock, steady_ns
from trackres_ros.node.comparison import Comparison
from trackres_ros.node.endpoints import InputTopic, input_topics, live_topics, other_topics, without_effect
from trackres_ros.node.guard import Guard
from trackres_ros.node.input_reader import InputReader
from trackres_ros.node.live_learning import LiveLearning
from trackres_ros.node.message_handler import MessageHandler
from trackres_ros.node.notices import Notice, level_of
from trackres_ros.node.parameters import Parameters
from trackres_ros.node.publisher import OutputPublisher
from trackres_ros.node.report import Overview, bare_status, overview, statuses
from trackres_ros.node.service_manager import ServiceManager
from trackres_ros.node.setup import changed_parameters, read_setup
from trackres_ros.node.speed_sources import SpeedSources
from trackres_ros.node.state_keeper import StateKeeper, state_path
from trackres_ros.node.transport import KeepMessage, Level, Peer, Reasons, Transport
from trackres_ros.node.watch import COMPANIONS, STARTING_NS, Watch, contested, two_speeds
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
        measured = any("torque" in given.roles for given in self.inputs)
        self._diagnose = parameters.diagnose_command()
        self.comparison = Comparison(parameters.mismatch(), self.vehicle.disturbance if measured else None)
        file = state_path(parameters.text("state_file"), parameters.sim_time, node, namespace, self.vehicle.name)
        self.keeper = StateKeeper(*file, steady_ns=steady_ns)
        self.active = self._withdrawn = False
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
        self._publisher = OutputPublisher(self.outputs, self.estimator, transport)
        self._publisher.on_estimate = self._keep_published
        self._service = ServiceManager()
        self.learning = LiveLearning(self.estimator, parameters.text("learning"), measured)
        self.session, self.began_with = self.keeper.load(self.estimator, self.learning)
        if idle := without_effect(self.topics, self.estimator.channels, bool(self.estimator.assemblies)):
            self.began_with += f"; the vehicle has no belt or wheel for {', '.join(idle)} of the topics file: without effect"
        self._state_at = self.keeper.holds_at
        self._topic_names = [transport.topic_name(given.name) for given in self.inputs]
        named = [replace(given, name=name) for given, name in zip(self.inputs, self._topic_names, strict=True)]
        self._watch = Watch(self.estimator, named)
        self._reasons_seen: tuple[int, bool, Reasons] | None = None  # time, whether the speed was old, reasons
        self._peers: list[Sequence[Peer]] = [()] * len(self.inputs)
        self._latched: set[int] = set()  # inputs that also receive what their publishers keep
        self._rivals: Sequence[str] = ()
        self._withheld = False
        now = steady_ns()
        self._next_second_ns, self._next_output_ns, self._next_save_ns = now, now, now + self._save_period_ns()
        self._next_look_ns, self._started_ns = now, now

    @property
    def publishes(self) -> bool:
        """Whether it is active, and no other publisher of the feed-forward was found before its own outputs were opened."""
        return self.active and self._publisher.opened

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

    def record(self, keep: KeepMessage) -> list[tuple[InputTopic, str]]:
        """Record every message on all topics of the topics file; return these topics and the texts that define their types.

        Messages come with their place in that list.
        """
        others = other_topics(self.topics, self.inputs)
        texts = self._transport.record(others)
        listed = list(zip((*self.inputs, *others), texts, strict=True))
        for given, text in listed:
            if text is None:
                name = self._transport.topic_name(given.name)
                self._log(Level.WARN, f"{name} is not recorded: its type {given.type} is unknown")
        known = [(given, text) for given, text in listed if text is not None]
        place = {index: known.index((given, text)) for index, (given, text) in enumerate(listed) if text is not None}
        self.messages.keep_raw = lambda index, raw, arrival_ns: keep(place[index], raw, arrival_ns) if index in place else None
        return known

    def _step(self, channel: int, stamp: int, value: float, steady: int, now: int, arrival: int) -> None:
        restored = None
        if channel == at.SPEED and self._publisher.stamp_ns is None:
            self.guard("cooling the restored belts", self._rest_unused_belts)
            restored = self.guard("recording", self._restored) if self.on_restored else None
        counters = self.session.memory.counters
        before, doubted = counters[channel, ACCEPTED], counters[channel, IMPLAUSIBLE]
        estimate = self.session.feed(channel, stamp, arrival, value)
        if counters[channel, ACCEPTED] != before:
            self._watch.accepted_ns[channel] = steady - self._waited_ns(channel, arrival)
        elif counters[channel, IMPLAUSIBLE] != doubted:
            self._show(SPEED_IMPLAUSIBLE if channel == at.SPEED else LOAD_DOUBTED)
        if estimate is not None:
            if restored and self.on_restored:
                self.guard("recording", self.on_restored, restored, arrival)
            self._take(estimate, steady, now, arrival)

    def _waited_ns(self, channel: int, arrival: int) -> int:
        """How long the last accepted message waited in a queue before it came, as while this process was stopped.

        The steady clock does not know how long a simulated time is.
        """
        return 0 if self.clock.simulated else arrival - int(self.session.memory.times[channel, at.Times.last_arrival])

    def _restored(self) -> bytes | None:
        """State file from which a replay of all messages gives the live estimates; None for a start without a past."""
        if not self.session.has_past:
            return None
        session = self.estimator.session()  # without the messages until now, which are in the replay
        session.begin(self.session.state)
        session.motion[:] = self.session.motion
        return content(session, self._state_at, self.learning.stored())

    def _take(self, estimate: Estimate, steady: int, now: int, arrival: int) -> None:
        values = estimate.row.tolist()
        if odd := [self.estimator.columns[column] for column in MUST_BE_FINITE if not math.isfinite(values[column])]:
            raise ArithmeticError(f"not finite: {', '.join(odd)}")  # without values: a new text each time floods the log
        stamp, waited = int(self.session.memory.times[at.SPEED, at.Times.last_stamp]), self._waited_ns(at.SPEED, arrival)
        set_ns = 0 if self.messages.reader.stamped else self.clock.set_by_ns(now, arrival)
        published = stamp + set_ns
        self._publisher.slow_max_age_s = float(self.session.motion[at.Motion.longest_age])
        self._publisher.take(values, published, steady, waited)
        offset = now - waited - published
        new_reasons = self.guard("watching the reasons", self._watch.accepted, int(values[at.Results.reasons]), offset)
        if new_reasons:
            self._reasons_seen = None
        if self.publishes and self._on_speed:
            self._next_output_ns = steady + int(LONGEST_PERIOD_S * SECOND_NS)
            self.guard.essential("publishing", self._publish, self.clock.steady_ns())
        self._state_at = time.time() - waited * NANOSECOND
        news = self.guard("the comparison with the measured torque", self.comparison.take, stamp, values, arrival, set_ns)
        if news:
            self._reasons_seen = None
            self._log(Level.OK, news)
        if new_reasons and self.active:
            self._publish_status(self.clock.steady_ns())
        self.guard("learning", self.learning.take, stamp, values, self.session)  # it acts from the next step on
        if self.on_estimate:
            record = self.on_estimate
            self.guard("recording", lambda: record([*values, *self.learning.columns(values, self.session)], stamp, arrival))

    def _report_fault(self, text: str) -> None:
        self._reasons_seen = None
        self._log(Level.ERROR, text)

    def _log(self, level: Level, text: str) -> None:
        try:
            self._transport.log(level, text)
        except KeyboardInterrupt:
            raise
        except BaseException:  # the failure to report cannot be reported
            pass

    def _publish(self, steady: int) -> None:
        pace = self.clock.pace_ns(steady)
        goal, target, unfed = self._fed(steady, pace)
        self._show(unfed)
        self._publisher.publish(steady, pace, self._reasons_or_fault, goal, target)

    def _keep_published(self, stamp: int, numbers: list[float], reasons: Reasons) -> None:
        if self.on_published:
            steady = self.clock.steady_ns()
            at_ns = self.clock.recorded_ns(steady, self.clock.pace_ns(steady))
            self.guard("recording", self.on_published, stamp, numbers, reasons, at_ns)

    def _fed(self, steady: int, pace: int) -> tuple[float, float, int]:
        """The session's feed-forward now and its target [Nm], and the reason why that is zero; see `feedforward_at`."""
        arrival = self.clock.recorded_ns(steady, pace)
        goal, target, unfed = feedforward_at(self.estimator.constants, self.session.memory, self.session.motion, arrival)
        return float(goal), float(target), unfed

    def _reasons_or_fault(self, steady: int) -> Reasons:
        hold = self.guard("the reasons", self._reasons, steady)
        return (("PART_FAILED", Level.WARN),) if hold is None else hold

    def _show(self, reasons: int) -> None:
        """Publish reasons between two estimates, at once where they are new."""
        if self.guard("watching the reasons", self._watch.note, reasons):
            self._reasons_seen = None
            if self.active:
                self._publish_status(self.clock.steady_ns())

    def _reasons(self, steady: int) -> Reasons:
        """All present notices, each name once."""
        old = self._publisher.age_s(steady) > self._publisher.max_age_s
        seen = self._reasons_seen
        if seen is None or old is not seen[1] or not 0 <= steady - seen[0] < REASONS_KEPT_NS:
            hold = tuple({notice.name: notice.level for notice in self.notices(steady)}.items())
            self._reasons_seen = seen = steady, old, hold
        return seen[2]

    # Outputs

    def activate(self) -> None:
        """Begin to publish, once nobody else publishes the feed-forward. The estimate runs whether it is published or not."""
        self._publisher.begin()
        self.active, self._withdrawn, self._withheld, self._reasons_seen = True, False, False, None
        self.guard("looking for other publishers", self._look_around, self.clock.steady_ns())

    def deactivate(self, error: BaseException | None = None, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Ramp the feed-forward to zero at its rate limit, and stop publishing; log and report the fault behind it, if any.

        It takes `feedforward_fade_s` at most, and calls `meanwhile` every `period_s`. It never raises: where nothing can be
        published, nothing can be done.
        """
        if error is not None:
            self.guard.failed("the main loop", error, essential=True)
        if not self.active:
            return
        self._withdrawn, self._reasons_seen = True, None
        self._publisher.withdraw(self.clock.steady_ns())
        self._publish_status(self.clock.steady_ns(), diagnostics=True)
        with suppress(Exception):
            while self._publisher.opened and self._publisher.stamp_ns is not None:
                self._publish(self.clock.steady_ns())
                if self._publisher.feedforward == 0.0:
                    break
                self._sleep(self.period_s)
                meanwhile()
        self._publish_status(self.clock.steady_ns(), diagnostics=True)
        self.active = False

    def tick(self) -> None:
        """Publish, check ages and peers, and save the state, each when due; to be called every `period_s`.

        It never raises: a part that fails is named on the status, and the others run.
        """
        steady = self.clock.steady_ns()
        age_s, max_age_s = self._publisher.age_s(steady), self._publisher.max_age_s
        turned_old = self.guard("watching the age of the speed", self._watch.look_at_age, age_s, max_age_s)
        self.guard.essential("taking late messages", self.messages.handle_late, steady)
        if steady >= self._next_look_ns:
            self._next_look_ns = steady + LOOK_NS
            self.guard("looking for other publishers", self._look_around, steady)
        self.guard("withholding the feed-forward", self._withhold, steady)
        self.guard.essential("publishing", self._publish_due, steady)
        if steady >= self._next_second_ns:
            self._next_second_ns += SECOND_NS * (1 + (steady - self._next_second_ns) // SECOND_NS)
            self._every_second(steady)
        elif turned_old and self.active:
            self._publish_status(steady)
        self.guard("saving the state", self._save_due, steady)
        self.guard("the service manager", self._service.alive, self._publisher.sent, self.active, steady)

    def _look_around(self, steady: int) -> None:
        """Open the outputs where nobody else publishes the feed-forward; receive what publishers keep, soon after the start."""
        rivals = self._transport.rivals()
        if self.active and not self._publisher.opened and rivals is not None and not rivals:
            self._transport.open_outputs()
            self._publisher.opened = True
        if rivals is not None and set(rivals) != set(self._rivals):
            self._rivals, self._reasons_seen = tuple(dict.fromkeys(rivals)), None
        if steady - self._started_ns < STARTING_NS:
            for index, given in enumerate(self.inputs):
                if given.stands and index not in self._latched:
                    self._latch(index, self._transport.peers(index))

    def _latch(self, index: int, peers: Sequence[Peer]) -> None:
        """Receive what publishers of an input keep, if one does. Others would warn of a subscriber that asks for too much."""
        if any(peer.latched and peer.type == self.inputs[index].type and peer.defines_alike for peer in peers):
            self._transport.latch(index)
            self._latched.add(index)

    def _withhold(self, steady: int) -> None:
        """Let the feed-forward go to zero while another gives the torque or the speed too, or there is no time."""
        now = self.clock.recorded_ns(steady, self.clock.pace_ns(steady))
        withheld = bool(self._rivals or self.sources.disagreeing(now) or self._clock_is_bad(steady))
        if withheld is self._withheld:
            return
        self._withheld, self._reasons_seen = withheld, None
        if not self._withdrawn:
            self._publisher.withdraw(steady if withheld else None)
        if self.active:
            self._publish_status(self.clock.steady_ns())

    def _clock_is_bad(self, steady: int) -> bool:
        return self.clock.simulated and self.clock.now_ns(steady) == 0

    def _publish_due(self, steady: int) -> None:
        early_ns = 0 if self._on_speed else int(0.5 * self.period_s * SECOND_NS)
        if self.publishes and steady >= self._next_output_ns - early_ns:
            between_ns = int(self._between_outputs_s * SECOND_NS)
            self._next_output_ns = max(self._next_output_ns + between_ns, steady)
            self._publish(steady)
        elif self.publishes and self._between_outputs_s > LONGEST_PERIOD_S and self._has_to_fall(steady):
            self._publish(steady)

    def _has_to_fall(self, steady: int) -> bool:
        """Whether the last published torque is on its way to zero or through it: that waits for no slow rate of outputs."""
        here = self._publisher.feedforward
        if here == 0.0:
            return False
        return self._publisher.left(steady) < 1.0 or here * self._fed(steady, self.clock.pace_ns(steady))[1] <= 0.0

    def _save_due(self, steady: int) -> None:
        if steady >= self._next_save_ns:
            self._next_save_ns = steady + self._save_period_ns()
            self.keeper.save_soon(self.session, self._state_at, self.learning)

    def _every_second(self, steady: int) -> None:
        self.guard("watching the inputs", self._look, steady)
        self.guard("the log", self._log_notices, steady)
        if self.active:
            self._publish_status(steady, diagnostics=True)

    def _look(self, steady: int) -> None:
        self._peers = [()] * len(self.inputs)
        self.messages.misread = ()
        try:
            self._peers = [self._transport.peers(i) for i in range(len(self.inputs))]
            self._look_at_peers()
        finally:  # rates and refusals are of interest without peers too
            arrival = self.clock.recorded_ns(steady, self.clock.pace_ns(steady))
            self._watch.every_second(self.session, self.messages.reader, self._peers, steady, arrival)
            self._reasons_seen = None

    def _look_at_peers(self) -> None:
        """Treat each input as its present publishers require."""
        self.messages.misread = [i for i, found in enumerate(self._peers) if any(peer.misread for peer in found)]
        several = {}
        for index, (given, found) in enumerate(zip(self.inputs, self._peers, strict=True)):
            sending = [peer for peer in found if peer.compatible and peer.type == given.type]
            several[index] = len(sending) > 1
            if not given.stands:
                continue
            if index not in self._latched:
                self._latch(index, found)
            self.messages.repeat(index, {peer.source for peer in sending if peer.latched})
        self.messages.mixed = [index for index, more in several.items() if more]

    def _log_notices(self, steady: int) -> None:
        notices = self.notices(steady)
        texts = "; ".join(notice.text for notice in notices) or "no warnings"
        self.guard("the service manager", self._service.status, f"{level_of(notices).name.lower()}: {texts}")
        entry = self._watch.to_log(notices, steady)
        if entry:
            self._log(*entry)

    def _publish_status(self, steady: int, diagnostics: bool = False) -> None:
        self.guard("publishing statuses", self._publish_statuses, steady, diagnostics)

    def _publish_statuses(self, steady: int, diagnostics: bool) -> None:
        name = f"{self.namespace.rstrip('/')}/{self.node}".lstrip("/")
        found = self.guard("the statuses", lambda: statuses(self.overview(steady), name, self.vehicle.name))
        learned = self.guard("the statuses of learning", self.learning.statuses, name, self.vehicle.name)
        bare = [] if found else [bare_status(self.notices(steady), name, self.vehicle.name)]
        self._publisher.publish_statuses(found or bare, self.clock.now_ns(steady), diagnostics, learned or ())

    def notices(self, steady: int | None = None) -> list[Notice]:
        """All present notices, most severe first."""
        steady = self.clock.steady_ns() if steady is None else steady
        found = [
            *(self.guard("watching the inputs", self._watched, steady) or []),
            *(self.guard("the comparison with the measured torque", self.comparison.notices, self._diagnose) or []),
            *(self.guard("learning", self.learning.notices) or []),
            *(self.guard("publishing statuses", self._publisher.notices) or []),
            *(self.guard("saving the state", self.keeper.notices) or []),
            *(self.guard("recording", self.recording_notices) or []),
            *self.guard.notices(steady),
        ]
        if self._withdrawn and all(notice.name != "INTERNAL_ERROR" for notice in found):  # which says why it ends
            found.append(Notice("INACTIVE", "the node is deactivated or ends, and the feed-forward goes to zero"))
        return sorted(found, key=lambda notice: -notice.level)

    def _watched(self, steady: int) -> list[Notice]:
        found = self._watch.notices(
            age_s=self._publisher.age_s(steady),
            max_age_s=self._publisher.max_age_s,
            period_s=int(self.session.memory.times[at.SPEED, at.Times.period]) * NANOSECOND,
            no_clock=self.clock.lack if self._clock_is_bad(steady) else "",
        )
        if self._rivals:
            found.append(contested(self._rivals, self._publisher.opened))
        both = self.sources.disagreeing(self.clock.recorded_ns(steady, self.clock.pace_ns(steady)))
        if both:
            index = next(index for index, given in enumerate(self.inputs) if "speed" in given.roles)
            found.append(two_speeds(self._topic_names[index], both, self._peers[index]))
        return found

    def overview(self, steady: int | None = None) -> Overview:
        """Snapshot for statuses and the terminal."""
        steady = self.clock.steady_ns() if steady is None else steady
        return overview(self.notices(steady), self._publisher, self._watch, self.comparison, self.keeper, self.learning, steady)

    # Requests of a transport or a signal

    def change(self, given: Mapping[str, object]) -> None:
        """Change parameters while running; the temperatures stay.

        Raises InputError as `checked_change` does; then nothing is changed.
        """
        parameters = self.checked_change(given)
        settings = settings_for(parameters.settings(), self.topics)
        self.comparison.change(parameters.mismatch())
        self.learning.change(parameters.text("learning"), self.session)
        if parameters.number("save_period_s") != self.parameters.number("save_period_s"):
            self._next_save_ns = self.clock.steady_ns()
        if parameters.number("output_rate_hz") != self.parameters.number("output_rate_hz"):
            self._next_output_ns = self.clock.steady_ns()
        self.parameters = parameters
        if settings != self.estimator.settings:
            self._go_on_with(Estimator(self.vehicle, settings))

    def checked_change(self, given: Mapping[str, object]) -> Parameters:
        """The parameters after a change, which is not made; see `changed_parameters`."""
        return changed_parameters(self.parameters, given, self.topics)

    def reset(self) -> str:
        """Start cold, with belts at the ambient temperature; inputs stay. Return a text for the log."""
        age_s = self._publisher.age_s(self.clock.steady_ns())
        self.session.start_cold(driving=age_s <= self._publisher.max_age_s)
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
        reader, channels = self.messages.reader, self.estimator.channels
        counted = [f"{name} {count.name.lower()} {number}" for name, count, number in self.session.counts()]
        others = {"bad_stamp": reader.bad_stamp, "without_other_part": reader.alone(), "absent": reader.absent}
        others |= dict(zip(COMPANIONS, map(list, zip(*reader.dropped_by_companions(), strict=True)), strict=True))
        others["unused"] = reader.unused
        for kind, counts in others.items():
            counted += [f"{name} {kind} {n}" for name, n in zip(channels, counts, strict=True) if n]
        counted += [f"{name} dropped {n}" for name, n in zip(self._topic_names, reader.dropped, strict=True) if n]
        self._log(Level.OK, f"messages: {', '.join(counted) or 'none'}")

    def _go_on_with(self, estimator: Estimator) -> None:
        session = estimator.session()
        session.adopt(self.session)
        self.estimator, self.session = estimator, session
        self._publisher.estimator = estimator

    def _rest_unused_belts(self) -> None:
        """Belts from a state file cool and learned values wear until the first speed: a clock set before that tells how long."""
        off = max(0.0, time.time() - self._state_at)
        if self.session.started:
            self.session.begin(self.estimator.rest(self.session.state, None, min(off, LONGEST_OFF)))
        self.learning.wear(off)
        self._state_at += off

    def _save_period_ns(self) -> int:
        return int(self.parameters.number("save_period_s") * SECOND_NS)

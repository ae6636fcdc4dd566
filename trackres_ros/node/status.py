# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The state of the running node: ages, rates, refusals and publishers become notices, an overview of all becomes statuses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.arrays import IntArray
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.disturbance import Belief
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.settings import longest_age_s
from trackres_ros.node.inputs import InputReader
from trackres_ros.node.measured_torque import Mismatch
from trackres_ros.node.notices import KINDS, Notice, level_of, of_reasons
from trackres_ros.node.transport import InputTopic, Level, Peer, Status
from trackres_ros.output.topics import TOTALS, sign_of
from trackres_ros.text import figures
from trackres_ros.units import NANOSECOND

REFUSED_SHARE = 0.1  # of the messages of a second: more is not the odd late one
CLOCK_OFFSET_NS = 1_000_000_000
STARTING_NS = 5_000_000_000  # assumed: publishers are found within 2 s, and the slowest usual input comes at 1 Hz
ENOUGH_HZ = 10  # of a speed: a controller's feed-forward is then never older than its speed by more than 0.1 s
COMPANIONS = ("invalid", "without_direction")
"""Why a sample was dropped before the guards, see `recording.combining`."""
REFUSALS = tuple(count.name.lower() for count in at.REFUSALS)
SLOW_ROLES = ("speed", "accel", "grade", "yaw_rate", "heading")  # they may come rarely, and are then used for longer
DIGITS = {"stamp": 3, "age_s": 3, "feedforward_left": 3, "value": 4, "there": 3, "since": 3, "share": 4}
"""Digits behind the point of the numbers in statuses; others have one."""

Values = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class InputState:
    """One role of one input topic in the last second."""

    role: str
    topic: str  # full name, remapped
    rate_hz: float  # messages received, including refused ones [1/s]
    age_s: float  # since the arrival of the last accepted one, by a monotonic clock [s]; nan if there was none
    value: float  # the last accepted one, in the unit of the role; nan if there was none
    counts: tuple[tuple[str, int], ...]  # counters that are not zero, by name
    refusals: str = ""  # numbers and kinds, where too many were rejected
    too_old: bool = False  # whether the last accepted value is not used any more


class Watch:
    """Statistics of inputs, whose topics have their full names, and of estimates; they change nothing."""

    def __init__(self, estimator: Estimator, inputs: Sequence[InputTopic]) -> None:
        self.accepted_ns: list[int | None] = [None] * len(estimator.channels)  # by a steady clock
        self._inputs: tuple[InputState, ...] = ()
        self.steps_hz = 0.0
        self._roles = [(role, i) for i, topic in enumerate(inputs) for role in topic.valued if role in estimator.channels]
        self._channel = {role: estimator.channels.index(role) for role, _ in self._roles}
        self._topics = inputs
        self._peers: Sequence[Sequence[Peer]] = [()] * len(inputs)
        self._last: dict[str, IntArray] = {}  # counters at the last look, by name
        self._drops: list[tuple[str, int]] = []
        self._looked_ns: int | None = None
        self._shown_reasons, self._second_reasons, self._last_reasons = 0, 0, 0
        self._steps = 0
        self._was_old: bool | None = None
        self._offset_ns = 0
        self._began_ns: int | None = None
        self._missing_inputs: set[int] = set()  # inputs whose message stands, and which have had none
        self._logged_names: frozenset[str] | None = None

    def count_step(self, reasons: int, offset_ns: int) -> bool:
        """Record an estimate; return true if it has reasons that are not shown yet."""
        self._steps += 1
        self._offset_ns, self._last_reasons = offset_ns, reasons
        return self.note(reasons)

    def note(self, reasons: int) -> bool:
        """Record present reasons; return true if some are not shown yet."""
        self._second_reasons |= reasons
        news = bool(reasons & ~self._shown_reasons)
        self._shown_reasons |= reasons
        return news

    def look_at_age(self, age_s: float, max_age_s: float) -> bool:
        """True when the speed has just become too old, or fresh again."""
        is_old = age_s > max_age_s
        is_new, self._was_old = is_old is not self._was_old, is_old
        return is_new

    def inputs(self, steady_ns: int) -> tuple[InputState, ...]:
        """Every role in the last second, with its present age."""
        ages = {role: self.accepted_ns[self._channel[role]] for role, _ in self._roles}
        return tuple(
            replace(state, age_s=math.nan if (at_ns := ages[state.role]) is None else (steady_ns - at_ns) * 1e-9)
            for state in self._inputs
        )

    def every_second(
        self, session: Session, reader: InputReader, peers: Sequence[Sequence[Peer]], steady_ns: int, arrival: int
    ) -> None:
        """Work out rates and refusals since the last call, and begin a new second. `arrival` is that of a message now [ns]."""
        elapsed_s = math.nan if self._looked_ns is None else max((steady_ns - self._looked_ns) * 1e-9, 1e-9)
        totals = {count.name.lower(): session.memory.counters[:, count] for count in at.Count} | reader.counts()
        increases = {name: self._increase(name, counts) for name, counts in totals.items()}
        counts_received = self._increase("received", reader.message_counts)
        self._drops = [(topic.name, int(n)) for topic, n in zip(self._topics, increases["dropped"], strict=True) if n]
        states = []
        for role, i in self._roles:
            channel = self._channel[role]
            place = {name: i if name == "dropped" else channel for name in totals}
            latest_counts = {name: int(counts[place[name]]) for name, counts in increases.items()}
            messages = sum(latest_counts[name] for name in ("accepted", *REFUSALS, "bad_stamp", "unused"))
            messages = int(counts_received[i]) if role in reader.sums else messages
            refusals = _refusal_text(latest_counts, messages, reader.lack_texts[channel])
            messages += 0 if role in reader.sums else sum(latest_counts[name] for name in ("absent", *COMPANIONS))
            counts = tuple((name, int(n)) for name, counter in totals.items() if (n := counter[place[name]]))
            value, is_old = float(session.memory.values[channel]), self._is_old(role, session, steady_ns, arrival)
            states.append(InputState(role, self._topics[i].name, messages / elapsed_s, math.nan, value, counts, refusals, is_old))
        self._inputs = tuple(states)
        pending_reasons = self._last_reasons if not (self._steps or self._was_old) else 0  # of a slow speed, until its next step
        self.steps_hz, self._steps = self._steps / elapsed_s, 0
        self._peers, self._looked_ns = peers, steady_ns
        self._began_ns = steady_ns if self._began_ns is None else self._began_ns
        is_late = steady_ns - self._began_ns >= STARTING_NS
        self._missing_inputs = {
            i for i, topic in enumerate(self._topics) if is_late and topic.stands and not reader.message_counts[i]
        }
        self._shown_reasons, self._second_reasons = self._second_reasons | pending_reasons, 0

    def _is_old(self, role: str, session: Session, steady_ns: int, arrival: int) -> bool:
        """Whether the last accepted value of a role is not used any more."""
        channel, settings = self._channel[role], session.estimator.settings
        age_ns = steady_ns - (self.accepted_ns[channel] or 0)  # simulated time does not age a speed
        if role != "speed":
            age_ns = arrival - int(session.memory.times[channel, at.Times.last_arrival])
        allowed_s = longest_age_s(settings, role)
        if role in SLOW_ROLES:
            period_s = int(session.memory.times[channel, at.Times.period]) * NANOSECOND
            allowed_s = max(allowed_s, min(1.5 * period_s, settings.slow_input_max_age_s))
        return age_ns * NANOSECOND > allowed_s

    def _increase(self, name: str, counters: Sequence[int] | Sequence[Sequence[int]] | IntArray) -> IntArray:
        """What was added to counters since the last look at them."""
        latest_counts = np.array(counters, dtype=np.int64)
        last, self._last[name] = self._last.get(name, np.zeros_like(latest_counts)), latest_counts
        return latest_counts - last

    def notices(self, age_s: float, max_age_s: float, period_s: float, no_clock: str) -> list[Notice]:
        """All present notices of inputs and estimate; `period_s`: in which the speed comes; `no_clock`: why there is no time,
        empty if there is one.
        """
        notices: list[Notice] = []
        if no_clock:
            notices.append(Notice("NO_CLOCK", no_clock))
        if math.isinf(age_s):
            notices.append(Notice("NO_SPEED", "no speed yet"))
        elif age_s > max_age_s:
            fade_text = "the feed-forward fades to zero"
            notices.append(
                Notice("SPEED_OLD", f"no accepted speed for {age_s:.1f} s, at most {max_age_s:g} s allowed: {fade_text}")
            )
        for name, number in self._drops:
            text = f"{name}: {number} messages were dropped in the last second, as they arrived too fast"
            notices.append(Notice("OVERRUN", text))
        refusals = {state.role: state.refusals for state in self._inputs if state.refusals}
        notices += [Notice("REFUSED", f"{role}: rejected in the last second: {text}") for role, text in refusals.items()]
        notices += [
            notice for topic, peers in zip(self._topics, self._peers, strict=True) for notice in _peer_notices(topic, peers)
        ]
        notices += [notice for i in sorted(self._missing_inputs) for notice in _latch_notices(self._topics[i], self._peers[i])]
        if abs(self._offset_ns) > CLOCK_OFFSET_NS and not no_clock:
            side = "behind" if self._offset_ns > 0 else "ahead of"
            text = f"the stamps of the speed are {abs(self._offset_ns) * 1e-9:.1f} s {side} this node's clock"
            notices.append(Notice("CLOCK_OFFSET", text))
        reasons = at.Reason(self._shown_reasons)
        if reasons & at.Reason.SPEED_SLOW:
            reasons &= ~at.Reason.SPEED_SLOW
            notices.append(_slow_speed_notice(period_s, max_age_s))
        return notices + of_reasons(reasons)

    def to_log(self, notices: Sequence[Notice], steady_ns: int) -> tuple[Level, str] | None:
        """Level and text for the log, if the notices above OK have changed since the last call.

        Just after the start a missing input is no warning.
        """
        if self._began_ns is None:
            return None
        starting = steady_ns - self._began_ns < STARTING_NS
        heavy_notices = [notice for notice in notices if notice.level > Level.OK]
        wrong_notices = [notice for notice in heavy_notices if not (starting and KINDS[notice.name].awaited)]
        names = frozenset(notice.name for notice in wrong_notices) or frozenset({"STARTING"} if heavy_notices else ())
        if names == self._logged_names:
            return None
        self._logged_names = names
        text = "; ".join(notice.text for notice in wrong_notices or heavy_notices) or "no warnings"
        return (level_of(wrong_notices), text if wrong_notices or not heavy_notices else f"waiting for inputs: {text}")


def _refusal_text(latest_counts: Mapping[str, int], messages: int, lack: str) -> str:
    """Numbers and kinds of the messages rejected in the last second, where they are many; `lack` is the last missing field."""
    refusals = {name: latest_counts[name] for name in (*REFUSALS, "bad_stamp", "without_other_part", *COMPANIONS)}
    if not latest_counts["accepted"]:  # else another publisher on the topic has the element
        refusals[f"absent (the messages do not have {lack})"] = latest_counts["absent"]
    is_many = sum(refusals.values()) > REFUSED_SHARE * messages
    return ", ".join(f"{number} {name}" for name, number in refusals.items() if number and is_many)


def _slow_speed_notice(period_s: float, max_age_s: float) -> Notice:
    """What a speed that comes rarely means; a period longer than the age is one of fading."""
    effect = (
        f"it is trusted for {figures(max_age_s, 2)} s"
        if period_s <= max_age_s
        else f"the feed-forward fades after {figures(max_age_s, 2)} s"
    )
    rate = figures(1.0 / period_s, 2) if period_s > 0.0 else "?"
    return Notice("SPEED_SLOW", f"your speed comes at {rate} Hz; {effect}: send it at {ENOUGH_HZ} Hz or more")


def _peer_notices(topic: InputTopic, peers: Sequence[Peer]) -> list[Notice]:
    roles = topic.role_names
    publishers = [peer for peer in peers if peer.type == topic.type and not peer.is_misread]
    notices = []
    if any(peer.is_misread for peer in peers):
        text = f"{roles}: a publisher on {topic.name} has another definition of {topic.type}: no message of the topic is used"
        notices.append(Notice("WRONG_TYPE", text))
    for kind in sorted({peer.type for peer in peers} - {topic.type}):
        notices.append(Notice("WRONG_TYPE", f"{roles}: a publisher on {topic.name} sends {kind} instead of {topic.type}"))
    if not publishers:
        notices.append(Notice("NO_PUBLISHER", f"{roles}: nobody publishes {topic.type} on {topic.name}"))
    elif len(publishers) > 1:
        notices.append(
            Notice("SEVERAL_PUBLISHERS", f"{roles}: {len(publishers)} publishers on {topic.name} ({_names(publishers)})")
        )
    if incompatible := [peer for peer in publishers if not peer.compatible]:
        cause = "its quality of service is below what the input requests, or its type's definition differs"
        notices.append(Notice("INCOMPATIBLE_QOS", f"{roles}: {_names(incompatible)} on {topic.name} never connects: {cause}"))
    return notices


def _latch_notices(topic: InputTopic, peers: Sequence[Peer]) -> list[Notice]:
    """That publishers of an input have sent nothing so far, and keep nothing of what they sent before."""
    publishers = [peer for peer in peers if peer.compatible and peer.type == topic.type]
    if not publishers or any(peer.latched for peer in publishers):
        return []
    text = (
        f"{topic.role_names}: nothing came from {_names(publishers)} on {topic.name}, "
        "which keeps nothing for those who join later; publish it again and again, or reliable and transient local"
    )
    return [Notice("NOT_LATCHED", text)]


def contest_notice(rivals: Sequence[str], is_open: bool) -> Notice:
    """That others publish the feed-forward too, by the names of their nodes, and whether our topics are open."""
    effect = "the feed-forward goes to zero" if is_open else "nothing is published but /diagnostics"
    end = "until it is gone, which takes up to 20 s after a crash"
    return Notice("TORQUE_CONTESTED", f"another publisher of the feed-forward: {', '.join(rivals)}: {effect} {end}")


def two_speeds(topic: str, pairs: Sequence[tuple[int, float]], peers: Sequence[Peer]) -> Notice:
    """That two publishers of the speed disagree, by their numbers and speeds [m/s]."""
    names = {peer.source: peer.name for peer in peers if peer.source}
    speeds = " and ".join(f"{speed:.2f} m/s{f' from {names[source]}' if source in names else ''}" for source, speed in pairs)
    origin = "" if any(source in names for source, _ in pairs) else f" from {_names(peers)}"
    text = f"{speeds}{origin} on {topic}: none of them is used, and the feed-forward goes to zero; a speed needs one publisher"
    return Notice("TWO_SPEEDS", f"speed: publishers disagree: {text}")


def _names(peers: Sequence[Peer]) -> str:
    return " and ".join(sorted(peer.name for peer in peers))


ESTIMATE_KEYS = {
    "level": "ok, warn, error or stale",
    "remarks": "names of all notices, see docs/robustness.md",
    "stamp": "time of the state [s since 1970], nan before the first",
    "age_s": "time since the last accepted speed [s], by a clock that never jumps",
    "rate_hz": "estimates made [1/s], over the last second",
    "published": "how often the outputs were published",
    "feedforward_left": "share of the feed-forward that is published: 1, falling to 0 while the speed is old",
    "resistance_torque/<name>": f"as on that topic: each of {', '.join(TOTALS)} [Nm]; resistance to forward travel is negative",
    "resistance_std_nm": "standard deviation of its total [Nm]",
    "feedforward_torque_nm": "feed-forward as published [Nm]",
    "speed_mps": "speed of the last step [m/s]",
    "weight_n": "weight of the last step [N]",
    "ambient_degc": "ambient temperature of the last step [degC]",
    "belt_degc/<assembly>": "belt temperature [degC]",
    "belt_std_k/<assembly>": "its standard deviation [K]",
}
INPUT_KEYS = {
    "topic": "the full name of the topic, remapped",
    "rate_hz": "messages [1/s] over the last second, including rejected ones",
    "age_s": "time since the last accepted message [s], by a clock that never jumps",
    "value": "last accepted value in the unit of the role",
    "accepted, non_finite, out_of_range, implausible, duplicate, late, future, backward, bad_stamp": "messages so far, each in "
    "one counter",
    "zero_stamp, gap, clock_jump, reset": "remarks on accepted messages so far",
    "absent": "messages without the element, so far",
    "without_other_part": "messages that gave no sum so far, as another part of it is missing",
    "invalid, without_direction": "values so far that another channel calls invalid, and speeds without a known direction",
    "unused": "speeds so far of another publisher than the one in use, or while publishers disagree; in no other counter",
    "dropped": "messages of the topic so far that were dropped because they arrived too fast; in no other counter",
}
COMPARISON_KEYS = {
    "parted": "true while measured and expected torque differ significantly",
    "after_s": "driving time with a measured torque until then [s]",
    "mean_nm": "measured minus expected torque in the direction of travel, mean since then [Nm]",
    "share": "the same as a share of the expected torque",
    "settled": "true once there is enough data to judge",
}
DISTURBANCE_KEYS = {
    "form": "spells or drift, from the vehicle file",
    "there": "probability that a spell is present; nan for a drift",
    "present": "true from a probability of 0.9 on until it is below 0.1",
    "since": "time when the present spell began or the last one ended [s since 1970]; nan before, and for a drift",
    "torque_nm": "estimated torque of the disturbance against travel [Nm]; no other output includes it",
    "std_nm": "its standard deviation [Nm]",
}
STATE_KEYS = {
    "file": "the state file, empty if none is saved",
    "saved_s_ago": "time since it was written [s]",
    "error": "why not",
}


@dataclass(frozen=True)
class Overview:
    """Snapshot for statuses and the terminal; torques in Nm, positive where they resist forward travel."""

    level: Level
    notices: tuple[Notice, ...]
    stamp_ns: int | None
    age_s: float
    steps_hz: float
    published: int
    left: float
    feedforward_nm: float  # as last published
    values: dict[str, float]  # the last row of results by name, empty before the first
    assemblies: tuple[str, ...]
    inputs: tuple[InputState, ...]
    mismatch: Mismatch
    disturbance: Belief | None
    learning: str  # learned values in a sentence; empty without a measured torque
    state_file: str
    saved_s_ago: float
    state_error: str
    state_unused: str  # why the state file that was there could not be used

    @property
    def message(self) -> str:
        """All notices in one line, except those about the node's start."""
        return "; ".join(notice.text for notice in self.notices if not KINDS[notice.name].of_start) or "ok"


def bare_status(notices: Sequence[Notice], node: str, vehicle: str) -> Status:
    """The node's own status where only its notices are available."""
    level = level_of(notices)
    values = (("level", level.name.lower()), ("remarks", " ".join(notice.name for notice in notices)))
    return Status(level, f"{node}: estimate", "; ".join(notice.text for notice in notices), vehicle, values)


def statuses(overview: Overview, node: str, vehicle: str) -> list[Status]:
    """The statuses of /diagnostics; the first is the node's own."""
    rows = [(overview.level, "estimate", overview.message, _estimate_values(overview))]
    for state in overview.inputs:
        counts = tuple((name, str(number)) for name, number in state.counts)
        values = _values(("topic", "rate_hz", "age_s", "value"), state) + counts
        level, text = _input_level(state)
        rows.append((level, f"input {state.role}", text, values))
    if any(state.role == "torque" for state in overview.inputs):
        level = Level.WARN if overview.mismatch.parted else Level.OK
        rows.append((level, "comparison", overview.mismatch.text, _values(COMPARISON_KEYS, overview.mismatch)))
    if (belief := overview.disturbance) is not None:
        since_s = math.nan if belief.since_ns is None else belief.since_ns * NANOSECOND
        rows.append((Level.OK, "disturbance", belief.text, _values(DISTURBANCE_KEYS, belief, since=since_s)))
    state_values = _values(STATE_KEYS, overview, file=overview.state_file, error=overview.state_error)
    text = "; ".join(filter(None, (overview.state_error, overview.state_unused))) or (
        "kept" if overview.state_file else "not kept"
    )
    rows.append((Level.WARN if overview.state_error else Level.OK, "state", text, state_values))
    return [Status(level, f"{node}: {name}", text, vehicle, values) for level, name, text, values in rows]


def _estimate_values(overview: Overview) -> Values:
    stamp = math.nan if overview.stamp_ns is None else overview.stamp_ns * 1e-9
    remarks = " ".join(notice.name for notice in overview.notices)
    head = ("level", "remarks", "stamp", "age_s", "rate_hz", "published", "feedforward_left")
    derived_values = {"level": overview.level.name.lower(), "remarks": remarks, "stamp": stamp, "rate_hz": overview.steps_hz}
    head_values = _values(head, overview, **derived_values, feedforward_left=overview.left)
    if not overview.values:
        return head_values
    numbers = {f"resistance_torque/{part}": overview.values[name] * sign_of(name) + 0.0 for part, name in TOTALS.items()}
    numbers |= {name: overview.values[name] for name in ("resistance_std_nm", "speed_mps", "weight_n", "ambient_degc")}
    numbers["feedforward_torque_nm"] = overview.feedforward_nm
    belts = [f"{name}/{assembly}" for assembly in overview.assemblies for name in ("belt_degc", "belt_std_k")]
    numbers |= {name: overview.values[name] for name in belts}
    return head_values + tuple((name, _text(value, 3)) for name, value in numbers.items())


def _values(keys: Iterable[str], source: object, **derived_values: object) -> Values:
    """Keys of a status with their texts, of values derived or by that name."""
    values = {key: derived_values[key] if key in derived_values else getattr(source, key) for key in keys}
    return tuple((key, _text(value, DIGITS.get(key, 1))) for key, value in values.items())


def _text(value: object, digits: int) -> str:
    if isinstance(value, float):
        return f"{value:.{digits}f}" if math.isfinite(value) else str(value)
    return str(value).lower() if isinstance(value, bool | np.bool_) else str(value)


def _input_level(state: InputState) -> tuple[Level, str]:
    causes = [f"rejected in the last second: {state.refusals}"] if state.refusals else []
    if math.isnan(state.age_s):
        return Level.STALE, "; ".join(["no accepted message yet", *causes])
    if state.too_old:
        return Level.STALE, "; ".join([f"no accepted message for {state.age_s:.1f} s", *causes])
    if causes:
        return Level.WARN, causes[0]
    return Level.OK, f"{state.rate_hz:.1f} Hz" if state.rate_hz else "no message in the last second"

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Watches the running node: ages, rates, refusals, publishers, and the reasons of the last second become notices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.arrays import IntArray
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.topic_settings import longest_age_s
from trackres_ros.node.endpoints import InputTopic
from trackres_ros.node.input_reader import InputReader
from trackres_ros.node.notices import KINDS, Notice, level_of, of_reasons
from trackres_ros.node.transport import Level, Peer
from trackres_ros.text.numbers import figures
from trackres_ros.units import NANOSECOND

REFUSED_SHARE = 0.1  # of the messages of a second: more is not the odd late one
CLOCK_OFFSET_NS = 1_000_000_000
STARTING_NS = 5_000_000_000  # assumed: publishers are found within 2 s, and the slowest usual input comes at 1 Hz
ENOUGH_HZ = 10  # of a speed: a controller's feed-forward is then never older than its speed by more than 0.1 s
COMPANIONS = ("invalid", "without_direction")
"""Why a sample was dropped before the guards, see `recording.combining`."""
REFUSALS = [int(count) for count in at.REFUSALS]
MESSAGES = [int(at.Count.ACCEPTED), *REFUSALS]


@dataclass(frozen=True, slots=True)
class InputState:
    """One role of one input topic in the last second."""

    role: str
    topic: str  # full name, remapped
    rate_hz: float  # messages received, including refused ones [1/s]
    age_s: float  # since the arrival of the last accepted one, by a monotonic clock [s]; nan if there was none
    value: float  # the last accepted one, in the unit of the role; nan if there was none
    counts: tuple[tuple[str, int], ...]  # counters that are not zero, by name
    refused: str = ""  # numbers and kinds, where too many were rejected
    too_old: bool = False  # whether the last accepted value is not used any more


class Watch:
    """Statistics of inputs, whose topics have their full names, and of estimates; they change nothing."""

    def __init__(self, estimator: Estimator, inputs: Sequence[InputTopic]) -> None:
        self.accepted_ns: list[int | None] = [None] * len(estimator.channels)  # by a steady clock
        self._inputs: tuple[InputState, ...] = ()
        self.steps_hz = 0.0
        self._roles = [(role, i) for i, given in enumerate(inputs) for role in given.valued if role in estimator.channels]
        self._channel = {role: estimator.channels.index(role) for role, _ in self._roles}
        self._topics = inputs
        self._peers: Sequence[Sequence[Peer]] = [()] * len(inputs)
        self._last: dict[str, IntArray] = {}  # counters at the last look, by name
        self._overrun: list[tuple[str, int]] = []
        self._looked_ns: int | None = None
        self._shown_reasons, self._second_reasons, self._last_reasons = 0, 0, 0
        self._steps = 0
        self._old: bool | None = None
        self._offset_ns = 0
        self._began_ns: int | None = None
        self._awaited: set[int] = set()  # inputs whose message stands, and which have had none
        self._logged: frozenset[str] | None = None

    def accepted(self, reasons: int, offset_ns: int) -> bool:
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
        old = age_s > max_age_s
        turned, self._old = old is not self._old, old
        return turned

    def inputs(self, steady: int) -> tuple[InputState, ...]:
        """Every role in the last second, with its present age."""
        ages = {role: self.accepted_ns[self._channel[role]] for role, _ in self._roles}
        return tuple(
            replace(state, age_s=math.nan if (at_ns := ages[state.role]) is None else (steady - at_ns) * 1e-9)
            for state in self._inputs
        )

    def every_second(
        self, session: Session, reader: InputReader, peers: Sequence[Sequence[Peer]], steady: int, arrival: int
    ) -> None:
        """Work out rates and refusals since the last call, and begin a new second. `arrival` is that of a message now [ns]."""
        elapsed_s = math.nan if self._looked_ns is None else max((steady - self._looked_ns) * 1e-9, 1e-9)
        new = self._since("counts", session.memory.counters)
        unused = self._since("unused", reader.unused)
        bad_stamp, alone = self._since("bad_stamp", reader.bad_stamp), self._since("alone", reader.alone())
        received, dropped = self._since("received", reader.received), self._since("dropped", reader.dropped)
        absent, dropped_by = self._since("absent", reader.absent), self._since("companions", reader.dropped_by_companions())
        self._overrun = [(given.name, int(n)) for given, n in zip(self._topics, dropped, strict=True) if n]
        states = []
        for role, i in self._roles:
            channel = self._channel[role]
            ours = new[channel, MESSAGES].sum() + bad_stamp[channel] + unused[channel]
            messages = int(received[i] if role in reader.sums else ours)
            refused = [(at.Count(c).name.lower(), int(new[channel, c])) for c in REFUSALS]
            refused += [("bad_stamp", int(bad_stamp[channel])), ("without_other_part", int(alone[channel]))]
            refused += [(name, int(n)) for name, n in zip(COMPANIONS, dropped_by[channel], strict=True)]
            if not new[channel, at.Count.ACCEPTED]:  # else another publisher on the topic has the element
                refused.append((f"absent (the messages do not have {reader.lacks[channel]})", int(absent[channel])))
            many = sum(number for _, number in refused) > REFUSED_SHARE * messages
            why = ", ".join(f"{number} {name}" for name, number in refused if number and many)
            seen = [(count.name.lower(), int(self._last["counts"][channel, count])) for count in at.Count]
            seen += [("bad_stamp", reader.bad_stamp[channel]), ("without_other_part", int(self._last["alone"][channel]))]
            seen += [("absent", reader.absent[channel]), ("unused", reader.unused[channel]), ("dropped", reader.dropped[i])]
            seen += [(name, int(n)) for name, n in zip(COMPANIONS, self._last["companions"][channel], strict=True)]
            value = float(session.memory.values[channel])
            shown = tuple((name, number) for name, number in seen if number)
            messages += 0 if role in reader.sums else int(absent[channel] + dropped_by[channel].sum())
            since = steady - (self.accepted_ns[channel] or 0)  # simulated time does not age a speed
            if role != "speed":
                since = arrival - int(session.memory.times[channel, at.Times.last_arrival])
            allowed_s, settings = longest_age_s(session.estimator.settings, role), session.estimator.settings
            if role in ("speed", "accel", "grade", "yaw_rate", "heading"):
                period_s = int(session.memory.times[channel, at.Times.period]) * NANOSECOND
                allowed_s = max(allowed_s, min(1.5 * period_s, settings.slow_input_max_age_s))
            old = since * NANOSECOND > allowed_s
            states.append(InputState(role, self._topics[i].name, messages / elapsed_s, math.nan, value, shown, why, old))
        self._inputs = tuple(states)
        still = self._last_reasons if not (self._steps or self._old) else 0  # of a slow speed, until its next step
        self.steps_hz, self._steps = self._steps / elapsed_s, 0
        self._peers, self._looked_ns = peers, steady
        self._began_ns = steady if self._began_ns is None else self._began_ns
        late = steady - self._began_ns >= STARTING_NS
        self._awaited = {i for i, given in enumerate(self._topics) if late and given.stands and not reader.received[i]}
        self._shown_reasons, self._second_reasons = self._second_reasons | still, 0

    def _since(self, name: str, counters: Sequence[int] | Sequence[Sequence[int]] | IntArray) -> IntArray:
        """What was added to counters since the last look at them."""
        now = np.array(counters, dtype=np.int64)
        before, self._last[name] = self._last.get(name, np.zeros_like(now)), now
        return now - before

    def notices(self, age_s: float, max_age_s: float, period_s: float, no_clock: str) -> list[Notice]:
        """All present notices of inputs and estimate; `period_s`: in which the speed comes; `no_clock`: why there is no time,
        empty if there is one.
        """
        found: list[Notice] = []
        if no_clock:
            found.append(Notice("NO_CLOCK", no_clock))
        if math.isinf(age_s):
            found.append(Notice("NO_SPEED", "no speed yet"))
        elif age_s > max_age_s:
            fading = "the feed-forward fades to zero"
            found.append(Notice("SPEED_OLD", f"no accepted speed for {age_s:.1f} s, at most {max_age_s:g} s allowed: {fading}"))
        for name, number in self._overrun:
            text = f"{name}: {number} messages were dropped in the last second, as they arrived too fast"
            found.append(Notice("OVERRUN", text))
        refused = {state.role: state.refused for state in self._inputs if state.refused}
        found += [Notice("REFUSED", f"{role}: rejected in the last second: {why}") for role, why in refused.items()]
        found += [notice for given, peers in zip(self._topics, self._peers, strict=True) for notice in _of_peers(given, peers)]
        found += [notice for i in sorted(self._awaited) for notice in _nothing_kept(self._topics[i], self._peers[i])]
        if abs(self._offset_ns) > CLOCK_OFFSET_NS and not no_clock:
            side = "behind" if self._offset_ns > 0 else "ahead of"
            text = f"the stamps of the speed are {abs(self._offset_ns) * 1e-9:.1f} s {side} this node's clock"
            found.append(Notice("CLOCK_OFFSET", text))
        reasons = at.Reason(self._shown_reasons)
        if reasons & at.Reason.SPEED_SLOW:
            reasons &= ~at.Reason.SPEED_SLOW
            found.append(_of_slow_speed(period_s, max_age_s))
        return found + of_reasons(reasons)

    def to_log(self, notices: Sequence[Notice], steady: int) -> tuple[Level, str] | None:
        """Level and text for the log, if the notices above OK have changed since the last call.

        Just after the start a missing input is no warning.
        """
        if self._began_ns is None:
            return None
        starting = steady - self._began_ns < STARTING_NS
        heavy = [notice for notice in notices if notice.level > Level.OK]
        wrong = [notice for notice in heavy if not (starting and KINDS[notice.name].awaited)]
        names = frozenset(notice.name for notice in wrong) or frozenset({"STARTING"} if heavy else ())
        if names == self._logged:
            return None
        self._logged = names
        text = "; ".join(notice.text for notice in wrong or heavy) or "no warnings"
        return (level_of(wrong), text if wrong or not heavy else f"waiting for inputs: {text}")


def _of_slow_speed(period_s: float, max_age_s: float) -> Notice:
    """What a speed that comes rarely means; a period longer than the age is one of fading."""
    meanwhile = (
        f"it is trusted for {figures(max_age_s, 2)} s"
        if period_s <= max_age_s
        else f"the feed-forward fades after {figures(max_age_s, 2)} s"
    )
    rate = figures(1.0 / period_s, 2) if period_s > 0.0 else "?"
    return Notice("SPEED_SLOW", f"your speed comes at {rate} Hz; {meanwhile}: send it at {ENOUGH_HZ} Hz or more")


def _of_peers(given: InputTopic, peers: Sequence[Peer]) -> list[Notice]:
    roles = given.role_names
    right = [peer for peer in peers if peer.type == given.type and not peer.misread]
    found = []
    if any(peer.misread for peer in peers):
        text = f"{roles}: a publisher on {given.name} has another definition of {given.type}: no message of the topic is used"
        found.append(Notice("WRONG_TYPE", text))
    for kind in sorted({peer.type for peer in peers} - {given.type}):
        found.append(Notice("WRONG_TYPE", f"{roles}: a publisher on {given.name} sends {kind} instead of {given.type}"))
    if not right:
        found.append(Notice("NO_PUBLISHER", f"{roles}: nobody publishes {given.type} on {given.name}"))
    elif len(right) > 1:
        found.append(Notice("SEVERAL_PUBLISHERS", f"{roles}: {len(right)} publishers on {given.name} ({_names(right)})"))
    if apart := [peer for peer in right if not peer.compatible]:
        why = "its quality of service is below what the input requests, or its type's definition differs"
        found.append(Notice("INCOMPATIBLE_QOS", f"{roles}: {_names(apart)} on {given.name} never connects: {why}"))
    return found


def _nothing_kept(given: InputTopic, peers: Sequence[Peer]) -> list[Notice]:
    """That publishers of an input have sent nothing so far, and keep nothing of what they sent before."""
    there = [peer for peer in peers if peer.compatible and peer.type == given.type]
    if not there or any(peer.latched for peer in there):
        return []
    text = (
        f"{given.role_names}: nothing came from {_names(there)} on {given.name}, which keeps nothing for those who join later; "
        "publish it again and again, or reliable and transient local"
    )
    return [Notice("NOT_LATCHED", text)]


def contested(rivals: Sequence[str], opened: bool) -> Notice:
    """That others publish the feed-forward too, by the names of their nodes, and whether our topics are open."""
    what = "the feed-forward goes to zero" if opened else "nothing is published but /diagnostics"
    until = "until it is gone, which takes up to 20 s after a crash"
    return Notice("TORQUE_CONTESTED", f"another publisher of the feed-forward: {', '.join(rivals)}: {what} {until}")


def two_speeds(topic: str, both: Sequence[tuple[int, float]], peers: Sequence[Peer]) -> Notice:
    """That two publishers of the speed disagree, by their numbers and speeds [m/s]."""
    named = {peer.source: peer.name for peer in peers if peer.source}
    speeds = " and ".join(f"{speed:.2f} m/s{f' from {named[source]}' if source in named else ''}" for source, speed in both)
    among = "" if any(source in named for source, _ in both) else f" from {_names(peers)}"
    text = f"{speeds}{among} on {topic}: none of them is used, and the feed-forward goes to zero; a speed needs one publisher"
    return Notice("TWO_SPEEDS", f"speed: publishers disagree: {text}")


def _names(peers: Sequence[Peer]) -> str:
    return " and ".join(sorted(peer.name for peer in peers))

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reports the state of the node: one overview, from which statuses, diagnostics and the table in the terminal are made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from trackres_ros.estimator.disturbance import Belief
from trackres_ros.node.comparison import Comparison
from trackres_ros.node.live_learning import LiveLearning
from trackres_ros.node.measured_torque import Mismatch
from trackres_ros.node.notices import KINDS, Notice, level_of
from trackres_ros.node.output import OutputPublisher
from trackres_ros.node.state_keeper import StateKeeper
from trackres_ros.node.status import InputState, Watch
from trackres_ros.node.transport import Level, Status
from trackres_ros.output.topics import TOTALS, sign_of
from trackres_ros.units import NANOSECOND

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


def overview(
    notices: Sequence[Notice],
    publisher: OutputPublisher,
    watch: Watch,
    comparison: Comparison,
    keeper: StateKeeper,
    learning: LiveLearning,
    steady: int,
) -> Overview:
    """Gather the current overview."""
    estimator = publisher.estimator
    return Overview(
        level=level_of(notices),
        notices=tuple(notices),
        stamp_ns=publisher.stamp_ns,
        age_s=publisher.age_s(steady),
        steps_hz=watch.steps_hz,
        published=publisher.published,
        left=publisher.left(steady),
        feedforward_nm=publisher.feedforward,
        values=dict(zip(estimator.columns, publisher.row, strict=True)) if publisher.row else {},
        assemblies=estimator.assemblies,
        inputs=watch.inputs(steady),
        mismatch=comparison.verdict,
        disturbance=comparison.belief,
        learning=learning.text,
        state_file=str(keeper.path or ""),
        saved_s_ago=math.nan if keeper.saved_ns is None else (steady - keeper.saved_ns) * NANOSECOND,
        state_error=keeper.error,
        state_unused=keeper.unused,
    )


def bare_status(notices: Sequence[Notice], node: str, vehicle: str) -> Status:
    """The node's own status where only its notices are available."""
    level = level_of(notices)
    values = (("level", level.name.lower()), ("remarks", " ".join(notice.name for notice in notices)))
    return Status(level, f"{node}: estimate", "; ".join(notice.text for notice in notices), vehicle, values)


def statuses(seen: Overview, node: str, vehicle: str) -> list[Status]:
    """The statuses of /diagnostics; the first is the node's own."""
    estimate = [
        ("level", seen.level.name.lower()),
        ("remarks", " ".join(notice.name for notice in seen.notices)),
        ("stamp", _text(math.nan if seen.stamp_ns is None else seen.stamp_ns * 1e-9, 3)),
        ("age_s", _text(seen.age_s, 3)),
        ("rate_hz", _text(seen.steps_hz)),
        ("published", str(seen.published)),
        ("feedforward_left", _text(seen.left, 3)),
    ]
    if seen.values:
        values = seen.values
        estimate += [(f"resistance_torque/{part}", _text(values[name] * sign_of(name) + 0.0, 3)) for part, name in TOTALS.items()]
        estimate += [(name, _text(values[name], 3)) for name in ("resistance_std_nm", "speed_mps", "weight_n", "ambient_degc")]
        estimate.append(("feedforward_torque_nm", _text(seen.feedforward_nm, 3)))
        of_belts = [f"{name}/{assembly}" for assembly in seen.assemblies for name in ("belt_degc", "belt_std_k")]
        estimate += [(name, _text(values[name], 3)) for name in of_belts]
    found = [Status(seen.level, f"{node}: estimate", seen.message, vehicle, tuple(estimate))]
    for given in seen.inputs:
        known = (
            ("topic", given.topic),
            ("rate_hz", _text(given.rate_hz)),
            ("age_s", _text(given.age_s, 3)),
            ("value", _text(given.value, 4)),
            *((name, str(number)) for name, number in given.counts),
        )
        level, text = _input_level(given)
        found.append(Status(level, f"{node}: input {given.role}", text, vehicle, known))
    mismatch = seen.mismatch
    if any(given.role == "torque" for given in seen.inputs):
        compared = (
            ("parted", str(mismatch.parted).lower()),
            ("after_s", _text(mismatch.after_s)),
            ("mean_nm", _text(mismatch.mean_nm)),
            ("share", _text(mismatch.share, 4)),
            ("settled", str(mismatch.settled).lower()),
        )
        found.append(Status(Level.WARN if mismatch.parted else Level.OK, f"{node}: comparison", mismatch.text, vehicle, compared))
    if seen.disturbance is not None:
        found.append(_of_disturbance(seen.disturbance, node, vehicle))
    kept = (("file", seen.state_file), ("saved_s_ago", _text(seen.saved_s_ago)), ("error", seen.state_error))
    text = "; ".join(filter(None, (seen.state_error, seen.state_unused))) or ("kept" if seen.state_file else "not kept")
    found.append(Status(Level.WARN if seen.state_error else Level.OK, f"{node}: state", text, vehicle, kept))
    return found


def _of_disturbance(belief: Belief, node: str, vehicle: str) -> Status:
    known = (
        ("form", belief.form),
        ("there", _text(belief.there, 3)),
        ("present", str(belief.present).lower()),
        ("since", _text(math.nan if belief.since_ns is None else belief.since_ns * NANOSECOND, 3)),
        ("torque_nm", _text(belief.torque_nm)),
        ("std_nm", _text(belief.std_nm)),
    )
    return Status(Level.OK, f"{node}: disturbance", belief.text, vehicle, known)


def _input_level(given: InputState) -> tuple[Level, str]:
    why = [f"rejected in the last second: {given.refused}"] if given.refused else []
    if math.isnan(given.age_s):
        return Level.STALE, "; ".join(["no accepted message yet", *why])
    if given.too_old:
        return Level.STALE, "; ".join([f"no accepted message for {given.age_s:.1f} s", *why])
    if why:
        return Level.WARN, why[0]
    return Level.OK, f"{given.rate_hz:.1f} Hz" if given.rate_hz else "no message in the last second"


def _text(value: float, digits: int = 1) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else str(value)

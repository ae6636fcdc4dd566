# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The results of the diagnosis on real recordings, next to the channels that it did not get.

How cold a drive began is fitted to that drive alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from proofs.field.live import learned_rows, live_rows
from proofs.field.trials import (
    COLD_S,
    SECONDS_PER_H,
    FieldTrial,
    RepeatedRoute,
    Start,
    acts_early,
    against_given,
    payload_numbers,
    starts,
    twice,
)
from proofs.tables import Rows, Tables, number
from trackres_ros.arrays import Array
from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.inference.fitting import Fit, fit, with_levels
from trackres_ros.effects.vehicle.warmup import WarmUp
from trackres_ros.text import figures
from trackres_ros.units import MAD_TO_STD

WARM_AFTER_S = 600.0
EVERY_STEPS, FEWEST_APART = 60, 10  # between samples of warm driving
LEAST_KNOWN = 0.2  # of a shape's square
OUTLIER = 4.0  # standard deviations
SETTLED_STD = 1.0  # of a start state: the beginning of a drive with a less certain one can hardly be compared


def tables_of(data: Path, tried: Sequence[FieldTrial], of_bus: Sequence[FieldTrial]) -> Tables:
    """Of `trials.try_all` and `trials.try_bus`: verdicts, start states, slopes, replays, learning, and single numbers."""
    winter, known = tried[0], tried[1]
    begun = starts(data, winter)
    states = start_states(warming(known.found.refitted), [SECONDS_PER_H * s.stood_h for s in begun])
    begun = [replace(s, state=float(x), std=float(d)) for s, x, d in zip(begun, states.alone, states.alone_std, strict=True)]
    slopes, payload = against_given(of_bus)
    numbers = [
        *start_numbers(begun, [acts_early(known, i) for i in range(len(begun))]),
        *(payload_numbers(payload) if payload else ()),
        *route_numbers(twice(next(t for t in tried if "twice" in t.what))),
    ]
    return {
        "real": verdict_rows((*tried, *of_bus)),
        "real_starts": start_rows(begun),
        "real_slopes": slopes,
        "real_replays": live_rows(data),
        "real_learning": learned_rows(data),
        "real_numbers": [{"quantity": quantity, "value": value} for quantity, value in numbers],
    }


def verdict_rows(tried: Sequence[FieldTrial]) -> Rows:
    """What was found in each trial, and the verdict word for word."""
    return [
        {
            "recordings": t.what,
            "concealed": t.hidden,
            "found": "; ".join((*(" or ".join(members) for members in t.named), *t.described)) or t.found.verdict.status,
            "refitted_nm": figures(t.found.held_out.mae["refitted"]),
            "with_effects_nm": figures(t.found.held_out.mae["with_effects"]),
            "outcome": t.outcome,
            "verdict": t.found.verdict.sentence,
        }
        for t in tried
    ]


def start_rows(begun: Sequence[Start]) -> Rows:
    """The car's starts, the longest standing time first."""
    return [
        {
            "trip": s.trip, "stood_h": number(s.stood_h, 1), "ambient_degc": f"{s.ambient:g}",
            "lacks_nm": number(s.lacks, 0), "start_state": number(s.state, 2), "std": number(s.std, 2),
        }
        for s in sorted(begun, key=lambda s: -s.stood_h)
    ]  # fmt: skip


def start_numbers(begun: Sequence[Start], acts_s: Sequence[float]) -> list[tuple[str, str]]:
    """Torque that the base lacks early, how long the named effect acts then, and what the start states follow."""
    cold, lacks, early = np.array([s.cold for s in begun]), np.array([s.lacks for s in begun]), np.array(acts_s)
    numbers = []
    for stop, of in (("a night or a day", cold), ("a short stop", ~cold)):
        numbers.append((f"car, after {stop}: lacks in the first {COLD_S:.0f} s [Nm]", number(float(np.nanmean(lacks[of])), 0)))
        numbers.append((f"car, after {stop}: the named effect acts in the first {COLD_S:.0f} s [s]", number(early[of].mean(), 0)))
    sure = [s for s in begun if s.std < SETTLED_STD and np.isfinite(s.state)]
    numbers.append((f"car: start states with a standard deviation below {SETTLED_STD:g}", str(len(sure))))
    for what, values in (("standing time", [s.stood_h for s in sure]), ("ambient temperature", [s.ambient for s in sure])):
        rank = spearmanr(values, [s.state for s in sure])
        numbers.append((f"car: rank correlation of these with the {what}", number(rank.statistic, 2)))
        numbers.append((f"car: p of that with the {what}", figures(rank.pvalue, 2)))
    return numbers


def route_numbers(route: RepeatedRoute) -> list[tuple[str, str]]:
    """Whether residuals depend on the position, and on the slope."""
    return [
        ("one route twice: correlation of the residuals of both drives", number(route.repeats, 2)),
        ("one route twice: their correlation with the concealed slope", number(route.follows_slope, 2)),
    ]


@dataclass(frozen=True, eq=False)
class Starts:
    """Start states of drives, 0 as warm as after a drive like it, 1 as cold as the ambient; arrays of shape (drives,)."""

    alone: Array  # fitted to each drive alone
    alone_std: Array
    stood_s: Array  # standing time before


def warming(refitted: Fit) -> Fit:
    """A re-fitted base with a warm-up, whatever was named, and values by levels."""
    base = refitted.problem.base
    effect = WarmUp().for_size(base.facts.weight * base.facts.radius, not base.has_belt)
    return with_levels(fit(refitted.problem, [effect], refitted.estimates))


def start_states(fitted: Fit, stood_s: Sequence[float]) -> Starts:
    """The start state of each drive by least squares: the share of a cold start's extra torque over a warm one.

    The fit has an effect that warms up, and values by levels; an unknown standing time is nan.

    Notes
    -----
    The residual of a vehicle model has correlations over minutes, with the street for one. So the uncertainty of a start state
    comes from the same sum over the residuals of all drives from ten minutes on, when they are warm.
    """
    sessions = fitted.problem.sessions

    def begun(gap: float, unseen: bool) -> list[Predicted]:
        changed = [replace(s, gap=gap, after_unseen=unseen) for s in sessions]
        return fitted.problem.base.predict(changed, fitted.base_values, fitted.acting)

    cold, warm = begun(np.inf, False), begun(0.0, True)
    every = np.concatenate([r[s.used] for r, s in zip(fitted.residuals, sessions, strict=True)])
    most = OUTLIER * MAD_TO_STD * float(np.median(np.abs(every - np.median(every))))
    later = [
        np.where(s.used & (s.time >= WARM_AFTER_S), np.clip(r, -most, most), np.nan)
        for r, s in zip(fitted.residuals, sessions, strict=True)
    ]
    states, stds = [], []
    for session, at_cold, at_warm in zip(sessions, cold, warm, strict=True):
        extra = at_cold.torque - at_warm.torque
        shape = np.where(session.time < WARM_AFTER_S, extra, 0.0)[: int(WARM_AFTER_S / session.step)]
        left = np.where(session.used, np.clip(session.torque - at_warm.torque, -most, most + np.abs(extra)), np.nan)
        states.append(_share(shape, left[: len(shape)]))
        apart = [_share(shape, row[i : i + len(shape)]) for row in later for i in range(0, len(row) - len(shape), EVERY_STEPS)]
        known = np.array(apart)[np.isfinite(apart)]
        stds.append(float(np.sqrt(np.mean(known**2))) if len(known) >= FEWEST_APART else np.inf)
    return Starts(np.array(states), np.array(stds), np.array(stood_s))


def _share(shape: Array, left: Array) -> float:
    """Amount of a shape in the residual, nan if less than half of the shape is known."""
    known = np.isfinite(left)
    size = float(shape[known] @ shape[known])
    return float(shape[known] @ left[known]) / size if size > LEAST_KNOWN * float(shape @ shape) else np.nan

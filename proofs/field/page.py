# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes page and pictures of the diagnosis on real recordings.

The start temperatures of several drives are fitted to each alone, and jointly with one time constant of cooling at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from proofs.field.live import learned_page, live_page
from proofs.field.trials import (
    COLD_AFTER_H,
    COLD_S,
    SECONDS_PER_H,
    TURNING,
    FieldTrial,
    RepeatedRoute,
    Start,
    acts_early,
    bus_page,
    starts,
    twice,
)
from trackres_ros.arrays import Array
from trackres_ros.diagnosis.base.base import Predicted
from trackres_ros.diagnosis.inference.fitting import Fit, fit, with_levels
from trackres_ros.diagnosis.selection.as_used import NORMAL_95
from trackres_ros.diagnosis.selection.locate import evenly_filled
from trackres_ros.effects.vehicle.warmup import WarmUp
from trackres_ros.output.style import BLUE, GREY, ORANGE, VERMILION, picture
from trackres_ros.text import decimals
from trackres_ros.units import MAD_TO_STD

SHORTEST_S, LONGEST_S, CONSTANTS = 60.0, 4e5, 40  # time constants of cooling at rest that are tried
SPREADS = np.concatenate(([0.0], np.geomspace(0.05, 2.0, 20)))  # standard deviations of start states about the model
DRAWS = 500
NEAR_BEST = 1.92  # in log-likelihood: 95 % of one parameter
WARM_AFTER_S = 600.0
EVERY_STEPS, FEWEST_APART = 60, 10  # between samples of warm driving
LEAST_KNOWN = 0.2  # of a shape's square
OUTLIER = 4.0  # standard deviations
SURE_STD = 1.0  # of a start state: a less certain one is of a drive whose beginning could hardly be compared


@dataclass(frozen=True, eq=False)
class Starts:
    """Start states of drives, 0 as warm as after a drive like it, 1 as cold as the ambient; arrays of shape (drives,)."""

    alone: Array  # fitted to each drive alone
    alone_std: Array
    stood_s: Array  # standing time before


@dataclass(frozen=True, eq=False)
class PooledStarts:
    """Joint start states of drives: A (1 - exp(-stood / tau)), with a scatter about it."""

    time_constant_s: float  # tau
    low_s: float  # its 95 % interval, which is open at an end of the search range
    high_s: float
    height: float  # A
    spread: float  # standard deviation of start states about the model
    state: Array  # joint estimate of each drive's start state
    std: Array
    rank_together: float  # rank correlation of the standing time with the start states, fitted together
    chance: float  # share of random permutations of the standing times that fit the start states as well
    reached: float  # probability that the rank correlation of states fitted alone reaches `WANTED_RANK` under this model

    @property
    def settled(self) -> bool:
        """Whether the time constant is inside the search range, not at an end."""
        return self.low_s > SHORTEST_S and self.high_s < LONGEST_S


WANTED_RANK = 0.6


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
        remainder = np.where(session.used, np.clip(session.torque - at_warm.torque, -most, most + np.abs(extra)), np.nan)
        states.append(_share(shape, remainder[: len(shape)]))
        apart = [_share(shape, row[i : i + len(shape)]) for row in later for i in range(0, len(row) - len(shape), EVERY_STEPS)]
        known = np.array(apart)[np.isfinite(apart)]
        stds.append(float(np.sqrt(np.mean(known**2))) if len(known) >= FEWEST_APART else np.inf)
    return Starts(np.array(states), np.array(stds), np.array(stood_s))


def _share(shape: Array, left: Array) -> float:
    """Amount of a shape in the residual, nan if less than half of the shape is known."""
    known = np.isfinite(left)
    size = float(shape[known] @ shape[known])
    return float(shape[known] @ left[known]) / size if size > LEAST_KNOWN * float(shape @ shape) else np.nan


def pool(starts: Starts, rng: np.random.Generator) -> PooledStarts:
    """All drives with a known standing time and an identifiable start, together."""
    sure = np.isfinite(starts.stood_s) & np.isfinite(starts.alone) & (starts.alone_std < SURE_STD)
    alone, std, stood = starts.alone[sure], starts.alone_std[sure], starts.stood_s[sure]
    constants = np.geomspace(SHORTEST_S, LONGEST_S, CONSTANTS)
    likelihood, heights = _likelihood(alone, std, stood, constants)
    best = np.unravel_index(int(np.argmax(likelihood)), likelihood.shape)
    height, spread = float(heights[best]), float(SPREADS[best[1]])
    near = constants[likelihood.max(axis=1) > likelihood[best] - NEAR_BEST]
    expectation = height * -np.expm1(-starts.stood_s / constants[best[0]])
    trust = spread**2 / (spread**2 + starts.alone_std**2)
    state = expectation + np.where(sure, trust * (starts.alone - expectation), 0.0)
    as_good = [_likelihood(alone, std, rng.permutation(stood), constants)[0].max() >= likelihood[best] for _ in range(DRAWS)]
    drawing = expectation[sure] + np.hypot(std, spread) * rng.normal(size=(DRAWS, len(alone)))
    rank_together = float(spearmanr(stood, state[sure]).statistic)
    reached = float(np.mean([spearmanr(stood, row).statistic >= WANTED_RANK for row in drawing]))
    return PooledStarts(
        float(constants[best[0]]), float(near[0]), float(near[-1]), height, spread, state, np.sqrt(trust) * starts.alone_std,
        rank_together, float(np.mean(as_good)), reached,
    )  # fmt: skip


def _likelihood(alone: Array, std: Array, stood: Array, constants: Array) -> tuple[Array, Array]:
    """Logarithm of the likelihood and most likely height, each of shape (time constants, spreads)."""
    shape = -np.expm1(-stood / constants[:, np.newaxis, np.newaxis])
    weight = 1.0 / (std**2 + SPREADS[:, np.newaxis] ** 2)
    height = np.maximum((weight * shape * alone).sum(axis=-1) / np.maximum((weight * shape**2).sum(axis=-1), 1e-12), 0.0)
    remainder = alone - height[..., np.newaxis] * shape
    return 0.5 * (np.log(weight) - weight * remainder**2).sum(axis=-1), height


EARLY_S, BIN_S = 900.0, 60.0
YAW_BINS = 16
LEAST_SHOWN_H = 0.03  # on a logarithmic axis, for a trip that began as the one before ended
SIGNIFICANT = 0.05
SETTLED_STD = 1.0  # of a start state: a less certain one is not used


def write_page(data: Path, tried: Sequence[FieldTrial], of_bus: Sequence[FieldTrial], folder: Path, of_pictures: str = "") -> str:
    """Draw the pictures of `run.try_all` and `bus.try_bus` into a folder; the page, whose links begin with `of_pictures`."""
    winter = tried[0]
    route = next(t for t in tried if "twice" in t.what)
    grass = next(t for t in tried if t.wanted == TURNING and t.hidden.startswith("nothing"))
    begun, repeated = starts(data, winter), twice(route)
    states = start_states(warming(tried[1].found.refitted), [SECONDS_PER_H * s.stood_h for s in begun])
    together = pool(states, np.random.default_rng(1))
    begun = [replace(s, state=float(x), std=float(d)) for s, x, d in zip(begun, states.alone, states.alone_std, strict=True)]
    _draw_starts(folder / "starts.png", winter, begun, together)
    _draw_twice(folder / "twice.png", route, repeated)
    _draw_turning(folder / "turning.png", grass)
    lines = [
        "| Recordings | Concealed | Found | Mean error on held-out laps, re-fitted and with effects [Nm] | Outcome |",
        "|---|---|---|---|---|",
    ]
    for t in (*tried, *of_bus):
        named = "; ".join((*(" or ".join(members) for members in t.named), *t.described)) or t.found.verdict.status
        mae = t.found.held_out.mae
        lines.append(f"| {t.what} | {t.hidden} | {named} | {mae['refitted']:.3g}, {mae['with_effects']:.3g} | {t.outcome} |")
    lines += ["", "The verdicts, word for word:", ""]
    lines += [f"- **{t.what}, concealed: {t.hidden}.** {t.found.verdict.sentence}" for t in (*tried, *of_bus)]
    lines += ["", "## The car's starts, unsealed", "", *_starts(begun, together), _where(tried[1], begun), ""]
    lines += [
        f"![Torque that the re-fitted base lacks over the time since the start, and start states.]({of_pictures}starts.png)",
        "",
    ]
    lines += bus_page(of_bus, folder, of_pictures)
    lines += live_page(data)
    lines += learned_page(data)
    lines += ["## A route driven twice", "", *_twice(route, repeated), ""]
    lines += [f"![Residuals of both drives and the slope over the distance.]({of_pictures}twice.png)", ""]
    lines += ["## Turning on wet grass", ""]
    lines += [f"![Measured and expected torque over the yaw rate.]({of_pictures}turning.png)"]
    return "\n".join(lines) + "\n"


def _starts(begun: Sequence[Start], together: PooledStarts) -> list[str]:
    lines = [
        "The start state of each trip is fitted to that trip alone, with a warm-up that uses the clocks. 0 is as warm as after a "
        "drive like it, 1 is fully cold. The standard deviation comes from the same sum over the residual ten minutes and more "
        "after a start, when nothing warms up.",
        "",
        "| Trip | Stood [h] | Ambient [degC] | Lacks in the first three minutes [Nm] | Start state |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {s.trip} | {s.stood_h:.1f} | {s.ambient:g} | {decimals(s.lacks)} | {decimals(s.state, 2)} +- {decimals(s.std, 2)} |"
        for s in sorted(begun, key=lambda s: -s.stood_h)
    ]
    lacks, cold = np.array([s.lacks for s in begun]), np.array([s.cold for s in begun])
    low, high = (f"{x / SECONDS_PER_H:.2g}" for x in (together.low_s, together.high_s))
    return [
        *lines,
        "",
        f"In the first three minutes the base lacks {np.nanmean(lacks[cold]):.0f} Nm after a night or a day "
        f"({COLD_AFTER_H:g} h and more). After a short stop it lacks {np.nanmean(lacks[~cold]):.0f} Nm. {_ranks(begun)}",
        "",
        "A fit of all trips together has one time constant of cooling at rest. Its start states have a spread about the value "
        f"for the standing time. The time constant is {together.time_constant_s / SECONDS_PER_H:.2g} h [{low}, {high}], "
        + ("within" if together.settled else "open to one end of")
        + f" the range tried; the spread is {together.spread:.2g}. These start states have a rank correlation of "
        f"{together.rank_together:.2f} with the standing time, as the fit draws them towards it. Standing times given to the "
        f"trips at random fit as well in {together.chance:.1%} of draws. Were the model true, the states fitted alone would "
        f"reach a rank correlation of {WANTED_RANK:g} in {together.reached:.0%} of winters like this one.",
    ]


def _where(known: FieldTrial, begun: Sequence[Start]) -> str:
    early = np.array([acts_early(known, i) for i in range(len(begun))])
    cold = np.array([s.cold for s in begun])
    return (
        f"With the clock, but without the ambient temperature, the named effect acts for {early[cold].mean():.0f} of the first "
        f"{COLD_S:.0f} s after a night or a day. After a short stop it acts for {early[~cold].mean():.0f} s."
    )


def _ranks(begun: Sequence[Start]) -> str:
    sure = [s for s in begun if s.std < SETTLED_STD and np.isfinite(s.state)]
    if len(sure) < 4:
        return "Too few start states are certain enough to be ranked."
    stood = spearmanr([s.stood_h for s in sure], [s.state for s in sure])
    ambient = spearmanr([s.ambient for s in sure], [s.state for s in sure])
    follow = stood.pvalue < SIGNIFICANT and stood.statistic > 0.0
    return (
        f"The start states of {len(sure)} trips have a standard deviation below {SETTLED_STD:g}. Their rank correlation with the "
        f"standing time is {stood.statistic:.2f} (p = {stood.pvalue:.2g}), with the ambient temperature "
        f"{ambient.statistic:.2f} (p = {ambient.pvalue:.2g}). "
        + (
            "So the start states follow the standing time."
            if follow
            else "So the start states do not follow the standing time, trip by trip."
        )
    )


def _twice(route: FieldTrial, repeated: RepeatedRoute) -> list[str]:
    return [
        f"The residuals of both drives repeat over distance with a correlation of {repeated.repeats:.2f}, and follow the "
        f"concealed slope with {repeated.follows_slope:.2f}. So they depend on the position, which need not be the grade. "
        + ("Grade was not named." if route.outcome == "right" else "Something was named all the same.")
    ]


def _over_time(fit: Fit, sessions: Sequence[int]) -> tuple[Array, Array]:
    """Mean residual of sessions over the time since their start."""
    time, remainder = [], []
    for i in sessions:
        session = fit.problem.sessions[i]
        place_here = session.used & (session.time < EARLY_S)
        time.append(session.time[place_here])
        remainder.append(fit.residuals[i][place_here])
    place = (np.concatenate(time) / BIN_S).astype(int)
    count = np.bincount(place, minlength=int(EARLY_S / BIN_S))
    means = np.bincount(place, np.concatenate(remainder), minlength=int(EARLY_S / BIN_S)) / np.maximum(count, 1)
    return np.asarray((np.arange(len(means)) + 0.5) * BIN_S / 60.0), np.where(count > 0, means, np.nan)


def _draw_starts(path: Path, winter: FieldTrial, begun: Sequence[Start], together: PooledStarts) -> None:
    cold = [i for i, s in enumerate(begun) if s.cold]
    warm = [i for i, s in enumerate(begun) if not s.cold]
    with picture(path, 9.0, 3.4) as figure:
        remainder, right = figure.subplots(1, 2)
        for value, colour, what in ((cold, BLUE, "a night or a day"), (warm, ORANGE, "a short stop")):
            remainder.plot(*_over_time(winter.found.refitted, value), color=colour, label=f"after {what}: re-fitted base")
            remainder.plot(*_over_time(winter.found.final, value), color=colour, linestyle=":", label="with what was named")
        remainder.axhline(0.0, color=GREY, linewidth=0.8)
        remainder.set_xlabel("time since start [min]")
        remainder.set_ylabel("measured less expected torque [Nm]")
        remainder.legend()
        for s in begun:
            colour = BLUE if s.cold else ORANGE
            right.errorbar(
                max(s.stood_h, LEAST_SHOWN_H), s.state, yerr=NORMAL_95 * s.std, fmt="o", markersize=4, color=colour, linewidth=1.0
            )
        hours = np.geomspace(LEAST_SHOWN_H, max(s.stood_h for s in begun), 100)
        says = together.height * -np.expm1(-hours * SECONDS_PER_H / together.time_constant_s)
        right.plot(hours, says, color=GREY, label="all together")
        right.legend()
        right.set_xscale("log")
        right.set_xlabel("time it had stood [h]")
        right.set_ylabel("start state, 0 warm, 1 cold (95 %)")


def _draw_twice(path: Path, route: FieldTrial, repeated: RepeatedRoute) -> None:
    with picture(path, 9.0, 3.8) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        for session, residual, colour in zip(route.found.sessions, repeated.residuals, (BLUE, ORANGE), strict=True):
            upper.plot(repeated.distance / 1000.0, residual, color=colour, label=Path(session.name).stem)
        upper.set_ylabel("measured less expected\ntorque [Nm]")
        upper.legend(ncols=2)
        lower.plot(repeated.distance / 1000.0, 100.0 * repeated.slope, color=GREY)
        lower.set_ylabel("slope [%]\n(concealed)")
        lower.set_xlabel("distance [km]")


def _draw_turning(path: Path, grass: FieldTrial) -> None:
    rows: list[tuple[Array, Array, Array, Array]] = []
    f = grass.found
    for session, base, final in zip(f.sessions, f.refitted.predicted, f.final.predicted, strict=True):
        place_here, way = session.used, np.sign(session.speed)
        resists = [way * torque for torque in (session.torque, base.torque, final.torque)]
        rows.append(
            (np.abs(session.yaw_rate)[place_here], resists[0][place_here], resists[1][place_here], resists[2][place_here])
        )
    yaw, *torques = (np.concatenate(column) for column in zip(*rows, strict=True))
    _, place = evenly_filled(yaw, YAW_BINS)
    count = np.bincount(place)
    middle = np.bincount(place, yaw) / count
    with picture(path, 6.0, 3.4) as figure:
        axes = figure.subplots()
        labels = ("measured", "re-fitted base", "with what was named")
        for torque, colour, label in zip(torques, (GREY, BLUE, VERMILION), labels, strict=True):
            axes.plot(middle, np.bincount(place, torque) / count, color=colour, marker="o", markersize=3, label=label)
        axes.set_xlabel("yaw rate, size [rad/s]")
        axes.set_ylabel("torque against travel, mean [Nm]")
        axes.legend()

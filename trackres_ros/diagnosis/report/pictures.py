# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pictures of a diagnosis. Each has an alternative text."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.empirical.finders import variable_of
from trackres_ros.diagnosis.empirical.payload import Payload, Stretch
from trackres_ros.diagnosis.empirical.term import Term
from trackres_ros.diagnosis.findings.wording import range_of
from trackres_ros.diagnosis.inference.fitting import Fit, for_tests
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.prepare.session import Array, shown_names
from trackres_ros.diagnosis.report.series import (
    MOST_POINTS,
    TITLE_LETTERS,
    WIDTH,
    Picture,
    axis_label,
    bars,
    clock,
    draw_timeline,
    half_interval,
    lasting,
    most_off,
    shown_lap,
    stages,
)
from trackres_ros.diagnosis.selection.as_used import NORMAL_95
from trackres_ros.diagnosis.selection.locate import (
    SMOOTHED_S,
    against_travel,
    evenly_filled,
    rms_over_time,
    smoothed,
    torque_residuals,
)
from trackres_ros.output.style import BLUE, GREY, ORANGE, VERMILION, picture, picture_with_legend, shortened, thinned
from trackres_ros.route.learned import SLOPE
from trackres_ros.route.lookup import SPACING_M
from trackres_ros.text import alike, figures, rising

SHOWN_BINS = 24
OFF_NM = 1e-6  # a term whose gate is closed adds no more
AGAINST = "torque against travel [Nm]"
PERCENT = 100.0


def draw_term(d: Diagnosis, term: Term, path: Path) -> Picture:
    """The residual without a term, and the term's torque: over its variable, or over time without one."""
    left_over = against_travel(d.sessions, torque_residuals(d.final))
    adds = against_travel(d.sessions, term.adds)
    if term.location is not None:
        variable = BY_NAME[term.location.variable]
        course = [variable.of(s, p) for s, p in zip(d.sessions, d.final.predicted, strict=True)]
        label, title = axis_label(variable.name, stages(d)[-1].label), f"{term.name}: {term.effect.text}"
        return _over(d, course, adds, left_over, label, term.name, title, path)
    if course := variable_of(term, d.final):
        label = f"{term.variable} [{term.unit}]" if term.unit else term.variable or term.gate
        gated = [np.where(np.abs(x) > OFF_NM, c, np.nan) for c, x in zip(course, adds, strict=True)]
        return _over(d, gated if term.gate else course, adds, left_over, label, term.name, term.sentence, path)
    if isinstance(term.pattern, Payload):
        return _by_stretch(d, term, term.pattern.stretches, path)
    return _over_time(d, adds, left_over, term, path)


def _label(axis: Any, along: str, across: str, title: str) -> None:
    """Labels of a term's picture: its axes, and its sentence."""
    axis.set_xlabel(along)
    axis.set_ylabel(across)
    axis.set_title(textwrap.fill(title, TITLE_LETTERS))


def _by_stretch(d: Diagnosis, term: Term, stretches: Sequence[Stretch], path: Path) -> Picture:
    """The mass of each stretch with its interval, all recordings in sequence."""
    ends = np.cumsum([s.time[-1] + s.step for s in d.sessions]).tolist()
    begin = dict(zip((s.name for s in d.sessions), [0.0, *ends[:-1]], strict=True))  # [s]
    edges = np.array([[begin[s.recording] + s.begin_s, begin[s.recording] + s.end_s] for s in stretches])
    mass, std = np.array([s.mass for s in stretches]), np.array([s.std for s in stretches])
    with picture_with_legend(path, WIDTH, 3.0) as body:
        axis = body.subplots()
        middle, half = edges.mean(axis=1) / 60.0, 0.5 * np.diff(edges, axis=1)[:, 0] / 60.0
        label = "mass between two stops, with its 95 % interval"
        axis.errorbar(middle, mass, NORMAL_95 * std, half, fmt="none", color=VERMILION, linewidth=1.2, label=label)
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        _label(axis, "time over consecutive recordings [min]", "mass minus the model's [kg]", term.sentence)
    text = "Mass of each fitted stretch between stops, minus the model's. Acceleration, rolling and climbing determine it."
    return Picture(path, f"The term: {term.name}", text)


def _over_time(d: Diagnosis, adds: list[Array], left_over: list[Array], term: Term, path: Path) -> Picture:
    """The recording with the largest torque of the term."""
    i = int(np.argmax([float(np.abs(x[s.used]).sum()) for x, s in zip(adds, d.sessions, strict=True)]))
    session = d.sessions[i]
    left = smoothed(session, left_over[i] + adds[i])
    with picture_with_legend(path, WIDTH, 3.0) as body:
        axis = body.subplots()
        axis.plot(session.time, left, color=BLUE, label=f"residual without the term, means over {lasting(d, SMOOTHED_S)}")
        axis.plot(session.time, np.where(session.used, adds[i], np.nan), color=VERMILION, label=f"{term.name} as found")
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        _label(axis, f"time in {shortened(shown_names(d.sessions)[i], TITLE_LETTERS - 40)} [s]", AGAINST, term.sentence)
    text = (
        "Residual without the term, and the term, over the recording in which it acts most; on hold-out laps the "
        "term is predicted from the torque up to a few seconds before."
    )
    return Picture(path, f"The term: {term.name}", text)


def _over(
    d: Diagnosis, course: list[Array], adds_: list[Array], left_over: list[Array], label: str, name: str, title: str, path: Path
) -> Picture:
    """The residual without a term, and the term's torque, over its variable, where that is known."""
    used = np.concatenate([s.used & np.isfinite(c) for s, c in zip(d.sessions, course, strict=True)])
    adds, residual, x = (np.concatenate(series)[used] for series in (adds_, left_over, course))
    _, place = evenly_filled(x, SHOWN_BINS)
    count = np.bincount(place)
    middle, term, left = (np.bincount(place, weights=w) / np.maximum(count, 1) for w in (x, adds, adds + residual))
    spread = np.sqrt(np.bincount(place, weights=(residual - (left - term)[place]) ** 2) / np.maximum(count, 1))
    with picture_with_legend(path, WIDTH, 3.0) as body:
        axis = body.subplots()
        shown = count > 0
        axis.errorbar(
            middle[shown],
            left[shown],
            spread[shown],
            fmt="o",
            color=BLUE,
            ecolor=GREY,
            markersize=4,
            linewidth=1.0,
            label="residual without it, mean and spread",
        )
        axis.plot(middle[shown], term[shown], color=VERMILION, label=f"{name} as fitted")
        _label(axis, label, AGAINST, title)
    ends = float(term[shown].min()), float(term[shown].max())
    least, most = alike(ends, ends[1] - ends[0])
    text = f"Residual without {name}, and the fitted term, over {label}; from {least} to {most} Nm."
    return Picture(path, f"The term: {name}", text)


def draw_route(term: Term, final: Fit, path: Path) -> Picture:
    """Draw a slope or a torque by place, as learned on the fitted laps."""
    learned = term.learned(final)
    slope = learned.kind == SLOPE
    factor, unit = (PERCENT, "slope [%]") if slope else (1.0, "torque [Nm]")
    way = 0.001 * SPACING_M * np.arange(len(learned.passes))
    x, y = (0.001 * part for part in learned.frame.metres(learned.latitude, learned.longitude))
    with picture_with_legend(path, WIDTH, 5.4) as body:
        along, seen = body.subplots(2, 1, height_ratios=(2.0, 3.0))
        ways = ((0, BLUE, "uphill positive"),) if slope else ((0, BLUE, "one way"), (1, VERMILION, "opposite direction"))
        for column, color, label in ways:
            value, std = factor * learned.value[:, column], factor * learned.std[:, column]
            along.fill_between(way, value - NORMAL_95 * std, value + NORMAL_95 * std, color=color, alpha=0.25, linewidth=0.0)
            along.plot(way, value, color=color, linewidth=1.0, label=f"{label}, with its 95 % interval")
        along.axhline(0.0, color=GREY, linewidth=0.8)
        along.set_xlabel("matched distance along the streets, in the order of the first drive [km]")
        along.set_ylabel(unit)
        ways_known = np.isfinite(learned.value).sum(axis=1)
        mean = np.nansum(learned.value, axis=1) / np.where(ways_known > 0, ways_known, np.nan)
        shown = factor * (learned.value[:, 0] if slope else mean)
        most = float(np.nanmax(np.abs(shown)))
        dots = seen.scatter(x, y, c=shown, cmap="coolwarm", vmin=-most, vmax=most, s=8.0, rasterized=True)
        body.colorbar(dots, ax=seen, label=f"{unit}, in the direction of the first drive" if slope else unit)
        seen.set_aspect("equal")
        seen.set_xlabel("east [km]")
        seen.set_ylabel("north [km]")
    unit, what = ("%", "The slope") if slope else ("Nm", "The torque")
    low, high = (figures(float(q), 2) for q in np.nanquantile(factor * learned.value, (0.025, 0.975)))
    sure = figures(factor * float(np.nanmedian(learned.std)), 2)
    return Picture(
        path,
        "By place",
        f"{what} of each place over the matched distance, and a map of the places; most values are between {low} and {high} "
        f"{unit}, with a median standard deviation of {sure} {unit}.",
    )


LONGEST_SHOWN_S = 400.0
PIECE_S = 30.0  # mean errors of longer pieces are hardly correlated
ROUTE_PICTURES = "route.svg", "route_beside.svg"
DARK = "#333333"
IN_ONE_COLUMN = 8
LAGS = 30
SHOWN_FREQUENCIES = 400
BARTLETT = 1.358  # over the root of the number of frequencies: 95 % of white noise stays within (Kolmogorov and Smirnov)


def draw_all(d: Diagnosis, folder: Path) -> list[Picture]:
    """Draw all pictures of a diagnosis into a folder."""
    found = [
        draw_timeline(d, folder / "believed.svg"),
        draw_before_after(d, folder / "before_after.svg"),
        draw_times(d, folder / "where_time.svg"),
        draw_regimes(d, folder / "where_regime.svg"),
    ]
    found += [draw_term(d, t, folder / f"effect_{t.name}.svg") for t in d.found]
    found += [draw_term(d, t, folder / f"term_{t.name}.svg") for t in d.described if not t.is_by_place]
    by_place = [t for t in d.in_order if t.is_by_place]
    found += [draw_route(term, d.final, folder / name) for name, term in zip(ROUTE_PICTURES, by_place, strict=False)]
    found.append(_laps(d, folder / "held_out.svg"))
    found.append(_noise(d, folder / "noise.svg"))
    if len(d.last.separability.of_names.names) > 1:
        found.append(_matrix(d, folder / "separability.svg"))
    return found


def draw_before_after(d: Diagnosis, path: Path) -> Picture:
    """Draw the hold-out lap with the largest gain of the model, with all its samples, or the part with the largest mismatch."""
    index, rows, drawn, *errors = shown_lap(d, LONGEST_SHOWN_S)
    session, name = d.sessions[index], shown_names(d.sessions)[index]
    time = session.time[rows] - session.time[rows[0]]
    measured = np.where(session.used[rows], session.torque[rows], np.nan)
    before, after = d.refitted.predicted[index].torque[rows], d.final.predicted[index].torque[rows]
    with picture_with_legend(path, WIDTH, 4.0) as body:
        upper, lower = body.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        upper.plot(time, measured, color=GREY, linewidth=2.5, label="measured")
        upper.plot(time, before, color=BLUE, label="simulated, base re-fitted")
        if d.modelled:
            upper.plot(time, after, color=VERMILION, label="simulated, with the effects")
        mismatch = "mismatch before" if d.modelled else "mismatch"
        upper.fill_between(time, measured, before, color=ORANGE, alpha=0.35, linewidth=0, label=mismatch)
        upper.set_ylabel("torque [Nm]")
        upper.set_title(f"{shortened(name, TITLE_LETTERS - 40)}, {drawn}")
        lower.plot(time, session.speed[rows], color=GREY)
        lower.set_ylabel("speed [m/s]")
        lower.set_xlabel("time [s]")
    before_nm, after_nm = map(figures, errors)
    with_terms = f" before and {after_nm} Nm with {', '.join(d.modelled)}" if d.modelled else ""
    text = f"Torque over time on {drawn}: the mean error of the whole lap is {before_nm} Nm{with_terms}."
    return Picture(path, "Measured against simulated", text)


def draw_times(d: Diagnosis, path: Path) -> Picture:
    """The residual over the time of each recording, with or without a named effect; of very many, the worst."""
    unit, word = clock(d)
    residuals = [[smoothed(s, s.torque - stage.torques[i]) for i, s in enumerate(d.sessions)] for stage in stages(d)]
    sizes, rms_nm = rms_over_time(residuals[1])
    shown, names = most_off(sizes), shown_names(d.sessions)
    columns = 1 if len(shown) <= IN_ONE_COLUMN else 2
    rows = -(-len(shown) // columns)
    with picture_with_legend(path, WIDTH, max((1.15 if columns == 1 else 0.9) * rows + 0.5, 2.2)) as body:
        grid = body.subplots(rows, columns, squeeze=False, sharey=True)
        axes = grid.T.ravel()
        for axis, i in zip(axes, shown, strict=False):
            session = d.sessions[i]
            for begin, end in session.stretches(np.isin(session.block, d.split.held_out)):
                axis.axvspan(begin / unit, end / unit, color=GREY, alpha=0.18, linewidth=0, label="held out")
            for stage, of in zip(stages(d), residuals, strict=True):
                line = thinned(session.time / unit, of[i], MOST_POINTS)
                axis.plot(*line, color=stage.colour, label=stage.label, linewidth=0.7 if stage.key == "nominal" else 1.1)
            for found in d.found[:1]:
                for span in found.spans:
                    if span.recording == session.name:
                        ends = span.begin / unit, span.end / unit
                        axis.axvspan(*ends, ymax=0.05, color=ORANGE, linewidth=0, label=f"{found.name} acts most")
            for change in d.changes:
                if change.recording == session.name:
                    axis.axvline(change.time / unit, color=GREY, linestyle="--", linewidth=1.0, label="change of level")
            axis.axhline(0.0, color=GREY, linewidth=0.8)
            axis.set_xlim(session.time[0] / unit, (session.time[-1] + session.step) / unit)
            axis.set_title(shortened(names[i], TITLE_LETTERS // columns - 6), fontsize=8.5)
        for axis in axes[len(shown) :]:
            axis.set_visible(False)
        for column in grid.T:
            [axis for axis in column if axis.get_visible()][-1].set_xlabel(f"time [{word}]")
        body.supylabel("measured minus simulated [Nm]", fontsize=9)
    count, left_out = len(d.sessions), len(d.sessions) - len(shown)
    worst = (
        f" Of {count} recordings, the {len(shown)} with the largest error are drawn; {left_out} are not drawn."
        if left_out
        else ""
    )
    return Picture(
        path,
        "Where: over time",
        f"Measured minus simulated torque over the time of each recording, means over {lasting(d, SMOOTHED_S)}; with gaps where "
        f"nothing could be compared. With the base re-fitted the root mean square is {figures(rms_nm)} Nm.{worst}",
    )


def draw_regimes(d: Diagnosis, path: Path) -> Picture:
    """The mean residual by bins of each variable that varies, between the edges of the bins."""
    variables, columns = list(bars(d)), 2
    rows = max(1, -(-len(variables) // columns))
    with picture_with_legend(path, WIDTH, 1.55 * rows + 0.4) as body:
        axes = body.subplots(rows, columns, squeeze=False, sharey=True).ravel()
        for axis, (name, edges, of_stages) in zip(axes, variables, strict=False):
            for stage, bins, at, half in of_stages:
                mean = [b.mean_residual for b in bins]
                axis.bar(at, mean, 0.38 if d.modelled else 0.7, color=stage.colour, label=stage.label)
                axis.errorbar(at, mean, half, fmt="none", ecolor=DARK, elinewidth=0.8, capsize=1.5)
                for x, b in zip(at, bins, strict=True):
                    if b.p < 0.05:
                        above = b.mean_residual > 0
                        axis.annotate(
                            "*", (x, 0.0), (0, -1 if above else 1), textcoords="offset points", ha="center",
                            va="top" if above else "bottom", color=stage.colour,
                        )  # fmt: skip
            axis.set_xticks(np.arange(len(edges)) - 0.5, rising(edges), fontsize=7)
            axis.margins(y=0.15)
            axis.axhline(0.0, color=GREY, linewidth=0.8)
            axis.set_title(axis_label(name, of_stages[0].stage.label), fontsize=8.5)
        for axis in axes[len(variables) :]:
            axis.set_visible(False)
        if not variables:
            axes[0].set_visible(True)
            axes[0].text(0.5, 0.5, "nothing varies enough to locate the residual", ha="center", transform=axes[0].transAxes)
        body.supylabel("mean residual against travel [Nm]", fontsize=9)
    texts = []
    for b in d.at_base.significant[:5]:
        texts.append(f"{'+' if b.mean_residual > 0.0 else ''}{figures(b.mean_residual)} Nm at {range_of(b)}")
    text = (
        "Mean residual against travel by bins of each variable, each with as many samples; the numbers are the edges of the "
        "bins, lines are 95 % intervals over laps, and a star marks bins beyond noise. With the base re-fitted: "
        f"{'; '.join(texts) or 'no bin exceeds the noise'}."
    )
    return Picture(path, "Where: by regime", text)


def _laps(d: Diagnosis, path: Path) -> Picture:
    h = d.held_out
    with picture_with_legend(path, WIDTH, 2.2) as body:
        axis = body.subplots()
        wide = 0.8 / len(stages(d))
        for i, stage in enumerate(stages(d)):
            place = np.arange(len(h.laps)) + (i - 0.5 * (len(stages(d)) - 1)) * wide
            axis.bar(place, h.by_lap["mae"][stage.key], wide, color=stage.colour, label=stage.label)
            half = _uncertainty_of_laps(d, stage.torques)
            axis.errorbar(place, h.by_lap["mae"][stage.key], half, fmt="none", ecolor=DARK, elinewidth=0.8, capsize=1.5)
        every = -(-len(h.laps) // 30)
        axis.set_xticks(np.arange(0, len(h.laps), every), [str(i + 1) for i in range(0, len(h.laps), every)])
        axis.set_xlabel("held-out lap")
        axis.set_ylabel("mean error [Nm]")
        axis.set_title("Hold-out laps")
    return Picture(
        path,
        "How much it improves the model",
        f"Mean absolute error by held-out lap, with 95 % intervals over pieces of {lasting(d, PIECE_S)}; over all: "
        + ", ".join(f"{stage.label} {figures(h.mae[stage.key])} Nm" for stage in stages(d))
        + ".",
    )


def _uncertainty_of_laps(d: Diagnosis, expected: Sequence[Array]) -> list[float]:
    """Half of the 95 % interval of the mean error of each hold-out lap [Nm], over its pieces; nan for a lap of one piece."""
    found = []
    masks = [d.split.held_out_mask(s) for s in d.sessions]
    for lap in sorted({int(b) for s, m in zip(d.sessions, masks, strict=True) for b in np.unique(s.block[m])}):
        errors, pieces = [], []
        for i, (s, m) in enumerate(zip(d.sessions, masks, strict=True)):
            inside = m & (s.block == lap)
            errors.append(np.abs(s.torque - expected[i])[inside])
            pieces.append((s.time[inside] // (PIECE_S * s.pace)).astype(np.int64))
        found.append(half_interval(np.concatenate(errors), np.concatenate(pieces)))
    return found


def _matrix(d: Diagnosis, path: Path) -> Picture:
    s = d.last.separability.of_names
    n = len(s.names)
    with picture(path, WIDTH, max(0.17 * n + 1.8, 2.6)) as figure:
        axis = figure.subplots()
        image = axis.imshow(s.cosines, vmin=-1.0, vmax=1.0, cmap="PuOr_r")
        axis.set_xticks(range(n), s.names, rotation=90, fontsize=7.5)
        axis.set_yticks(range(n), s.names, fontsize=7.5)
        axis.grid(False)
        figure.colorbar(image, label="cosine", shrink=0.5, aspect=12)
        title = "Similarity of the effects in these recordings, after the re-fit of the base"
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    pairs = [(abs(s.cosines[i, j]), s.names[i], s.names[j]) for i in range(n) for j in range(i)]
    alike = ", ".join(f"{a} and {b}" for c, a, b in sorted(pairs, reverse=True)[:6] if c > 0.95) or "none"
    return Picture(path, "Which effects look alike", f"Cosine similarity of the visible effects; pairs above 0.95: {alike}.")


def autocorrelation(rows: Sequence[Array]) -> tuple[Array, Array]:
    """Autocorrelation at lags 1 to `LAGS` of series with gaps (nan), and the number of pairs of each."""
    rows = [row - np.nanmean(np.concatenate(list(rows))) for row in rows]
    square = np.nanmean(np.concatenate(rows) ** 2)
    found, pairs = np.zeros(LAGS), np.zeros(LAGS)
    for lag in range(1, LAGS + 1):
        products = np.concatenate([row[lag:] * row[:-lag] for row in rows if len(row) > lag] or [np.full(1, np.nan)])
        pairs[lag - 1] = np.isfinite(products).sum()
        found[lag - 1] = np.nanmean(products) / square if pairs[lag - 1] else np.nan
    return found, pairs


def cumulative_power(rows: Sequence[Array]) -> Array:
    """Cumulative share of the power over the frequency of concatenated series without gaps; shape (frequencies,)."""
    joined = np.concatenate([row[np.isfinite(row)] for row in rows])
    power = np.abs(np.fft.rfft(joined - joined.mean())[1:-1]) ** 2
    return np.asarray(np.cumsum(power) / power.sum())


def _noise(d: Diagnosis, path: Path) -> Picture:
    """Autocorrelation and cumulative periodogram of the plain and whitened residual, with bounds of white noise."""
    fit, step = for_tests(d.final), d.sessions[0].step
    plain = [np.where(mask, r, np.nan) for r, mask in zip(torque_residuals(fit), fit.problem.masks, strict=True)]
    white = fit.white[: len(plain)]
    with picture_with_legend(path, WIDTH, 2.3) as body:
        left, right = body.subplots(1, 2)
        for rows, colour, label, shift in ((plain, GREY, "residual", -0.2), (white, BLUE, "whitened", 0.2)):
            found, pairs = autocorrelation(rows)
            lags = np.arange(1, LAGS + 1)
            left.bar((lags + shift) * step, found, 0.4 * step, color=colour, label=label)
            power = cumulative_power(rows)
            every = max(1, len(power) // SHOWN_FREQUENCIES)
            frequency = np.linspace(0.0, 0.5 / step, len(power))
            right.plot(frequency[::every], power[::every], color=colour, label=label)
        bound = NORMAL_95 / np.sqrt(np.maximum(pairs, 1.0))
        beyond = int((np.abs(found) > bound).sum())
        left.plot(lags * step, bound, color=VERMILION, linestyle="--", linewidth=1.0, label="95 % bounds of white noise")
        left.plot(lags * step, -bound, color=VERMILION, linestyle="--", linewidth=1.0)
        rim = BARTLETT / np.sqrt(max(len(power), 1))
        for side in (-rim, rim):
            right.plot([0.0, 0.5 / step], [side, 1.0 + side], color=VERMILION, linestyle="--", linewidth=1.0)
        right.set_ylim(0.0, 1.0)
        left.set_xlabel("lag [s]")
        left.set_ylabel("autocorrelation")
        right.set_xlabel("frequency [Hz]")
        right.set_ylabel("cumulative share of power")
    return Picture(
        path,
        "Is the residual white noise?",
        f"Autocorrelation and cumulative periodogram of the residual after the last fit, raw and whitened. Of "
        f"{LAGS} lags of the whitened residual, {beyond} exceed the bounds of white noise, "
        f"where {figures(0.05 * LAGS, 2)} would by chance.",
    )

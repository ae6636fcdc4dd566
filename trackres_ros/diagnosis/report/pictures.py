# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The charts of a diagnosis. Each has an alternative text."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.empirical.finders import variable_of
from trackres_ros.diagnosis.empirical.payload import Payload, Stretch
from trackres_ros.diagnosis.empirical.term import Term
from trackres_ros.diagnosis.findings.wording import range_of
from trackres_ros.diagnosis.inference.fitting import Fit, for_tests
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.prepare.session import Array, shown_names
from trackres_ros.diagnosis.report.charts import (
    DARK,
    FOOT,
    MARK,
    TITLE_LETTERS,
    ZERO,
    Area,
    Bars,
    Chart,
    Element,
    Line,
    Map,
    Matrix,
    Panel,
    Picture,
    Points,
    Rule,
    Span,
)
from trackres_ros.diagnosis.report.series import (
    axis_label,
    bars,
    clock,
    duration_text,
    half_interval,
    shown_lap,
    shown_slice,
    stages,
    timeline,
)
from trackres_ros.diagnosis.report.static import draw
from trackres_ros.diagnosis.selection.as_used import NORMAL_95
from trackres_ros.diagnosis.selection.locate import (
    SMOOTHED_S,
    against_travel,
    evenly_filled,
    rms_over_time,
    smooth_residual,
    torque_residuals,
)
from trackres_ros.output.style import BLUE, GREY, SKY, VERMILION, shorten
from trackres_ros.route.learned import SLOPE
from trackres_ros.route.lookup import SPACING_M
from trackres_ros.text import alike, figures, from_to, rising

SHOWN_BINS = 24
OFF_NM = 1e-6  # a term whose gate is closed adds no more
AGAINST = "torque against travel [Nm]"
PERCENT = 100.0
BEYOND_NOISE_P = 0.05  # of starred bins
LONGEST_SHOWN_S = 600.0
PIECE_S = 30.0  # mean errors of longer pieces are hardly correlated
ROUTE_PICTURES = "route", "route_beside"
IN_ONE_COLUMN, MOST_RECORDINGS = 8, 24  # that are drawn over their time: those with the largest error
LAGS = 30
SHOWN_FREQUENCIES = 400
BARTLETT = 1.358  # over the root of the number of frequencies: 95 % of white noise stays within (Kolmogorov and Smirnov)


def draw_all(d: Diagnosis, folder: Path) -> list[Picture]:
    """Draw all pictures of a diagnosis into a folder."""
    charts = first_charts(d)
    charts |= {f"effect_{t.name}": term_chart(d, t) for t in d.found}
    charts |= {f"term_{t.name}": term_chart(d, t) for t in d.described if not t.is_by_place}
    by_place = [t for t in d.in_order if t.is_by_place]
    charts |= {name: route(term, d.final) for name, term in zip(ROUTE_PICTURES, by_place, strict=False)}
    charts |= {"held_out": held_out_laps(d), "noise": noise(d)}
    if len(d.last.separability.of_names.names) > 1:
        charts["separability"] = similarity(d)
    return [draw(chart, folder / f"{name}.svg") for name, chart in charts.items()]


def first_charts(d: Diagnosis) -> dict[str, Chart]:
    """The charts that are also interactive on a page, by the names of their files."""
    return {"believed": timeline(d), "before_after": lap(d), "where_time": times(d), "where_regime": regimes(d)}


def term_chart(d: Diagnosis, term: Term) -> Chart:
    """The residual without a term, and the term's torque: over its variable, or over time without one."""
    left_over = against_travel(d.sessions, torque_residuals(d.final))
    adds = against_travel(d.sessions, term.adds)
    if term.location is not None:
        variable = BY_NAME[term.location.variable]
        course = [variable.of(s, p) for s, p in zip(d.sessions, d.final.predicted, strict=True)]
        title = f"{term.name}: {term.effect.text}"
        return _means_over(d, course, adds, left_over, axis_label(variable.name, stages(d)[-1].label), term.name, title)
    if course := variable_of(term, d.final):
        label = f"{term.variable} [{term.unit}]" if term.unit else term.variable or term.gate
        gated_course = [np.where(np.abs(x) > OFF_NM, c, np.nan) for c, x in zip(course, adds, strict=True)]
        return _means_over(d, gated_course if term.gate else course, adds, left_over, label, term.name, term.sentence)
    if isinstance(term.pattern, Payload):
        return _by_stretch(d, term, term.pattern.stretches)
    return _over_time(d, adds, left_over, term)


def _of_term(name: str, text: str, sentence: str, x_label: str, y_label: str, *elements: Element) -> Chart:
    """The chart of a term, under its sentence."""
    panel = Panel([ZERO, *elements], textwrap.fill(sentence, TITLE_LETTERS), x_label, y_label, 350)
    return Chart(f"The term: {name}", text, [panel])


def _by_stretch(d: Diagnosis, term: Term, stretches: Sequence[Stretch]) -> Chart:
    """The mass of each stretch with its interval, all recordings in sequence."""
    ends = np.cumsum([s.time[-1] + s.step for s in d.sessions]).tolist()
    begin = dict(zip((s.name for s in d.sessions), [0.0, *ends[:-1]], strict=True))  # [s]
    edges = np.array([[begin[s.recording] + s.begin_s, begin[s.recording] + s.end_s] for s in stretches])
    mass, std = np.array([s.mass for s in stretches]), np.array([s.std for s in stretches])
    middle, half_width = edges.mean(axis=1) / 60.0, 0.5 * np.diff(edges, axis=1)[:, 0] / 60.0
    points = Points("mass between two stops, with its 95 % interval", VERMILION, middle, mass, NORMAL_95 * std, half_width)
    text = "Mass of each fitted stretch between stops, minus the model's. Acceleration, rolling and climbing determine it."
    x_label, y_label = "time over consecutive recordings [min]", "mass minus the model's [kg]"
    return _of_term(term.name, text, term.sentence, x_label, y_label, points)


def _over_time(d: Diagnosis, adds: list[Array], left_over: list[Array], term: Term) -> Chart:
    """The recording with the largest torque of the term."""
    i = int(np.argmax([float(np.abs(x[s.used]).sum()) for x, s in zip(adds, d.sessions, strict=True)]))
    session = d.sessions[i]
    line_text = f"residual without the term, means over {duration_text(d, SMOOTHED_S)}"
    residual_line = Line(line_text, BLUE, [(session.time, smooth_residual(session, left_over[i] + adds[i]))])
    torque = Line(f"{term.name} as found", VERMILION, [(session.time, np.where(session.used, adds[i], np.nan))])
    text = (
        "Residual without the term, and the term, over the recording in which it acts most; on hold-out laps the "
        "term is predicted from the torque up to a few seconds before."
    )
    x_label = f"time in {shorten(shown_names(d.sessions)[i], TITLE_LETTERS - 40)} [s]"
    return _of_term(term.name, text, term.sentence, x_label, AGAINST, residual_line, torque)


def _means_over(
    d: Diagnosis, course: list[Array], adds_: list[Array], left_over: list[Array], label: str, name: str, title: str
) -> Chart:
    """The residual without a term, and the term's torque, over its variable, where that is known."""
    used_steps = np.concatenate([s.used & np.isfinite(c) for s, c in zip(d.sessions, course, strict=True)])
    adds, residual, x = (np.concatenate(series)[used_steps] for series in (adds_, left_over, course))
    _, place = evenly_filled(x, SHOWN_BINS)
    count = np.bincount(place)
    middle, term, residual_means = (np.bincount(place, weights=w) / np.maximum(count, 1) for w in (x, adds, adds + residual))
    spread = np.sqrt(np.bincount(place, weights=(residual - (residual_means - term)[place]) ** 2) / np.maximum(count, 1))
    middle, term, residual_means, spread = (values[count > 0] for values in (middle, term, residual_means, spread))
    points = Points("residual without it, mean and spread", BLUE, middle, residual_means, spread)
    ends = float(term.min()), float(term.max())
    lower_end, upper_end = alike(ends, ends[1] - ends[0])
    text = f"Residual without {name}, and the fitted term, over {label}; from {lower_end} to {upper_end} Nm."
    return _of_term(name, text, title, label, AGAINST, points, Line(f"{name} as fitted", VERMILION, [(middle, term)]))


def route(term: Term, final_fit: Fit) -> Chart:
    """A slope or a torque by place, as learned on the fitted laps."""
    route_values = term.learned(final_fit)
    slope = route_values.kind == SLOPE
    factor, unit, quantity = (PERCENT, "%", "slope") if slope else (1.0, "Nm", "torque")
    way = 0.001 * SPACING_M * np.arange(len(route_values.passes))
    x, y = (0.001 * part for part in route_values.frame.metres(route_values.latitude, route_values.longitude))
    elements: list[Element] = [ZERO]
    ways = ((0, BLUE, "uphill positive"),) if slope else ((0, BLUE, "one way"), (1, VERMILION, "opposite direction"))
    for column, colour, label in ways:
        value, half_width = factor * route_values.value[:, column], NORMAL_95 * factor * route_values.std[:, column]
        elements.append(Area("", f"{colour}40", way, value - half_width, value + half_width))
        elements.append(Line(f"{label}, with its 95 % interval", colour, [(way, value)], 1.0))
    ways_known = np.isfinite(route_values.value).sum(axis=1)
    mean = np.nansum(route_values.value, axis=1) / np.where(ways_known > 0, ways_known, np.nan)
    observed_values = factor * (route_values.value[:, 0] if slope else mean)
    scale = f"{quantity} [{unit}]{', in the direction of the first drive' if slope else ''}"
    over_way = "matched distance along the streets, in the order of the first drive [km]"
    low, high = (figures(float(q), 2) for q in np.nanquantile(factor * route_values.value, (0.025, 0.975)))
    std_text = figures(factor * float(np.nanmedian(route_values.std)), 2)
    text = (
        f"The {quantity} of each place over the matched distance, and a map of the places; most values are between {low} and "
        f"{high} {unit}, with a median standard deviation of {std_text} {unit}."
    )
    top_panel = Panel(elements, "", over_way, f"{quantity} [{unit}]", 260)
    return Chart("By place", text, [top_panel, Panel([Map(x, y, observed_values, scale)], "", "east [km]", "north [km]", 420)])


def lap(d: Diagnosis) -> Chart:
    """The hold-out lap with the largest gain of the model, with all its samples, or the part with the largest mismatch."""
    index, rows, steps_drawn, *errors = shown_lap(d, LONGEST_SHOWN_S)
    session, name = d.sessions[index], shown_names(d.sessions)[index]
    time, model_torque = session.time[rows], d.refitted.predicted[index].torque[rows]
    measured = np.where(session.used[rows], session.torque[rows], np.nan)
    mismatch = np.where(np.isnan(measured), model_torque, measured)
    torques: list[Element] = [
        Area("mismatch before" if d.modelled else "mismatch", f"{SKY}59", time, mismatch, model_torque),
        Line("measured", DARK, [(time, measured)], 2.5),
        *(
            Line(f"simulated, {stage.label}", stage.colour, [(time, stage.torques[index][rows])], stage.width)
            for stage in stages(d)
        ),
    ]
    title, speed = f"{shorten(name, TITLE_LETTERS - 40)}, {steps_drawn}", Line("measured", DARK, [(time, session.speed[rows])])
    before_nm, after_nm = map(figures, errors)
    with_terms = f" before and {after_nm} Nm with {', '.join(d.modelled)}" if d.modelled else ""
    text = f"Torque over time on {steps_drawn}: the mean error of the whole lap is {before_nm} Nm{with_terms}."
    torque_panel = Panel(torques, title, "", "torque [Nm]", 280, highlight=(index, 1.0))
    speed_panel = Panel([speed], "speed", "", "speed [m/s]", 140, highlight=(index, 1.0))
    return Chart("Measured against simulated", text, [torque_panel, speed_panel], "time [s]")


def times(d: Diagnosis) -> Chart:
    """The residual over the time of each recording, with or without a named effect; of very many, the worst."""
    unit, word = clock(d)
    residuals = [[smooth_residual(s, s.torque - stage.torques[i]) for i, s in enumerate(d.sessions)] for stage in stages(d)]
    sizes, rms_nm = rms_over_time(residuals[1])
    numbers_drawn, names = sorted(np.argsort(sizes)[::-1][:MOST_RECORDINGS].tolist()), shown_names(d.sessions)
    columns = 1 if len(numbers_drawn) <= IN_ONE_COLUMN else 2
    panels = []
    for i in numbers_drawn:
        session = d.sessions[i]
        held_out = session.stretches(np.isin(session.block, d.split.held_out))
        elements: list[Element] = [ZERO, *(Span("hold-out laps", begin / unit, end / unit) for begin, end in held_out)]
        for term in d.found[:1]:
            spans_here = [span for span in term.spans if span.recording == session.name]
            elements += [Span(f"{term.name} acts most", x.begin / unit, x.end / unit, MARK, FOOT) for x in spans_here]
        changes = [change for change in d.changes if change.recording == session.name]
        elements += [Rule(change.time / unit, True, "change of level") for change in changes]
        for stage, stage_residuals in zip(stages(d), residuals, strict=True):
            pieces = [(session.time[shown_slice(session)] / unit, stage_residuals[i][shown_slice(session)])]
            elements.append(Line(stage.label, stage.colour, pieces, stage.width))
        title = shorten(names[i], TITLE_LETTERS // columns - 6)
        panels.append(Panel(elements, title, height=150 if columns == 1 else 120, highlight=(i, unit)))
    count, left_out = len(d.sessions), len(d.sessions) - len(numbers_drawn)
    selection_note = (
        f" Of {count} recordings, the {len(numbers_drawn)} with the largest error are drawn; {left_out} are not drawn."
    )
    selection_note = selection_note if left_out else ""
    average_text = f"means over {duration_text(d, SMOOTHED_S)}"
    text = (
        f"Measured minus simulated torque over the time of each recording, {average_text}; with gaps where "
        f"nothing could be compared. "
        f"With the base re-fitted the root mean square is {figures(rms_nm)} Nm.{selection_note}"
    )
    return Chart("Where: over time", text, panels, f"time [{word}]; {average_text}", "residual [Nm]", columns)


def regimes(d: Diagnosis) -> Chart:
    """The mean residual by bins of each variable that varies, between the edges of the bins."""
    panels = []
    for name, edges, of_stages in bars(d):
        elements: list[Element] = [ZERO]
        for stage, bins, x, half_widths in of_stages:
            details = [
                f"{stage.label}, {from_to(b.low, b.high)} {b.unit}: {figures(b.mean_residual)} ± {figures(h, 2)} Nm (95 %), "
                f"{figures(b.samples * d.sessions[0].step, 4)} s, p = {b.p:.3f}"
                for b, h in zip(bins, half_widths, strict=True)
            ]
            keys, has_star = [f"{name}:{number}" for number in range(len(bins))], [b.p < BEYOND_NOISE_P for b in bins]
            mean, width = np.array([b.mean_residual for b in bins]), 0.38 if d.modelled else 0.7
            elements.append(Bars(stage.label, stage.colour, x, mean, half_widths, width, has_star, details, keys))
        ticks = (np.arange(len(edges)) - 0.5).tolist(), rising(edges)
        panels.append(Panel(elements, axis_label(name, of_stages[0].stage.label), height=210, ticks=ticks))
    texts = []
    for b in d.at_base.significant[:5]:
        texts.append(f"{'+' if b.mean_residual > 0.0 else ''}{figures(b.mean_residual)} Nm at {range_of(b)}")
    text = (
        "Mean residual against travel by bins of each variable, each with as many samples; the numbers are the edges of the "
        "bins, lines are 95 % intervals over laps, and a star marks bins beyond noise. With the base re-fitted: "
        f"{'; '.join(texts) or 'no bin exceeds the noise'}."
    )
    panels = panels or [Panel([], "nothing varies enough to locate the residual")]
    return Chart("Where: by regime", text, panels, y_label="mean residual [Nm]", columns=2)


def held_out_laps(d: Diagnosis) -> Chart:
    """The mean error of each hold-out lap."""
    h, count, elements = d.held_out, len(d.held_out.laps), list[Element]()
    width = 0.8 / len(stages(d))
    for i, stage in enumerate(stages(d)):
        place = np.arange(count) + (i - 0.5 * (len(stages(d)) - 1)) * width
        half_widths = np.array(_uncertainty_of_laps(d, stage.torques))
        elements.append(Bars(stage.label, stage.colour, place, np.array(h.by_lap["mae"][stage.key]), half_widths, width))
    ticks = range(0, count, -(-count // 30))
    errors = ", ".join(f"{stage.label} {figures(h.mae[stage.key])} Nm" for stage in stages(d))
    panel = Panel(elements, "Hold-out laps", "held-out lap", "mean error [Nm]", ticks=(ticks, [str(i + 1) for i in ticks]))
    piece_text = duration_text(d, PIECE_S)
    text = f"Mean absolute error by held-out lap, with 95 % intervals over pieces of {piece_text}; over all: {errors}."
    return Chart("How much it improves the model", text, [panel])


def _uncertainty_of_laps(d: Diagnosis, torques: Sequence[Array]) -> list[float]:
    """Half of the 95 % interval of the mean error of each hold-out lap [Nm], over its pieces; nan for a lap of one piece."""
    uncertainties = []
    masks = [d.split.held_out_mask(s) for s in d.sessions]
    for lap in sorted({int(b) for s, m in zip(d.sessions, masks, strict=True) for b in np.unique(s.block[m])}):
        errors, pieces = [], []
        for i, (s, m) in enumerate(zip(d.sessions, masks, strict=True)):
            lap_steps = m & (s.block == lap)
            errors.append(np.abs(s.torque - torques[i])[lap_steps])
            pieces.append((s.time[lap_steps] // (PIECE_S * s.pace)).astype(np.int64))
        uncertainties.append(half_interval(np.concatenate(errors), np.concatenate(pieces)))
    return uncertainties


def similarity(d: Diagnosis) -> Chart:
    """Which effects look alike in these recordings."""
    s = d.last.separability.of_names
    n = len(s.names)
    pairs = [(abs(s.cosines[i, j]), s.names[i], s.names[j]) for i in range(n) for j in range(i)]
    pairs_text = ", ".join(f"{a} and {b}" for c, a, b in sorted(pairs, reverse=True)[:6] if c > 0.95) or "none"
    panel = Panel([Matrix(s.names, s.cosines, "cosine")], "Similarity of the effects after the re-fit", height=24 * n + 180)
    return Chart(
        "Which effects look alike", f"Cosine similarity of the visible effects; pairs above 0.95: {pairs_text}.", [panel]
    )


def autocorrelation(rows: Sequence[Array]) -> tuple[Array, Array]:
    """Autocorrelation at lags 1 to `LAGS` of series with gaps (nan), and the number of pairs of each."""
    rows = [row - np.nanmean(np.concatenate(list(rows))) for row in rows]
    square = np.nanmean(np.concatenate(rows) ** 2)
    sums, pairs = np.zeros(LAGS), np.zeros(LAGS)
    for lag in range(1, LAGS + 1):
        products = np.concatenate([row[lag:] * row[:-lag] for row in rows if len(row) > lag] or [np.full(1, np.nan)])
        pairs[lag - 1] = np.isfinite(products).sum()
        sums[lag - 1] = np.nanmean(products) / square if pairs[lag - 1] else np.nan
    return sums, pairs


def cumulative_power(rows: Sequence[Array]) -> Array:
    """Cumulative share of the power over the frequency of concatenated series without gaps; shape (frequencies,)."""
    values = np.concatenate([row[np.isfinite(row)] for row in rows])
    power = np.abs(np.fft.rfft(values - values.mean())[1:-1]) ** 2
    return np.asarray(np.cumsum(power) / power.sum())


def noise(d: Diagnosis) -> Chart:
    """Autocorrelation and cumulative periodogram of the plain and whitened residual, with bounds of white noise."""
    fit, step = for_tests(d.final), d.sessions[0].step
    torque_rows = [np.where(mask, r, np.nan) for r, mask in zip(torque_residuals(fit), fit.problem.masks, strict=True)]
    lags, left_elements, right_elements = np.arange(1, LAGS + 1), list[Element](), list[Element]()
    for rows, colour, label, shift in (
        (torque_rows, GREY, "residual", -0.2),
        (fit.white[: len(torque_rows)], BLUE, "whitened", 0.2),
    ):
        correlations, pairs = autocorrelation(rows)
        left_elements.append(Bars(label, colour, (lags + shift) * step, correlations, np.full(LAGS, np.nan), 0.4 * step))
        power = cumulative_power(rows)
        stride = max(1, len(power) // SHOWN_FREQUENCIES)
        right_elements.append(Line(label, colour, [(np.linspace(0.0, 0.5 / step, len(power))[::stride], power[::stride])]))
    bound, rim = NORMAL_95 / np.sqrt(np.maximum(pairs, 1.0)), BARTLETT / np.sqrt(max(len(power), 1))
    outlier_count = int((np.abs(correlations) > bound).sum())
    limit_lines = [(np.array([0.0, 0.5 / step]), np.array([side, 1.0 + side])) for side in (-rim, rim)]
    for elements, bounds in ((left_elements, [(lags * step, bound), (lags * step, -bound)]), (right_elements, limit_lines)):
        elements.append(Line("95 % bounds of white noise", VERMILION, bounds, 1.0, True))
    text = (
        f"Autocorrelation and cumulative periodogram of the residual after the last fit, raw and whitened. Of {LAGS} lags of the "
        f"whitened residual, {outlier_count} exceed the bounds of white noise, where {figures(0.05 * LAGS, 2)} would by chance."
    )
    panels = [
        Panel(left_elements, "", "lag [s]", "autocorrelation"),
        Panel(right_elements, "", "frequency [Hz]", "cumulative power"),
    ]
    return Chart("Is the residual white noise?", text, panels, columns=2)

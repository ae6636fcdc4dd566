# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Series of the pictures, the chart of all terms over time, and the bin or effect of each step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.empirical.term import Term
from trackres_ros.diagnosis.findings.verdict import LACK_OF_FIT_P
from trackres_ros.diagnosis.findings.wording import describe_difference, largest_of, range_of, short_text
from trackres_ros.diagnosis.inference.fitting import Fit, for_tests, valid_rows
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask, shown_names
from trackres_ros.diagnosis.report.charts import FOOT, MARK, ZERO, Chart, Element, Line, Panel, Rule, Span
from trackres_ros.diagnosis.selection.as_used import NORMAL_95
from trackres_ros.diagnosis.selection.locate import Bin, against_travel, regime_map, smooth_residual, steps_within
from trackres_ros.diagnosis.selection.visibility import base_columns
from trackres_ros.output.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION
from trackres_ros.text import figures

NOWHERE, IN_TWO = ".", "a"
SEED = 1  # of the test of the last fit in the bins of the base


class Stage(NamedTuple):
    """A completed stage."""

    key: str  # in report.json
    label: str
    colour: str
    torques: Sequence[Array]  # predicted for each session [Nm]
    width: float = 1.2  # of its lines


class StageBins(NamedTuple):
    """Mean residuals of a stage by bins of a variable."""

    stage: Stage
    bins: Sequence[Bin]
    x: Array  # middle of each bin, with the edges at -0.5, 0.5, ...
    half_width: Array  # half of the 95 % interval [Nm]


def axis_label(name: str, stage: str) -> str:
    """A variable with its unit; a simulated one with the `stage` that simulates it."""
    variable = BY_NAME[name]
    return f"{name}{f', {stage}' if variable.simulated else ''} [{variable.unit}]"


def stages(d: Diagnosis) -> list[Stage]:
    """The completed stages."""
    stage_list = [
        Stage("nominal", "model as given", GREY, d.nominal, 0.7),
        Stage("refitted", "base re-fitted", BLUE, [p.torque for p in d.refitted.predicted]),
        Stage("with_effects", "with the effects", VERMILION, [p.torque for p in d.final.predicted]),
    ]
    return stage_list if d.modelled else stage_list[:2]


def clock(d: Diagnosis) -> tuple[float, str]:
    """Seconds per unit of displayed times, and its name: a minute, or a second for machines quicker than a vehicle."""
    return (60.0, "min") if all(s.pace == 1.0 for s in d.sessions) else (1.0, "s")


def duration_text(d: Diagnosis, seconds: float) -> str:
    """A time of a drive, scaled to these recordings, in words."""
    return f"{seconds * min(s.pace for s in d.sessions):g} s"


def shown_lap(d: Diagnosis, longest_s: float) -> tuple[int, NDArray[np.intp], str, float, float]:
    """The hold-out lap with the largest gain of the model; of one longer than `longest_s` of a drive, the part with the largest
    mismatch. Its session, its steps, its name, and the mean errors of the whole lap with the base re-fitted and with the effects
    [Nm].
    """
    mae = d.held_out.by_lap["mae"]
    improvement = mae["refitted"] - mae["with_effects"] if d.modelled else mae["refitted"]
    laps = [lap for lap in d.split.held_out if any((s.block[s.used] == lap).any() for s in d.sessions)]
    samples = [sum(int((s.block[s.used] == lap).sum()) for s in d.sessions) for lap in laps]
    number = int(np.argmax(improvement * samples))
    index = next(i for i, s in enumerate(d.sessions) if (s.block == laps[number]).any())
    session = d.sessions[index]
    rows, window = np.flatnonzero(session.block == laps[number]), int(longest_s * session.pace / session.step)
    errors = mae["refitted"][number], mae["with_effects"][number]
    if len(rows) <= window:
        return index, rows, "a hold-out lap", *errors
    error = np.where(session.used, np.abs(session.torque - d.refitted.predicted[index].torque), 0.0)[rows]
    sums = np.cumsum(np.append(0.0, error))
    begin = int(np.argmax(sums[window:] - sums[:-window]))
    return index, rows[begin : begin + window], f"the worst {duration_text(d, longest_s)} of a hold-out lap", *errors


def bins_by_variable(bins: Sequence[Bin]) -> dict[str, list[Bin]]:
    """Bins of each variable with more than one: a single bin has no location."""
    bins_by_name: dict[str, list[Bin]] = {}
    for b in bins:
        bins_by_name.setdefault(b.variable, []).append(b)
    return {name: variable_bins for name, variable_bins in bins_by_name.items() if len(variable_bins) > 1}


def bins_of_steps(d: Diagnosis) -> list[dict[str, str]]:
    """Bin numbers of each session by variable, one letter per step; `NOWHERE` without a bin or comparison.
    A step on the edge of two bins has a letter from `IN_TWO` on, the first for bins 0 and 1.

    An effect has an entry too, ``effect:NAME``: 0 where it acts most.
    """
    step_bins = []
    for i, session in enumerate(d.sessions):
        letters = {
            name: _letters(
                len(session), [steps_within(b.variable, b.low, b.high, session, d.refitted.predicted[i]) for b in bins]
            )
            for name, bins in bins_by_variable(d.at_base.bins).items()
        }
        letters |= {f"effect:{effect.name}": _letters(len(session), [acts_most(effect, session)]) for effect in d.found}
        step_bins.append(letters)
    return step_bins


def acts_most(effect: Term, session: DriveSession) -> Mask:
    """The steps of a session where an effect acts most."""
    is_inside = np.zeros(len(session), bool)
    for span in effect.spans:
        if span.recording == session.name:
            is_inside |= (session.time >= span.begin) & (session.time < span.end)
    return is_inside


def _letters(length: int, masks: Sequence[Mask]) -> str:
    codes = np.full(length, ord(NOWHERE), np.uint8)
    for number, mask in enumerate(masks):
        overlap = mask & (codes != ord(NOWHERE))
        codes[mask] = ord("0") + number
        codes[overlap] = ord(IN_TWO) + number - 1
    return codes.tobytes().decode()


def uncertainty(d: Diagnosis, b: Bin, torques: Sequence[Array]) -> float:
    """Half of the 95 % interval of the mean residual against travel of a bin [Nm], over fitted laps; nan if all is in one lap."""
    errors, laps = [], []
    for i, (session, segment) in enumerate(zip(d.sessions, d.refitted.problem.segments, strict=False)):  # torques come first
        is_inside = segment.valid & steps_within(b.variable, b.low, b.high, session, d.refitted.predicted[i])
        (resistance,) = against_travel([session], [session.torque - torques[i]])
        errors.append(resistance[is_inside])
        laps.append(session.block[is_inside])
    return half_interval(np.concatenate(errors), np.concatenate(laps))


def bars(d: Diagnosis) -> Iterator[tuple[str, list[float], list[StageBins]]]:
    """Mean residuals by bins of each variable: its label, the edges of the bins, and the bars of each stage after the first.

    The last fit has the bins of the re-fitted base: with other belt temperatures, its own would hold other steps.
    """
    at_end = {}
    if d.modelled:
        last = regime_map(for_tests(d.final), np.random.default_rng(SEED), predictions=d.refitted.predicted)
        at_end = bins_by_variable(last.bins)
    for name, of_base in bins_by_variable(d.at_base.bins).items():
        edges = sorted({edge for b in of_base for edge in (b.low, b.high)})
        bar_list = []
        for stage, bins, shift in zip(stages(d)[1:], (of_base, at_end.get(name, [])), (-0.2, 0.2), strict=False):
            x = np.interp([0.5 * (b.low + b.high) for b in bins], edges, np.arange(len(edges)) - 0.5)
            half_widths = np.array([uncertainty(d, b, stage.torques) for b in bins])
            bar_list.append(StageBins(stage, bins, x + shift if d.modelled else x, half_widths))
        yield name, edges, bar_list


def half_interval(values: Array, pieces: NDArray[np.int64]) -> float:
    """Half of the 95 % interval of a mean with values correlated within pieces; nan for one piece."""
    numbers, place = np.unique(pieces, return_inverse=True)
    if len(numbers) < 2:
        return float("nan")
    sums = np.bincount(place, weights=values - values.mean())
    return NORMAL_95 * float(np.sqrt((sums**2).sum() * len(numbers) / (len(numbers) - 1)) / len(values))


AVERAGED_S = 10.0
SHOWN_EACH_S = 4.0  # of means over a longer time
LETTERS = 90  # of a small font over the whole width
COLOURS = (ORANGE, BLACK, GREEN, PURPLE, SKY)  # of terms, with different lightness; blue and vermilion are residuals


def timeline(d: Diagnosis) -> Chart:
    """The residual of the re-fitted base over all sessions with the terms over it, and the remaining residual below; without a
    term the first alone. It has the names of the sessions, and the times of the verdict's sentence.
    """
    mae, ends, (text, marks) = (
        {stage: figures(error) for stage, error in d.held_out.mae.items()},
        begin_minutes(d),
        marked_times(d),
    )
    common: list[Element] = [ZERO, *(Span("hold-out laps", begin, end) for begin, end in held_out_times(d))]
    elements: list[Element] = [Span(text, begin, end, MARK, FOOT) for begin, end in marks]
    elements += [Rule(begin, True, label=name) for begin, name in zip(ends, names(d, LETTERS), strict=False)]
    term_lines, re_fitted = (
        terms(d),
        _residual(d, "measured minus re-fitted model", BLUE, [p.torque for p in d.refitted.predicted]),
    )
    as_it_is = _residual(d, f"measured minus model as given ({mae['nominal']} Nm)", GREY, d.nominal)
    title = f"Re-fitted: mean error {mae['refitted']} Nm on hold-out laps"  # short enough for a phone
    panels = [Panel([*common, *elements, *(term_lines or [as_it_is]), re_fitted], title)]
    if term_lines:
        residual_line = _residual(d, "residual", VERMILION, [p.torque for p in d.final.predicted])
        title = f"Residual: mean error {mae['with_effects']} Nm on hold-out laps"
        panels.append(Panel([*common, *(Rule(begin, True) for begin in ends[1:-1]), residual_line], title))
    term_text = f" with {', '.join(line.text for line in term_lines)} over it; below it the residual" if term_lines else ""
    errors, average_text = ". ".join(panel.title for panel in panels), duration_text(d, AVERAGED_S)
    alternative = (
        f"Measured torque minus the re-fitted model{term_text}. {errors}. Means over {average_text}, all recordings in sequence."
    )
    label = f"time over consecutive recordings [{clock(d)[1]}]; means over {average_text}"
    return Chart("What the model lacks, over time", alternative, panels, label, "torque [Nm]")


def _residual(d: Diagnosis, text: str, colour: str, torques: Sequence[Array]) -> Line:
    return Line(text, colour, _in_sequence(d, [s.torque - e for s, e in zip(d.sessions, torques, strict=True)]), 0.8)


def _in_sequence(d: Diagnosis, values: Sequence[Array]) -> list[tuple[Array, Array]]:
    """Means of a series over consecutive sessions, and their times."""
    means = (smooth_residual(s, v, AVERAGED_S) for s, v in zip(d.sessions, values, strict=True))
    return [
        (minutes(d, i)[shown_slice(s)], series[shown_slice(s)])
        for i, (s, series) in enumerate(zip(d.sessions, means, strict=True))
    ]


def shown_slice(session: DriveSession) -> slice:
    """The steps of a session that a picture shows of a mean."""
    return slice(0, None, max(1, int(SHOWN_EACH_S * session.pace / session.step)))


def terms(d: Diagnosis) -> list[Line]:
    """Part of the re-fitted base's residual due to each term of the last fit. Their sum is the difference of the fits."""
    drawn_terms = [t for t in d.terms if len(t.adds)]
    if not drawn_terms:
        return []
    total = [
        prediction.torque - base_prediction.torque
        for prediction, base_prediction in zip(d.final.predicted, d.refitted.predicted, strict=True)
    ]
    shapes = _beyond_a_refit(d.refitted, [t.adds for t in drawn_terms]) if len(drawn_terms) > 1 else [list(drawn_terms[0].adds)]
    sizes = np.array([np.mean(np.concatenate(list(t.adds)) ** 2) for t in drawn_terms])
    rest = [sum_of_terms - sum(term_values) for sum_of_terms, term_values in zip(total, zip(*shapes, strict=True), strict=True)]
    lines = []
    for i, t in enumerate(drawn_terms):
        share = float(sizes[i] / max(sizes.sum(), 1e-300))
        is_confirmed = t.confirmed
        name = f"{short_text(t).replace('_', ' ')}{'' if is_confirmed else ' (suspected)'}"
        torques = [x + share * r for x, r in zip(shapes[i], rest, strict=True)]
        lines.append(
            Line(name, COLOURS[i % len(COLOURS)], _in_sequence(d, torques), 2.4 if is_confirmed else 1.4, not is_confirmed)
        )
    return lines


def _beyond_a_refit(base_fit: Fit, adds: Sequence[Sequence[Array]]) -> list[list[Array]]:
    """Torque of each term minus the part absorbed by a re-fit of the base, to first order; of each session [Nm]."""
    problem = base_fit.problem
    by_segment = problem.split(base_columns(base_fit))
    white = valid_rows(problem.white(by_segment, base_fit.noises))
    curvature = white.T @ white + np.diag([f.std**-2.0 for f in base_fit.free])
    shapes = []
    for term in adds:
        rows = problem.white(problem.of_torque(term), base_fit.noises)
        shifts = np.linalg.lstsq(curvature, white.T @ valid_rows(rows), rcond=1e-12)[0]
        shapes.append([x - columns @ shifts for x, columns in zip(term, by_segment, strict=False)])  # torques come first
    return shapes


def begin_minutes(d: Diagnosis) -> list[float]:
    """Start of each session in sequence, and the end of the last [unit of `clock`]."""
    return [float(x) for x in np.cumsum([0.0, *(s.time[-1] + s.step for s in d.sessions)]) / clock(d)[0]]


def held_out_times(d: Diagnosis) -> Iterator[tuple[float, float]]:
    """Begin and end of each hold-out lap [unit of `clock`]."""
    yield from _times(d, [np.isin(s.block, d.split.held_out) for s in d.sessions])


def marked_times(d: Diagnosis) -> tuple[str, list[tuple[float, float]]]:
    """Times of the difference in the verdict's sentence: words, and begin and end of each [unit of `clock`]; or none."""
    lead = next(iter(d.terms), None)
    unexplained_bins = [b for b in d.at_end.bins if b.p < LACK_OF_FIT_P]
    if d.verdict.status == "unexplained" and unexplained_bins:
        b = largest_of(unexplained_bins)
        masks = [steps_within(b.variable, b.low, b.high, s, p) for s, p in zip(d.sessions, d.final.predicted, strict=True)]
        return f"at {range_of(b)}", list(_times(d, masks))
    if lead is not None and lead.location is not None and (d.verdict.names or d.verdict.seen == describe_difference(lead)):
        location, predictions = lead.location, d.final.predicted
        if location.text:
            masks = [
                steps_within(location.variable, location.low, location.high, s, p)
                for s, p in zip(d.sessions, predictions, strict=True)
            ]
            return location.text, list(_times(d, masks))
        return f"{lead.name.replace('_', ' ')} acts most", list(_times(d, [acts_most(lead, s) for s in d.sessions]))
    return "", []


def _times(d: Diagnosis, masks: Sequence[Mask]) -> Iterator[tuple[float, float]]:
    unit = clock(d)[0]
    for session, begin, mask in zip(d.sessions, begin_minutes(d), masks, strict=False):
        for start, last in session.stretches(mask):
            yield begin + start / unit, begin + last / unit


def minutes(d: Diagnosis, session: int) -> Array:
    """The time of a session, with all sessions in sequence [unit of `clock`]."""
    return np.asarray(begin_minutes(d)[session] + d.sessions[session].time / clock(d)[0])


def names(d: Diagnosis, letters: int) -> list[str]:
    """Label of each session: its name if all fit into `letters` characters, else its number."""
    ends = begin_minutes(d)
    room = [int(letters * (end - begin) / max(ends[-1], 1e-9)) for begin, end in pairwise(ends)]
    full_names = shown_names(d.sessions)
    if all(len(name) < width for name, width in zip(full_names, room, strict=True)):
        return full_names
    return [str(i + 1) if width > len(str(i + 1)) else "" for i, width in enumerate(room)]

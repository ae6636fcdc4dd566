# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The first picture of a page: the residual over consecutive sessions, and the share of each found term."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis.findings.found import NamedEffect, by_improvement
from trackres_ros.diagnosis.findings.locate import smoothed, within
from trackres_ros.diagnosis.findings.verdict import LACK_OF_FIT_P
from trackres_ros.diagnosis.findings.wording import differs, largest_of, range_of, short
from trackres_ros.diagnosis.inference.fitting import Fit, valid_rows
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.prepare.session import Array, Mask, shown_names
from trackres_ros.diagnosis.report.picture import WIDTH, Picture
from trackres_ros.diagnosis.report.series import acts_most, clock, lasting
from trackres_ros.diagnosis.selection.held_out import CONFIRMED
from trackres_ros.diagnosis.selection.visibility import base_columns
from trackres_ros.output.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, picture_with_legend, thinned
from trackres_ros.text import figures

AVERAGED_S = 10.0
MARK = "#777777"
MOST_POINTS = 3000  # of a line over all sessions
LEGEND_LETTERS = 115
LETTERS = 105  # of a small font over the whole width
COLOURS = (ORANGE, BLACK, GREEN, PURPLE, SKY)  # of terms, with different lightness; blue and vermilion are residuals


@dataclass(frozen=True, eq=False)
class Line:
    """A line over time."""

    text: str
    colour: str
    solid: bool  # whether it is measured or confirmed; a suspected term is dashed
    wide: bool  # whether it is a term
    values: Sequence[Array]  # of each session, averaged over `AVERAGED_S` [Nm]; nan in gaps


@dataclass(frozen=True, eq=False)
class Panel:
    """Lines in one plot, and its title."""

    title: str
    lines: Sequence[Line]


def panels(d: Diagnosis) -> list[Panel]:
    """The residual of the re-fitted base with the terms over it, and the remaining residual; without a term the first alone."""
    mae = {stage: figures(error) for stage, error in d.held_out.mae.items()}
    re_fitted = _line(d, "measured minus re-fitted model", BLUE, [p.torque for p in d.refitted.predicted])
    title = f"Re-fitted: mean error {mae['refitted']} Nm on hold-out laps"  # short enough for a phone
    found = terms(d)
    if not found:
        as_it_is = _line(d, f"measured minus model as given ({mae['nominal']} Nm)", GREY, d.nominal)
        return [Panel(title, (as_it_is, re_fitted))]
    left = _line(d, "residual", VERMILION, [p.torque for p in d.final.predicted])
    after = f"Residual: mean error {mae['with_effects']} Nm on hold-out laps"
    return [Panel(title, (re_fitted, *found)), Panel(after, (left,))]


def _line(d: Diagnosis, text: str, colour: str, expected: Sequence[Array]) -> Line:
    values = [smoothed(s, s.torque - e, AVERAGED_S) for s, e in zip(d.sessions, expected, strict=True)]
    return Line(text, colour, True, False, values)


def terms(d: Diagnosis) -> list[Line]:
    """Part of the re-fitted base's residual due to each term of the last fit. Their sum is the difference of the fits."""
    of = [t for t in by_improvement([*d.found, *d.described]) if t.adds]
    if not of:
        return []
    total = [after.torque - before.torque for after, before in zip(d.final.predicted, d.refitted.predicted, strict=True)]
    shown = _beyond_a_refit(d.refitted, [t.adds for t in of]) if len(of) > 1 else [list(of[0].adds)]
    sizes = np.array([np.mean(np.concatenate(list(t.adds)) ** 2) for t in of])
    rest = [whole - sum(each) for whole, each in zip(total, zip(*shown, strict=True), strict=True)]
    lines = []
    for i, t in enumerate(of):
        share = float(sizes[i] / max(sizes.sum(), 1e-300))
        sure = t.graded.grade == CONFIRMED
        name = f"{short(t).replace('_', ' ')}{'' if sure else ' (suspected)'}"
        averaged = [smoothed(s, x + share * r, AVERAGED_S) for s, x, r in zip(d.sessions, shown[i], rest, strict=True)]
        lines.append(Line(name, COLOURS[i % len(COLOURS)], sure, True, averaged))
    return lines


def _beyond_a_refit(refitted: Fit, adds: Sequence[Sequence[Array]]) -> list[list[Array]]:
    """Torque of each term minus the part absorbed by a re-fit of the base, to first order; of each session [Nm]."""
    problem = refitted.problem
    by_segment = problem.split(base_columns(refitted))
    white = valid_rows(problem.white(by_segment, refitted.noises))
    curvature = white.T @ white + np.diag([f.std**-2.0 for f in refitted.free])
    found = []
    for term in adds:
        rows = problem.white(problem.of_torque(term), refitted.noises)
        moved = np.linalg.lstsq(curvature, white.T @ valid_rows(rows), rcond=1e-12)[0]
        found.append([x - columns @ moved for x, columns in zip(term, by_segment, strict=False)])  # torques come first
    return found


def begins(d: Diagnosis) -> list[float]:
    """Start of each session in sequence, and the end of the last [unit of `clock`]."""
    return [float(x) for x in np.cumsum([0.0, *(s.time[-1] + s.step for s in d.sessions)]) / clock(d)[0]]


def held_out_times(d: Diagnosis) -> Iterator[tuple[float, float]]:
    """Begin and end of each hold-out lap [unit of `clock`]."""
    yield from _times(d, [np.isin(s.block, d.split.held_out) for s in d.sessions])


def marked_times(d: Diagnosis) -> tuple[str, list[tuple[float, float]]]:
    """Times of the difference in the verdict's sentence: words, and begin and end of each [unit of `clock`]; or none."""
    lead = next(iter(by_improvement([*d.found, *d.described])), None)
    left = [b for b in d.at_end.bins if b.p < LACK_OF_FIT_P]
    if d.verdict.status == "unexplained" and left:
        b = largest_of(left)
        inside = [within(b.variable, b.low, b.high, s, p) for s, p in zip(d.sessions, d.final.predicted, strict=True)]
        return range_of(b), list(_times(d, inside))
    if isinstance(lead, NamedEffect) and (d.verdict.names or d.verdict.seen == differs(lead)):
        of, final = lead.location, d.final.predicted
        if of.text:
            inside = [within(of.variable, of.low, of.high, s, p) for s, p in zip(d.sessions, final, strict=True)]
            return of.text, list(_times(d, inside))
        return f"{lead.name.replace('_', ' ')} acts most", list(_times(d, [acts_most(lead, s) for s in d.sessions]))
    return "", []


def _times(d: Diagnosis, inside: Sequence[Mask]) -> Iterator[tuple[float, float]]:
    unit = clock(d)[0]
    for session, begin, mask in zip(d.sessions, begins(d), inside, strict=False):
        for first, last in session.stretches(mask):
            yield begin + first / unit, begin + last / unit


def minutes(d: Diagnosis, session: int) -> Array:
    """The time of a session, with all sessions in sequence [unit of `clock`]."""
    return np.asarray(begins(d)[session] + d.sessions[session].time / clock(d)[0])


def names(d: Diagnosis, letters: int) -> list[str]:
    """Label of each session: its name if all fit into `letters` characters, else its number."""
    ends = begins(d)
    room = [int(letters * (end - begin) / max(ends[-1], 1e-9)) for begin, end in pairwise(ends)]
    full = shown_names(d.sessions)
    if all(len(name) < most for name, most in zip(full, room, strict=True)):
        return full
    return [str(i + 1) if most > len(str(i + 1)) else "" for i, most in enumerate(room)]


def draw_timeline(d: Diagnosis, path: Path) -> Picture:
    """Draw the residual of the re-fitted base over all sessions with each term over it, and the remaining residual below."""
    drawn, ends = panels(d), begins(d)
    text, marked = marked_times(d)
    most = max(60, MOST_POINTS // len(d.sessions))
    entries = ["hold-out laps", *(line.text for line in drawn[0].lines), text]
    columns = max(1, LEGEND_LETTERS // (6 + max(map(len, entries))))
    with picture_with_legend(path, WIDTH, 1.9 * len(drawn) + 0.5, -(-len(entries) // columns)) as body:
        axes = body.subplots(len(drawn), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
        for axis, panel in zip(axes, drawn, strict=True):
            for begin, end in held_out_times(d):
                axis.axvspan(begin, end, color=GREY, alpha=0.18, linewidth=0, label="hold-out laps")
            axis.axhline(0.0, color=GREY, linewidth=0.8)
            for begin in ends[1:-1]:
                axis.axvline(begin, color=GREY, linestyle=":", linewidth=1.0)
            for line in panel.lines:
                label = line.text if panel is drawn[0] else ""  # the title of the panel below names its line
                for i, values in enumerate(line.values):
                    axis.plot(
                        *thinned(minutes(d, i), values, most),
                        color=line.colour,
                        label=label,
                        linewidth=(2.4 if line.solid else 1.4) if line.wide else 0.8,
                        zorder=2.0 if line.wide else 2.5,
                        linestyle="-" if line.solid else (0, (3, 1.5)),
                    )
            axis.set_title(panel.title, fontsize=8.5)
            axis.set_xlim(0.0, ends[-1])
            axis.set_ylabel("torque [Nm]")
        for begin, end in marked:
            axes[0].axvspan(begin, end, ymax=0.04, color=MARK, linewidth=0, label=text)
        for begin, name in zip(ends, names(d, LETTERS), strict=False):
            axes[0].annotate(
                name,
                (begin, 1.0),
                (2, -2),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                va="top",
                fontsize=7,
                color="#555555",
            )
        axes[-1].set_xlabel(f"time over consecutive recordings [{clock(d)[1]}]")
    terms = [line.text for line in drawn[0].lines if line.wide]
    over = f" with {', '.join(terms)} over it; below it the residual" if terms else ""
    errors = ". ".join(panel.title for panel in drawn)
    return Picture(
        path,
        "What the model lacks, over time",
        f"Measured torque minus the re-fitted model{over}. {errors}. Means over {lasting(d, AVERAGED_S)}, all recordings "
        "in sequence.",
    )

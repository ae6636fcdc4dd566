# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Series of the page: residuals over time, and the bin or effect of each step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.empirical.torque import against_travel
from trackres_ros.diagnosis.findings.found import NamedEffect
from trackres_ros.diagnosis.findings.locate import within
from trackres_ros.diagnosis.findings.residual_bins import Bin, regime_map
from trackres_ros.diagnosis.inference.levels import for_tests
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.diagnosis.selection.intervals import NORMAL_95
from trackres_ros.output.style import BLUE, GREY, VERMILION

NOWHERE, IN_TWO = ".", "a"
MOST_RECORDINGS = 24  # that are drawn over their time: those with the largest error
SEED = 1  # of the test of the last fit in the bins of the base


class Stage(NamedTuple):
    """A completed stage."""

    key: str  # in report.json
    label: str
    colour: str
    torques: Sequence[Array]  # predicted for each session [Nm]


class Bars(NamedTuple):
    """Mean residuals of a stage by bins of a variable."""

    stage: Stage
    bins: Sequence[Bin]
    x: Array  # middle of each bin, with the edges at -0.5, 0.5, ...
    half: Array  # half of the 95 % interval [Nm]


class ShownLap(NamedTuple):
    """A hold-out lap, or a part of it."""

    session: int
    rows: NDArray[np.intp]  # its steps
    text: str
    before: float  # mean error of the whole lap with the base re-fitted [Nm]
    after: float  # with the effects [Nm]


def axis_label(name: str, stage: str) -> str:
    """A variable with its unit; a simulated one with the `stage` that simulates it."""
    of = BY_NAME[name]
    return f"{name}{f', {stage}' if of.simulated else ''} [{of.unit}]"


def stages(d: Diagnosis) -> list[Stage]:
    """The completed stages."""
    found = [
        Stage("nominal", "model as given", GREY, d.nominal),
        Stage("refitted", "base re-fitted", BLUE, [p.torque for p in d.refitted.predicted]),
        Stage("with_effects", "with the effects", VERMILION, [p.torque for p in d.final.predicted]),
    ]
    return found if d.modelled else found[:2]


def clock(d: Diagnosis) -> tuple[float, str]:
    """Seconds per unit of displayed times, and its name: a minute, or a second for machines quicker than a vehicle."""
    return (60.0, "min") if all(s.pace == 1.0 for s in d.sessions) else (1.0, "s")


def lasting(d: Diagnosis, seconds: float) -> str:
    """A time of a drive, scaled to these recordings, in words."""
    return f"{seconds * min(s.pace for s in d.sessions):g} s"


def most_off(sizes: Sequence[float]) -> list[int]:
    """The sessions that are drawn over their time, by their errors."""
    return sorted(np.argsort(sizes)[::-1][:MOST_RECORDINGS].tolist())


def shown_lap(d: Diagnosis, longest_s: float) -> ShownLap:
    """The hold-out lap with the largest gain of the model; of one longer than `longest_s` of a drive, the part with the largest
    mismatch.
    """
    mae = d.held_out.by_lap["mae"]
    gained = mae["refitted"] - mae["with_effects"] if d.modelled else mae["refitted"]
    laps = [lap for lap in d.split.held_out if any((s.block[s.used] == lap).any() for s in d.sessions)]
    samples = [sum(int((s.block[s.used] == lap).sum()) for s in d.sessions) for lap in laps]
    number = int(np.argmax(gained * samples))
    index = next(i for i, s in enumerate(d.sessions) if (s.block == laps[number]).any())
    session = d.sessions[index]
    rows, longest = np.flatnonzero(session.block == laps[number]), int(longest_s * session.pace / session.step)
    errors = mae["refitted"][number], mae["with_effects"][number]
    if len(rows) <= longest:
        return ShownLap(index, rows, "a hold-out lap", *errors)
    off = np.where(session.used, np.abs(session.torque - d.refitted.predicted[index].torque), 0.0)[rows]
    sums = np.cumsum(np.append(0.0, off))
    first = int(np.argmax(sums[longest:] - sums[:-longest]))
    return ShownLap(index, rows[first : first + longest], f"the worst {lasting(d, longest_s)} of a hold-out lap", *errors)


def bins_by_variable(bins: Sequence[Bin]) -> dict[str, list[Bin]]:
    """Bins of each variable with more than one: a single bin has no location."""
    found: dict[str, list[Bin]] = {}
    for b in bins:
        found.setdefault(b.variable, []).append(b)
    return {name: of for name, of in found.items() if len(of) > 1}


def bins_of_steps(d: Diagnosis) -> list[dict[str, str]]:
    """Bin numbers of each session by variable, one letter per step; `NOWHERE` without a bin or comparison.
    A step on the edge of two bins has a letter from `IN_TWO` on, the first for bins 0 and 1.

    An effect has an entry too, ``effect:NAME``: 0 where it acts most.
    """
    found = []
    for i, session in enumerate(d.sessions):
        letters = {
            name: _letters(len(session), [within(b.variable, b.low, b.high, session, d.refitted.predicted[i]) for b in bins])
            for name, bins in bins_by_variable(d.at_base.bins).items()
        }
        letters |= {f"effect:{effect.name}": _letters(len(session), [acts_most(effect, session)]) for effect in d.found}
        found.append(letters)
    return found


def acts_most(effect: NamedEffect, session: DriveSession) -> Mask:
    """The steps of a session where an effect acts most."""
    inside = np.zeros(len(session), bool)
    for span in effect.where:
        if span.recording == session.name:
            inside |= (session.time >= span.begin) & (session.time < span.end)
    return inside


def _letters(length: int, inside: Sequence[Mask]) -> str:
    codes = np.full(length, ord(NOWHERE), np.uint8)
    for number, mask in enumerate(inside):
        shared = mask & (codes != ord(NOWHERE))
        codes[mask] = ord("0") + number
        codes[shared] = ord(IN_TWO) + number - 1
    return codes.tobytes().decode()


def uncertainty(d: Diagnosis, b: Bin, expected: Sequence[Array]) -> float:
    """Half of the 95 % interval of the mean residual against travel of a bin [Nm], over fitted laps; nan if all is in one lap."""
    off, laps = [], []
    for i, (session, segment) in enumerate(zip(d.sessions, d.refitted.problem.segments, strict=False)):  # torques come first
        inside = segment.valid & within(b.variable, b.low, b.high, session, d.refitted.predicted[i])
        (against,) = against_travel([session], [session.torque - expected[i]])
        off.append(against[inside])
        laps.append(session.block[inside])
    return half_interval(np.concatenate(off), np.concatenate(laps))


def bars(d: Diagnosis) -> Iterator[tuple[str, list[float], list[Bars]]]:
    """Mean residuals by bins of each variable: its label, the edges of the bins, and the bars of each stage after the first.

    The last fit has the bins of the re-fitted base: with other belt temperatures, its own would hold other steps.
    """
    at_end = {}
    if d.modelled:
        last = regime_map(for_tests(d.final), np.random.default_rng(SEED), predicted=d.refitted.predicted)
        at_end = bins_by_variable(last.bins)
    for name, of_base in bins_by_variable(d.at_base.bins).items():
        edges = sorted({edge for b in of_base for edge in (b.low, b.high)})
        found = []
        for stage, bins, shift in zip(stages(d)[1:], (of_base, at_end.get(name, [])), (-0.2, 0.2), strict=False):
            x = np.interp([0.5 * (b.low + b.high) for b in bins], edges, np.arange(len(edges)) - 0.5)
            half = np.array([uncertainty(d, b, stage.torques) for b in bins])
            found.append(Bars(stage, bins, x + shift if d.modelled else x, half))
        yield name, edges, found


def half_interval(values: Array, pieces: NDArray[np.int64]) -> float:
    """Half of the 95 % interval of a mean with values correlated within pieces; nan for one piece."""
    numbers, place = np.unique(pieces, return_inverse=True)
    if len(numbers) < 2:
        return float("nan")
    sums = np.bincount(place, weights=values - values.mean())
    return NORMAL_95 * float(np.sqrt((sums**2).sum() * len(numbers) / (len(numbers) - 1)) / len(values))

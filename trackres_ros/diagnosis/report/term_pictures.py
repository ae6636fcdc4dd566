# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of named effects and unnamed terms: the residual without the term, and its torque, over its variable."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.findings.found import NamedEffect, Told
from trackres_ros.diagnosis.findings.locate import SMOOTHED_S, against_travel, evenly_filled, smoothed
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.report.picture import MOST_POINTS, TITLE_LETTERS, WIDTH, Picture
from trackres_ros.diagnosis.report.series import clock, lasting
from trackres_ros.output.style import BLUE, GREY, VERMILION, picture_with_legend, shortened, thinned
from trackres_ros.text.numbers import decimals

Array = NDArray[np.float64]

SHOWN_BINS = 24


def draw_effect(d: Diagnosis, found: NamedEffect, path: Path) -> Picture:
    """The residual without the effect, and the effect's torque, over its main variable."""
    fit = d.final
    left_over = [s.torque - p.torque for s, p in zip(d.sessions, fit.predicted, strict=True)]
    if found.acts_on != "sensor":
        left_over = against_travel(d.sessions, left_over)
    variable = BY_NAME[found.acts.variable]
    course = [variable.of(s, p) for s, p in zip(d.sessions, fit.predicted, strict=True)]
    return _over(
        d, course, found.resists, left_over, f"{variable.name} [{variable.unit}]", found.name, f"{found.name}: {found.text}", path
    )


def draw_term(d: Diagnosis, told: Told, path: Path) -> Picture:
    """The same for an unnamed term: over its variable, or over time without one."""
    of = told.described
    left_over = against_travel(d.sessions, [s.torque - p.torque for s, p in zip(d.sessions, d.final.predicted, strict=True)])
    adds = against_travel(d.sessions, told.adds)
    if told.course:
        label = f"{of.variable} [{of.unit}]" if of.unit else of.variable or of.gate
        return _over(d, told.course, adds, left_over, label, of.name, of.sentence, path)
    if of.stretches:
        return _by_stretch(d, of, path)
    if of.form == "level_change":
        return _over_recordings(d, adds, left_over, of.name, of.sentence, path)
    return _over_time(d, adds, left_over, of.name, of.sentence, path)


def _label(axis: Any, along: str, title: str) -> None:
    """Labels of a term's picture: its axis, and its sentence."""
    axis.set_xlabel(along)
    axis.set_ylabel("torque against travel [Nm]")
    axis.set_title(textwrap.fill(title, TITLE_LETTERS))


def _over_recordings(d: Diagnosis, adds: list[Array], left_over: list[Array], name: str, title: str, path: Path) -> Picture:
    """All recordings in sequence."""
    unit, word = clock(d)
    begins = np.cumsum([0.0, *(s.time[-1] + s.step for s in d.sessions)]) / unit
    with picture_with_legend(path, WIDTH, 3.0) as body:
        axis = body.subplots()
        for session, begin, left, term in zip(d.sessions, begins[:-1], left_over, adds, strict=True):
            time = begin + session.time / unit
            without = smoothed(session, left + term)
            axis.plot(
                *thinned(time, without, MOST_POINTS),
                color=BLUE,
                label=f"residual without the term, means over {lasting(d, SMOOTHED_S)}",
            )
            axis.plot(time, np.where(session.used, term, np.nan), color=VERMILION, label=f"{name} as found")
            axis.axvline(begin, color=GREY, linestyle="--", linewidth=0.8, label="a recording begins")
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        _label(axis, f"time over consecutive recordings [{word}]", title)
    return Picture(
        path,
        f"The term: {name}",
        "Residual without the term, and the term, over all recordings in sequence. On hold-out laps the term follows from time "
        "alone.",
    )


def _by_stretch(d: Diagnosis, of: Described, path: Path) -> Picture:
    """The mass of each stretch with its interval, all recordings in sequence."""
    begins = dict(
        zip((s.name for s in d.sessions), np.cumsum([0.0, *(s.time[-1] + s.step for s in d.sessions[:-1])]), strict=True)
    )
    edges = np.array([[s.begin_s, s.end_s] for s in of.stretches]) + np.array([[begins[s.recording]] for s in of.stretches])
    mass, std = np.array([s.mass for s in of.stretches]), np.array([s.std for s in of.stretches])
    with picture_with_legend(path, WIDTH, 3.0) as body:
        axis = body.subplots()
        axis.errorbar(
            edges.mean(axis=1) / 60.0, mass, 1.96 * std, 0.5 * np.diff(edges, axis=1)[:, 0] / 60.0, fmt="none", color=VERMILION,
            linewidth=1.2, label="mass between two stops, with its 95 % interval",
        )  # fmt: skip
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        axis.set_xlabel("time over consecutive recordings [min]")
        axis.set_ylabel("mass minus the model's [kg]")
        axis.set_title(textwrap.fill(of.sentence, TITLE_LETTERS))
    return Picture(
        path,
        f"The term: {of.name}",
        "Mass of each fitted stretch between stops, minus the model's. Acceleration, rolling and climbing determine it.",
    )


def _over_time(d: Diagnosis, adds: list[Array], left_over: list[Array], name: str, title: str, path: Path) -> Picture:
    """The recording with the largest torque of the term."""
    acts = [float(np.abs(x[s.used]).sum()) for x, s in zip(adds, d.sessions, strict=True)]
    i = int(np.argmax(acts))
    session = d.sessions[i]
    left = smoothed(session, left_over[i] + adds[i])
    with picture_with_legend(path, WIDTH, 3.0) as body:
        axis = body.subplots()
        axis.plot(session.time, left, color=BLUE, label=f"residual without the term, means over {lasting(d, SMOOTHED_S)}")
        axis.plot(session.time, np.where(session.used, adds[i], np.nan), color=VERMILION, label=f"{name} as found")
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        _label(axis, f"time in {shortened(Path(session.name).name, TITLE_LETTERS - 40)} [s]", title)
    return Picture(
        path,
        f"The term: {name}",
        "Residual without the term, and the term, over the recording in which it acts most; on hold-out laps the "
        "term is predicted from the torque up to a few seconds before.",
    )


def _over(
    d: Diagnosis,
    course: list[Array],
    adds_: list[Array],
    left_over: list[Array],
    label: str,
    name: str,
    title: str,
    path: Path,
) -> Picture:
    """The residual without a term, and the term's torque, over its variable."""
    used = np.concatenate([s.used for s in d.sessions])
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
        _label(axis, label, title)
    return Picture(
        path,
        f"The term: {name}",
        f"Residual without {name}, and the fitted term, over {label}; "
        f"from {decimals(term[shown].min())} to {decimals(term[shown].max())} Nm.",
    )

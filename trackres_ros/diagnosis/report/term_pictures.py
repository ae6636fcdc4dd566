# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of named effects and unnamed terms: the residual without the term, and its torque, over its variable or place."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.empirical.closest import evenly_filled
from trackres_ros.diagnosis.empirical.routes import Route
from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.empirical.torque import against_travel, torque_residuals
from trackres_ros.diagnosis.findings.found import NamedEffect, UnnamedTerm
from trackres_ros.diagnosis.findings.locate import SMOOTHED_S, smoothed
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.prepare.session import Array, shown_names
from trackres_ros.diagnosis.report.picture import TITLE_LETTERS, WIDTH, Picture
from trackres_ros.diagnosis.report.series import axis_label, lasting, stages
from trackres_ros.diagnosis.selection.intervals import NORMAL_95
from trackres_ros.output.style import BLUE, GREY, VERMILION, picture_with_legend, shortened
from trackres_ros.route.learned import SLOPE
from trackres_ros.route.lookup import SPACING_M
from trackres_ros.text import alike, figures

SHOWN_BINS = 24
OFF_NM = 1e-6  # a term whose gate is closed adds no more
AGAINST = "torque against travel [Nm]"
PERCENT = 100.0


def draw_effect(d: Diagnosis, found: NamedEffect, path: Path) -> Picture:
    """The residual without the effect, and the effect's torque, over its main variable."""
    left_over = against_travel(d.sessions, torque_residuals(d.final))
    variable = BY_NAME[found.location.variable]
    course = [variable.of(s, p) for s, p in zip(d.sessions, d.final.predicted, strict=True)]
    label, title = axis_label(variable.name, stages(d)[-1].label), f"{found.name}: {found.text}"
    return _over(d, course, found.resists, left_over, label, found.name, title, path)


def draw_term(d: Diagnosis, term: UnnamedTerm, path: Path) -> Picture:
    """The same for an unnamed term: over its variable, or over time without one."""
    of = term.described
    left_over = against_travel(d.sessions, torque_residuals(d.final))
    adds = against_travel(d.sessions, term.adds)
    if term.course:
        label = f"{of.variable} [{of.unit}]" if of.unit else of.variable or of.gate
        course = [np.where(np.abs(x) > OFF_NM, c, np.nan) for c, x in zip(term.course, adds, strict=True)]
        return _over(d, course if of.gate else term.course, adds, left_over, label, of.name, of.sentence, path)
    if of.stretches:
        return _by_stretch(d, of, path)
    return _over_time(d, adds, left_over, of, path)


def _label(axis: Any, along: str, across: str, title: str) -> None:
    """Labels of a term's picture: its axes, and its sentence."""
    axis.set_xlabel(along)
    axis.set_ylabel(across)
    axis.set_title(textwrap.fill(title, TITLE_LETTERS))


def _by_stretch(d: Diagnosis, of: Described, path: Path) -> Picture:
    """The mass of each stretch with its interval, all recordings in sequence."""
    ends = np.cumsum([s.time[-1] + s.step for s in d.sessions]).tolist()
    begin = dict(zip((s.name for s in d.sessions), [0.0, *ends[:-1]], strict=True))  # [s]
    edges = np.array([[begin[s.recording] + s.begin_s, begin[s.recording] + s.end_s] for s in of.stretches])
    mass, std = np.array([s.mass for s in of.stretches]), np.array([s.std for s in of.stretches])
    with picture_with_legend(path, WIDTH, 3.0) as body:
        axis = body.subplots()
        middle, half = edges.mean(axis=1) / 60.0, 0.5 * np.diff(edges, axis=1)[:, 0] / 60.0
        label = "mass between two stops, with its 95 % interval"
        axis.errorbar(middle, mass, NORMAL_95 * std, half, fmt="none", color=VERMILION, linewidth=1.2, label=label)
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        _label(axis, "time over consecutive recordings [min]", "mass minus the model's [kg]", of.sentence)
    text = "Mass of each fitted stretch between stops, minus the model's. Acceleration, rolling and climbing determine it."
    return Picture(path, f"The term: {of.name}", text)


def _over_time(d: Diagnosis, adds: list[Array], left_over: list[Array], of: Described, path: Path) -> Picture:
    """The recording with the largest torque of the term."""
    i = int(np.argmax([float(np.abs(x[s.used]).sum()) for x, s in zip(adds, d.sessions, strict=True)]))
    session = d.sessions[i]
    left = smoothed(session, left_over[i] + adds[i])
    with picture_with_legend(path, WIDTH, 3.0) as body:
        axis = body.subplots()
        axis.plot(session.time, left, color=BLUE, label=f"residual without the term, means over {lasting(d, SMOOTHED_S)}")
        axis.plot(session.time, np.where(session.used, adds[i], np.nan), color=VERMILION, label=f"{of.name} as found")
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        _label(axis, f"time in {shortened(shown_names(d.sessions)[i], TITLE_LETTERS - 40)} [s]", AGAINST, of.sentence)
    text = (
        "Residual without the term, and the term, over the recording in which it acts most; on hold-out laps the "
        "term is predicted from the torque up to a few seconds before."
    )
    return Picture(path, f"The term: {of.name}", text)


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


def draw_route(route: Route, final: Fit, path: Path) -> Picture:
    """Draw a slope or a torque by place, as learned on the fitted laps."""
    learned = route.learned(final)
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

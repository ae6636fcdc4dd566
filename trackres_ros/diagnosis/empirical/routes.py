# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Residuals that repeat at the same places of streets, by position: a slope if the sign changes with the direction of travel
or follows the load, else a torque by place.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.patterns import STEEPEST, ByPlace, SlopeByPlace, TorqueByPlace
from trackres_ros.diagnosis.empirical.by_place import BaseColumns, PlaceColumns, PlaceValues, StreetGraph, gains, learn
from trackres_ros.diagnosis.empirical.payload import loads, may_differ
from trackres_ros.diagnosis.empirical.term import SURE_OF_KIND, Route, Term, compared
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.inference.noise import LARGEST_ROOT, SHORT_ROOT, Noise, estimate_noise
from trackres_ros.diagnosis.prepare.gate import way_of
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.diagnosis.selection.locate import torque_residuals
from trackres_ros.diagnosis.selection.visibility import base_columns
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap
from trackres_ros.route.lookup import SPACING_M
from trackres_ros.route.matching import Matched, Places, matched, neighbours, places_of
from trackres_ros.route.track import Frame, track_of
from trackres_ros.text import figures
from trackres_ros.vehicle.writing.changes import BY_PLACE

SLOPES = ("grade", "grade_profile")  # effects of the catalogue that a slope by place includes
SURE = 10.0  # in log-likelihood: of a term by place, and beyond shifted places on passes not used for learning
LEAST_AGAIN_M = 500.0  # on repeated streets of the fitted laps
TURNS = 5  # of fitting the base and the term by place
SETTLED = 0.05  # of its size: a smaller change means convergence
MOVED, NEAREST_MOVED = 39, 0.125  # shifted places for comparison, and the least shift in shares of all places
MORE = 1e-4  # of weight times radius, for the derivative
OWN = 2.0  # times the gain at shifted places: a slow drift fits many by chance
COMMON = 0.1  # of the slopes' size: a larger standard deviation of their mean is told
UNLEARNED = 0.9  # of its size: a place with such a standard deviation is not learned, such as an undriven direction


@dataclass(frozen=True, eq=False)
class _ByPlace:
    """A slope, if significant, else a torque."""

    kind: str
    places: PlaceColumns
    learned: PlaceValues
    expected: list[Array]  # sine of the slope, or torque against travel, of each session
    slope_gain: float

    def moved(self, before: _ByPlace, masks: Sequence[Mask]) -> float:
        """Relative root-mean-square change from a previous one; infinite for another kind."""
        if self.kind != before.kind:
            return math.inf
        now, then = (np.concatenate([x[m] for x, m in zip(of.expected, masks, strict=True)]) for of in (self, before))
        return float(np.sqrt(np.mean((now - then) ** 2) / max(float(np.mean(now**2)), 1e-30)))


@dataclass(frozen=True, eq=False)
class Roads:
    """Sessions matched to themselves."""

    frame: Frame
    places: Places
    streets: StreetGraph
    at: tuple[Matched, ...]  # place at the middle of each step of each session
    within: tuple[Matched, ...]  # place at each of the positions within the steps

    def passes(self, masks: Sequence[Mask]) -> NDArray[np.int64]:
        """Number of passes of each place on used samples, shape (places,)."""
        found = set()
        for track, mask in zip(self.within, masks, strict=True):
            used = np.repeat(mask, len(track.number) // len(mask)) & track.known
            nearer = np.where(track.share[used, 1] > 0.5, track.place[used, 1], track.place[used, 0])
            found |= set(zip(nearer.tolist(), track.number[used].tolist(), strict=True))
        return np.bincount(np.array([place for place, _ in found], dtype=np.int64), minlength=len(self.places))


def roads_of(sessions: Sequence[DriveSession]) -> Roads | None:
    """Match sessions to themselves; None without a recorded position."""
    ways = [way_of(s) for s in sessions]
    latitude, longitude = (np.concatenate([getattr(w, name) for w in ways]) for name in ("latitude", "longitude"))
    there = np.isfinite(latitude) & np.isfinite(longitude)
    if not there.any():
        return None
    frame = Frame.about(latitude, longitude)
    tracks = [track_of(w.driven, *frame.metres(w.latitude, w.longitude)) for w in ways]
    places = places_of(tracks)
    whole = matched(places, tracks)
    within = tuple(m.at(t.nearest(w.driven)) for m, t, w in zip(whole, tracks, ways, strict=True))
    at = tuple(m.middles(len(m.number) // len(s)) for m, s in zip(within, sessions, strict=True))
    return Roads(frame, places, StreetGraph.of(neighbours(whole), places.table, whole), at, within)


def find_route(current: Fit, roads: Roads, kinds: Collection[str] = (SLOPE, TORQUE)) -> Term | None:
    """A slope or a torque by place in the residual of a fit; None if not significant, already known, or not among the
    `kinds`.

    Notes
    -----
    With an unknown slope the noise looks like a random walk, and the base absorbs slopes. So base, noise and the term by
    place are fitted in turn.
    """
    masks = current.problem.masks
    passes = roads.passes(masks)
    again_m = SPACING_M * int((passes > 1).sum())
    if again_m < LEAST_AGAIN_M:
        return None
    residuals, fitted = torque_residuals(current), current
    noise = estimate_noise(residuals, masks, SHORT_ROOT)
    best: _ByPlace | None = None
    for _ in range(TURNS):
        before = best
        best = _slope_or_torque(current, fitted, roads, residuals, noise, kinds)
        if best is None:
            return None
        effect = _effect(current, roads, best, passes)
        fitted = _fitted_with(current, effect, fitted, SHORT_ROOT)
        left = torque_residuals(fitted)
        noise = estimate_noise(left, masks, SHORT_ROOT)
        noise = replace(noise, scale=noise.scale / best.learned.shrinks)
        residuals = [r + x for r, x in zip(left, fitted.contribution(effect.name), strict=True)]
        if before is not None and best.moved(before, masks) < SETTLED:
            break
    assert best is not None
    found = compared(current, _fitted_with(current, effect, fitted), effect, best.learned.cost + math.log(2.0))
    if not found.matters:
        return None
    metres = SPACING_M * int((passes > 0).sum())
    course = tuple(np.where(m.known, SPACING_M * (m.place * m.share).sum(axis=1), np.nan) for m in roads.at)
    again = int(np.median(passes[passes > 1]))
    return replace(found, pattern=Route(best.slope_gain, metres, again_m, again, course, best.places, best.learned))


def _slope_or_torque(
    current: Fit, fitted: Fit, roads: Roads, residuals: Sequence[Array], noise: Noise, kinds: Collection[str]
) -> _ByPlace | None:
    """A slope or a torque, with the base fitted too; None if other passes do not show it, or it is of no requested kind."""
    problem, masks, per = current.problem, current.problem.masks, _torque_per(current)
    spread = float(np.std(np.concatenate([r[m] for r, m in zip(residuals, masks, strict=True)])))
    columns = {
        SLOPE: PlaceColumns.of_slope(roads.within, per[SLOPE], roads.streets),
        TORQUE: PlaceColumns.of_torque(roads.within, per[TORQUE], roads.streets),
    }
    typical = {SLOPE: spread / (problem.base.facts.weight * problem.base.facts.radius), TORQUE: spread}
    base = _base_and_loads(current, fitted)
    at_places = [m & t.known for m, t in zip(masks, roads.at, strict=True)]  # elsewhere the base alone would take a slope
    learned = {kind: learn(c, residuals, at_places, noise, typical[kind], base) for kind, c in columns.items()}
    slope_gain = learned[SLOPE].evidence - learned[TORQUE].evidence
    kind = SLOPE if slope_gain > SURE_OF_KIND else TORQUE
    if kind not in kinds or (len(kinds) == 1 and abs(slope_gain) <= SURE_OF_KIND):
        return None
    if learned[kind].evidence < SURE or not _shows_on_others(columns[kind], learned[kind], roads, residuals, masks):
        return None
    ways = [np.where(s.speed < 0.0, -1.0, 1.0) for s in problem.sessions]
    if kind == SLOPE:
        shape = PlaceColumns.of_slope(roads.within, ways, roads.streets)
    else:
        shape = PlaceColumns.of_torque(roads.within, [np.ones(len(way)) for way in ways], roads.streets)
    return _ByPlace(kind, columns[kind], learned[kind], shape.expected(learned[kind]), slope_gain)


def _torque_per(current: Fit) -> dict[str, list[Array]]:
    """Torque as the sensor shows it, per sine of a slope along travel and per torque against travel. Gears add to it while
    driving and take from it while braking, as of rolling resistance: else the two would differ, and a mean slope be told.
    """
    problem, facts = current.problem, current.problem.base.facts
    more = MORE * facts.weight * facts.radius
    loaded = [replace(s, torque_by_place=s.torque_by_place + more) for s in problem.sessions]
    expected = problem.base.predict(loaded, *current.model_at(current.point))
    per = [(e.torque - p.torque) / more for e, p in zip(expected, current.predicted, strict=True)]
    return {SLOPE: [s.weight * facts.radius * x for s, x in zip(problem.sessions, per, strict=True)], TORQUE: per}


def _base_and_loads(current: Fit, fitted: Fit) -> BaseColumns:
    """Torque changes of each session for one standard deviation of each base parameter, and of the mass of each
    stretch if masses may differ. Otherwise a load would be learned as a slope where a vehicle accelerates. The values are those
    of a later fit; about that fit, a mass would change the slopes' torque, and explain it.
    """
    own = [i for i, f in enumerate(current.free) if f.key[0] not in current.effect_names]
    columns = base_columns(current) * np.array([f.std if np.isfinite(f.std) else f.scale for f in current.free])
    of = current.problem.split(columns[:, own])[: len(current.problem.sessions)]
    off = np.array([(fitted.at[f.key] - f.nominal) / f.std for f in (current.free[i] for i in own)])
    if may_differ(current):
        of = [np.column_stack(both) for both in zip(of, loads(current), strict=True)]
    return BaseColumns(of, np.concatenate([off, np.zeros(of[0].shape[1] - len(off))]))


def _shows_on_others(
    columns: PlaceColumns, found: PlaceValues, roads: Roads, residuals: Sequence[Array], masks: Sequence[Mask]
) -> bool:
    """Whether values from every other pass explain the passes between, and far better than those of shifted places."""
    total = np.zeros(1 + MOVED)
    ways = len(found.value) // len(roads.places)
    numbers = [t.number if ways == 1 else t.number_this_way for t in roads.at]
    for half in (0, 1):
        others, used = (
            [m & (n >= 0) & ((n % 2 == half) == own) for m, n in zip(masks, numbers, strict=True)] for own in (True, False)
        )
        value = found.relearned(columns, residuals, used)
        moved = [ways * round(by * len(roads.places)) for by in (0.0, *np.linspace(NEAREST_MOVED, 1.0 - NEAREST_MOVED, MOVED))]
        total += gains(columns, np.stack([np.roll(value, by) for by in moved], axis=1), residuals, others, found.noise)
    elsewhere = max(0.0, float(total[1:].max()))
    return bool(total[0] > elsewhere + SURE and total[0] > OWN * elsewhere)


def _effect(current: Fit, roads: Roads, best: _ByPlace, passes: NDArray[np.int64]) -> ByPlace:
    facts, masks = current.problem.base.facts, current.problem.masks
    route, shape = _map(roads, best.kind, best.learned, passes), best.expected
    if best.kind == SLOPE:
        sine = [np.clip(x, -STEEPEST, STEEPEST) for x in shape]
        shape = [x / np.sqrt(1.0 - x**2) for x in sine]
    used = np.concatenate([x[m] for x, m in zip(shape, masks, strict=True)])
    typical = max(float(np.sqrt(np.mean(used**2))), 1e-9)
    make = SlopeByPlace if best.kind == SLOPE else TorqueByPlace
    text = _text(route, best.learned.std_of_mean(np.flatnonzero(passes > 0)))
    return make(BY_PLACE[best.kind], text, [x / typical for x in shape], facts.weight * facts.radius, route, typical)


def _fitted_with(current: Fit, effect: ByPlace, begin: Fit, largest_root: float = LARGEST_ROOT) -> Fit:
    """Fit with the effect added, under a noise with bounded roots: for predictive values, or for tests."""
    effects = [*(a.effect for a in current.effects), effect]
    start = {**begin.at, (effect.name, effect.parameters[0].name): effect.typical}
    return fit(current.problem, effects, start, largest_root=largest_root)


def _map(roads: Roads, kind: str, learned: PlaceValues, passes: NDArray[np.int64]) -> RouteMap:
    """Learned map of the places passed on the fitted laps."""
    seen = np.flatnonzero(passes > 0)
    x, y, east, north = roads.places.table[seen].T
    if kind == SLOPE:
        slope, spread = np.clip(learned.value[seen], -STEEPEST, STEEPEST), learned.std(seen)
        slope = slope / np.sqrt(1.0 - slope**2)
        value, std = np.stack([slope, -slope], axis=1), np.stack([spread, spread], axis=1)
    else:
        ways = np.stack([2 * seen, 2 * seen + 1], axis=1)
        value, std = learned.value[ways], learned.std(ways.ravel()).reshape(-1, 2)
    known = std < UNLEARNED * learned.size
    value, std = np.where(known, value, np.nan), np.where(known, std, np.nan)
    latitude, longitude = roads.frame.position(x, y)
    return RouteMap(kind, latitude, longitude, np.arctan2(north, east), value, std, passes[seen])


def _text(route: RouteMap, of_mean: float) -> str:
    """Sentence for a map with this standard deviation of its mean."""
    low, high = (float(q) for q in np.nanquantile(route.value, (0.025, 0.975)))
    if route.kind == TORQUE:
        return f"the vehicle needs {figures(low, 2)} to {figures(high, 2)} Nm more depending on the place, the same on each pass"
    text = f"the road has slopes of up to {100.0 * max(-low, high):.1f} %, the same on each pass"
    if of_mean > COMMON * float(np.sqrt(np.nanmean(route.value**2))):
        off = f"{200.0 * of_mean:.1f} %"
        text += f"; as rolling resistance looks like a mean slope on a road driven one way, all may be {off} off"
    return text

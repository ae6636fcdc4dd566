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
from trackres_ros.diagnosis.empirical.term import SURE_OF_KIND, Route, Term, term_of_fit
from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.inference.noise import LARGEST_ROOT, SHORT_ROOT, Noise, estimate_noise
from trackres_ros.diagnosis.prepare.gate import way_of
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.diagnosis.selection.locate import torque_residuals
from trackres_ros.diagnosis.selection.visibility import base_columns
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap
from trackres_ros.route.lookup import SPACING_M
from trackres_ros.route.matching import Matched, Places, match_tracks, neighbour_pairs, places_of
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

    def moved(self, last_values: _ByPlace, masks: Sequence[Mask]) -> float:
        """Relative root-mean-square change from a previous one; infinite for another kind."""
        if self.kind != last_values.kind:
            return math.inf
        values, previous_values = (
            np.concatenate([x[m] for x, m in zip(term.expected, masks, strict=True)]) for term in (self, last_values)
        )
        return float(np.sqrt(np.mean((values - previous_values) ** 2) / max(float(np.mean(values**2)), 1e-30)))


@dataclass(frozen=True, eq=False)
class Roads:
    """Sessions matched to themselves."""

    frame: Frame
    places: Places
    streets: StreetGraph
    middles: tuple[Matched, ...]  # place at the middle of each step of each session
    within: tuple[Matched, ...]  # place at each of the positions within the steps

    def passes(self, masks: Sequence[Mask]) -> NDArray[np.int64]:
        """Number of passes of each place on used samples, shape (places,)."""
        pairs = set()
        for track, mask in zip(self.within, masks, strict=True):
            used_rows = np.repeat(mask, len(track.number) // len(mask)) & track.is_known
            nearest_places = np.where(track.share[used_rows, 1] > 0.5, track.place[used_rows, 1], track.place[used_rows, 0])
            pairs |= set(zip(nearest_places.tolist(), track.number[used_rows].tolist(), strict=True))
        return np.bincount(np.array([place for place, _ in pairs], dtype=np.int64), minlength=len(self.places))


def roads_of(sessions: Sequence[DriveSession]) -> Roads | None:
    """Match sessions to themselves; None without a recorded position."""
    ways = [way_of(s) for s in sessions]
    latitude, longitude = (np.concatenate([getattr(w, name) for w in ways]) for name in ("latitude", "longitude"))
    is_known = np.isfinite(latitude) & np.isfinite(longitude)
    if not is_known.any():
        return None
    frame = Frame.of_positions(latitude, longitude)
    tracks = [track_of(w.driven, *frame.metres(w.latitude, w.longitude)) for w in ways]
    places = places_of(tracks)
    matches = match_tracks(places, tracks)
    matches_within = tuple(m.select(t.nearest_index(w.driven)) for m, t, w in zip(matches, tracks, ways, strict=True))
    middles = tuple(m.middles(len(m.number) // len(s)) for m, s in zip(matches_within, sessions, strict=True))
    return Roads(frame, places, StreetGraph.of(neighbour_pairs(matches), places.table, matches), middles, matches_within)


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
    residuals, current_fit = torque_residuals(current), current
    noise = estimate_noise(residuals, masks, SHORT_ROOT)
    best_values: _ByPlace | None = None
    for _ in range(TURNS):
        previous_values = best_values
        best_values = _slope_or_torque(current, current_fit, roads, residuals, noise, kinds)
        if best_values is None:
            return None
        effect = _effect(current, roads, best_values, passes)
        current_fit = _fit_with(current, effect, current_fit, SHORT_ROOT)
        remainder = torque_residuals(current_fit)
        noise = estimate_noise(remainder, masks, SHORT_ROOT)
        noise = replace(noise, scale=noise.scale / best_values.learned.shrinks)
        residuals = [r + x for r, x in zip(remainder, current_fit.contribution(effect.name), strict=True)]
        if previous_values is not None and best_values.moved(previous_values, masks) < SETTLED:
            break
    assert best_values is not None
    term = term_of_fit(current, _fit_with(current, effect, current_fit), effect, best_values.learned.cost + math.log(2.0))
    if not term.matters:
        return None
    metres = SPACING_M * int((passes > 0).sum())
    course = tuple(np.where(m.is_known, SPACING_M * (m.place * m.share).sum(axis=1), np.nan) for m in roads.middles)
    typical_passes = int(np.median(passes[passes > 1]))
    return replace(
        term,
        pattern=Route(best_values.slope_gain, metres, again_m, typical_passes, course, best_values.places, best_values.learned),
    )


def _slope_or_torque(
    current: Fit, current_fit: Fit, roads: Roads, residuals: Sequence[Array], noise: Noise, kinds: Collection[str]
) -> _ByPlace | None:
    """A slope or a torque, with the base fitted too; None if other passes do not show it, or it is of no requested kind."""
    problem, masks, unit_torques = current.problem, current.problem.masks, _unit_torques(current)
    spread = float(np.std(np.concatenate([r[m] for r, m in zip(residuals, masks, strict=True)])))
    columns = {
        SLOPE: PlaceColumns.of_slope(roads.within, unit_torques[SLOPE], roads.streets),
        TORQUE: PlaceColumns.of_torque(roads.within, unit_torques[TORQUE], roads.streets),
    }
    typical_sizes = {SLOPE: spread / (problem.base.facts.weight * problem.base.facts.radius), TORQUE: spread}
    base = _base_columns(current, current_fit)
    at_places = [m & t.is_known for m, t in zip(masks, roads.middles, strict=True)]  # elsewhere the base alone would take a slope
    values_by_kind = {kind: learn(c, residuals, at_places, noise, typical_sizes[kind], base) for kind, c in columns.items()}
    slope_gain = values_by_kind[SLOPE].evidence - values_by_kind[TORQUE].evidence
    kind = SLOPE if slope_gain > SURE_OF_KIND else TORQUE
    if kind not in kinds or (len(kinds) == 1 and abs(slope_gain) <= SURE_OF_KIND):
        return None
    if values_by_kind[kind].evidence < SURE or not _shows_on_others(columns[kind], values_by_kind[kind], roads, residuals, masks):
        return None
    ways = [np.where(s.speed < 0.0, -1.0, 1.0) for s in problem.sessions]
    if kind == SLOPE:
        shape = PlaceColumns.of_slope(roads.within, ways, roads.streets)
    else:
        shape = PlaceColumns.of_torque(roads.within, [np.ones(len(way)) for way in ways], roads.streets)
    return _ByPlace(kind, columns[kind], values_by_kind[kind], shape.expected(values_by_kind[kind]), slope_gain)


def _unit_torques(current: Fit) -> dict[str, list[Array]]:
    """Sensed torque per sine of a slope along travel, and per torque against travel [Nm].

    Gear losses increase it while driving and reduce it while braking, as for rolling resistance. If only the resistance had
    them, the difference would look like a mean slope.
    """
    problem, facts = current.problem, current.problem.base.facts
    increment = MORE * facts.weight * facts.radius
    shifted_sessions = [replace(s, torque_by_place=s.torque_by_place + increment) for s in problem.sessions]
    predictions = problem.base.predict(shifted_sessions, *current.model_at(current.point))
    unit_torques = [(e.torque - p.torque) / increment for e, p in zip(predictions, current.predicted, strict=True)]
    return {
        SLOPE: [s.weight * facts.radius * x for s, x in zip(problem.sessions, unit_torques, strict=True)],
        TORQUE: unit_torques,
    }


def _base_columns(current: Fit, current_fit: Fit) -> BaseColumns:
    """Torque changes of each session for one standard deviation of each base parameter, and of the mass of each
    stretch if masses may differ. Otherwise a load would be learned as a slope where a vehicle accelerates. The values are those
    of a later fit; about that fit, a mass would change the slopes' torque, and explain it.
    """
    own_indices = [i for i, f in enumerate(current.free) if f.key[0] not in current.effect_names]
    columns = base_columns(current) * np.array([f.std if np.isfinite(f.std) else f.scale for f in current.free])
    torques = current.problem.split(columns[:, own_indices])[: len(current.problem.sessions)]
    offsets = np.array([(current_fit.estimates[f.key] - f.nominal) / f.std for f in (current.free[i] for i in own_indices)])
    if may_differ(current):
        torques = [np.column_stack(pair) for pair in zip(torques, loads(current), strict=True)]
    return BaseColumns(torques, np.concatenate([offsets, np.zeros(torques[0].shape[1] - len(offsets))]))


def _shows_on_others(
    columns: PlaceColumns, values: PlaceValues, roads: Roads, residuals: Sequence[Array], masks: Sequence[Mask]
) -> bool:
    """Whether values from every other pass explain the passes between, and far better than those of shifted places."""
    total = np.zeros(1 + MOVED)
    ways = len(values.value) // len(roads.places)
    numbers = [t.number if ways == 1 else t.number_this_way for t in roads.middles]
    for half_number in (0, 1):
        other_masks, used_masks = (
            [m & (n >= 0) & ((n % 2 == half_number) == is_other) for m, n in zip(masks, numbers, strict=True)]
            for is_other in (True, False)
        )
        value = values.relearned(columns, residuals, used_masks)
        shifts = [
            ways * round(shift * len(roads.places)) for shift in (0.0, *np.linspace(NEAREST_MOVED, 1.0 - NEAREST_MOVED, MOVED))
        ]
        total += gains(
            columns, np.stack([np.roll(value, shift) for shift in shifts], axis=1), residuals, other_masks, values.noise
        )
    gain_elsewhere = max(0.0, float(total[1:].max()))
    return bool(total[0] > gain_elsewhere + SURE and total[0] > OWN * gain_elsewhere)


def _effect(current: Fit, roads: Roads, place_values: _ByPlace, passes: NDArray[np.int64]) -> ByPlace:
    facts, masks = current.problem.base.facts, current.problem.masks
    route, shape = _map(roads, place_values.kind, place_values.learned, passes), place_values.expected
    if place_values.kind == SLOPE:
        sine = [np.clip(x, -STEEPEST, STEEPEST) for x in shape]
        shape = [x / np.sqrt(1.0 - x**2) for x in sine]
    used_values = np.concatenate([x[m] for x, m in zip(shape, masks, strict=True)])
    typical_size = max(float(np.sqrt(np.mean(used_values**2))), 1e-9)
    make = SlopeByPlace if place_values.kind == SLOPE else TorqueByPlace
    text = _text(route, place_values.learned.std_of_mean(np.flatnonzero(passes > 0)))
    return make(
        BY_PLACE[place_values.kind], text, [x / typical_size for x in shape], facts.weight * facts.radius, route, typical_size
    )


def _fit_with(current: Fit, effect: ByPlace, begin: Fit, largest_root: float = LARGEST_ROOT) -> Fit:
    """Fit with the effect added, under a noise with bounded roots: for predictive values, or for tests."""
    effects = [*(a.effect for a in current.effects), effect]
    start = {**begin.estimates, (effect.name, effect.parameters[0].name): effect.typical}
    return fit(current.problem, effects, start, largest_root=largest_root)


def _map(roads: Roads, kind: str, place_values: PlaceValues, passes: NDArray[np.int64]) -> RouteMap:
    """Learned map of the places passed on the fitted laps."""
    driven_places = np.flatnonzero(passes > 0)
    x, y, east, north = roads.places.table[driven_places].T
    if kind == SLOPE:
        slope, spread = np.clip(place_values.value[driven_places], -STEEPEST, STEEPEST), place_values.std(driven_places)
        slope = slope / np.sqrt(1.0 - slope**2)
        value, std = np.stack([slope, -slope], axis=1), np.stack([spread, spread], axis=1)
    else:
        ways = np.stack([2 * driven_places, 2 * driven_places + 1], axis=1)
        value, std = place_values.value[ways], place_values.std(ways.ravel()).reshape(-1, 2)
    is_known = std < UNLEARNED * place_values.size
    value, std = np.where(is_known, value, np.nan), np.where(is_known, std, np.nan)
    latitude, longitude = roads.frame.position(x, y)
    return RouteMap(kind, latitude, longitude, np.arctan2(north, east), value, std, passes[driven_places])


def _text(route: RouteMap, mean_std: float) -> str:
    """Sentence for a map with this standard deviation of its mean."""
    low, high = (float(q) for q in np.nanquantile(route.value, (0.025, 0.975)))
    if route.kind == TORQUE:
        return f"the vehicle needs {figures(low, 2)} to {figures(high, 2)} Nm more depending on the place, the same on each pass"
    text = f"the road has slopes of up to {100.0 * max(-low, high):.1f} %, the same on each pass"
    if mean_std > COMMON * float(np.sqrt(np.nanmean(route.value**2))):
        error = f"{200.0 * mean_std:.1f} %"
        text += f"; as rolling resistance looks like a mean slope on a road driven one way, all may be {error} off"
    return text

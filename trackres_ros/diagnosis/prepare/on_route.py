# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Adds the learned values of a route's places to sessions, by position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trackres_ros.diagnosis.prepare.gate import Gated
from trackres_ros.diagnosis.prepare.notes import WarningNote
from trackres_ros.diagnosis.prepare.resample import MOST_UNKNOWN
from trackres_ros.diagnosis.prepare.session import ALWAYS_KNOWN, Array, DriveSession, Way
from trackres_ros.effects.effect import Active
from trackres_ros.route.learned import SLOPE, RouteMap
from trackres_ros.route.matching import matched
from trackres_ros.route.track import track_of
from trackres_ros.text import some_of


def on_route(gated: Gated, route: Sequence[RouteMap], acting: Sequence[Active] = ()) -> Gated:
    """Sessions with torque and, if not recorded, slope of the route by position; samples off the route are excluded.

    The notes name what lacks an input: values of the route, and effects of the vehicle file and its surroundings, `acting`.
    """
    sessions, notes = list(gated.sessions), list(gated.notes)
    notes += _left_out(sessions, route, acting)
    for one in route:
        for i, session in enumerate(sessions):
            if "position" not in session.given or (one.kind == SLOPE and "grade" in session.given):
                continue
            found = _along(session, one)
            known = np.isfinite(found)
            notes.append(f"{session.name}: {100.0 * known.mean():.0f} % of it is on the route with known {one.kind}s")
            if known.mean() <= MOST_UNKNOWN:
                notes[-1] = WarningNote(f"{notes[-1]}; they are not used")
                continue
            found = np.where(known, found, 0.0)
            session = replace(session, used=session.used & known)
            if one.kind == SLOPE:
                sessions[i] = replace(session, grade=found, given=session.given | {"grade"})
            else:
                sessions[i] = replace(session, torque_by_place=found)
    return replace(with_fewer_steps(gated, sessions, "off the route"), notes=tuple(notes))


def _left_out(sessions: Sequence[DriveSession], route: Sequence[RouteMap], acting: Sequence[Active]) -> list[str]:
    """A note for each effect, or kind of value of the route, that lacks an input in some sessions."""
    of = "of the vehicle or its surroundings"
    needed: dict[str, Sequence[str]] = {f"{one.effect.name} {of}": one.effect.needs for one in acting}
    needed |= {f"{values.kind} of the route": ("position",) for values in route}
    found: dict[tuple[str, str], list[str]] = {}
    for session in sessions:
        for name, needs in needed.items():
            lacks = [need for need in needs if need not in ALWAYS_KNOWN and need not in session.given]
            if lacks and not (name == f"{SLOPE} of the route" and "grade" in session.given):
                found.setdefault((name, ", ".join(lacks)), []).append(session.name)
    return [
        WarningNote(f"{some_of(names)}: {name} is left out, as {lacks} is not known") for (name, lacks), names in found.items()
    ]


def with_fewer_steps(gated: Gated, sessions: Sequence[DriveSession], reason: str) -> Gated:
    """The same sessions with fewer compared steps; their time is excluded for a reason."""
    before, after = (sum(s.used.sum() * s.step for s in of) for of in (gated.sessions, sessions))
    lost = {reason: round(before - after)} if before > after else {}
    return replace(gated, sessions=tuple(sessions), excluded={**gated.excluded, **lost})


def way_of(session: DriveSession) -> Way:
    """Positions of a session; without positions within its steps, those at their middles."""
    if session.way is not None:
        return session.way
    driven = np.abs(np.nan_to_num(session.speed)) * session.step
    return Way(session.latitude, session.longitude, np.cumsum(driven) - 0.5 * driven)


def _along(session: DriveSession, route: RouteMap) -> Array:
    """Means over each step of the values learned in the direction of travel, a slope along the heading; nan where unknown."""
    way = way_of(session)
    track = track_of(way.driven, *route.frame.metres(way.latitude, way.longitude))
    at = matched(route.places, [track])[0].at(track.nearest(way.driven))
    learned = route.value[at.place, (at.sign < 0.0).astype(int)]
    there = np.isfinite(learned) & (at.share > 0.0) & at.known[:, np.newaxis]
    share = np.where(there, at.share, 0.0)
    total = share.sum(axis=1)
    found = (share * np.where(there, learned, 0.0)).sum(axis=1) / np.where(total > 0.0, total, np.nan)
    mean = found.reshape(len(session), -1).mean(axis=1)
    return np.asarray(np.where((session.speed < 0.0) & (route.kind == SLOPE), -mean, mean))

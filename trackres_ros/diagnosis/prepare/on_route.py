# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gives sessions the slopes of a route that was learned before, by their positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trackres_ros.diagnosis.prepare.gate import Gated
from trackres_ros.diagnosis.prepare.resample import MOST_UNKNOWN
from trackres_ros.diagnosis.prepare.session import Array, Session, Way
from trackres_ros.route.learned import RouteMap
from trackres_ros.route.matching import matched
from trackres_ros.route.track import track_of


def on_route(gated: Gated, route: RouteMap | None) -> Gated:
    """Sessions with a position and without a recorded slope have that of the route; samples beside it are not compared."""
    if route is None:
        return gated
    sessions, notes = [], list(gated.notes)
    for session in gated.sessions:
        if "position" in session.given and "grade" not in session.given:
            slope = _slope(session, route)
            known = np.isfinite(slope)
            notes.append(f"{session.name}: {known.mean():.0%} of it lies on the route whose slopes are given")
            if known.mean() > MOST_UNKNOWN:
                given, used = session.given | {"grade"}, session.used & known
                session = replace(session, grade=np.where(known, slope, 0.0), given=given, used=used)
            else:
                notes[-1] += "; they are not used"
        sessions.append(session)
    return replace(gated, sessions=tuple(sessions), notes=tuple(notes))


def way_of(session: Session) -> Way:
    """Where a session was; of one without positions within its steps, at their middles."""
    if session.way is not None:
        return session.way
    driven = np.abs(np.nan_to_num(session.speed)) * session.step
    return Way(session.latitude, session.longitude, np.cumsum(driven) - 0.5 * driven)


def _slope(session: Session, route: RouteMap) -> Array:
    """Rise over run the way the vehicle points, mean over each step; nan beside the route."""
    way = way_of(session)
    track = track_of(way.driven, *route.frame.metres(way.latitude, way.longitude))
    at = matched(route.places, [track])[0].at(track.nearest(way.driven))
    rise = np.where(at.known, (at.share * at.sign * route.value[at.place, 0]).sum(axis=1), np.nan)
    mean = rise.reshape(len(session), -1).mean(axis=1)
    return np.asarray(np.where(session.speed < 0.0, -mean, mean))

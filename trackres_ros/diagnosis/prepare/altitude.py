# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derives a slope from a recorded altitude of sufficient accuracy, with its standard deviation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from trackres_ros.diagnosis.prepare.robust import robust_least_squares
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.recording.slopes import slopes
from trackres_ros.route.track import Frame
from trackres_ros.units import GRAVITY, MAD_TO_STD

SAME_PLACE_M = 10.0  # covers lanes and receiver scatter
ANOTHER_PASS_S = 600.0  # after which the receiver error is independent
APART_M = 20.0  # spacing of the compared places within one pass
FEWEST_REVISITS = 30
MOST_UNKNOWN = 0.5  # of a recording
WORTH = 0.5  # least share of the slope's variance that is not error
PIECE_S = 300.0  # correlation time of the errors
SURE = 2.0  # standard deviations


def with_slope(session: DriveSession) -> tuple[DriveSession, str]:
    """The session with a slope from its altitude, and a note; unchanged without a usable one, see `slope_of_altitude`.

    The measured torque must also fit significantly better with these slopes than without.
    """
    found, text = slope_of_altitude(session)
    return (found, text) if found is session else confirmed(session, found, text, "torque", "Nm", torque_errors(found))


def slope_of_altitude(session: DriveSession) -> tuple[DriveSession, str]:
    """The session with a slope from its altitude, used where that is known, and a note; unchanged without altitude, with a
    recorded slope, or without samples to compare.

    The distance for the slope follows from the altitude's error: its scatter, and the difference between passes of one
    place. The slope is used if at least half of its variance is not error.
    """
    if "altitude" not in session.given or "grade" in session.given or not session.used.any():
        return session, ""
    error, passes = error_by_revisits(session)
    found = slopes(session.time + 0.5 * session.step, session.speed, session.altitude, error)
    known = np.isfinite(found.value)
    used = session.used & known
    of_error = f", which differs by {error:.1f} m between passes of one place ({passes} places)," if passes else ""
    where = f"{session.name}: the altitude{of_error}"
    if used.sum() < (1.0 - MOST_UNKNOWN) * session.used.sum():
        return session, f"{where} gives a slope on less than half of the distance; it is not used"
    spread = float(np.std(found.value[used]))
    text = f"over {found.length_m:.0f} m with a standard deviation of {found.std:.2%}"
    if spread**2 < found.std**2 / (1.0 - WORTH):
        return session, f"{where} gives no usable slope: slopes {text}, as large as the slopes themselves; it is not used"
    grade = np.where(known, found.value, 0.0)
    given, computed = session.given | {"grade"}, session.computed | {"grade"}
    with_it = replace(session, grade=grade, grade_std=found.std, used=used, given=given, computed=computed)
    return with_it, f"{where} gives a slope {text}"


def confirmed(
    session: DriveSession, found: DriveSession, text: str, what: str, unit: str, errors: tuple[float, float, bool]
) -> tuple[DriveSession, str]:
    """The session with its slope `found` if the errors of a measurement confirm it, else unchanged; and the note with both."""
    without, with_it, surely = errors
    text = f"{text}; the {what} error is {with_it:.4g} {unit} with it and {without:.4g} {unit} without"
    return (found, text) if surely else (session, f"{text}, so it is no usable slope")


def error_by_revisits(session: DriveSession) -> tuple[float, int]:
    """Standard deviation of the altitude's error between passes of a place [m], and the number of pairs; 0 without pairs."""
    from scipy.spatial import cKDTree  # takes a while to load

    x, y = Frame.about(session.latitude, session.longitude).metres(session.latitude, session.longitude)
    known = np.isfinite(x) & np.isfinite(session.altitude)
    piece = np.floor(session.distance / APART_M)
    rows = np.flatnonzero(known & (np.diff(piece, prepend=-1.0) > 0.0))
    if len(rows) < 2:
        return 0.0, 0
    pairs = cKDTree(np.column_stack([x[rows], y[rows]])).query_pairs(SAME_PLACE_M, output_type="ndarray")
    first, second = rows[pairs[:, 0]], rows[pairs[:, 1]]
    again = np.abs(session.time[first] - session.time[second]) > ANOTHER_PASS_S
    apart = np.abs(session.altitude[first] - session.altitude[second])[again]
    if len(apart) < FEWEST_REVISITS:
        return 0.0, 0
    return float(MAD_TO_STD * np.median(apart) / np.sqrt(2.0)), len(apart)


def torque_errors(session: DriveSession) -> tuple[float, float, bool]:
    """Mean torque error without and with the slopes of a session [Nm], and whether the reduction is significant.

    The torque of inertia, rolling and air is fitted, with one factor each. A slope needs the torque of an acceleration of
    g times the slope, so mass and radius need not be known. Significant: two standard deviations over pieces of the drive.
    """
    use = session.used
    mass, torque = session.weight[use] / GRAVITY, session.torque[use]
    pulls = (session.accel[use], session.accel[use] + GRAVITY * session.grade[use])
    columns = (np.column_stack([mass * pull, _resisting(session)]) for pull in pulls)
    return _compared(((torque, x) for x in columns), session.time[use] // PIECE_S)


def coasting_errors(sessions: Sequence[DriveSession]) -> tuple[float, float, bool]:
    """The same for coast-downs, each in use and a block of its own: mean error of the decelerating force [N]."""
    resists = np.concatenate([_resisting(s) for s in sessions])
    forces = (
        np.concatenate([(s.weight / GRAVITY * (s.accel + part * GRAVITY * s.grade))[s.used] for s in sessions])
        for part in (0.0, 1.0)
    )
    return _compared(((force, resists) for force in forces), np.concatenate([s.block[s.used] for s in sessions]))


def _resisting(session: DriveSession) -> Array:
    """Columns for the resistance of rolling and air, of the steps in use."""
    mass, speed = session.weight[session.used] / GRAVITY, session.speed[session.used]
    return np.column_stack([mass * np.sign(speed), mass * speed, speed * np.abs(speed)])


def _compared(fits: Iterable[tuple[Array, Array]], pieces: Array) -> tuple[float, float, bool]:
    """Mean errors of two fits of values by columns, and whether the second is significantly smaller, by the pieces."""
    without, with_it = (np.abs(y - x @ robust_least_squares(x, y)) for y, x in fits)
    _, piece = np.unique(pieces, return_inverse=True)
    gains = np.bincount(piece, without - with_it) / np.bincount(piece)
    surely = len(gains) > 1 and gains.mean() > SURE * np.std(gains, ddof=1) / np.sqrt(len(gains))
    return float(without.mean()), float(with_it.mean()), bool(surely)

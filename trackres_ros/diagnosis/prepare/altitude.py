# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derives a slope from a recorded altitude of sufficient accuracy, with its standard deviation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trackres_ros.diagnosis.prepare.robust import robust_least_squares
from trackres_ros.diagnosis.prepare.session import DriveSession
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
    """The session with a slope from its altitude, and a note; unchanged without altitude, with a recorded slope, or without
    samples to compare.

    The distance for the slope follows from the altitude's error: its scatter, and the difference between passes of one
    place. The slope is used if at least half of its variance is not error. The measured torque must also fit significantly
    better with these slopes than without.
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
    if spread**2 < found.std**2 / (1.0 - WORTH):
        text = (
            f"slopes with a standard deviation of {found.std:.2%} over {found.length_m:.0f} m, as large as the slopes themselves"
        )
        return session, f"{where} gives no usable slope: {text}; it is not used"
    with_it = replace(session, grade=np.where(known, found.value, 0.0), grade_std=found.std, used=used)
    without, error_with, surely = torque_errors(with_it)
    if not surely:
        text = f"the torque error is {error_with:.4g} Nm with its slopes and {without:.4g} Nm without"
        return session, f"{where} gives no usable slope over {found.length_m:.0f} m: {text}; it is not used"
    text = f"a slope over {found.length_m:.0f} m with a standard deviation of {found.std:.2%}"
    explained = f"the torque error is {error_with:.4g} Nm with it and {without:.4g} Nm without"
    return replace(with_it, given=session.given | {"grade"}), f"{where} gives {text}; {explained}"


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
    mass, speed, torque = session.weight[use] / GRAVITY, session.speed[use], session.torque[use]
    resists = [mass * np.sign(speed), mass * speed, speed * np.abs(speed)]
    by_slope = GRAVITY * session.grade[use]
    pulls = (session.accel[use], session.accel[use] + by_slope)
    columns = [np.stack([mass * pull, *resists], axis=1) for pull in pulls]
    without, with_it = (np.abs(torque - x @ robust_least_squares(x, torque)) for x in columns)
    _, piece = np.unique(session.time[use] // PIECE_S, return_inverse=True)
    gains = np.bincount(piece, without - with_it) / np.bincount(piece)
    surely = len(gains) > 1 and gains.mean() > SURE * np.std(gains, ddof=1) / np.sqrt(len(gains))
    return float(without.mean()), float(with_it.mean()), bool(surely)

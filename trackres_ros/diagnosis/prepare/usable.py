# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Selects the steps of a session with comparable torques, and counts the others by reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from trackres_ros.diagnosis.prepare.brakes import near
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Mask
from trackres_ros.diagnosis.prepare.settings import GateSettings

BRAKES_ON = "brakes on"
SAME_SHARE = 1e-9  # of the largest torque: a rounding difference
LONGEST_STUCK_S = 30.0
BRAKING_MPS2 = -0.5  # at a torque that does not drive: friction brakes may act


def usable(
    session: DriveSession, unknown: Mapping[str, Mask], settings: GateSettings, left_out: Counter[str], alone: float = 0.0
) -> Mask:
    """Steps with a comparable torque.

    Parameters
    ----------
    session
        Session on its grid.
    unknown
        Steps without a needed measurement, each of shape (n,), by reason.
    settings
        Of the vehicle.
    alone
        Torque [Nm], zero or negative, down to which the motor brakes alone.
    left_out
        Receives the seconds of excluded steps, each under its first reason.
    """
    used = np.ones(len(session), dtype=bool)
    braking = (session.accel < BRAKING_MPS2) & (session.torque <= 0.0)
    if settings.friction_brakes:  # applied with a braking torque, and for a moment after it
        braking = near(session.torque < alone if alone < 0.0 else session.torque <= 0.0)
    if "brake" in session.given or settings.friction_brakes is None:  # all braking except the torque is known
        braking = np.zeros(len(session), dtype=bool)
    slow = is_slow(session, settings)
    stuck = _stuck(session.torque, session.step, ~slow, LONGEST_STUCK_S * session.pace)
    braked = unknown.get(BRAKES_ON, np.zeros(len(session), dtype=bool))
    for reason, bad in (
        *((reason, bad) for reason, bad in unknown.items() if reason != BRAKES_ON),
        (f"slower than {settings.slowest:g} m/s", slow),
        ("torque stuck", stuck),
        (BRAKES_ON, braked),
        ("may brake", braking),
    ):
        left_out[reason] += round(int((used & bad).sum()) * session.step)
        used &= ~bad
    return used


def is_slow(session: DriveSession, settings: GateSettings) -> Mask:
    """Steps in which friction may be static."""
    return np.asarray(np.abs(session.speed) < settings.slowest)


def _stuck(torque: Array, step: float, moving: Mask, longest_s: float) -> Mask:
    """Steps with a constant torque, but for rounding, while moving."""
    changes = np.flatnonzero(~(np.abs(np.diff(torque, prepend=np.nan)) <= SAME_SHARE * np.abs(torque).max()))
    lengths = np.diff(np.append(changes, len(torque)))
    return np.repeat(lengths * step > longest_s, lengths) & moving

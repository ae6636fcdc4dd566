"""Step 0, second half: units, signs and clocks of the torque, judged by what the vehicle file expects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.session import Course, Session
from trackres_ros.errors import InputError

Array = NDArray[np.float64]

SURE = 0.5  # correlation from which a wrong sign or unit is no doubt
KILO = (1.0 / 3000.0, 1.0 / 300.0)
LARGEST_SHIFT_S = 30
LEAST_SHIFT_S = 2
UNLIKE = 1.8  # times the torque: more than load, ground and weather do to one vehicle between two drives
CLEARLY_BETTER = 0.05  # in correlation


def aligned_clock(session: Session, expected: Array) -> tuple[Session, str]:
    """The session with its torque moved in time to where it goes with the speed best, and what was done.

    Only whole steps from `LEAST_SHIFT_S` on: less is a delay, which is physics, or a sensor's.
    """
    shifts = range(-LARGEST_SHIFT_S, LARGEST_SHIFT_S + 1)
    there = [_correlation(_moved(session.torque, -s), expected, _moved_mask(session.used, -s) & session.used) for s in shifts]
    best = int(np.argmax(there))
    shift, gain = shifts[best], there[best] - there[LARGEST_SHIFT_S]
    if abs(shift) < LEAST_SHIFT_S or gain < CLEARLY_BETTER or there[best] < SURE:
        return session, ""
    course = session.torque_course and Course(session.torque_course.at - shift * session.step, session.torque_course.integral)
    moved = replace(
        session,
        torque=_moved(session.torque, -shift),
        used=_moved_mask(session.used, -shift) & session.used,
        torque_course=course,
    )
    return moved, f"{session.name}: the torque's clock is {shift:+d} s off against the speed's; moved by that"


def check_torque(sessions: Sequence[Session], expected: Sequence[Array]) -> None:
    """Refuse a torque whose sign or unit is plainly wrong.

    Raises
    ------
    InputError
        With the remedy.
    """
    m = np.concatenate([s.torque[s.used] for s in sessions])
    e = np.concatenate([x[s.used] for x, s in zip(expected, sessions, strict=True)])
    names = ", ".join(s.name for s in sessions)
    if np.ptp(m) == 0.0:
        raise InputError(f"{names}: torque", f"always {m[0]:g} Nm", "a torque that changes; is the sensor connected?")
    slope, r = float(m @ e / (e @ e)), float(np.corrcoef(m, e)[0, 1])
    if r < -SURE or (slope < 0.0 and abs(m.mean()) > 0.3 * abs(e.mean())):
        raise InputError(
            f"{names}: torque", f"falls where {slope:.2g} of the expected torque rises (correlation {r:.2f})",
            "a torque that is positive where it drives forward", "give it a scale of -1 in the topics file",
        )  # fmt: skip
    if KILO[0] < abs(slope) < KILO[1]:
        raise InputError(
            f"{names}: torque", f"about {slope:.1e} of the expected", "a torque in Nm", "if it is in kNm, give it a scale of 1000"
        )
    if 1.0 / KILO[1] < abs(slope) < 1.0 / KILO[0]:
        raise InputError(
            f"{names}: torque",
            f"about {slope:.0f} times the expected",
            "a torque in Nm",
            "if it is in mNm, give it a scale of 0.001",
        )
    if not 0.05 < slope < 20.0:
        raise InputError(
            f"{names}: torque", f"about {slope:.2g} of the expected", "the torque at the sprockets, whole vehicle",
            "multiply a motor torque by its ratio, and one side by two, with scale in the topics file",
        )  # fmt: skip


def unlike(sessions: Sequence[Session], expected: Sequence[Array]) -> list[str]:
    """What to say of recordings whose torque is in another proportion to the expected one than that of the others."""
    used = [(s.torque[s.used], e[s.used]) for s, e in zip(sessions, expected, strict=True)]
    shares = [float(m @ e) / max(float(e @ e), 1e-12) for m, e in used]
    middle = float(np.median(shares)) if len(shares) > 2 else max(shares)
    return [
        f"{s.name}: its torque is {share:.2g} of the expected one, of other recordings {middle:.2g}: is it of the same vehicle?"
        for s, share in zip(sessions, shares, strict=True)
        if s.used.sum() > 60 and not 1.0 / UNLIKE < share / middle < UNLIKE
    ]


def _correlation(a: Array, b: Array, used: NDArray[np.bool_]) -> float:
    if used.sum() < 30 or np.ptp(a[used]) == 0.0 or np.ptp(b[used]) == 0.0:
        return 0.0
    return float(np.corrcoef(a[used], b[used])[0, 1])


def _moved(series: Array, steps: int) -> Array:
    """The series earlier (negative) or later by steps; what is not known repeats the edge."""
    if steps == 0:
        return series
    edge = np.full(abs(steps), series[0 if steps > 0 else -1])
    return np.concatenate((edge, series[:-steps]) if steps > 0 else (series[-steps:], edge))


def _moved_mask(used: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """The same of a mask; what is not known is not used."""
    if steps == 0:
        return used
    edge = np.zeros(abs(steps), dtype=bool)
    return np.concatenate((edge, used[:-steps]) if steps > 0 else (used[-steps:], edge))

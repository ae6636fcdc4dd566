# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 0, second half: checks units, signs and clocks of the torque against the vehicle file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.notes import SensorFinding
from trackres_ros.diagnosis.prepare.refuse import Refusal, each_usable
from trackres_ros.diagnosis.prepare.session import Array, Cumulative, DriveSession, Mask
from trackres_ros.diagnosis.prepare.settings import SLOWEST_MPS, GateSettings
from trackres_ros.errors import InputError
from trackres_ros.recording.roles import Conversion
from trackres_ros.recording.topics_files import line_to_write
from trackres_ros.units import KMH_PER_MPS, MAD_TO_STD

SURE = 0.5  # correlation for a certain wrong sign or unit
HEALTHY = (0.62, 1.7)  # of the inertia: covers a gear loss of a quarter, rotating parts and a sensor gain together
FAR_OFF = (0.05, 20.0)  # of the total, where inertia does not show
ONE_WAY = 0.1  # of the energy that flows either way: a smaller balance has no certain sign
TAKEN_BACK = 0.3  # of the expected energy: so much with the other sign is no offset of the sensor
NEAR = 1.35  # either way of a factor
ROBUST_TURNS, OUTLIER = 5, 2.0
LARGEST_SHIFT_S = 30
FEWEST_COMPARED = 30  # steps, for a correlation; at least the largest shift
LEAST_SHIFT_S = 2
SMALL_ERROR = 0.2  # of the torque
UNLIKE = 1.8  # times the torque: more than load, ground and weather change between two drives of one vehicle
CLEARLY_BETTER = 0.05  # in correlation


def aligned_clock(session: DriveSession, expected: Array) -> tuple[DriveSession, str]:
    """The session with its torque shifted to the best correlation with the speed, and a note.

    Shifts only by whole steps from `LEAST_SHIFT_S` on: a shorter delay is physical, or a sensor's. Both halves must agree: on
    hills without a recorded slope, a smooth drive correlates best at another time by chance. And none with the other sign may
    correlate as well where it is: a motion to and fro then fits half a period later.
    """
    if session.used.sum() < FEWEST_COMPARED:
        return session, ""
    shifts = range(-LARGEST_SHIFT_S, LARGEST_SHIFT_S + 1)
    used = {s: _moved(session.used, -s, unknown=False) & session.used for s in shifts}
    first = np.cumsum(session.used) <= 0.5 * session.used.sum()

    def there(part: Mask) -> list[float]:
        return [_correlation(_moved(session.torque, -s), expected, session.speed, used[s] & part) for s in shifts]

    whole = there(session.used)
    best = int(np.argmax(whole))
    shift, gain = shifts[best], whole[best] - abs(whole[LARGEST_SHIFT_S])
    if abs(shift) < LEAST_SHIFT_S or gain < CLEARLY_BETTER or whole[best] < SURE:
        return session, ""
    if any(abs(int(np.argmax(there(half))) - best) > LEAST_SHIFT_S for half in (first, ~first)):
        return session, ""
    course = session.torque_course and Cumulative(session.torque_course.at - shift * session.step, session.torque_course.integral)
    moved = replace(session, torque=_moved(session.torque, -shift), used=used[shift], torque_course=course)
    return moved, f"{session.name}: the torque's clock differs from the speed's by {shift * session.step:+g} s; corrected"


def check_torque(
    sessions: Sequence[DriveSession], expected: Sequence[Array], resisting: Sequence[Array], known: GateSettings
) -> list[str]:
    """Refuse a torque with a plainly wrong sign or unit, or of a part, with the remedy; warn where that is in doubt.

    `expected` is the torque of each session from the vehicle file [Nm], and `resisting` the same without inertia. The resistance
    may be several times the data sheet's. The inertia may not, because the mass is known. So the torque is compared with the
    inertia torque where that shows; for a machine beside any offset and friction.
    """
    used = [s.used for s in sessions]
    m, e, r, v = (
        np.concatenate([x[u] for x, u in zip(of, used, strict=True)])
        for of in ([s.torque for s in sessions], expected, resisting, [s.speed for s in sessions])
    )
    where = f"{', '.join(s.name for s in sessions)}: torque"
    if np.ptp(m) == 0.0:
        raise InputError(where, f"always {m[0]:g} Nm", "a torque that changes; is the sensor connected?")
    if not e.any():
        raise InputError(f"{where} of the model", "always 0", "a torque that depends on speed or acceleration")
    # A vehicle that only speeds up hardly separates an offset from its inertia; its resistance has the friction anyway.
    others = r[:, np.newaxis] if known.is_vehicle else np.stack([r, np.ones(len(r)), np.sign(v)], axis=1)
    inertia = _inertia(m, e - r, others)
    notes = _sign_notes(where, (m, e, v), inertia, sessions, known)
    low, high = HEALTHY[0] * known.torque_share[0], HEALTHY[1] * known.torque_share[1]
    allowed = "the torque of the whole vehicle at sprockets or wheels, in Nm" if known.is_vehicle else "the torque of the model"
    if not (inertia.least <= high and inertia.most >= low):
        share = float(np.sqrt(inertia.least * inertia.most))
        given = f"about {share:.2g} times the expected torque, by the speed's changes"
        if inertia.alike >= SURE:
            raise InputError(where, given, allowed, _remedy(share, sessions, known))
        notes.append(_doubt(where, given, _remedy(share, sessions, known)))
    slope, size = float(m @ e / (e @ e)), float(np.sqrt((m @ m) / (e @ e)))
    least, most = FAR_OFF[0] * known.torque_share[0], FAR_OFF[1] * known.torque_share[1]
    if size <= least or size > most + known.friction / float(np.sqrt(np.mean(e**2))):
        raise InputError(where, f"about {size:.2g} times the expected torque", allowed, _remedy(size, sessions, known))
    if not least < abs(slope) < most:
        notes.append(_doubt(where, f"about {slope:.2g} times the expected torque", _remedy(abs(slope), sessions, known)))
    return notes


def _doubt(where: str, given: str, remedy: str) -> str:
    return SensorFinding(f"{where}: {given}, unless the model lacks much; {remedy}", f"The torque is {given}")


def _sign_notes(
    where: str, series: tuple[Array, Array, Array], inertia: _Inertia, sessions: Sequence[DriveSession], known: GateSettings
) -> list[str]:
    """Refuse a torque whose sign the energy contradicts; warn where only the torque's course does.

    What moves takes energy from its motor, over a drive as a whole. On hills without a recorded slope the torque may
    nevertheless fall where a rise is expected: uphill one pushes harder, and goes slower. `series` are measured and expected
    torque [Nm] and speed, of shape (n,).
    """
    m, e, v = series
    work = float(e @ v)
    energy = float(m @ v) / work if abs(work) > ONE_WAY * float(np.abs(e * v).sum()) else 0.0
    alike = float(np.corrcoef(m, e)[0, 1]) if np.ptp(e) > 0.0 else 0.0
    back = energy < -TAKEN_BACK
    if not (back or alike < -SURE):
        return []
    line = line_to_write("torque", Conversion(-1.0), *(s.bindings for s in sessions))
    of_energy = f"{energy:.2g} times the expected energy" if energy else "an energy of no certain sign"
    given = f"{of_energy}, and a correlation of {alike:.2f} with the expected torque"
    against = inertia.alike < SURE if back else not energy and inertia.alike < -SURE
    if against:
        motion = "driving forward" if known.is_vehicle else "moving forward"
        raise InputError(where, given, f"a torque that is positive when {motion}", line)
    lacks = "a slope that is not recorded" if known.is_vehicle else "something that the model lacks"
    sure = "its sign is right by the energy" if energy > 0.0 else f"if the sign is wrong, {line}"
    says = f"The torque has a correlation of {alike:.2f} with the expected torque: {lacks} may do this"
    return [SensorFinding(f"{where}: {given}: {lacks} may do this; {sure}", says)]


def faulty_torques(
    sessions: Sequence[DriveSession], expected: Sequence[Array], resisting: Sequence[Array], known: GateSettings
) -> list[Refusal]:
    """Sessions that `check_torque` refuses one by one; none if it refuses all of them."""
    refused: list[Refusal] = []

    def check(one: tuple[DriveSession, Array, Array]) -> None:
        session, its, without_inertia = one
        check_torque([session], [its], [without_inertia], known)

    passed = each_usable(zip(sessions, expected, resisting, strict=True), check, refused, lambda one: one[0].name)
    return refused if passed else []


@dataclass(frozen=True)
class _Inertia:
    """Bounds of measured over expected inertia torque, as errors of the speed hide a part of it; and their correlation.

    The lower bound assumes an exact inertia, the upper bound an exact torque.
    """

    least: float
    most: float
    alike: float


def _inertia(measured: Array, inertia: Array, others: Array) -> _Inertia:
    """The share of the inertia, robustly, beside `others`: resistance, or that, offset and friction, shape (n, k)."""
    weight, columns = np.ones(len(measured)), np.column_stack([inertia, others])
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-300)

    def without(x: Array, of: Array) -> Array:
        root = np.sqrt(weight)
        return np.asarray(x - of @ np.linalg.lstsq(of * root[:, np.newaxis], x * root, rcond=None)[0])

    for _ in range(ROBUST_TURNS):
        left = without(measured, columns)
        scale = MAD_TO_STD * float(np.median(np.abs(left))) or 1.0
        weight = np.minimum(1.0, OUTLIER * scale / np.maximum(np.abs(left), 1e-12))
    x, y = without(inertia, columns[:, 1:]), without(measured, columns[:, 1:])
    both, alone, whole = (float((weight * a) @ b) for a, b in ((x, y), (x, x), (y, y)))
    alike = both / np.sqrt(alone * whole) if alone > 0.0 and whole > 0.0 else 0.0
    return _Inertia(both / alone, whole / both, alike) if alone > 0.0 and both > 0.0 else _Inertia(0.0, np.inf, alike)


def _remedy(share: float, sessions: Sequence[DriveSession], known: GateSettings) -> str:
    """Possible causes of this ratio to the expected torque, and the line for the topics file."""
    whats = {"in kNm": 1e3, "in mNm": 1e-3}
    if known.is_vehicle:
        whats |= {"counted twice": 0.5} | {f"one of {n}": float(n) for n in (2, 3, 4)}
    if known.motor_ratio:
        whats["of the motor"] = known.motor_ratio
    fitting = [what for what, factor in whats.items() if 1.0 / NEAR < share * factor < NEAR]
    nearest = min(fitting, key=lambda what: abs(np.log(share * whats[what])), default="")
    said, each = [], [s.bindings for s in sessions]
    fastest = max(float(np.percentile(np.abs(s.speed), 99.0)) for s in sessions)
    if 1.0 / NEAR < share * KMH_PER_MPS < NEAR and fastest > KMH_PER_MPS * SLOWEST_MPS:
        said.append(f"if the speed is in km/h, {line_to_write('speed', Conversion(1.0 / KMH_PER_MPS), *each)}")
    if nearest:
        said.append(f"if it is {nearest}, {line_to_write('torque', Conversion(whats[nearest]), *each)}")
    elif known.is_vehicle:
        said.append("with scale in the topics file, multiply a motor torque by its gear ratio and the torque of one side by two")
    else:
        said.append("scale in the topics file converts a unit; if the model is off, widen the ranges of its parameters")
    return "; ".join(said)


LOOK_AT = "check units, signs and that torque, speed and load belong to the whole vehicle; check the vehicle file"


def nothing_to_conclude(
    names: str, r2: Mapping[str, float], mae: Mapping[str, float], size: float, notes: Sequence[str] = ()
) -> InputError | None:
    """The error if no stage of the model predicts the torque of hold-out laps better than its mean, by R2 and mean error [Nm].

    A steady drive's torque hardly varies, so R2 means nothing if the error is small relative to `size`, the mean torque [Nm].
    """
    best = max(r2, key=lambda stage: r2[stage])
    if r2[best] >= 0.0 or min(mae.values()) < SMALL_ERROR * size:
        return None
    return InputError(
        f"{names}: torque",
        f"R2 {r2[best]:.2f} on hold-out laps, with a mean error of {mae[best]:.3g} Nm at a mean torque of {size:.3g} Nm",
        "a torque that depends on speed and load; without it no conclusion is possible",
        "; ".join((*notes, LOOK_AT)),
    )


def inconsistent_scale_notes(sessions: Sequence[DriveSession], expected: Sequence[Array], is_vehicle: bool) -> list[str]:
    """Notes on recordings whose ratio of measured to expected torque differs from the others."""
    used = [(s.torque[s.used], e[s.used]) for s, e in zip(sessions, expected, strict=True)]
    shares = [float(m @ e) / max(float(e @ e), 1e-12) for m, e in used]
    middle = float(np.median(shares)) if len(shares) > 2 else max(shares)
    return [
        SensorFinding(
            f"{s.name}: its torque is {share:.2g} times the expected one, but {middle:.2g} times in other recordings: is it the "
            f"same {'vehicle' if is_vehicle else 'machine'}?",
            f"The torque of {s.name} is {share:.2g} times the expected one, but {middle:.2g} times in other recordings",
        )
        for s, share in zip(sessions, shares, strict=True)
        if s.used.sum() > 60 and not 1.0 / UNLIKE < share / middle < UNLIKE
    ]


def _correlation(a: Array, b: Array, speed: Array, used: Mask) -> float:
    """Correlation of two torques beside any offset and friction, thus less their means forward and in reverse."""
    if used.sum() < FEWEST_COMPARED:
        return 0.0
    x, y, forward = a[used], b[used], speed[used] > 0.0
    for side in (forward, ~forward):
        if side.any():
            x[side] -= x[side].mean()
            y[side] -= y[side].mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 1e-12 * float(np.sqrt((a[used] @ a[used]) * (b[used] @ b[used]))) else 0.0


def _moved(series: NDArray[Any], steps: int, unknown: Any = None) -> NDArray[Any]:
    """The series shifted by steps, earlier if negative; where that is unknown, it repeats the edge, or has the given value."""
    if steps == 0:
        return series
    edge = np.full(abs(steps), series[0 if steps > 0 else -1] if unknown is None else unknown)
    return np.concatenate((edge, series[:-steps]) if steps > 0 else (series[-steps:], edge))

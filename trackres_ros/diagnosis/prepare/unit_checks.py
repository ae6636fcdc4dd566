# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Step 0, first half: checks the units of all channels but the torque against plausible values of vehicle and weather."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trackres_ros.diagnosis.prepare.notes import SensorFinding
from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.diagnosis.prepare.settings import GateSettings
from trackres_ros.effects.sensor.speed_scale import SpeedScale
from trackres_ros.errors import InputError
from trackres_ros.estimator.constants import PLAUSIBLE
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import ROLES, UNITS, Conversion, base_role
from trackres_ros.recording.topics_files import line_to_write
from trackres_ros.text.numbers import some_of
from trackres_ros.units import GRAVITY

HOTTEST_AIR_DEGC = 50.0  # as a median of hours; the record of a moment in the shade is 57
UNUSUAL_AIR_DEGC = 40.0
WEIGHTS = (0.3, 2.5)  # over that of the vehicle file: range for a lighter or loaded vehicle
USUAL_WEIGHTS = (0.6, 1.7)
AROUND = 1.7  # either way of a unit's factor
FASTEST_TURN, STEEPEST = PLAUSIBLE["yaw_rate"][1], PLAUSIBLE["grade"][1]
SPEED_OFF = 0.01  # against the recorded distance
RELATED = 0.8  # correlation from which the ratio of two series is due to units
FEWEST = 30


def check_units(recording: Recording, known: GateSettings) -> list[str]:
    """Refuse values in a wrong unit, with the line for the topics file; note unusual ones. `known` are facts of the vehicle."""
    said, bindings = [], recording.bindings
    for role, samples in recording.series.items():
        value = samples.value[np.isfinite(samples.value)]
        if not len(value):
            continue
        where, base = f"{recording.name}: {role}", base_role(role)
        middle, most = float(np.median(value)), float(np.percentile(np.abs(value), 95.0))
        if base in ("ambient", "belt"):
            said += _temperature(where, role, middle, bindings)
        elif base == "yaw_rate" and most > FASTEST_TURN:
            _refuse(where, f"{most:.3g} rad/s", f"at most {FASTEST_TURN:g}", "deg/s", role, bindings)
        elif base == "grade" and most > STEEPEST:
            allowed = f"rise over run, at most {STEEPEST:g}"
            _refuse(where, f"slopes of {most:.3g}", allowed, "%", role, bindings)
        elif base == "heading" and _turns_by(value, 360.0) and not _turns_by(value, 2.0 * np.pi):
            _refuse(where, "jumps of 360", "an angle in rad", "deg", role, bindings)
    said += _weight(recording, known)
    return said


def check_speed_unit(
    name: str,
    bindings: Mapping[str, TopicBinding],
    speed: Array,
    accel: Array,
    recorded_accel: Array | None,
    distance: Array | None,
) -> list[str]:
    """Refuse a speed that recorded acceleration or distance show is not in m/s; a note on a small deviation from the distance.

    `speed` is the mean of each step [m/s] and `accel` its change [m/s^2], shape (n,). Recorded are accelerations [m/s^2], and the
    distance of each step [m], or None.
    """
    if recorded_accel is not None:
        ratio = _ratio(recorded_accel, accel)
        for unit, (factor, _) in _others("speed").items():
            if ratio and 1.0 / AROUND**0.5 < ratio / factor < AROUND**0.5:
                given = f"changes {1.0 / ratio:.2g} times as fast as the recorded acceleration says"
                _refuse(f"{name}: speed", given, "a speed in m/s", unit, "speed", bindings)
        if ratio and GRAVITY / AROUND**0.5 < 1.0 / ratio < GRAVITY * AROUND**0.5:
            given = f"{ratio:.2g} times the acceleration from the speed"
            _refuse(f"{name}: accel", given, "an acceleration in m/s2", "g", "accel", bindings)
    ratio = _ratio(distance, speed) if distance is not None else 0.0
    if ratio:
        for unit, (factor, _) in _others("speed").items():
            if 0.9 < ratio / factor < 1.1:
                given = f"{1.0 / ratio:.2f} times as fast as the recorded distance grows"
                _refuse(f"{name}: speed", given, "a speed in m/s", unit, "speed", bindings)
        if 0.9 < 1e3 * ratio < 1.1:
            _refuse(f"{name}: distance", f"{ratio:.2g} times the distance from the speed", "metres", "km", "distance", bindings)
        if abs(1.0 / ratio - 1.0) > SPEED_OFF:
            return [speed_off({name: ratio - 1.0})]
    return []


def speed_off(errors: Mapping[str, float]) -> SensorFinding:
    """A speed that the recorded distance contradicts: true over measured speed, minus one, of each recording."""
    value = float(np.median(list(errors.values())))
    off = 1.0 / (1.0 + value) - 1.0
    says = f"the speed is {100.0 * abs(off):.1f} % {'more' if off > 0.0 else 'less'} than the recorded distance implies"
    return SensorFinding(f"{some_of(list(errors), 2)}: {says}: one of them is wrong", f"T{says[1:]}", SpeedScale.name, value)


def pooled(notes: Sequence[str]) -> list[str]:
    """Notes with one finding for all recordings whose speed is off to the same side."""
    found: dict[bool, dict[str, float]] = {}
    for note in notes:
        if isinstance(note, SensorFinding) and note.effect == SpeedScale.name:
            found.setdefault(note.value > 0.0, {})[note.partition(": ")[0]] = note.value
    others = [note for note in notes if not (isinstance(note, SensorFinding) and note.effect == SpeedScale.name)]
    return [*map(speed_off, found.values()), *others]


def _others(role: str) -> dict[str, Conversion]:
    """Conversions from the other units of a role."""
    inside = ROLES[base_role(role)].unit
    return {unit: one for unit, one in UNITS[inside].items() if unit != inside}


def _refuse(where: str, given: str, allowed: str, unit: str, role: str, bindings: Mapping[str, TopicBinding]) -> None:
    raise InputError(where, given, allowed, f"if it is in {unit}, {line_to_write(role, _others(role)[unit], bindings)}")


def _temperature(where: str, role: str, middle: float, bindings: Mapping[str, TopicBinding]) -> list[str]:
    low, hottest = PLAUSIBLE["ambient"][0], HOTTEST_AIR_DEGC if base_role(role) == "ambient" else PLAUSIBLE["belt"][1]
    for unit, (scale, offset) in _others(role).items():
        if low <= scale * middle + offset <= hottest < middle:
            _refuse(where, f"{middle:.4g} degC (median)", f"{low:g} to {hottest:g} degC", unit, role, bindings)
    if not low <= middle <= hottest:
        raise InputError(where, f"{middle:.4g} degC (median)", f"{low:g} to {hottest:g} degC", "is the sensor connected?")
    if base_role(role) == "ambient" and middle > UNUSUAL_AIR_DEGC:
        line = line_to_write(role, _others(role)["degF"], bindings)
        says = f"air of {middle:.0f} degC is unusual"
        return [SensorFinding(f"{where}: {says}; if it is in degF, {line}", says.capitalize())]
    return []


def _weight(recording: Recording, known: GateSettings) -> list[str]:
    """Compare the recorded loads with the vehicle file's of the same parts."""
    finite = {role: s.value[np.isfinite(s.value)] for role, s in recording.series.items() if base_role(role) == "load"}
    loads = {role: np.array(np.median(value)) for role, value in finite.items() if len(value)}
    roles = ["load"] if "load" in loads else list(loads)
    if not roles:
        return []
    others = float(known.total_load({role: np.array(0.0) for role in loads}))  # nominal, of the parts without a load
    weight = known.weight - others
    share = (float(known.total_load(loads)) - others) / weight
    where, low, high = f"{recording.name}: {', '.join(roles)}", *WEIGHTS
    carrier = "the whole vehicle" if roles == ["load"] else "these parts"
    given = f"{share * weight:.4g} {ROLES['load'].unit}, {share:.2g} of the {weight:.4g} N of {carrier} in the vehicle file"
    if not low <= share <= high:
        for unit, other in _others("load").items():
            if 1.0 / AROUND < share * other.scale < AROUND:
                _refuse(where, given, f"{low:g} to {high:g} of it", unit, "load", recording.bindings)
        remedy = f"give the weight of {carrier}; for a payload, add the empty weight as offset in the topics file"
        raise InputError(where, given, f"{low:g} to {high:g} of it", remedy)
    if not USUAL_WEIGHTS[0] <= share <= USUAL_WEIGHTS[1]:
        return [SensorFinding(f"{where}: {given}: is each part of the load recorded exactly once?", f"The load is {given}")]
    return []


def _turns_by(value: Array, whole: float) -> bool:
    """Whether an angle jumps by a whole turn, within a twentieth."""
    return bool((np.abs(np.abs(np.diff(value)) / whole - 1.0) < 0.05).any())


def _ratio(a: Array, b: Array) -> float:
    """Ratio of a to b, or 0 without a sufficient correlation."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    if len(a) < FEWEST or not a.any() or not b.any():
        return 0.0
    alike = float(a @ b / np.sqrt((a @ a) * (b @ b)))
    return float(a @ b / (b @ b)) / alike if alike > RELATED else 0.0

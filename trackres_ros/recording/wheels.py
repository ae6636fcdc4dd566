# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compares recorded wheel speeds with the vehicle speed: rolling radius and slip under torque."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trackres_ros.recording.roles import base_role
from trackres_ros.recording.samples import FloatArray

SLOWEST_MPS = 2.0  # below it pulses of a wheel come too slowly
STRAIGHT_RAD = 0.05  # of steering: wheels at the outside of a turn have a longer way
STRAIGHT_RADPS = 0.03  # of turning, without a recorded steering
PIECES, FEWEST_EACH = 8, 30
SURE = 3.0  # standard deviations
KNM = 1e3  # Nm


@dataclass(frozen=True, slots=True)
class Wheel:
    """One wheel against the vehicle."""

    name: str  # as in the role
    # its speed over that of the vehicle without torque, and its standard deviation: the wheel rolls on its nominal radius over
    # the ratio
    ratio: float
    ratio_std: float
    # relative excess of its speed over the vehicle's, per kNm of torque on all wheels; nan without a recorded torque
    slip: float
    slip_std: float


def wheels(held: Mapping[str, FloatArray]) -> tuple[Wheel, ...]:
    """Wheel ratios and slips of a recording, if it drives straight for long enough.

    `held`: roles on the samples of the speed, from `Recording.aligned`.

    Notes
    -----
    The speed v_w of a wheel is fitted by r v + k v T + tau a by least squares. These are the ratio r, the slip k by torque T, and
    the delay tau between the two speeds with acceleration a, which would otherwise look like slip. Standard deviations
    are those between consecutive pieces of the recording.
    """
    time, speed = held["time_s"], held["speed"]
    roles = [role for role in held if base_role(role) == "wheel_speed"]
    if not roles or len(time) < PIECES * FEWEST_EACH:
        return ()
    step = np.gradient(time)
    usable = np.isfinite(speed) & (np.abs(speed) > SLOWEST_MPS) & (step > 0.0)
    if "steering_angle" in held:
        usable &= np.abs(held["steering_angle"]) < STRAIGHT_RAD
    elif "yaw_rate" in held:
        usable &= np.abs(held["yaw_rate"]) < STRAIGHT_RADPS
    accel = np.gradient(speed) / np.where(step > 0.0, step, np.nan)
    columns = [speed, accel]
    if "torque" in held and np.nanmax(np.abs(held["torque"]), initial=0.0) > 0.0:
        columns.append(speed * held["torque"] / KNM)
        usable &= np.isfinite(held["torque"])
    return tuple(
        wheel
        for role in roles
        if (wheel := _fitted(role.partition("/")[2] or role, np.stack(columns, axis=1), held[role], usable)) is not None
    )


def _fitted(name: str, columns: FloatArray, rim: FloatArray, usable: np.ndarray) -> Wheel | None:
    rows = np.flatnonzero(usable & np.isfinite(rim) & np.isfinite(columns).all(axis=1))
    pieces = [piece for piece in np.array_split(rows, PIECES) if len(piece) >= FEWEST_EACH]
    if len(pieces) < PIECES:
        return None
    found = np.linalg.lstsq(columns[rows], rim[rows], rcond=None)[0]
    each = np.array([np.linalg.lstsq(columns[piece], rim[piece], rcond=None)[0] for piece in pieces])
    std = np.std(each, axis=0, ddof=1) / np.sqrt(len(pieces))
    slip, slip_std = (float(found[2]), float(std[2])) if len(found) > 2 else (np.nan, np.nan)
    return Wheel(name, float(found[0]), float(std[0]), slip, slip_std)


def driven(found: Sequence[Wheel]) -> dict[str, tuple[float, float]]:
    """Wheels that surely turn faster under torque than the one with the least slip, by how much per kNm, and its std.

    That one rolls freely, or slips least: the vehicle's own speed may be that of the driven wheels.
    """
    if any(np.isnan(wheel.slip) for wheel in found):
        return {}
    free = min(found, key=lambda wheel: wheel.slip)
    more = {wheel.name: (wheel.slip - free.slip, float(np.hypot(wheel.slip_std, free.slip_std))) for wheel in found}
    return {name: (slip, std) for name, (slip, std) in more.items() if slip > SURE * std}


def wheel_notes(held: Mapping[str, FloatArray]) -> list[str]:
    """Radii and slip of the wheels, a sentence each; empty if none is recorded for long enough."""
    found = wheels(held)
    if not found:
        return []
    ratios = ", ".join(f"{wheel.name} {wheel.ratio:.4f} +- {wheel.ratio_std:.4f}" for wheel in found)
    notes = [f"wheel speed over vehicle speed, straight on without torque (divide each radius by it): {ratios}"]
    slipping = driven(found)
    if slipping:
        listed = ", ".join(f"{name} {slip:.3%} +- {std:.3%}" for name, (slip, std) in slipping.items())
        free, most = min(found, key=lambda wheel: wheel.slip), max(slip for slip, _ in slipping.values())
        text = f"wheels that turn faster than {free.name} under torque, with their slip per kNm: {listed}"
        behind = free.slip < -0.5 * most  # its speed is closer to that of the slipping wheels
        notes.append(f"{text}; the vehicle's speed has the same slip" if behind else text)
    return notes

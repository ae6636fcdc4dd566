# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Wheel speeds against the vehicle's: radii and slip that were put in come out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from trackres_ros.recording.recording import driven_wheels, wheel_notes, wheels

RATIOS = {"front": 0.97, "rear": 1.02}
SLIP = 0.004  # of the speed for each kNm


def drive(
    of_vehicle: str, slip: float = SLIP, seconds: int = 3000, noise: float = 0.01, delay: float = 0.2
) -> dict[str, np.ndarray]:
    """Roles on the samples of the speed: the rear is driven; the vehicle's speed is that of the front, or of the rear."""
    rng, time = np.random.default_rng(1), np.arange(float(seconds))
    accel = 0.6 * np.sin(2.0 * np.pi * time / 40.0)
    true = 8.0 + np.cumsum(accel)
    torque = 1.2 * accel + 0.5 + 0.8 * np.sin(2.0 * np.pi * time / 333.0)  # kNm, and a hill
    rear = true * (1.0 + slip * torque)
    shown = {"front": true, "rear": rear}[of_vehicle]
    late = {"front": true - delay * accel, "rear": rear - delay * accel}
    held = {f"wheel_speed/{name}": RATIOS[name] * v + rng.normal(0.0, noise, seconds) for name, v in late.items()}
    return {"time_s": time, "speed": shown, "torque": 1e3 * torque, **held}


@pytest.mark.parametrize("of_vehicle", ["front", "rear"])
@pytest.mark.parametrize("given", [np.asarray, lambda values: np.tile(values, 2), lambda values: np.repeat(values, 3)])
def test_radii_and_slip_are_found_whichever_wheels_give_speed(of_vehicle: str, given: Callable[..., np.ndarray]) -> None:
    """Of a drive recorded once, twice in one recording, and with each sample three times."""
    held = {role: given(values) for role, values in drive(of_vehicle).items()}
    for wheel in wheels(held):
        assert wheel.ratio == pytest.approx(RATIOS[wheel.name], abs=4.0 * wheel.ratio_std + 2e-4)
        assert wheel.ratio_std < 1e-3
    (result,) = driven_wheels(wheels(held)).items()
    name, (slip, std) = result
    assert name == "rear"
    assert slip == pytest.approx(SLIP, abs=4.0 * std + 0.03 * SLIP)
    assert ("has the same slip" in wheel_notes(held)[1]) == (of_vehicle == "rear")


def test_a_delay_is_no_slip() -> None:
    held = drive("front", slip=0.0)
    assert not driven_wheels(wheels(held))
    assert len(wheel_notes(held)) == 1


def test_turns_and_short_recordings_say_nothing() -> None:
    held = drive("front")
    assert not wheels(held | {"steering_angle": np.full(3000, 0.3)})
    assert not wheels({role: value[:100] for role, value in held.items()})
    assert not wheel_notes({role: value for role, value in held.items() if not role.startswith("wheel")})


def test_without_a_torque_there_are_radii_alone() -> None:
    held = drive("front")
    del held["torque"]
    assert {wheel.name: round(wheel.ratio, 2) for wheel in wheels(held)} == RATIOS
    assert not driven_wheels(wheels(held))

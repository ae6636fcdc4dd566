# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Facts of a vehicle for the preparation of recordings, and the common time step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.recording.roles import PASSENGER_KG

STEP_S = 1.0  # mean torque over a step against its change of speed: exact for any course within
LEAST_SAMPLES = 5  # in a step: with fewer, sampling affects the change of speed and the mean torque as much as the drive does
SLOWEST_MPS, SLOWEST_SHARE = 0.3, 0.1  # of the greatest speed; below both friction may be static


def pace(step: float) -> float:
    """Time scale of a recording over that of a drive: 1, or less for a quick machine with steps of less than `STEP_S`.

    It scales the built-in times of the diagnosis (length of a piece, of a long gap).
    """
    return min(1.0, step / STEP_S)


class LiveFilter(NamedTuple):
    """Settings of the live filter of the acceleration that fit a recording's speeds, named as in the estimator's `Settings`."""

    speed_std_mps: float
    acceleration_std: float
    acceleration_time_s: float


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Facts of a vehicle for the checks of its recordings."""

    weight: float  # [N], for recordings without it
    max_speed: float  # [m/s]
    ambient: float  # [degC], for recordings without it
    friction_brakes: bool | None  # whether they may add to a braking torque, if not recorded; None for a vehicle without
    belt_shows_surface: bool = False  # whether a measured belt temperature is that of the surface, as from infrared
    motor_ratio: float | None = None  # motor turns per sprocket turn; None if not in the file
    torque_scale: float = 1.0  # shown over true torque: sessions have the true one [Nm]
    torque_share: tuple[float, float] = (1.0, 1.0)  # limits of true over expected torque, by the ranges of the file
    passenger_kg: float = PASSENGER_KG  # of one passenger
    track_width: float | None = None  # distance of left from right wheels [m]; None if not in the file
    has_belt: bool = False  # whether notes on belts apply
    is_vehicle: bool = True  # whether words and times of vehicles apply; else a slide, or a model of the user's own
    friction: float = 0.0  # torque that an offset and friction which the model lacks may reach [Nm]
    axles: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # by axle, nominal loads of its assemblies [N]

    def total_load(self, known: Mapping[str, Array], payload: Array | float = 0.0) -> Array:
        """Load of the whole vehicle [N], from loads of it, of axles or of assemblies by role, alike in shape, at least one.

        Where that of an axle or assembly is unknown, it is the nominal one with its share of a counted payload [N].
        """
        loaded = 1.0 + payload / self.weight
        if "load" in known:
            return known["load"]
        if not known.keys() <= {f"load/{name}" for axle, of in self.axles.items() for name in (axle, *of)}:
            return np.asarray(np.sum(list(known.values()), axis=0))
        unknown = np.full_like(next(iter(known.values())), np.nan)
        total = np.zeros_like(unknown)
        for axle, nominal in self.axles.items():
            own, *each = (known.get(f"load/{name}", unknown) for name in (axle, *nominal))
            whole = np.sum(
                [np.where(np.isfinite(x), x, load * loaded) for x, load in zip(each, nominal.values(), strict=True)], axis=0
            )
            total += np.where(np.isfinite(own), own, whole)
        return total

    @property
    def slowest(self) -> float:
        """Speed below which friction may be static [m/s]."""
        return min(SLOWEST_MPS, SLOWEST_SHARE * self.max_speed)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Road load as a base: a rolling coefficient, air, inertia, a known slope; for a chassis on tyres and other vehicles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis.base.base import Acting, BaseParameter, Values
from trackres_ros.diagnosis.base.simulated import FileBase, simulate_sessions
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.effects.effect import Active
from trackres_ros.effects.sensor.delay import Delay
from trackres_ros.effects.sensor.torque_gain import TorqueGain
from trackres_ros.effects.sensor.torque_offset import TorqueOffset
from trackres_ros.effects.vehicle.rotating_inertia import RotatingInertia
from trackres_ros.estimator.constants import make_constants
from trackres_ros.estimator.settings import Settings
from trackres_ros.units import GRAVITY
from trackres_ros.vehicle import RoadVehicle
from trackres_ros.vehicle.road import OF_SLIDES, ROAD_LOAD, SECTION, built_in
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import write_road_vehicle

FITTED = (
    "rolling_coefficient", "rolling_rise", "drag_area", "mass",
    "rotating_mass_factor", "torque_scale", "efficiency", "torque_delay",
)  # fmt: skip
"""Re-fitted parameters, if their range has a width; also sliding friction and an offset, if the file has them."""
TORQUE_OFFSET = TorqueOffset.name
DELAY, OFFSET = Delay(), TorqueOffset()
ONLY_ONE_OF = ("mass", "torque_scale")
"""Both scale nearly all terms, and only their product is identifiable. One is re-fitted if the file fixes the other with a
range of zero width. With both free, a robot's scale fell to half to a tenth of its value: speed errors hide inertia.
Its turning friction went to its bound. A car's mean error on hold-out laps fell by 0.2 of 60 Nm.
"""


class RoadBase(FileBase):
    """Base model `road_load`; see `base.Base`."""

    name = "road_load"
    vehicle: RoadVehicle

    def __init__(self, vehicle: RoadVehicle) -> None:
        super().__init__(vehicle)
        self._active = (*vehicle.effects, *vehicle.surroundings)
        self._by_default = v = vehicle.values
        self.torque_scale, self.rotating_mass_factor = v["torque_scale"], v["rotating_mass_factor"]
        self.facts = vehicle.constants
        self._constants = make_constants(vehicle, Settings())
        self.parts = {"wheels": 2.0 * math.pi * v["wheel_radius"]}
        self.rolls = vehicle.rolls
        quantities = {name: vehicle.parameters[f"{SECTION}.{name}"] for name in (*FITTED, *OF_SLIDES, TORQUE_OFFSET) if name in v}
        free_names = [name for name, q in quantities.items() if q.standard_deviation > 0.0]
        if set(ONLY_ONE_OF) <= set(free_names):
            free_names = [name for name in free_names if name not in ONLY_ONE_OF]

        def parameter(name: str) -> BaseParameter:
            q, limit = quantities[name], ROAD_LOAD[name]
            return BaseParameter(name, limit.unit, v[name], q.standard_deviation, limit.low, limit.high, (q.low, q.high))

        self.parameters = tuple(map(parameter, free_names))
        effect_of_parameter = {"torque_scale": TorqueGain.name, "rotating_mass_factor": RotatingInertia.name}
        effects_refitted = (effect for parameter, effect in effect_of_parameter.items() if parameter in free_names)
        chain = (Delay.name, *(effect.name for effect, *_ in built_in(v)), *([TORQUE_OFFSET] if TORQUE_OFFSET in v else []))
        self.includes = (*chain, *effects_refitted, *(active.effect.name for active in self._active))

    def _shown_value(self, values: Values) -> float:
        return values["torque_scale"] / self.torque_scale

    def _own_effects(self, values: Values) -> Sequence[Active]:
        chain = [Active(effect, {q: arm * values[name]}) for effect, q, name, arm in built_in(values)]
        chain.append(Active(DELAY, {"time": values["torque_delay"]}))
        if TORQUE_OFFSET in values:
            chain.append(Active(OFFSET, {"offset": values[TORQUE_OFFSET]}))
        return (*chain, *self._active)

    def _simulate(self, sessions: Sequence[DriveSession], values: Values, acting_effects: Acting) -> list[Array]:
        number = self._constants.number._replace(
            bearing_friction=values["rolling_coefficient"],
            rolling_rise=values["rolling_rise"],
            drag_area=values["drag_area"],
            rotating_mass_factor=values["rotating_mass_factor"],
        )
        empty_weight = values["mass"] * GRAVITY
        sessions_with_load = [s if "load" in s.given else replace(s, weight=empty_weight + s.payload) for s in sessions]
        facts = self.facts._replace(weight=empty_weight, drag_area=values["drag_area"])
        return simulate_sessions(
            self._constants._replace(number=number), np.ones(1), 0, facts, sessions_with_load, acting_effects
        )

    def write(self, path: Path, file_changes: FileChanges, text: str) -> list[Path]:
        """See `base.Base`."""
        return write_road_vehicle(self.vehicle, path, file_changes, text)

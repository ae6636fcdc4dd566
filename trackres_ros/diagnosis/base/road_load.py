# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Road load as a base: a rolling coefficient, air, inertia, a known slope; for a chassis on tyres and other vehicles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.base import Acting, BaseParameter, Defaults, Predicted, Remembered, Values
from trackres_ros.diagnosis.prepare.session import Session, with_unseen
from trackres_ros.diagnosis.writing.kept import Kept
from trackres_ros.diagnosis.writing.vehicle_file import finish, opened, set_quantity
from trackres_ros.effects.effect import Active, VehicleConstants
from trackres_ros.effects.sensor.delay import Delay
from trackres_ros.effects.sensor.torque_gain import TorqueGain
from trackres_ros.effects.sensor.torque_offset import TorqueOffset
from trackres_ros.effects.stepping import DISTANCE, UNUSABLE, cooled, new_memory, new_work, rest_effects
from trackres_ros.effects.vehicle.coulomb_friction import CoulombFriction
from trackres_ros.effects.vehicle.drivetrain_efficiency import DrivetrainEfficiency
from trackres_ros.effects.vehicle.rotating_inertia import RotatingInertia
from trackres_ros.effects.vehicle.viscous_friction import ViscousFriction
from trackres_ros.errors import InputError
from trackres_ros.estimator.records import Series
from trackres_ros.estimator.road_series import RoadLoad, run_road_load
from trackres_ros.files.yamls import read_yaml
from trackres_ros.route.learned import RouteMap
from trackres_ros.units import GRAVITY, STANDSTILL_MPS
from trackres_ros.vehicle import Quantity
from trackres_ros.vehicle.loading import EFFECT_KEYS, listed_effects
from trackres_ros.vehicle.reading import Reader
from trackres_ros.vehicle.schema import Limits
from trackres_ros.vehicle.surroundings import load_route, load_surroundings

Array = NDArray[np.float64]

QUANTITIES = {
    "rolling_coefficient": Limits("1", 0.0, 0.5, "rolling resistance over weight"),
    "rolling_rise": Limits("s/m", -0.01, 0.05, "growth of the rolling coefficient with speed"),
    "drag_area": Limits("m^2", 0.0, 30.0, "drag coefficient times frontal area"),
    "air_density": Limits("kg/m^3", 0.3, 2.0, "air density"),
    "mass": Limits("kg", 0.5, 1e6, "mass with driver and load"),
    "rotating_mass_factor": Limits("1", 1.0, 3.0, "effective over true mass in acceleration"),
    "wheel_radius": Limits("m", 0.01, 3.0, "rolling radius of the driven wheels"),
    "torque_scale": Limits("1", 0.01, 100.0, "shown over true torque at the wheels, as of a motor constant"),
    "efficiency": Limits("1", 0.75, 1.0, "of the gears between the measured torque and the wheels"),
    "torque_delay": Limits("s", 0.0, 1.0, "by which the measured torque is late"),
    "contact_length": Limits("m", 0.01, 10.0, "length of the ground contact, or the wheelbase of a skid-steered vehicle"),
    "track_width": Limits("m", 0.02, 10.0, "distance of left from right wheels, as they turn it", optional=True),
    "max_speed": Limits("m/s", 0.1, 100.0, "greatest speed"),
    "ambient": Limits("degC", -60.0, 60.0, "ambient temperature where none is given"),
    "coulomb_friction": Limits("N", 0.0, 1e6, "friction of what slides, at any speed", optional=True),
    "viscous_friction": Limits("N s/m", 0.0, 1e8, "friction of what slides, over its speed", optional=True),
    "torque_offset": Limits("Nm", -1e5, 1e5, "shown at no torque", optional=True),
}
FITTED = (
    "rolling_coefficient", "rolling_rise", "drag_area", "mass",
    "rotating_mass_factor", "torque_scale", "efficiency", "torque_delay",
)  # fmt: skip
"""What is re-fitted, if its range has a width."""
OF_SLIDES = {"coulomb_friction": (CoulombFriction(), "friction"), "viscous_friction": (ViscousFriction(), "coefficient")}
"""Forces of what slides: the effect that each of them is, and its parameter, over the radius; re-fitted where they are given."""
SLOW_SHARE = 1.0 / 30.0  # of the greatest speed: what creeps turns from forward to reverse within less than `STANDSTILL_MPS`
ONLY_ONE_OF = ("mass", "torque_scale")
"""Both scale nearly all, and only the product shows: of these, one is re-fitted where the file holds the other, by a range
without width. With both free a robot's scale came to lie at half to a tenth of its value, as errors of the speed hide a
part of the inertia, and the friction of its turning at its bound; a car's mean error on held-out laps fell by 0.2 of 60 Nm.
"""


@dataclass(frozen=True)
class RoadVehicle:
    """A checked road-load file: quantities by name, with their ranges."""

    name: str
    title: str
    source: Path
    values: Mapping[str, float]
    parameters: Mapping[str, Quantity]
    friction_brakes: bool  # whether brakes of which nothing is recorded help a torque that brakes
    effects: tuple[Active, ...]
    surroundings: tuple[Active, ...]
    route: tuple[RouteMap, ...]  # slope and torque by place, of the surroundings
    torque_shown: tuple[float, float]  # least and most times the expected torque, by the ranges of its scale and of the mass


def load_road_vehicle(path: Path, content: Mapping[str, Any], surroundings: Path | None = None) -> RoadVehicle:
    """Check the content of a road-load file, and read the file of the surroundings if one is named.

    Raises
    ------
    InputError
        On a missing, unknown or implausible value.
    """
    reader = Reader(path, None)
    reader.keys(content, "", ("schema", "name", "title", "friction_brakes", "road_load"), EFFECT_KEYS)
    values = reader.table(content["road_load"], "road_load", QUANTITIES)
    parameters = {name: reader.parameters[f"road_load.{name}"] for name in values}
    brakes = content["friction_brakes"]
    if not isinstance(brakes, bool):
        raise InputError(reader.where("friction_brakes"), brakes, "true or false")
    name, title = reader.text(content["name"], "name"), reader.text(content["title"], "title")
    size = values["mass"] * GRAVITY * values["wheel_radius"]
    effects = listed_effects(reader, content, size, True, "vehicle")
    around = load_surroundings(surroundings, name, size, True) if surroundings else ()
    route = load_route(surroundings, size) if surroundings else ()
    scale, mass = parameters["torque_scale"], parameters["mass"]
    shown = (scale.low * mass.low / values["mass"], scale.high * mass.high / values["mass"])
    return RoadVehicle(name, title, path, values, parameters, brakes, effects, around, route, shown)


class RoadBase(Defaults):
    """Base model `road_load`; see `base.Base`."""

    name = "road_load"

    def __init__(self, vehicle: RoadVehicle) -> None:
        super().__init__()
        self.vehicle = vehicle
        self._active = (*vehicle.effects, *vehicle.surroundings)
        self._simulated = Remembered()
        v = vehicle.values
        self.torque_scale, self.rotating_mass_factor = v["torque_scale"], v["rotating_mass_factor"]
        self.facts = VehicleConstants(
            radius=v["wheel_radius"], weight=v["mass"] * GRAVITY, drag_area=v["drag_area"], air_density=v["air_density"],
            contact_length=v["contact_length"], assemblies=1, cooled_area=0.0, tension=1.0,
            standstill=min(STANDSTILL_MPS, SLOW_SHARE * v["max_speed"]),
        )  # fmt: skip
        self.parts = {"wheels": 2.0 * math.pi * v["wheel_radius"]}
        free = [
            name
            for name in (*FITTED, *OF_SLIDES, "torque_offset")
            if name in v and vehicle.parameters[name].standard_deviation > 0.0
        ]
        self.rolls = v["rolling_coefficient"] > 0.0 or "rolling_coefficient" in free
        if set(ONLY_ONE_OF) <= set(free):
            free = [name for name in free if name not in ONLY_ONE_OF]
        self.parameters = tuple(
            BaseParameter(
                name,
                QUANTITIES[name].unit,
                v[name],
                vehicle.parameters[name].standard_deviation,
                QUANTITIES[name].low,
                QUANTITIES[name].high,
                (vehicle.parameters[name].low, vehicle.parameters[name].high),
            )
            for name in free
        )
        same = {"torque_scale": TorqueGain.name, "rotating_mass_factor": RotatingInertia.name}
        refitted = (effect for parameter, effect in same.items() if parameter in free)
        chain = (DrivetrainEfficiency.name, Delay.name, *(name for name in (*OF_SLIDES, TorqueOffset.name) if name in v))
        self.includes = (*chain, *refitted, *(active.effect.name for active in self._active))

    @property
    def alone(self) -> RoadBase:
        """See `base.Base`."""
        return RoadBase(replace(self.vehicle, surroundings=(), route=())) if self.vehicle.surroundings else self

    def predict(self, sessions: Sequence[Session], values: Values, effects: Sequence[Active]) -> list[Predicted]:
        """See `base.Base`."""
        values = {**self.vehicle.values, **self.held, **values}
        chain = [
            Active(DrivetrainEfficiency(), {"efficiency": values["efficiency"]}),
            Active(Delay(), {"time": values["torque_delay"]}),
        ]
        radius = values["wheel_radius"]
        chain += [Active(e, {q: radius * values[name]}) for name, (e, q) in OF_SLIDES.items() if name in values]
        if "torque_offset" in values:
            chain.append(Active(TorqueOffset(), {"offset": values["torque_offset"]}))
        acting = Acting.of([*chain, *self._active, *effects], self.facts)
        torques = self._simulated.rows(sessions, values, acting, lambda: self._simulate(sessions, values, acting))
        found = []
        for i, (session, rolling) in enumerate(zip(sessions, torques, strict=True)):
            torque, nothing = acting.with_watched(rolling, i), np.full(len(session), np.nan)
            found.append(Predicted(values["torque_scale"] * acting.sensed(torque, session), torque, nothing, nothing))
        return found

    def _simulate(self, sessions: Sequence[Session], values: Values, acting: Acting) -> list[Array]:
        """Step through sessions; the torque of each [Nm]."""
        work, memory = new_work(self.facts), new_memory(len(acting.stepped))
        found = []
        for i, (session, unseen) in enumerate(with_unseen(sessions)):
            far = float(memory[DISTANCE])
            if i > 0 and np.isfinite(session.gap):
                rest_effects(*acting.table, memory, work, float(session.ambient[0]), session.gap)
            else:
                memory = cooled(memory)
            torque, outcome = np.empty(len(session)), np.empty(len(session), dtype=np.int64)
            unknown = np.full(len(session), np.nan)
            vehicle = RoadLoad(
                values["wheel_radius"],
                values["rolling_coefficient"],
                values["rolling_rise"],
                values["drag_area"],
                values["air_density"],
                values["rotating_mass_factor"],
            )
            series = Series(
                session.time,
                acting.speed(session),
                session.weight if "load" in session.given else values["mass"] * GRAVITY + session.payload,
                session.ambient,
                acting.accel(session),
                acting.grade(session, i),
                session.yaw_rate,
                session.heading,
                unknown,
                unknown,
                acting.torque_by_place(session, i),
                unknown,
            )
            run_road_load(*acting.table, work, memory, *vehicle, *series, torque, outcome)
            acting.check(outcome == UNUSABLE, session, self.facts)
            if unseen:
                memory[DISTANCE] = far
            else:
                found.append(torque)
        return found

    def as_written(self, values: Values) -> RoadBase:
        """See `base.Base`."""
        now = self.vehicle
        with TemporaryDirectory() as folder:
            path = Path(folder) / "vehicle.yaml"
            self.write(path, Kept(values, (), {}), "")
            written = load_road_vehicle(path, read_yaml(path))
        return RoadBase(replace(written, effects=now.effects, surroundings=now.surroundings, route=now.route))

    def write(self, path: Path, kept: Kept, text: str) -> list[Path]:
        """See `base.Base`."""
        vehicle, document = self.vehicle, opened(self.vehicle.source)
        if kept.values is not None:
            for name in kept.values:
                old = vehicle.parameters[name]
                set_quantity(
                    document, ("road_load", name), old, kept.values[name], kept.range_of(name), QUANTITIES[name], kept.by
                )
        return finish(document, vehicle.name, vehicle.effects, vehicle.surroundings, path, kept, text, vehicle.route)

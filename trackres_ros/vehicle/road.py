# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Describes and loads a vehicle without belts: a rolling coefficient, air, inertia, gears; a chassis on tyres."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.effects.effect import Active, Effect, VehicleConstants, VehicleKind
from trackres_ros.effects.vehicle.coulomb_friction import CoulombFriction
from trackres_ros.effects.vehicle.drivetrain_efficiency import DrivetrainEfficiency
from trackres_ros.effects.vehicle.viscous_friction import ViscousFriction
from trackres_ros.errors import InputError
from trackres_ros.files.dataclass_reader import ABSENT, Limits, limits_of
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import find_vehicle
from trackres_ros.route.learned import RouteMap
from trackres_ros.text import figures
from trackres_ros.units import GRAVITY, STANDSTILL_MPS
from trackres_ros.vehicle.description import Assembly, Axle, Chassis, Disturbance, Drift, Quantity, Spells, Vehicle
from trackres_ros.vehicle.loading import VehicleReader, build, checked_disturbance, listed_effects

SECTION = "road_load"
GEARS = DrivetrainEfficiency()
OF_SLIDES = {"coulomb_friction": (CoulombFriction(), "friction"), "viscous_friction": (ViscousFriction(), "coefficient")}
"""Forces of sliding vehicles: the effect of each, and its parameter, over the radius."""
ROUNDED = 1e-5  # of the rolling coefficient: the figures of written values
SLOW_SHARE = 1.0 / 30.0  # of the greatest speed: a slow vehicle reverses within less than `STANDSTILL_MPS`


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadLoad:
    """The section `road_load` of a vehicle file."""

    rolling_coefficient: Annotated[float, Limits("1", 0.0, 0.5, "rolling resistance over weight")]
    rolling_rise: Annotated[float, Limits("s/m", -0.01, 0.05, "growth of the rolling coefficient with speed")]
    drag_area: Annotated[float, Limits("m^2", 0.0, 30.0, "drag coefficient times frontal area")]
    air_density: Annotated[float, Limits("kg/m^3", 0.3, 2.0, "air density")]
    mass: Annotated[float, Limits("kg", 0.5, 1e6, "mass with driver and load")]
    rotating_mass_factor: Annotated[float, Limits("1", 1.0, 3.0, "effective over true mass in acceleration")]
    wheel_radius: Annotated[float, Limits("m", 0.01, 3.0, "rolling radius of the driven wheels")]
    torque_scale: Annotated[
        float, Limits("1", 0.01, 100.0, "measured over true torque at the wheels, for example from a motor constant")
    ]
    efficiency: Annotated[float, Limits("1", 0.75, 1.0, "of the gears between the measured torque and the wheels")]
    torque_delay: Annotated[float, Limits("s", 0.0, 1.0, "delay of the measured torque")]
    contact_length: Annotated[
        float, Limits("m", 0.01, 10.0, "length of the ground contact, or the wheelbase of a skid-steered vehicle")
    ]
    track_width: Annotated[float | None, Limits("m", 0.02, 10.0, "effective track width for turning")] = None
    max_speed: Annotated[float, Limits("m/s", 0.1, 100.0, "greatest speed")]
    ambient: Annotated[float, Limits("degC", -60.0, 60.0, "ambient temperature used if none is given")]
    coulomb_friction: Annotated[float | None, Limits("N", 0.0, 1e6, "Coulomb friction")] = None
    viscous_friction: Annotated[float | None, Limits("N s/m", 0.0, 1e8, "viscous friction over speed")] = None
    torque_offset: Annotated[float | None, Limits("Nm", -1e5, 1e5, "reading at zero torque, over the scale")] = None
    motor_ratio: Annotated[float | None, Limits("1", 0.1, 500.0, "motor speed over wheel speed")] = None


ROAD_LOAD = limits_of(RoadLoad)


@dataclass(frozen=True, slots=True)
class RoadVehicleFile:
    """The content of the file of a vehicle without belts."""

    schema: Literal[1]
    name: str
    title: str
    friction_brakes: bool
    road_load: RoadLoad
    effects: Mapping[str, Any] = field(default_factory=dict)
    effect_files: tuple[str, ...] = ()
    disturbance: Spells | Drift = ABSENT


@dataclass(frozen=True, eq=False, repr=False)
class RoadVehicle:
    """A vehicle of the base model `road_load`: it replaces a track vehicle everywhere, without belts and their temperatures.

    Attributes
    ----------
    name, title, source, parameters, effects, surroundings, surroundings_source, route, disturbance
        As of a `Vehicle`.
    values
        The quantities of the section `road_load`, by name; see `RoadLoad` for the units.
    friction_brakes
        Whether unrecorded friction brakes may assist a braking torque.
    """

    name: str
    title: str
    source: Path
    values: Mapping[str, float]
    parameters: Mapping[str, Quantity]
    friction_brakes: bool
    effects: tuple[Active, ...] = ()
    surroundings: tuple[Active, ...] = ()
    route: tuple[RouteMap, ...] = ()
    disturbance: Disturbance | None = None
    surroundings_source: Path | None = None

    hysteresis = thermal = SECTION
    axles: tuple[Axle, ...] = ()
    assemblies: tuple[Assembly, ...] = ()

    def __repr__(self) -> str:
        names = ", ".join(a.effect.name for a in (*self.effects, *self.surroundings))
        with_effects = f", with {names}" if names else ""
        return f"<RoadVehicle {self.name}: {self.title}; {self.weight / 1e3:.1f} kN, road load{with_effects}>"

    @property
    def own(self) -> tuple[Active, ...]:
        """All effects of the vehicle: its gears and sliding forces, then those that its file lists."""
        effects = []
        for effect, parameter, name, arm in built_in(self.values):
            quantity = self.parameters[f"{SECTION}.{name}"]
            effects.append(
                Active(effect, {parameter: arm * self.values[name]}, {parameter: (arm * quantity.low, arm * quantity.high)})
            )
        return (*effects, *self.effects)

    @property
    def rolls(self) -> bool:
        """Whether it has rolling resistance; a sliding vehicle has friction instead, see `Effect.only_of`."""
        return self.parameters[f"{SECTION}.rolling_coefficient"].high > 0.0

    @property
    def kind(self) -> VehicleKind:
        """What decides which effects it can have."""
        return VehicleKind(False, self.rolls, tuple(effect.name for effect, *_ in built_in(self.values)))

    @property
    def active(self) -> tuple[Active, ...]:
        """All effects in use, the vehicle's first."""
        return (*self.own, *self.surroundings)

    @property
    def weight(self) -> float:
        """Nominal weight [N]."""
        return self.values["mass"] * GRAVITY

    @property
    def size(self) -> float:
        """Weight times wheel radius [Nm]."""
        return self.weight * self.values["wheel_radius"]

    @property
    def chassis(self) -> Chassis:
        """A track vehicle's quantities other than tracks; its bearing friction is the rolling resistance at a crawl."""
        v = self.values
        shared = {name: v[name] for name in ("air_density", "rotating_mass_factor", "max_speed", "ambient")}
        # The expected torque has the loss of the gears, by `efficiency`.
        gears = {"motor_ratio": v["motor_ratio"], "motor_efficiency": 1.0} if "motor_ratio" in v else {}
        own = {"bearing_friction": v["rolling_coefficient"], "drag_coefficient": v["drag_area"], "frontal_area": 1.0}
        return Chassis(**own, **shared, **gears)

    @property
    def constants(self) -> VehicleConstants:
        """Constants of the vehicle for effects."""
        v = self.values
        return VehicleConstants(
            radius=v["wheel_radius"], weight=self.weight, drag_area=v["drag_area"], air_density=v["air_density"],
            contact_length=v["contact_length"], assemblies=1, cooled_area=0.0, tension=1.0,
            standstill=min(STANDSTILL_MPS, SLOW_SHARE * v["max_speed"]),
        )  # fmt: skip

    @property
    def torque_share(self) -> tuple[float, float]:
        """Least and most times the expected torque that a sensor shows, by the ranges of its scale and of the mass."""
        scale, mass = (self.parameters[f"{SECTION}.{name}"] for name in ("torque_scale", "mass"))
        product = self.values["torque_scale"] * self.values["mass"]
        return scale.low * mass.low / product, scale.high * mass.high / product

    def nominal_loads(self) -> Array:
        """Its weight [N], shape (1,): all wheels are one."""
        return np.array([self.weight])


AnyVehicle = Vehicle | RoadVehicle


def built_in(values: Mapping[str, float]) -> Iterator[tuple[Effect, str, str, float]]:
    """Each effect given as a quantity of the section `road_load`: the effect, its parameter, the quantity, and its factor."""
    yield GEARS, "efficiency", "efficiency", 1.0
    for name, (effect, parameter) in OF_SLIDES.items():
        if name in values:
            yield effect, parameter, name, values["wheel_radius"]


def load_any(path_or_name: str | os.PathLike[str]) -> AnyVehicle:
    """Load a vehicle file, on tracks or of the base model `road_load`; see `loading.load`."""
    path = find_vehicle(path_or_name)
    content = read_yaml(path)
    return build_road(path, content) if isinstance(content.get(SECTION), dict) else build(path, content)


def least_rolling(values: Mapping[str, float]) -> float:
    """Lowest rolling coefficient: with less the rolling resistance becomes negative below the greatest speed."""
    return max(ROAD_LOAD["rolling_coefficient"].low, -values["rolling_rise"] * values["max_speed"] / (1.0 + ROUNDED))


def _check_rolling(reader: VehicleReader, values: Mapping[str, float]) -> None:
    """Refuse a rolling resistance that becomes negative below the greatest speed."""
    coefficient, rise, fastest = values["rolling_coefficient"], values["rolling_rise"], values["max_speed"]
    if coefficient < least_rolling(values):
        bound = f"-rolling_coefficient / max_speed = {figures(-coefficient / fastest)} s/m"
        remedy = "below it the rolling resistance is negative at max_speed"
        raise InputError(reader.where(f"{SECTION}.rolling_rise"), rise, f"at least {bound}", remedy)


def files_of(vehicle: AnyVehicle) -> list[Path]:
    """The vehicle file and all files that it was read with."""
    rubber = vehicle.rubber_source if isinstance(vehicle, Vehicle) else None
    tables = (table.source for table in vehicle.route)
    paths = (vehicle.source, rubber, vehicle.surroundings_source, *tables, *(active.effect.source for active in vehicle.active))
    return [path for path in dict.fromkeys(paths) if path is not None]


def build_road(path: Path, content: Mapping[str, Any]) -> RoadVehicle:
    """Check the content of a road-load file.

    Raises
    ------
    InputError
        On a missing, unknown or implausible value.
    """
    reader = VehicleReader(path)
    file: RoadVehicleFile = reader.part(RoadVehicleFile, content)
    values = {name: value for name, value in asdict(file.road_load).items() if value is not None}
    _check_rolling(reader, values)
    disturbance = checked_disturbance(reader, file.disturbance)
    vehicle = RoadVehicle(file.name, file.title, path, values, reader.parameters, file.friction_brakes, disturbance=disturbance)
    return replace(
        vehicle, effects=listed_effects(reader, file.effects, file.effect_files, vehicle.size, vehicle.kind, "vehicle")
    )

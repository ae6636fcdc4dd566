# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Describes a vehicle: frozen, SI inside, temperatures in degC; each quantity with its unit and absolute limits.

Made by `trackres_ros.vehicle.load`, which checks every number. The limits here bound any track vehicle; the `range` a file gives
with each value is narrower and is that vehicle's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isnan, nan
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np

from trackres_ros import checks
from trackres_ros.arrays import Array
from trackres_ros.effects.effect import Active, VehicleKind
from trackres_ros.files.dataclass_reader import ABSENT, FILLED, Limits, fields_of, limits_of
from trackres_ros.route.learned import RouteMap
from trackres_ros.units import GRAVITY

FITTED = "F"
Flag = Literal["P", "L", "A", "F"]
FLAGS = get_args(Flag)
SPROCKET = "sprocket"
AxleName = Annotated[  # as in a role of a topics file
    str, partial(checks.name, pattern=r"[A-Za-z0-9_-]+", allowed="letters a to z or A to Z, digits, _ and -")
]
AssemblyName = Annotated[  # part of names of topics
    str,
    partial(checks.name, pattern=r"[A-Za-z][A-Za-z0-9_]*", allowed="a letter a to z or A to Z, then such letters, digits and _"),
]
WheelIndex = Annotated[int, lambda number, _: number - 1]
"""The index of a road wheel, which a file counts from 1."""
# Of a watched disturbance: that of blocks of `estimator.disturbance.BLOCK_S`.
NOISE = Limits("Nm", 1e-3, 1e6, "standard deviation of 5 s means of the measured torque about the expected torque")


def mean_of(values: Sequence[float], weights: Sequence[float] | Array = ()) -> float:
    """Weighted mean; of equal values that value, without rounding."""
    if len(set(values)) == 1:
        return values[0]
    return float(np.average(np.array(values), weights=np.array(weights) if len(weights) else None))


@dataclass(frozen=True, slots=True)
class Quantity:
    """One value of the vehicle file with its provenance: P the paper, L literature, A assumed, F fitted to recordings."""

    value: float | tuple[float, ...]
    unit: str
    flag: str
    low: float
    high: float
    reason: str

    @property
    def standard_deviation(self) -> float:
        """A quarter of the plausible range: the range is read as +-2 standard deviations."""
        return (self.high - self.low) / 4.0


@dataclass(frozen=True, slots=True)
class RubberValues:
    """Quantities of a compound."""

    sweep_frequency: Annotated[float, Limits("Hz", 0.001, 1e4, "frequency of the temperature sweep in the rubber file")]
    glass_transition: Annotated[float, Limits("degC", -130.0, 40.0, "Tg of the shift function")]
    wlf_c1: Annotated[float, Limits("1", 1.0, 30.0, "C1 of the WLF shift about Tg + 50 K")]
    wlf_c2: Annotated[float, Limits("K", 51.0, 300.0, "C2 of the WLF shift about Tg + 50 K")]
    density: Annotated[float, Limits("kg/m^3", 700.0, 2500.0, "rubber density")]
    conductivity: Annotated[float, Limits("W/m/K", 0.05, 2.0, "rubber heat conductivity")]
    heat_capacity: Annotated[float, Limits("J/kg/K", 700.0, 3000.0, "rubber specific heat capacity")]
    layer_stiffening: Annotated[float, Limits("1", 1.0, 3.0, "stiffness of the confined layer over that of the material")]
    loss_modulus_scale: Annotated[float, Limits("1", 0.1, 10.0, "factor on the loss modulus of the file")]


@dataclass(frozen=True, slots=True)
class RubberSection(RubberValues):
    """A compound in a vehicle file: its quantities, and the file of its temperature sweep."""

    file: str


@dataclass(frozen=True, slots=True)
class Rubber(RubberValues):
    """Compound: its quantities, and a temperature sweep at one frequency. Moduli [Pa], temperatures [degC]."""

    sweep_degc: Array
    storage_pa: Array
    loss_pa: Array


@dataclass(frozen=True, slots=True)
class Belt:
    """Belt section, loop and surroundings."""

    width: Annotated[float, Limits("m", 0.02, 3.0, "belt width")]
    thickness: Annotated[float, Limits("m", 0.003, 0.3, "belt thickness without tread bars and lugs")]
    cord_height: Annotated[float, Limits("m", 0.0005, 0.2, "height of the cords above the inner face")]
    loop_length: Annotated[float, Limits("m", 0.3, 60.0, "length of the belt loop")]
    lug_section: Annotated[float, Limits("m^2", 0.0, 0.5, "section of lugs and tread bars, mean round the loop")]
    tread_depth: Annotated[float, Limits("m", 0.0, 0.2, "height of the tread bars")]
    tread_land_ratio: Annotated[float, Limits("1", 0.0, 1.0, "share of the outer face that tread bars cover")]
    curvature_length: Annotated[float, Limits("m", 0.001, 1.0, "length over which the belt takes up its curvature")]
    cord_section: Annotated[float, Limits("m^2", 1e-7, 0.1, "section of all cords")]
    cord_modulus: Annotated[float, Limits("Pa", 1e8, 3e11, "tensile modulus of the cords")]
    cord_density: Annotated[float, Limits("kg/m^3", 900.0, 9000.0, "cord density")]
    cord_heat_capacity: Annotated[float, Limits("J/kg/K", 300.0, 2500.0, "cord specific heat capacity")]
    pretension: Annotated[float, Limits("N", 0.0, 1e6, "belt tension from the spring")]
    tooth_height: Annotated[float, Limits("m", 0.001, 0.5, "height of the drive teeth; the sag may be half of it")]
    sag_half_span: Annotated[float, Limits("m", 0.01, 10.0, "half the free span that sags")]
    exposed_share: Annotated[float, Limits("1", 0.05, 1.0, "cooled share of 2 (width + thickness) x loop length")]
    film_offset: Annotated[float, Limits("W/m^2/K", 0.5, 500.0, "film coefficient at rest")]
    film_slope: Annotated[float, Limits("W/m^2/K per speed_unit", 0.0, 50.0, "film coefficient gained per unit of speed")]
    surface_share: Annotated[float, Limits("1", 0.01, 0.9, "share of heat capacity in the surface node")]
    film_speed_unit: Literal["m/s", "km/h"]


@dataclass(frozen=True, slots=True)
class RoadWheels:
    """Road wheels of one assembly; positions [m] from the front end of the ground run."""

    positions: Annotated[tuple[float, ...], Limits("m", 0.0, 60.0, "positions from the front end of the ground run")]
    radius: Annotated[float, Limits("m", 0.01, 2.0, "road-wheel radius")]
    contact_length: Annotated[float, Limits("m", 0.01, 3.0, "axial length of the wheel's contact")]
    ground_run: Annotated[float, Limits("m", 0.05, 60.0, "length of the ground run")]


@dataclass(frozen=True, slots=True)
class WrappedWheel:
    """A wheel the belt wraps; a negative wrap angle [rad] bends the belt backwards. The sprocket has the radius of its track."""

    name: str
    kind: Literal["sprocket", "tensioner", "guide"]
    radius: Annotated[float, Limits("m", 0.01, 3.0, "radius of a wheel the belt wraps")] = field(default=nan, kw_only=True)
    wrap_angle: Annotated[float, Limits("rad", -3.2, 6.3, "wrap angle; negative where the belt is bent backwards")]


@dataclass(frozen=True, slots=True)
class Beam:
    """Balance beam: `split` of its load goes to the rear end. An end is a beam or the index of a road wheel.

    `own_weight_split` is `split` by default.
    """

    split: Annotated[float, Limits("1", 0.0, 1.0, "share of the load on the beam's rear end")]
    own_weight_split: Annotated[float, Limits("1", 0.0, 1.0, "the same for the assembly's own weight")] = field(
        default=nan, kw_only=True
    )
    front: Beam | WheelIndex
    rear: Beam | WheelIndex

    def __post_init__(self) -> None:
        if isnan(self.own_weight_split):
            object.__setattr__(self, "own_weight_split", self.split)

    def wheels(self) -> Iterator[int]:
        """Indices (from 0) of the road wheels below this beam, front to rear."""
        for end in (self.front, self.rear):
            if isinstance(end, Beam):
                yield from end.wheels()
            else:
                yield end


@dataclass(frozen=True, slots=True)
class Track:
    """One kind of track assembly."""

    name: str
    own_weight: Annotated[float, Limits("N", 1.0, 1e6, "weight of one assembly")]
    sprocket_radius: Annotated[float, Limits("m", 0.02, 3.0, "sprocket pitch radius")]
    belt: Belt
    road_wheels: RoadWheels
    wrapped_wheels: Annotated[tuple[WrappedWheel, ...], FILLED]
    beams: Beam | WheelIndex


@dataclass(frozen=True, slots=True)
class Axle:
    """Axle [N]: the load it carries without the weight of its assemblies."""

    name: AxleName
    load: Annotated[float, Limits("N", 10.0, 1e7, "load of the axle, without its assemblies")]


@dataclass(frozen=True, slots=True)
class Assembly:
    """A track assembly on the vehicle: which axle carries it, and which kind of track it is."""

    name: AssemblyName
    axle: str
    track: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Chassis:
    """Quantities of the vehicle as a whole."""

    bearing_friction: Annotated[float, Limits("1", 0.0, 0.2, "bearing friction coefficient")]
    drag_coefficient: Annotated[float, Limits("1", 0.0, 3.0, "aerodynamic drag coefficient")]
    frontal_area: Annotated[float, Limits("m^2", 0.0, 30.0, "frontal area")]
    air_density: Annotated[float, Limits("kg/m^3", 0.3, 2.0, "air density")]
    rotating_mass_factor: Annotated[float, Limits("1", 1.0, 3.0, "effective over true mass in acceleration")]
    max_speed: Annotated[float, Limits("m/s", 0.5, 60.0, "maximum speed; faster measurements are rejected")]
    max_acceleration: Annotated[
        float,
        Limits("m/s^2", 1.0, 50.0, "maximum acceleration and braking; speeds that change faster are rejected"),
    ] = GRAVITY  # the limit of friction on the ground
    ambient: Annotated[float, Limits("degC", -60.0, 60.0, "ambient temperature used if none is given")]
    motor_ratio: Annotated[float | None, Limits("1", 0.1, 500.0, "motor speed over sprocket speed")] = None
    motor_efficiency: Annotated[float | None, Limits("1", 0.3, 1.0, "efficiency from motor to sprocket")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ChassisSection(Chassis):
    """The chassis in a vehicle file, with the axles."""

    axles: Annotated[tuple[Axle, ...], FILLED]


@dataclass(frozen=True, slots=True)
class Spells:
    """A torque that switches between two levels."""

    form: ClassVar[str] = "spells"

    level: Annotated[float, Limits("Nm", -1e6, 1e6, "torque against travel while it is present, above the expected torque")]
    rest: Annotated[
        float,
        Limits("Nm", -1e6, 1e6, "torque against travel while it is absent; not 0 if the fitted values absorb its mean"),
    ]
    mean_there: Annotated[float, Limits("s", 10.0, 1e5, "mean length of a spell")]
    mean_away: Annotated[float, Limits("s", 10.0, 1e6, "mean time between two")]
    noise: Annotated[float, NOISE]


@dataclass(frozen=True, slots=True)
class Drift:
    """A torque that drifts about zero."""

    form: ClassVar[str] = "drift"

    size: Annotated[float, Limits("Nm", 1e-3, 1e6, "standard deviation of the drifting torque")]
    time_constant: Annotated[float, Limits("s", 10.0, 1e6, "time constant of the drift")]
    noise: Annotated[float, NOISE]


Disturbance = Spells | Drift
RUBBER, CHASSIS, BELT = map(limits_of, (RubberValues, Chassis, Belt))
DISTURBANCES = {kind.form: limits_of(kind) for kind in (Spells, Drift)}


@dataclass(frozen=True, slots=True)
class Methods:
    """Names of the loss method and of the thermal model."""

    hysteresis: Literal["spectral", "rainflow"]
    thermal: Literal["lumped", "core_surface"]


MODEL_CHOICES = {method.name: get_args(method.kind) for method in fields_of(Methods)}


@dataclass(frozen=True, slots=True)
class TrackVehicleFile:
    """The content of the file of a track vehicle. Its parameters have the order of these fields."""

    schema: Literal[1]
    name: str
    title: str
    model: Methods
    chassis: ChassisSection
    tracks: Annotated[Mapping[str, Track], FILLED]
    rubber: RubberSection
    assemblies: Annotated[tuple[Assembly, ...], FILLED]
    effects: Mapping[str, Any] = field(default_factory=dict)
    effect_files: tuple[str, ...] = ()
    disturbance: Spells | Drift = ABSENT


@dataclass(frozen=True, eq=False, repr=False)
class Vehicle:
    """A track vehicle, in SI units.

    Attributes
    ----------
    name, title
        Name for files and topics, and title for readers.
    source, rubber_source
        The vehicle file, and the file of the rubber's temperature sweep.
    hysteresis, thermal
        Names of the loss method and of the thermal model.
    rubber, chassis, axles, assemblies
        The parts of the vehicle.
    tracks
        Kinds of track by name.
    parameters
        Every quantity by its path in the file, with range and provenance.
    effects, surroundings
        Effects that the vehicle file switches on, and those of site, weather and ground from the surroundings file.
    surroundings_source
        The surroundings file, if one was given.
    route
        Slope and torque by place, from the surroundings; empty without either.
    disturbance
        An unpredictable torque: watched if a torque is measured, never part of the estimate.
    """

    name: str
    title: str
    source: Path
    rubber_source: Path
    hysteresis: str
    thermal: str
    rubber: Rubber
    chassis: Chassis
    axles: tuple[Axle, ...]
    assemblies: tuple[Assembly, ...]
    tracks: Mapping[str, Track]
    parameters: Mapping[str, Quantity]
    effects: tuple[Active, ...] = ()
    surroundings: tuple[Active, ...] = ()
    route: tuple[RouteMap, ...] = ()
    disturbance: Disturbance | None = None
    surroundings_source: Path | None = None

    kind: ClassVar[VehicleKind] = VehicleKind()

    def __repr__(self) -> str:
        with_effects = f", with {', '.join(active.effect.name for active in self.active)}" if self.active else ""
        return (
            f"<Vehicle {self.name}: {self.title}; {self.weight / 1e3:.1f} kN on {len(self.assemblies)} tracks, "
            f"{self.hysteresis}, {self.thermal}{with_effects}>"
        )

    @property
    def size(self) -> float:
        """Weight times sprocket radius [Nm]."""
        return self.weight * self.arm

    @property
    def arm(self) -> float:
        """Arm of a force on the whole vehicle [m]: mean of the sprocket radii, weighted by the nominal loads."""
        return mean_of(self.sprocket_radii, self.nominal_loads())

    @property
    def own(self) -> tuple[Active, ...]:
        """All effects of the vehicle."""
        return self.effects

    @property
    def active(self) -> tuple[Active, ...]:
        """All effects in use, the vehicle's first."""
        return (*self.own, *self.surroundings)

    @property
    def weight(self) -> float:
        """Nominal weight of the whole vehicle [N]: axle loads and assemblies."""
        return sum(axle.load for axle in self.axles) + sum(self.track_of(a).own_weight for a in self.assemblies)

    def track_of(self, assembly: Assembly) -> Track:
        """Kind of track of an assembly."""
        return self.tracks[assembly.track]

    @property
    def sprocket_radii(self) -> list[float]:
        """Sprocket pitch radius of each assembly [m]."""
        return [self.track_of(assembly).sprocket_radius for assembly in self.assemblies]

    def assemblies_of(self, axle: str) -> tuple[int, ...]:
        """Indices of the assemblies that an axle of a name rests on."""
        return tuple(i for i, a in enumerate(self.assemblies) if a.axle == axle)

    def nominal_loads(self) -> Array:
        """Load on each assembly with its own weight [N], shape (assemblies,)."""
        loads = {axle.name: axle.load / len(self.assemblies_of(axle.name)) for axle in self.axles}
        return np.array([loads[a.axle] + self.track_of(a).own_weight for a in self.assemblies])

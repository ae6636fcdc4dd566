# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Describes a vehicle: frozen, SI inside, temperatures in degC.

Made by `trackres_ros.vehicle.load`; every number in it passed the checks of `trackres_ros.vehicle.schema`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.effects.effect import Active, VehicleKind
from trackres_ros.route.learned import RouteMap


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
class Rubber:
    """Compound: a temperature sweep at one frequency and its shift. Moduli [Pa], temperatures [degC]."""

    sweep_degc: Array
    storage_pa: Array
    loss_pa: Array
    sweep_frequency: float
    glass_transition: float
    wlf_c1: float
    wlf_c2: float
    density: float
    conductivity: float
    heat_capacity: float
    layer_stiffening: float
    loss_modulus_scale: float


@dataclass(frozen=True, slots=True)
class Belt:
    """Belt section, loop and surroundings; see `schema.BELT` for the units."""

    width: float
    thickness: float
    cord_height: float
    loop_length: float
    lug_section: float
    tread_depth: float
    tread_land_ratio: float
    curvature_length: float
    cord_section: float
    cord_modulus: float
    cord_density: float
    cord_heat_capacity: float
    pretension: float
    tooth_height: float
    sag_half_span: float
    exposed_share: float
    film_offset: float
    film_slope: float
    surface_share: float
    film_speed_unit: str


@dataclass(frozen=True, slots=True)
class RoadWheels:
    """Road wheels of one assembly; positions [m] from the front end of the ground run."""

    radius: float
    contact_length: float
    positions: tuple[float, ...]
    ground_run: float


@dataclass(frozen=True, slots=True)
class WrappedWheel:
    """A wheel the belt wraps; a negative wrap angle [rad] bends the belt backwards."""

    name: str
    kind: str
    radius: float
    wrap_angle: float


@dataclass(frozen=True, slots=True)
class Beam:
    """Balance beam: `split` of its load goes to the rear end. An end is a beam or the index of a road wheel."""

    split: float
    own_weight_split: float
    front: Beam | int
    rear: Beam | int

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
    own_weight: float
    sprocket_radius: float
    belt: Belt
    road_wheels: RoadWheels
    wrapped_wheels: tuple[WrappedWheel, ...]
    beams: Beam | int


@dataclass(frozen=True, slots=True)
class Axle:
    """Axle [N]: the load it carries without the weight of its assemblies."""

    name: str
    load: float


@dataclass(frozen=True, slots=True)
class Assembly:
    """A track assembly on the vehicle: which axle carries it, and which kind of track it is."""

    name: str
    axle: str
    track: str


@dataclass(frozen=True, slots=True)
class Chassis:
    """Quantities of the vehicle as a whole; see `schema.CHASSIS` for the units."""

    bearing_friction: float
    drag_coefficient: float
    frontal_area: float
    air_density: float
    rotating_mass_factor: float
    max_speed: float
    max_acceleration: float
    ambient: float
    motor_ratio: float | None
    motor_efficiency: float | None


@dataclass(frozen=True, slots=True)
class Spells:
    """A torque that switches between two levels; see `schema.DISTURBANCES` for the units."""

    form: ClassVar[str] = "spells"

    level: float
    rest: float
    mean_there: float
    mean_away: float
    noise: float


@dataclass(frozen=True, slots=True)
class Drift:
    """A torque that drifts about zero; see `schema.DISTURBANCES` for the units."""

    form: ClassVar[str] = "drift"

    size: float
    time_constant: float
    noise: float


Disturbance = Spells | Drift


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
        """Weight times sprocket radius [Nm], of the first kind of track."""
        return self.weight * self.track_of(self.assemblies[0]).sprocket_radius

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

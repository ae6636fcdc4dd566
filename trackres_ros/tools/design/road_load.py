# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Road load of a vehicle as coefficients A, B and C of F = A + B v + C v^2: out of a vehicle file, and into one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from trackres_ros.errors import InputError
from trackres_ros.model.coverage import OVERSPEED
from trackres_ros.model.operating_point import explain_road, vehicle_state
from trackres_ros.tasks.arguments import check_weight
from trackres_ros.text import decimals, figures, table
from trackres_ros.tools.design.steady import J_PER_KWH, Array, steady
from trackres_ros.tools.design.values import numbers
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, variants
from trackres_ros.vehicle.road import SECTION
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import write_road_vehicle, write_track_vehicle

COMMAND = "trackres road-load"
ON_TRACKS = "rubber.loss_modulus_scale", "chassis.bearing_friction", "chassis.drag_coefficient"
ON_WHEELS = tuple(f"{SECTION}.{name}" for name in ("rolling_coefficient", "rolling_rise", "drag_area"))
SPEEDS, SLOWEST_SHARE = 10, 0.1  # by default, and of the maximum speed
WEIGHT_SHARES = 0.05, 20.0  # of the nominal weight
SLOWEST_KMH = 0.01
LEAST_SPEEDS = 4  # three coefficients fit three speeds without an error
END = 1e-3  # of a range


@dataclass(frozen=True, eq=False)
class RoadLoadRequest:
    """Conditions of a road load; None is the vehicle file's, or belts that have settled at each speed."""

    vehicle: AnyVehicle
    speeds: Array  # [m/s], shape (speeds,)
    ambient: float | None = None  # [degC]
    weight: float | None = None  # [N]
    belt: float | None = None  # [degC]

    @property
    def place(self) -> str:
        """The conditions in words."""
        vehicle = self.vehicle
        air = vehicle.chassis.ambient if self.ambient is None else self.ambient
        belts = "" if isinstance(vehicle, RoadVehicle) else ", belts "
        if belts:
            belts += "settled at each speed" if self.belt is None else f"at {self.belt:g} degC"
        weight = figures((self.weight or vehicle.weight) / 1e3, 4)
        return f"{vehicle.name}, {weight} kN, air {air:g} degC{belts}"


@dataclass(frozen=True, eq=False)
class RoadLoad:
    """Force of a vehicle [N], its coefficients [N, N/(m/s), N/(m/s)^2], and the force that these give, or others given."""

    request: RoadLoadRequest
    force: Array
    coefficients: tuple[float, float, float]
    reference: Array
    is_target: bool  # whether the reference is of given coefficients

    @property
    def largest_error(self) -> tuple[float, float]:
        """Largest difference of both forces [N], with its sign, and its speed [m/s]."""
        errors = self.reference - self.force
        worst = int(np.argmax(np.abs(errors)))
        return float(errors[worst]), float(self.request.speeds[worst])

    def text(self) -> str:
        """Coefficients in both units, and both forces over the speed."""
        error, speed = self.largest_error
        rows = [
            (figures(KMH_PER_MPS * v, 3), *(decimals(x, 1) for x in (f, other, other - f)), f"{100.0 * (other / f - 1.0):+.1f}")
            for v, f, other in zip(self.request.speeds, self.force, self.reference, strict=True)
        ]
        name = "given\nN" if self.is_target else "A + B v + C v^2\nN"
        what = "Largest difference from the given coefficients" if self.is_target else "Largest error of the coefficients"
        return "\n".join(
            [
                f"Road load of {self.request.place}",
                _coefficients_text(self.coefficients),
                table(rows, ("speed\nkm/h", "vehicle\nN", name, "difference\nN", "\n%")),
                f"{what}: {decimals(error, 1)} N at {figures(KMH_PER_MPS * speed)} km/h",
            ]
        )

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        error, speed = self.largest_error
        return {
            "vehicle": self.request.vehicle.name, "a_n": self.coefficients[0], "b_n_per_mps": self.coefficients[1],
            "c_n_per_mps2": self.coefficients[2], "speeds_mps": self.request.speeds.tolist(), "force_n": self.force.tolist(),
            "reference_n": self.reference.tolist(), "reference": "coefficients" if self.is_target else "fit",
            "largest_error_n": error, "largest_error_at_mps": speed,
        }  # fmt: skip


def request_of(
    vehicle: AnyVehicle, speed_kmh: str | None, ambient_degc: float | None, weight_kn: float | None, belt_degc: float | None
) -> RoadLoadRequest:
    """Conditions by the options of `trackres road-load`. Raises InputError if one is not valid for the vehicle."""
    fastest = KMH_PER_MPS * vehicle.chassis.max_speed
    kmh: Sequence[float] = np.linspace(SLOWEST_SHARE * fastest, fastest, SPEEDS).tolist()
    if speed_kmh is not None:
        kmh = numbers("--speed-kmh", speed_kmh, (SLOWEST_KMH, OVERSPEED * fastest))
    if len(kmh) < LEAST_SPEEDS:
        raise InputError("--speed-kmh", f"{len(kmh)} speeds", f"at least {LEAST_SPEEDS}")
    if belt_degc is not None and isinstance(vehicle, RoadVehicle):
        raise InputError("--belt-degc", belt_degc, f"none for {vehicle.name}, which has no belts")
    check_weight(vehicle, weight_kn, *WEIGHT_SHARES)
    weight = None if weight_kn is None else 1e3 * weight_kn
    return RoadLoadRequest(vehicle, np.sort(kmh) / KMH_PER_MPS, ambient_degc, weight, belt_degc)


def coefficients_of(text: str | None, per_kmh: bool) -> tuple[float, float, float] | None:
    """Coefficients [N, N/(m/s), N/(m/s)^2] of three numbers, which may be for a speed in km/h.

    Raises InputError for anything else.
    """
    if text is None:
        return None
    try:
        a, b, c = (float(part) for part in text.split(","))
        if not np.isfinite([a, b, c]).all():
            raise ValueError
    except ValueError:
        raise InputError("--coefficients", text, "three numbers A,B,C") from None
    return (a, b * KMH_PER_MPS, c * KMH_PER_MPS**2) if per_kmh else (a, b, c)


def _coefficients_text(coefficients: Sequence[float]) -> str:
    rows = [
        [letter, figures(value, 5), unit, figures(value / KMH_PER_MPS**power, 5), unit.replace("m/s", "km/h")]
        for power, (letter, value, unit) in enumerate(
            zip("ABC", coefficients, ("N", "N/(m/s)", "N/(m/s)^2"), strict=True)
        )
    ]  # fmt: skip
    return table(rows, ("", "v in m/s", "", "v in km/h", ""))


def forces(request: RoadLoadRequest, vehicle: AnyVehicle) -> Array:
    """Resistance along the way [N] at each speed, of the vehicle with other values than the request's, shape (speeds,).

    Raises InputError where no belt temperature is steady.
    """
    if isinstance(vehicle, RoadVehicle):
        states = [explain_road(vehicle, v, request.ambient, request.weight) for v in request.speeds.tolist()]
        return np.array([state["torque_nm"]["resistance"] for state in states]) / vehicle.constants.radius
    air = vehicle.chassis.ambient if request.ambient is None else request.ambient
    if request.belt is not None:
        belts, weight = [request.belt] * len(vehicle.assemblies), request.weight or vehicle.weight
        return np.array([vehicle_state(vehicle, v, belts, air, weight).force for v in request.speeds.tolist()])
    force = np.array([steady(vehicle, v, air, request.weight).kwh_per_km for v in request.speeds.tolist()]) * J_PER_KWH / 1e3
    if not np.isfinite(force).all():
        raise InputError("--speed-kmh", KMH_PER_MPS * float(request.speeds.max()), "speeds at which the belts settle")
    return force


def road_load(request: RoadLoadRequest, target: Sequence[float] | None = None) -> RoadLoad:
    """Least squares fit of A + B v + C v^2 to the force of a vehicle, and its errors, or those of given coefficients.

    `target`: [N, N/(m/s), N/(m/s)^2].
    """
    force = forces(request, request.vehicle)
    a, b, c = np.polynomial.polynomial.polyfit(request.speeds, force, 2).tolist()
    reference = _force_by((a, b, c) if target is None else target, request.speeds)
    return RoadLoad(request, force, (a, b, c), reference, target is not None)


def _force_by(coefficients: Sequence[float], speeds: Array) -> Array:
    a, b, c = coefficients
    return a + speeds * (b + speeds * c)


def values_for(request: RoadLoadRequest, target: Sequence[float]) -> dict[str, float]:
    """Values of the vehicle file, in their ranges, with which its force is closest to given coefficients, by path.

    Of tracks loss modulus, bearings and drag; of wheels rolling coefficient, its rise, and drag area.
    """
    vehicle, target_force = request.vehicle, _force_by(target, request.speeds)
    paths = ON_WHEELS if isinstance(vehicle, RoadVehicle) else ON_TRACKS
    free = {path: vehicle.parameters[path] for path in paths if vehicle.parameters[path].high > vehicle.parameters[path].low}
    if not free:
        raise InputError("--coefficients", f"no range of {', '.join(paths)}", "a range of one of them in the vehicle file")
    low, high = (np.array([getattr(quantity, end) for quantity in free.values()]) for end in ("low", "high"))
    start = np.array([float(np.mean(quantity.value)) for quantity in free.values()])
    make = with_values(vehicle)

    def errors(shares: Array) -> Array:
        values = np.clip(low + shares * (high - low), low, high)
        return forces(request, make(dict(zip(free, values.tolist(), strict=True)))) - target_force

    shares = np.clip((start - low) / (high - low), END, 1.0 - END)
    best = least_squares(errors, shares, bounds=(0.0, 1.0), x_scale=0.25, xtol=1e-12, ftol=1e-12).x
    return dict(zip(free, (low + best * (high - low)).tolist(), strict=True))


def with_values(vehicle: AnyVehicle) -> Callable[[Mapping[str, float]], AnyVehicle]:
    """A function that makes the same vehicle with other values by path."""
    if not isinstance(vehicle, RoadVehicle):
        return variants(vehicle)
    return lambda values: replace(vehicle, values={**vehicle.values, **{p.rpartition(".")[2]: x for p, x in values.items()}})


def ends_reached(vehicle: AnyVehicle, values: Mapping[str, float]) -> list[str]:
    """Paths of values at an end of their range."""
    ranges = {path: (vehicle.parameters[path].low, vehicle.parameters[path].high) for path in values}
    return [path for path, (low, high) in ranges.items() if min(values[path] - low, high - values[path]) < END * (high - low)]


def write_vehicle(vehicle: AnyVehicle, path: Path, values: Mapping[str, float], target: Sequence[float]) -> list[Path]:
    """Write the vehicle file with these values by path; all written files."""
    changes = FileChanges({name.rpartition(".")[2]: value for name, value in values.items()}, (), {}, command=COMMAND)
    text = f"For a road load of {figures(target[0], 5)} N, {figures(target[1], 5)} N/(m/s), {figures(target[2], 5)} N/(m/s)^2.\n"
    text += f"Written by {COMMAND}."
    if isinstance(vehicle, RoadVehicle):
        return write_road_vehicle(vehicle, path, changes, text)
    return write_track_vehicle(vehicle, path, changes, text)

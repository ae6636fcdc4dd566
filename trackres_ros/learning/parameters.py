# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the learned parameters: names, priors from the vehicle file, nuisance parameters; and the filter that learns them.

The filter is an extended Kalman filter with one measurement, in Joseph's form. It only uses sums and products of elements, in a
fixed order, so results are equal to the bit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trackres_ros.arrays import Array, Mask
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.constants import relative_std
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.dataclass_reader import Limits
from trackres_ros.vehicle import AnyVehicle, RoadVehicle, Vehicle
from trackres_ros.vehicle.description import BELT, CHASSIS, RUBBER
from trackres_ros.vehicle.road import ROAD_LOAD, SECTION
from trackres_ros.vehicle.writing.vehicle_file import rubber_share

# Filter


def age_estimate(mean: Array, covariance: Array, shares: Array, noise: Array) -> None:
    """Predict states with decay and process noise; changes both.

    `shares` is the remaining share of each state, `noise` its process noise, shape (states,).
    """
    mean *= shares
    covariance *= shares[:, None]
    covariance *= shares[None, :]
    covariance[np.diag_indices_from(covariance)] += noise


def widen_covariance(covariance: Array, stds: Array) -> None:
    """Raise standard deviations to those given, shape (states,); the correlations stay. Changes the covariance."""
    present_stds = np.sqrt(np.diag(covariance))
    share = np.divide(np.maximum(stds, present_stds), present_stds, out=np.ones(len(present_stds)), where=present_stds > 0.0)
    covariance *= share[:, None]
    covariance *= share[None, :]


def expected_residual(mean: Array, sensitivities: Array) -> float:
    """Expected measurement: the sum of states times their sensitivities, shape (states,)."""
    return float((mean * sensitivities).sum())


def spread(covariance: Array, sensitivities: Array) -> tuple[Array, float]:
    """Covariance of the states with the expected measurement, shape (states,), and its variance."""
    covariances = (covariance * sensitivities[None, :]).sum(axis=1)
    return covariances, float((covariances * sensitivities).sum())


def correct_estimate(
    mean: Array, covariance: Array, sensitivities: Array, departure: float, variance: float, freedom: Mask
) -> None:
    """Update by a measurement; changes mean and covariance.

    Parameters
    ----------
    sensitivities
        Sensitivity of the measurement to each state, shape (states,).
    departure
        Measured less expected.
    variance
        Of the measurement's noise.
    freedom
        States to update, shape (states,); the others are considered with their uncertainty (Schmidt's filter).

    Notes
    -----
    With gain K, P' = (I - K h) P (I - K h)^T + K r K^T, which is symmetric, and right for any gain.
    """
    covariances, total = spread(covariance, sensitivities)
    total += variance
    gain = np.where(freedom, covariances / total, 0.0)
    mean += gain * departure
    cross = gain[:, None] * covariances[None, :]
    covariance -= cross
    covariance -= cross.T
    covariance += total * (gain[:, None] * gain[None, :])


def conditional_mean(mean: Array, covariance: Array, is_learned: Mask) -> Array:
    """Departures of accepted parameters, given the file's values for all others; zero elsewhere, shape (states,).

    The estimates are correlated. If some are not accepted, their estimated contributions are conditionally assigned to the
    accepted ones.
    """
    result = np.zeros_like(mean)
    is_rest = ~is_learned
    if not is_learned.any():
        return result
    result[is_learned] = mean[is_learned]
    is_rest &= np.diag(covariance) > 0.0
    if is_rest.any():
        ties = np.linalg.solve(covariance[np.ix_(is_rest, is_rest)], mean[is_rest])
        result[is_learned] -= (covariance[np.ix_(is_learned, is_rest)] * ties[None, :]).sum(axis=1)
    return result


# Parameters

# States of the filter: the departures of `estimator.columns`, then nuisance states that keep their causes out of these:
# offset [Nm] and gain of the torque sensor; a torque against travel that drifts within minutes, and one that stepped [Nm]; the
# slope of the ground that the step does not know [1], its rise so far [m], and the tilt of an IMU [1], see `ground`.
OFFSET, GAIN, SLOW, STEP, SLOPE, HEIGHT, TILT = range(layout.LEARNABLE, layout.LEARNABLE + 7)
STATES = layout.LEARNABLE + 7
DELAY = STATES  # of the measured torque behind the speed [s]; no state of the filter, see `delay`
BELT_ROWS = {layout.OF_LOSS: (0, 3), layout.OF_COOLING: (1,), layout.OF_CAPACITY: (2,)}  # rows of the factor of their uncertainty
RADIUS_ROW = 3
VEHICLES_OWN = (layout.OF_LOSS, layout.OF_COOLING, layout.OF_CAPACITY, layout.OF_BEARING, layout.OF_DRAG, layout.OF_MASS)

LEAST_STD = 0.02  # assumed: rubber wears and oil ages, so that no value of a file stays exact
REACH_STD = 2.0  # the ranges of a vehicle file are +-2 standard deviations
LEAST_FACTOR = 0.2  # of the file's value, whatever the ranges say
OFFSET_SHARE = 0.005  # assumed: of the torque that rolling takes, standard deviation of a transducer's zero
GAIN_STD = 0.003  # assumed: class 0.5 is off by half a percent at most; a motor's current is no torque of its own, and worse
ROLLING_SHARE = 0.01  # assumed: prior rolling resistance over weight times sprocket radius
WANDERING_SHARE = 0.03  # assumed: standard deviation of the model error, of the rolling resistance


@dataclass(frozen=True)
class Learnable:
    """One learned parameter."""

    name: str  # as published; that of a re-fit by `trackres diagnose`
    unit: str
    meaning: str
    state: int  # index of the filter's state; or `DELAY`
    nominal: float  # value of the vehicle file; states are departures over it, but offset and torques are themselves
    paths: tuple[str, ...] = ()  # values of the file that a departure scales; the first is learned
    factor: float = 1.0  # their relative change for a departure of 1

    def value(self, departure: float) -> float:
        """The value in its unit, of a departure."""
        return self.nominal * (1.0 + departure) if self.state in VEHICLES_OWN or self.state == GAIN else departure

    def size(self, std: float) -> float:
        """A standard deviation in its unit, of one of the departure."""
        return abs(self.nominal) * std if self.state in VEHICLES_OWN or self.state == GAIN else std


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior of the learned parameters."""

    covariance: Array  # of all states, (STATES, STATES)
    low: Array  # bounds of the departures, (STATES,); infinite without one
    high: Array
    rolling_nm: float  # size of the rolling resistance torque


def learnables(vehicle: AnyVehicle) -> tuple[Learnable, ...]:
    """Learned parameters of a vehicle, in the order of publication."""
    of_vehicle = _of_tracks(vehicle) if isinstance(vehicle, Vehicle) else _of_wheels(vehicle)
    return (
        *of_vehicle,
        Learnable("torque_gain", "1", "gain of the torque sensor", GAIN, 1.0),
        Learnable("torque_offset", "Nm", "offset of the torque sensor", OFFSET, 0.0),
        Learnable("disturbance", "Nm", "drifting torque against travel", SLOW, 0.0),
        Learnable("step", "Nm", "torque step against travel", STEP, 0.0),
        Learnable("torque_delay", "s", "delay of the measured torque behind the speed", DELAY, 0.0),
    )


def _of_tracks(vehicle: Vehicle) -> tuple[Learnable, ...]:
    chassis, scale = vehicle.chassis, vehicle.rubber.loss_modulus_scale
    films = tuple(f"tracks.{name}.belt.{film}" for name in vehicle.tracks for film in ("film_offset", "film_slope"))
    heat = ("rubber.heat_capacity",), 1.0 / rubber_share(vehicle)  # of all belts': cords hold the rest
    drag, mass = ("chassis.drag_coefficient",), ("chassis.rotating_mass_factor",)
    return (
        Learnable("loss_modulus_scale", "1", "scale of the belts' loss", layout.OF_LOSS, scale, ("rubber.loss_modulus_scale",)),
        Learnable(
            "bearing_friction",
            "1",
            "bearing friction",
            layout.OF_BEARING,
            chassis.bearing_friction,
            ("chassis.bearing_friction",),
        ),
        Learnable("drag_coefficient", "1", "drag coefficient", layout.OF_DRAG, chassis.drag_coefficient, drag),
        Learnable("rotating_mass_factor", "1", "rotating-mass factor", layout.OF_MASS, chassis.rotating_mass_factor, mass),
        Learnable("film_scale", "1", "scale of the belts' cooling", layout.OF_COOLING, 1.0, films),
        Learnable("capacity_scale", "1", "scale of the belts' heat capacity", layout.OF_CAPACITY, 1.0, *heat),
    )


def _of_wheels(vehicle: RoadVehicle) -> tuple[Learnable, ...]:
    v, rolling = vehicle.values, (f"{SECTION}.rolling_coefficient", f"{SECTION}.rolling_rise")
    drag, mass = (f"{SECTION}.drag_area",), (f"{SECTION}.rotating_mass_factor",)
    return (
        Learnable(
            "rolling_coefficient", "1", "rolling resistance over weight", layout.OF_BEARING, v["rolling_coefficient"], rolling
        ),
        Learnable("drag_area", "m^2", "drag area", layout.OF_DRAG, v["drag_area"], drag),
        Learnable("rotating_mass_factor", "1", "rotating-mass factor", layout.OF_MASS, v["rotating_mass_factor"], mass),
    )


def limits_of(path: str) -> Limits:
    """What a file may hold for a value of `Learnable.paths`."""
    section, _, name = path.rpartition(".")
    return {"rubber": RUBBER, "chassis": CHASSIS, SECTION: ROAD_LOAD}.get(section, BELT)[name]


def _departure_bounds(vehicle: AnyVehicle, learnable: Learnable, std: float) -> tuple[float, float]:
    """Bounds of a departure: its standard deviations, and the file's own range, within what a vehicle file may hold."""
    low, high = -REACH_STD * std, REACH_STD * std
    lower, upper = LEAST_FACTOR - 1.0, np.inf
    for path in learnable.paths:
        quantity, limits = vehicle.parameters[path], limits_of(path)
        assert isinstance(quantity.value, float)
        if quantity.value:
            ends = [
                (end / quantity.value - 1.0) / learnable.factor for end in (quantity.low, quantity.high, limits.low, limits.high)
            ]
            if path == learnable.paths[0]:
                low, high = min(low, *ends[:2]), max(high, *ends[:2])
            lower, upper = max(lower, min(ends[2:])), min(upper, max(ends[2:]))
    return max(low, min(lower, 0.0)), min(high, max(upper, 0.0))


def make_prior(estimator: Estimator) -> Prior:
    """Prior from the ranges of the vehicle file, with their correlations.

    The sprockets' radius scales all torques. It is no state: its error is part of all departures, which makes them
    correlated. So are mass and scale of the torque of a vehicle on wheels.
    """
    k = estimator.constants
    own_states = {learnable.state: learnable for learnable in learnables(estimator.vehicle) if learnable.paths}
    load = k.assembly[:, layout.Assembly.nominal_load]
    factor = (load / load.sum()) @ k.assembly[:, layout.CONSIDER_FACTOR : layout.CAUSES_OF]
    covariance = _prior_covariance(estimator, own_states, factor.reshape(4, 4))
    for state in own_states:
        covariance[state, state] += max(LEAST_STD**2 - covariance[state, state], 0.0)
    rolling = ROLLING_SHARE * float(load @ k.assembly[:, layout.Assembly.radius])
    if estimator.assemblies:
        covariance[layout.OF_BELT, layout.OF_BELT] = k.number.initial_belt_std**2
    covariance[OFFSET, OFFSET] = (OFFSET_SHARE * rolling) ** 2
    covariance[GAIN, GAIN] = GAIN_STD**2
    covariance[SLOW, SLOW] = (WANDERING_SHARE * rolling) ** 2
    low, high = np.full(STATES, -np.inf), np.full(STATES, np.inf)
    for state in own_states:
        low[state], high[state] = _departure_bounds(
            estimator.vehicle, own_states[state], float(np.sqrt(covariance[state, state]))
        )
    return Prior(covariance, low, high, rolling)


def _prior_covariance(estimator: Estimator, own_states: Iterable[int], factor: Array) -> Array:
    """Covariance of the vehicle's own departures, (STATES, STATES); `factor` is (4, 4), of uncertain belts and the radius."""
    vehicle, number = estimator.vehicle, estimator.constants.number
    wheels = isinstance(vehicle, RoadVehicle)
    causes = np.zeros((STATES, 4 + 2))
    for state in own_states:
        causes[state, :4] = factor[list(BELT_ROWS.get(state, (RADIUS_ROW,)))].sum(axis=0)
        if wheels:
            causes[state, 4:] = relative_std(vehicle, "road_load.mass"), relative_std(vehicle, "road_load.torque_scale")
    causes[layout.OF_DRAG, 4] = 0.0  # drag is independent of the mass
    mass = relative_std(vehicle, "road_load.rotating_mass_factor" if wheels else "chassis.rotating_mass_factor")
    covariance = causes @ causes.T
    for state, value, std in (
        (layout.OF_BEARING, number.bearing_friction, number.bearing_friction_std),
        (layout.OF_DRAG, number.drag_area, number.drag_area_std),
    ):
        covariance[state, state] += (std / value) ** 2 if value else 0.0  # a value of 0 cannot depart by a share of itself
    covariance[layout.OF_MASS, layout.OF_MASS] += mass**2
    return covariance


def rise_torques(vehicle: AnyVehicle, speeds: Array) -> Array:
    """Torques [Nm] of a rolling coefficient with its rise, of the drag, and of a standard deviation of the rise, at speeds [m/s].

    Shape (3, speeds); zero for tracks. A departure of the coefficient scales the rise too, whose own error is not learned.
    """
    if not isinstance(vehicle, RoadVehicle):
        return np.zeros((3, len(speeds)))
    v, std = vehicle.values, vehicle.parameters["road_load.rolling_rise"].standard_deviation
    rolling = vehicle.weight * np.stack([v["rolling_coefficient"] + v["rolling_rise"] * speeds, std * speeds])
    drag = 0.5 * v["air_density"] * v["drag_area"] * speeds**2
    return np.asarray(v["wheel_radius"] * np.stack([rolling[0], drag, rolling[1]]))

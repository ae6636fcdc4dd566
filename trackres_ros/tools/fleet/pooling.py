# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pools recordings of many vehicles of one type: parameters of the type, and each vehicle's deviation.

Each recording gives a quadratic log-likelihood of the parameters (`likelihood.Evidence`), with three sources of variance:
the type, the vehicle, and the recording itself (weather, load, model error). Parameters are departures from the vehicle file's
values, over its standard deviations. Their dependence on the air temperature is common to all vehicles of a type.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.tools.fleet.dataset import OF_FILE

Array = NDArray[np.float64]

AMBIENT_DEGC, AMBIENT_STEP_K = 15.0, 10.0  # reference and unit of the dependence on the air temperature
FOLLOWS_STD = 0.3  # prior of the dependence, in standard deviations of the vehicle file [1/AMBIENT_STEP_K]
VEHICLES_STD, RECORDINGS_STD = 0.3, 0.1  # prior scatter of vehicles of a type, and of recordings of one vehicle,
WORTH = 3.0  # as if that many had been
ROUNDS, SETTLED = 100, 1e-3  # of learning how they differ; relative change of a variance at which it ends
DEGREES = 4.0  # of freedom: weather scatters as Student's t, most days little and some a lot
TURNS = 10  # of weights and means, given the covariances
MOST_ROWS = 5_000  # used for the covariances; means use all


def type_of(row: Mapping[str, Any]) -> Hashable:
    """Key of a good row's type: the vehicle file's values."""
    return tuple(row["names"]), tuple(row["nominal"]), tuple(row["std"])


@dataclass(frozen=True, eq=False)
class Vehicles:
    """Likelihoods of recordings of one type, ordered by vehicle and time; arrays begin with (n,)."""

    # of the p parameters
    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: Array
    std: Array
    # of each recording: vehicle, begin, and air temperature, about `AMBIENT_DEGC`, over `AMBIENT_STEP_K`
    vehicle: NDArray[np.str_]
    time_s: Array
    air: Array
    # see `likelihood.Evidence`
    precision: Array
    linear: Array
    urls: tuple[str, ...]  # of the recordings

    @classmethod
    def by_type(cls, rows: Iterable[Mapping[str, Any]]) -> list[Vehicles]:
        """Those of each type among good rows, of one file for each vehicle: equal files, also behind factors, are of one type."""
        good = [row for row in rows if row["status"] == "good"]
        file_values: dict[Hashable, dict[str, tuple[float | None, ...]]] = {}
        for row in good:
            if any(row.get(OF_FILE) or ()):
                file_values.setdefault(type_of(row), {})[row["vehicle"]] = tuple(row[OF_FILE])
        types: dict[Hashable, list[Mapping[str, Any]]] = {}
        for row in good:
            values = file_values.get(type_of(row), {})
            # Rows of earlier versions lack what factors multiply: it is that of the others, if they agree.
            common = next(iter(values.values())) if len(set(values.values())) == 1 else None
            types.setdefault((type_of(row), values.get(row["vehicle"], common)), []).append(row)
        return [cls._of_type(group) for group in types.values()]

    @classmethod
    def _of_type(cls, rows: list[Mapping[str, Any]]) -> Vehicles:
        rows = sorted(rows, key=lambda row: (row["vehicle"], row["start_s"], row["url"]))
        p = len(rows[0]["names"])
        upper = np.triu_indices(p)
        precision = np.zeros((len(rows), p, p))
        precision[:, upper[0], upper[1]] = [row["precision"] for row in rows]
        precision[:, upper[1], upper[0]] = precision[:, upper[0], upper[1]]
        return cls(
            tuple(rows[0]["names"]),
            tuple(rows[0]["units"]),
            np.array(rows[0]["nominal"]),
            np.array(rows[0]["std"]),
            np.array([row["vehicle"] for row in rows]),
            np.array([row["start_s"] for row in rows]),
            (np.array([row["mean_ambient"] for row in rows]) - AMBIENT_DEGC) / AMBIENT_STEP_K,
            precision,
            np.array([row["linear"] for row in rows]),
            tuple(row["url"] for row in rows),
        )

    def __len__(self) -> int:
        return len(self.vehicle)

    def subset(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Vehicles:
        """Part of the recordings."""
        return replace(
            self,
            vehicle=self.vehicle[rows],
            time_s=self.time_s[rows],
            air=self.air[rows],
            precision=self.precision[rows],
            linear=self.linear[rows],
            urls=tuple(np.array(self.urls, dtype=object)[rows]),
        )


@dataclass(frozen=True, eq=False)
class Pooled:
    """Parameters of a type, in standard deviations of its vehicle file about its values."""

    data: Vehicles
    # of the type, shapes (p,) and (p, p)
    mean: Array
    covariance: Array
    follows: Array  # change per `AMBIENT_STEP_K` of air temperature, shape (p,)
    # covariances among vehicles, and among recordings of one, shape (p, p)
    vehicle_scatter: Array
    recording_scatter: Array
    weight: Array  # of each recording, shape (n,): an outlier of its vehicle scatters as `within` over its weight
    by_vehicle: dict[str, tuple[Array, Array]]  # mean and covariance of each vehicle

    def likelihoods(self, rows: NDArray[np.bool_]) -> tuple[Vehicles, Array, Array]:
        """Some recordings; their precision and linear term without the dependence on the air and reduced by their scatter."""
        data = self.data.subset(rows)
        linear = data.linear - np.einsum("nij,j,n->ni", data.precision, self.follows, data.air)
        return data, *softened(data.precision, np.asarray(linear), _scatter(self.recording_scatter, self.weight[rows]))

    def value(self, vehicle: str | None, name: str) -> tuple[float, float]:
        """A parameter's value and standard deviation in its unit, of a vehicle or of the type."""
        mean, covariance = (self.mean, self.covariance) if vehicle is None else self.by_vehicle[vehicle]
        i = self.data.names.index(name)
        return float(self.data.nominal[i] + self.data.std[i] * mean[i]), float(self.data.std[i] * np.sqrt(covariance[i, i]))


def softened(precision: Array, linear: Array, spread: Array) -> tuple[Array, Array]:
    """Likelihoods of the mean of scattered parameters.

    `precision`, `linear`: of the scattered parameters, shapes (..., p, p) and (..., p); `spread`: covariance of the scatter,
    shape (p, p), or of each (..., p, p).
    """
    mixed = np.eye(precision.shape[-1]) + precision @ spread
    softer = np.asarray(np.linalg.solve(mixed, precision))
    softer = np.asarray(0.5 * (softer + np.swapaxes(softer, -1, -2)))
    slope = np.asarray(np.linalg.solve(mixed, linear[..., np.newaxis])[..., 0])
    return softer, slope


def _scatter(recording_scatter: Array, weight: Array) -> Array:
    return np.asarray(recording_scatter / weight[:, np.newaxis, np.newaxis])


def pool(data: Vehicles) -> Pooled:
    """Fit type, vehicles and scatter together: the most probable covariances, and the means given those.

    Recordings of one vehicle scatter due to weather and load, which affect several parameters at once, mostly the poorly
    separable ones. So the scatter has correlations. Raises InputError if there is no recording.
    """
    if not len(data):
        raise InputError("recordings", "no comparable recording", "at least one")
    vehicle_scatter, recording_scatter = _spreads(data)
    weight = np.ones(len(data))
    for _ in range(TURNS):
        weight = _scatter_of(data, vehicle_scatter, recording_scatter, weight).weight
    p, (type_, vehicles) = len(data.names), _means(data, vehicle_scatter, recording_scatter, weight)
    by_vehicle = {name: (v.itself.mean[:p], v.itself.covariance[:p, :p]) for name, v in vehicles.items()}
    return Pooled(
        data, type_.mean[:p], type_.covariance[:p, :p], type_.mean[p:], vehicle_scatter, recording_scatter, weight, by_vehicle
    )


class Estimate(NamedTuple):
    """Mean and covariance of the parameters at `AMBIENT_DEGC` and of their dependence on the air, shapes (2p,) and (2p, 2p)."""

    mean: Array
    covariance: Array


class VehicleEstimate(NamedTuple):
    """A vehicle, and its deviation from its type."""

    itself: Estimate
    deviation: Estimate


def _spreads(data: Vehicles) -> tuple[Array, Array]:
    """Covariances among vehicles and among recordings of one, by expectation and maximisation: Dempster, Laird and Rubin, Journal
    of the Royal Statistical Society B 39 (1977) 1.
    """
    p = len(data.names)
    if len(data) > MOST_ROWS:
        data = data.subset(np.sort(np.random.default_rng(0).choice(len(data), MOST_ROWS, replace=False)))
    vehicle_scatter, recording_scatter = VEHICLES_STD**2 * np.eye(p), RECORDINGS_STD**2 * np.eye(p)
    first_vehicle, first_recording = vehicle_scatter, recording_scatter
    weight, count = np.ones(len(data)), len(np.unique(data.vehicle))
    for _ in range(ROUNDS):
        scatter, last = _scatter_of(data, vehicle_scatter, recording_scatter, weight), np.diag(recording_scatter)
        weight = scatter.weight
        recording_scatter = (np.einsum("n,nij->ij", weight, scatter.recordings) + WORTH * first_recording) / (len(data) + WORTH)
        vehicle_scatter = (scatter.vehicles + WORTH * first_vehicle) / (count + WORTH)
        if np.abs(np.diag(recording_scatter) / last - 1.0).max() < SETTLED:
            break
    return vehicle_scatter, recording_scatter


class Scatter(NamedTuple):
    """Expected squares of the deviations, given all data: vehicles from their type, their sum, shape (p, p); recordings from
    their vehicle, shape (n, p, p); and the resulting weights, shape (n,).
    """

    vehicles: Array
    recordings: Array
    weight: Array


def _scatter_of(data: Vehicles, vehicle_scatter: Array, recording_scatter: Array, weight: Array) -> Scatter:
    p = len(data.names)
    names, index = np.unique(data.vehicle, return_inverse=True)
    vehicles = _means(data, vehicle_scatter, recording_scatter, weight)[1]
    estimates, deviations = zip(*(vehicles[str(name)] for name in names), strict=True)
    design = np.stack((np.ones_like(data.air), data.air), axis=1)
    # The mean of each recording, given its vehicle, and its covariance.
    means, covariances = np.array([k.mean for k in estimates])[index], np.array([k.covariance for k in estimates])[index]
    mean = np.einsum("na,nai->ni", design, means.reshape(-1, 2, p))
    unsure = np.einsum("na,nb,naibj->nij", design, design, covariances.reshape(-1, 2, p, 2, p))
    # The deviation of each recording: its own likelihood, and the present scatter.
    spread = _scatter(recording_scatter, weight)
    narrowed = np.linalg.solve(np.eye(p) + spread @ data.precision, spread)
    deviation = np.einsum("nij,nj->ni", narrowed, data.linear - np.einsum("nij,nj->ni", data.precision, mean))
    pulled = narrowed @ data.precision
    squares = narrowed + np.einsum("ni,nj->nij", deviation, deviation) + pulled @ unsure @ np.swapaxes(pulled, 1, 2)
    distance = np.einsum("ij,nij->n", np.linalg.inv(recording_scatter), squares)
    vehicle_squares = np.sum([(np.outer(k.mean, k.mean) + k.covariance)[:p, :p] for k in deviations], axis=0)
    return Scatter(vehicle_squares, squares, (DEGREES + p) / (DEGREES + distance))


def _means(
    data: Vehicles, vehicle_scatter: Array, recording_scatter: Array, weight: Array
) -> tuple[Estimate, dict[str, VehicleEstimate]]:
    """Estimate of the type, and of each vehicle from all data, given their scatter."""
    p = len(data.names)
    softer, slopes = softened(data.precision, data.linear, _scatter(recording_scatter, weight))
    # The same likelihoods, of the parameters at `AMBIENT_DEGC` and of their dependence on the air, twice as many.
    design, n = np.stack((np.ones_like(data.air), data.air), axis=1), len(data)
    joint = np.einsum("na,nb,nij->naibj", design, design, softer).reshape(n, 2 * p, 2 * p)
    linear = np.einsum("na,ni->nai", design, slopes).reshape(n, 2 * p)
    starts = np.concatenate(([0], np.flatnonzero(data.vehicle[1:] != data.vehicle[:-1]) + 1))
    joint, linear = np.add.reduceat(joint, starts), np.add.reduceat(linear, starts)
    spread = np.zeros((2 * p, 2 * p))
    spread[:p, :p] = vehicle_scatter
    softer, slopes = softened(joint, linear, spread)
    prior = np.diag(np.concatenate((np.ones(p), np.full(p, FOLLOWS_STD**-2.0))))
    covariance = np.linalg.inv(prior + softer.sum(axis=0))
    type_ = Estimate(covariance @ slopes.sum(axis=0), covariance)
    vehicles = {}
    for start, precision, right in zip(starts, joint, linear, strict=True):
        narrowed = np.linalg.solve(np.eye(2 * p) + spread @ precision, spread)
        pulled = narrowed @ precision
        deviation = Estimate(narrowed @ (right - precision @ type_.mean), narrowed + pulled @ covariance @ pulled.T)
        remainder = np.eye(2 * p) - pulled
        itself = Estimate(type_.mean + deviation.mean, narrowed + remainder @ covariance @ remainder.T)
        vehicles[str(data.vehicle[start])] = VehicleEstimate(itself, deviation)
    return type_, vehicles

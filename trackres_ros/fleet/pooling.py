# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What recordings of many vehicles of one type say together: parameters of the type, and how far each vehicle is from it.

Each recording gives a quadratic log-likelihood of the parameters (`likelihood.Evidence`), which here has three causes to differ:
the type, the vehicle, and the recording itself (weather, load, what the model lacks). Parameters are those of the vehicle file
less its values, over its standard deviations. They follow the air's temperature alike in all vehicles of a type.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from trackres_ros.errors import InputError

Array = NDArray[np.float64]

AMBIENT_DEGC, AMBIENT_STEP_K = 15.0, 10.0  # about which, and over how much, parameters are said to follow the air's temperature
FOLLOWS_STD = 0.3  # by how much they may, in standard deviations of the vehicle file [1/AMBIENT_STEP_K]
VEHICLES_STD, RECORDINGS_STD = 0.5, 0.3  # half-normal scales: of how vehicles of a type differ, and recordings of one vehicle
LEAST_STD = 1e-3
MOST_ROWS = 20_000  # of which it is learned how vehicles and recordings differ; means are of all


@dataclass(frozen=True, eq=False)
class Vehicles:
    """Likelihoods of recordings of one type, ordered by vehicle and time; arrays begin with (n,).

    Attributes
    ----------
    names, units, nominal, std
        Of the p parameters.
    vehicle, time_s, air
        Of each recording: whose it is, when it began, and how warm it was, about `AMBIENT_DEGC`, over `AMBIENT_STEP_K`.
    precision, linear
        See `likelihood.Evidence`.
    urls
        Of the recordings.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: Array
    std: Array
    vehicle: NDArray[np.str_]
    time_s: Array
    air: Array
    precision: Array
    linear: Array
    urls: tuple[str, ...]

    @classmethod
    def of(cls, rows: Iterable[Mapping[str, Any]]) -> list[Vehicles]:
        """Those of each type among good rows; of one type are vehicles whose files have the same values."""
        types: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
        for row in rows:
            if row["status"] == "good":
                types.setdefault((tuple(row["names"]), tuple(row["nominal"]), tuple(row["std"])), []).append(row)
        return [cls._of_type(of) for of in types.values()]

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

    def some(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Vehicles:
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
    """What a type is like, in standard deviations of its vehicle file about its values.

    Attributes
    ----------
    mean, covariance
        Of the type, shapes (p,) and (p, p).
    follows
        What `AMBIENT_STEP_K` more add, shape (p,).
    between, within
        Standard deviations among vehicles, and among recordings of one, shape (p,).
    by_vehicle
        Mean and covariance of each vehicle.
    """

    of: Vehicles
    mean: Array
    covariance: Array
    follows: Array
    between: Array
    within: Array
    by_vehicle: dict[str, tuple[Array, Array]]

    def value(self, vehicle: str | None, name: str) -> tuple[float, float]:
        """A parameter's value and standard deviation in its unit, of a vehicle or of the type."""
        mean, covariance = (self.mean, self.covariance) if vehicle is None else self.by_vehicle[vehicle]
        i = self.of.names.index(name)
        return float(self.of.nominal[i] + self.of.std[i] * mean[i]), float(self.of.std[i] * np.sqrt(covariance[i, i]))


def softened(precision: Array, linear: Array, variance: Array) -> tuple[Array, Array, Array]:
    """Likelihoods of a mean about which parameters scatter, and their logarithms at mean zero.

    Parameters
    ----------
    precision, linear
        Of what scatters, shapes (..., p, p) and (..., p).
    variance
        Of the scatter, shape (p,), or (p, p).
    """
    spread = np.diag(variance) if variance.ndim == 1 else variance
    eye = np.eye(precision.shape[-1])
    mixed = eye + precision @ spread
    softer = np.asarray(np.linalg.solve(mixed, precision))
    softer = np.asarray(0.5 * (softer + np.swapaxes(softer, -1, -2)))
    moved = np.asarray(np.linalg.solve(mixed, linear[..., np.newaxis])[..., 0])
    log = -0.5 * np.linalg.slogdet(mixed)[1] + 0.5 * np.einsum("...i,ij,...j->...", linear, spread, moved)
    return softer, moved, np.asarray(log)


def with_air(precision: Array, linear: Array, air: Array) -> tuple[Array, Array]:
    """The same likelihoods, of the parameters at `AMBIENT_DEGC` and of what they follow the air by, twice as many."""
    one = np.stack((np.ones_like(air), air), axis=1)
    n, p = linear.shape
    both = np.einsum("na,nb,nij->naibj", one, one, precision).reshape(n, 2 * p, 2 * p)
    return both, np.einsum("na,ni->nai", one, linear).reshape(n, 2 * p)


def pool(data: Vehicles) -> Pooled:
    """Fit type, vehicles and scatter together: the standard deviations by what is most probable, the means given those.

    Raises
    ------
    InputError
        If there is no recording.
    """
    if not len(data):
        raise InputError("recordings", "none that could be compared", "at least one")
    between, within = _spreads(data)
    _, mean, covariance = _means(data, between, within)
    p = len(data.names)
    by_vehicle = {}
    for name in np.unique(data.vehicle):
        of = data.some(data.vehicle == name)
        softer, moved, _ = softened(of.precision, of.linear - np.einsum("nij,j,n->ni", of.precision, mean[p:], of.air), within**2)
        own = np.diag(between**2) + covariance[:p, :p]
        posterior = np.linalg.inv(np.linalg.inv(own) + softer.sum(axis=0))
        by_vehicle[str(name)] = posterior @ (np.linalg.solve(own, mean[:p]) + moved.sum(axis=0)), posterior
    return Pooled(data, mean[:p], covariance[:p, :p], mean[p:], between, within, by_vehicle)


def _spreads(data: Vehicles) -> tuple[Array, Array]:
    p = len(data.names)
    chosen = data
    if len(data) > MOST_ROWS:
        chosen = data.some(np.sort(np.random.default_rng(0).choice(len(data), MOST_ROWS, replace=False)))
    scales = np.concatenate((np.full(p, VEHICLES_STD), np.full(p, RECORDINGS_STD)))

    def cost(logs: Array) -> float:
        stds = np.exp(logs)
        return -_means(chosen, stds[:p], stds[p:])[0] + 0.5 * float(((stds / scales) ** 2).sum()) - 0.1 * float(logs.sum())

    bounds = [(np.log(LEAST_STD), np.log(10.0))] * (2 * p)
    found = minimize(cost, np.log(0.3 * scales), method="L-BFGS-B", bounds=bounds, options={"maxiter": 60})
    stds = np.exp(found.x)
    return stds[:p], stds[p:]


def _means(data: Vehicles, between: Array, within: Array) -> tuple[float, Array, Array]:
    """Log-likelihood of standard deviations; mean and covariance of the type, and of what it follows the air by."""
    p = len(data.names)
    softer, moved, log = softened(data.precision, data.linear, within**2)
    total = float(log.sum())
    both, linear = with_air(softer, moved, data.air)
    starts = np.concatenate(([0], np.flatnonzero(data.vehicle[1:] != data.vehicle[:-1]) + 1))
    both, linear = np.add.reduceat(both, starts), np.add.reduceat(linear, starts)
    spread = np.concatenate((between**2, np.zeros(p)))
    softer, moved, log = softened(both, linear, spread)
    prior = np.diag(np.concatenate((np.ones(p), np.full(p, FOLLOWS_STD**-2.0))))
    precision, right = prior + softer.sum(axis=0), moved.sum(axis=0)
    covariance = np.linalg.inv(precision)
    mean = covariance @ right
    total += float(log.sum()) - 0.5 * float(np.linalg.slogdet(precision)[1]) + 0.5 * float(right @ mean)
    return total, mean, covariance

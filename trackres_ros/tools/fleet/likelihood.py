# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The information of one recording about the base's parameters, as a quadratic log-likelihood that adds up over recordings.

It excludes the vehicle file's ranges, which would be added once per recording, and is marginal over the wind.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.arrays import Array
from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.instrument import instrument, narrow_prior
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.inference.fitting import Fit, Free, Problem, fit, free_parameters, jacobian, of_rows, valid_rows
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.session import DriveSession, split_laps
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.surroundings.headwind import Headwind
from trackres_ros.recording.recording import Recording

WIND_MPS, STRONGEST_WIND_MPS = 3.0, 12.0  # prior standard deviation of either component of a day's wind, and its bound


@dataclass(frozen=True, eq=False)
class Evidence:
    """Likelihood and summary of a recording."""

    # of the parameters, those of the instrument as ``torque_offset.offset``
    names: tuple[str, ...]
    units: tuple[str, ...]
    # of the vehicle file, shape (p,)
    nominal: Array
    std: Array
    of_file: tuple[float | None, ...]  # of factors: the values of the vehicle file that they multiply; None of others
    # estimate of the fit and its covariance with the file's ranges, shapes (p,) and (p, p)
    point: Array
    covariance: Array
    # the log-likelihood alone is ``linear @ x - x @ precision @ x / 2`` for x the parameters less `nominal`, over `std`
    precision: Array
    linear: Array
    compared_s: float  # valid seconds
    # of the fit's residual in all valid seconds [Nm]
    residual_mean: float
    residual_std: float
    mismatch: float  # mean absolute error of the unchanged vehicle file over the mean absolute torque
    # mean absolute error on the hold-out laps, of the file and of the fit [Nm]; nan without any
    held_out_file: float
    held_out_refit: float
    # over valid seconds: absolute torque [Nm], [m/s], [N], [degC]
    mean_torque: float
    mean_speed: float
    mean_weight: float
    mean_ambient: float
    load_recorded: bool  # whether loads or passengers were recorded; else the vehicle file's weight is assumed
    notes: tuple[str, ...]  # assumptions of the gate


def evidence(recording: Recording, base_file: LoadedBase) -> Evidence:
    """Fit the base to one recording, and expand its likelihood about the fit.

    Raises InputError if the recording cannot be compared, with the reason.
    """
    gated = gate([recording], base_file.known)
    (session,) = gated.sessions
    problem = Problem(base_file.base, gated.sessions, (session.used,))
    training = _training(session)
    result = fit(Problem(base_file.base, gated.sessions, (training,)), weather(session, base_file.base), largest_root=SHORT_ROOT)
    columns = np.array([f.key[0] != Headwind.name for f in result.free])
    precision, linear, std = quadratic(problem, result)
    precision, linear, std = *marginal(precision, linear, columns), std[columns]
    parameters = [f for f, is_kept in zip(result.free, columns, strict=True) if is_kept]
    of_file = {q.name: q.of_file for q in base_file.base.parameters}
    by_file = base_file.base.predict(gated.sessions, base_file.base.nominal, ())[0].torque
    refit, in_use, holdout = result.predicted[0].torque, session.used, session.used & ~training
    torque = float(np.abs(session.torque[in_use]).mean())

    def error(expected: Array, mask: NDArray[np.bool_]) -> float:
        return float(np.abs(session.torque - expected)[mask].mean()) if mask.any() else float("nan")

    residual = (session.torque - refit)[in_use]
    speed, weight, ambient = (float(series[in_use].mean()) for series in (np.abs(session.speed), session.weight, session.ambient))
    return Evidence(
        names=tuple(map(name_of, parameters)),
        units=tuple(f.unit for f in parameters),
        nominal=np.array([f.nominal for f in parameters]),
        std=std,
        of_file=tuple(of_file.get(name_of(f)) for f in parameters),
        point=result.point[columns],
        covariance=result.covariance[np.ix_(columns, columns)],
        precision=precision,
        linear=linear,
        compared_s=float(in_use.sum() * session.step),
        residual_mean=float(residual.mean()),
        residual_std=float(residual.std()),
        mismatch=error(by_file, in_use) / max(torque, 1e-9),
        held_out_file=error(by_file, holdout),
        held_out_refit=error(refit, holdout),
        mean_torque=torque,
        mean_speed=speed,
        mean_weight=weight,
        mean_ambient=ambient,
        load_recorded=not session.given.isdisjoint(("load", "passengers")),
        notes=gated.notes,
    )


def name_of(parameter: Free) -> str:
    """As ``bearing_friction``, or ``torque_offset.offset``."""
    return ".".join(filter(None, parameter.key))


def parameters_of(base: Base) -> tuple[str, ...]:
    """Names of all parameters that a recording may tell."""
    return tuple(map(name_of, free_parameters(base, instrument(base))))


def weather(session: DriveSession, base: Base) -> list[Effect]:
    """Nuisance that differs from day to day: wind, if headings show its direction."""
    if "heading" not in session.given or Headwind.name in base.includes:
        return []
    return [narrow_prior(Headwind(), WIND_MPS, STRONGEST_WIND_MPS)]


def marginal(precision: Array, linear: Array, mask: NDArray[np.bool_]) -> tuple[Array, Array]:
    """A marginal quadratic log-likelihood of some parameters; the others have a prior standard deviation of 1.

    `precision`, `linear`: of all p parameters, shapes (p, p) and (p,); `mask`: which are kept, shape (p,).
    """
    across = precision[np.ix_(mask, ~mask)]
    gain = np.linalg.solve(precision[np.ix_(~mask, ~mask)] + np.eye(int((~mask).sum())), across.T).T
    return precision[np.ix_(mask, mask)] - gain @ across.T, linear[mask] - gain @ linear[~mask]


def quadratic(problem: Problem, result: Fit) -> tuple[Array, Array, Array]:
    """The log-likelihood of a problem about a fit, without priors, shapes (p, p) and (p,), and the scales (p,) of the parameters;
    see `Evidence.precision`.
    """
    parameters, point = result.free, result.point
    nominal = np.array([f.nominal for f in parameters])
    std = np.array([f.std if np.isfinite(f.std) else f.scale for f in parameters])
    residuals = problem.residuals(problem.predict(*result.model_at(point)))
    noises = problem.noises(residuals, SHORT_ROOT)
    white = problem.white(residuals, noises)

    def expected(values: Array) -> Array:
        return np.concatenate(problem.expected(problem.predict(*result.model_at(values))))

    columns = valid_rows(problem.white(problem.split(jacobian(expected, point, parameters)), noises)) * std
    slope = of_rows(problem, white, lambda noise, w: noise.weights(w) * w, noises)  # of the log-likelihood
    precision = columns.T @ columns  # Fisher's: innovations over their standard deviation have an information of 1 each
    return precision, columns.T @ slope + precision @ ((point - nominal) / std), std


def _training(session: DriveSession) -> NDArray[np.bool_]:
    """Data of the fit: without the last laps, unless there is only one."""
    if len(np.unique(session.block[session.used])) < 2:
        return session.used
    mask = split_laps((session,)).training_mask(session)
    return mask if mask.any() else session.used

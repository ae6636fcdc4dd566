"""Other ways to the temperatures and torques of a whole recording, to compare the estimator with.

All use the same loss table and the same recording, and give the same: temperature of each belt and the torques by part at
every sample.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import odeint, solve_ivp

from trackres_ros.compiled import compiled
from trackres_ros.estimator import layout as at
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.belt import GRAVITY
from trackres_ros.model.hysteresis import METHODS, LossMethod
from trackres_ros.model.loss_table import look_up, look_up_drive
from trackres_ros.model.resistance import STANDSTILL_SPEED
from trackres_ros.model.rubber import RubberModel, log_shift_factor

Array = NDArray[np.float64]

TORQUES = ("hysteresis_nm", "bearing_nm", "wind_nm", "inertia_nm")
# Relative tolerance of LSODA at which its torque errs by less than 0.1 %, see `lsoda_error` in bench_recording.py.
RELATIVE_TOLERANCE = 1e-4
ABSOLUTE_TOLERANCE_K = 1e-2


class Road(NamedTuple):
    """A recording: evenly spaced times [s], speed [m/s], acceleration [m/s^2], shape (times,); loads [N], shape (assemblies,)."""

    time: Array
    speed: Array
    acceleration: Array
    loads: Array
    ambient: float


class Plain(NamedTuple):
    """The constants of the model as bare arrays and numbers."""

    table: NDArray[np.int64]  # (assemblies,)
    thermal: Array  # (assemblies, 4): capacity, area, film offset, film slope
    first_log_load: Array
    step_log_load: Array
    radius: Array
    loss: Array
    drive: Array
    numbers: tuple[float, float, float, float, float, float, float, float]


def plain(estimator: Estimator) -> Plain:
    """Constants of a vehicle with the lumped thermal model."""
    k, number = estimator.constants, estimator.constants.number
    if number.two_nodes:
        raise ValueError("the rivals know only the lumped thermal model")
    return Plain(
        k.assembly[:, at.TABLE].astype(np.int64),
        k.assembly[:, [at.CORE_CAPACITY, at.AREA, at.FILM_OFFSET, at.FILM_SLOPE]].copy(),
        k.assembly[:, at.FIRST_LOG_LOAD].copy(),
        k.assembly[:, at.STEP_LOG_LOAD].copy(),
        k.assembly[:, at.RADIUS].copy(),
        k.loss,
        k.drive,
        (
            number.first_x, number.step_x, number.glass_transition, number.wlf_c1, number.wlf_c2,
            number.bearing_friction, 0.5 * number.air_density * number.drag_area, number.rotating_mass_factor / GRAVITY,
        ),
    )  # fmt: skip


@compiled
def plain_loop(p: Any, time: Array, speeds: Array, accelerations: Array, loads: Array, ambient: float, temps: Array, out: Array) -> None:
    """The limit: one loop over the samples that does the arithmetic and nothing else.

    Fills `temps` (times, assemblies) [degC] and `out` (times, 4) [Nm]. No guards, no doubt, no status, no other column; the
    temperature takes the same exponential step as the estimator's.
    """
    first_x, step_x, tg, c1, c2, friction, drag, inertia = p.numbers
    assemblies = loads.shape[0]
    weight, arm = 0.0, 0.0
    for i in range(assemblies):
        weight += loads[i]
        arm += p.radius[i] * loads[i]
        temps[0, i] = ambient
    arm /= weight
    driving = 0.0
    for n in range(time.shape[0]):
        speed = speeds[n]
        before = speeds[n - 1] if n > 0 else speed
        middle = 0.5 * (before + speed)
        log_middle = math.log10(max(abs(middle), 1e-6))
        log_speed = math.log10(max(abs(speed), 1e-6))
        sign = math.tanh(speed / STANDSTILL_SPEED)
        own = 0.0
        for i in range(assemblies):
            table, log_load = p.table[i], math.log(loads[i])
            drive = driving * loads[i] / weight
            temp = temps[n - 1, i] if n > 0 else ambient
            if n > 0:
                dt = time[n] - time[n - 1]
                shift, shift_slope = log_shift_factor(temp, tg, c1, c2)
                force, slope = look_up(
                    p.loss, table, first_x, step_x, p.first_log_load[i], p.step_log_load[i], shift + log_middle, log_load
                )
                linear, square = look_up_drive(p.drive, table, first_x, step_x, shift + log_middle)
                force += drive * (linear + drive * square)
                cooling = (p.thermal[i, 2] + p.thermal[i, 3] * abs(middle)) * p.thermal[i, 1]
                growth = (slope * shift_slope * abs(middle) - cooling) / p.thermal[i, 0]
                rate = (force * abs(middle) - cooling * (temp - ambient)) / p.thermal[i, 0]
                temp += rate * (math.expm1(growth * dt) / growth)
            temps[n, i] = temp
            shift, _ = log_shift_factor(temp, tg, c1, c2)
            force, _ = look_up(
                p.loss, table, first_x, step_x, p.first_log_load[i], p.step_log_load[i], shift + log_speed, log_load
            )
            linear, square = look_up_drive(p.drive, table, first_x, step_x, shift + log_speed)
            own += p.radius[i] * (force + drive * (linear + drive * square)) * sign
        out[n, 0] = own
        out[n, 1] = arm * friction * weight * sign
        out[n, 2] = arm * drag * speed * abs(speed)
        out[n, 3] = arm * inertia * weight * accelerations[n]
        driving = out[n, 0] + out[n, 1] + out[n, 2] + out[n, 3]


def limit(p: Plain, road: Road) -> tuple[Array, Array]:
    """Temperatures (times, assemblies) [degC] and torques (times, 4) [Nm] by `plain_loop`."""
    temps, out = np.empty((len(road.time), len(road.loads))), np.empty((len(road.time), len(TORQUES)))
    plain_loop(p, road.time, road.speed, road.acceleration, road.loads, road.ambient, temps, out)
    return temps, out


def losses(p: Plain, temps: Array, speed: Array, loads: Array, drive: Array) -> Array:
    """Loss [N] from the table with numpy alone; temperatures, loads and drive torques broadcast over (..., assemblies)."""
    first_x, step_x, tg, c1, c2 = p.numbers[:5]
    above = temps - tg
    shift = np.where(above > 0.0, -c1 * (above - 50.0) / (c2 + above - 50.0), 0.0)
    below = above <= 0.0
    if below.any():  # the estimator's own continuation below the glass transition
        shift = np.where(below, np.vectorize(lambda t: log_shift_factor(t, tg, c1, c2)[0])(temps), shift)
    x = shift + np.log10(np.maximum(np.abs(speed), 1e-6))
    u = np.clip((x - first_x) / step_x, 0.0, p.loss.shape[1] - 1.000001)
    w = np.clip((np.log(loads) - p.first_log_load) / p.step_log_load, 0.0, p.loss.shape[2] - 1.000001)
    i, j = u.astype(np.intp), w.astype(np.intp)
    u, w = u - i, w - j
    t = p.table
    near = p.loss[t, i, j] * (1.0 - w) + p.loss[t, i, j + 1] * w
    far = p.loss[t, i + 1, j] * (1.0 - w) + p.loss[t, i + 1, j + 1] * w
    slope = p.drive[t, i] + u[..., np.newaxis] * (p.drive[t, i + 1] - p.drive[t, i])
    return np.asarray(near + u * (far - near) + drive * (slope[..., 0] + drive * slope[..., 1]))


def torques(p: Plain, road: Road, temps: Array) -> Array:
    """Torques (times, 4) [Nm] at all samples at once, from temperatures (times, assemblies)."""
    weight, friction, drag, inertia = road.loads.sum(), *p.numbers[5:]
    share = road.loads / weight
    arm = p.radius @ share
    sign = np.tanh(road.speed / STANDSTILL_SPEED)
    others = np.stack(
        [arm * friction * weight * sign, arm * drag * road.speed * np.abs(road.speed), arm * inertia * weight * road.acceleration],
        axis=1,
    )
    drive = others.sum(axis=1)
    for _ in range(2):  # the drive torque moves the loss by little: the second pass settles it
        force = losses(p, temps, road.speed[:, np.newaxis], road.loads, drive[:, np.newaxis] * share)
        own = (force @ p.radius) * sign
        drive = own + others.sum(axis=1)
    return np.concatenate([own[:, np.newaxis], others], axis=1)


@compiled
def rates(time: float, temps: Array, p: Any, step: float, speeds: Array, accelerations: Array, loads: Array, ambient: float) -> Array:
    """dT/dt [K/s] of all belts; the recorded speed is a straight line between samples."""
    first_x, step_x, tg, c1, c2, friction, drag, inertia = p.numbers
    place = min(max(time / step, 0.0), speeds.shape[0] - 1.000001)
    n = int(place)
    speed = speeds[n] + (place - n) * (speeds[n + 1] - speeds[n])
    log_speed, sign = math.log10(max(abs(speed), 1e-6)), math.tanh(speed / STANDSTILL_SPEED)
    weight, arm, own = 0.0, 0.0, 0.0
    rate = np.empty(loads.shape[0])
    for i in range(loads.shape[0]):
        weight += loads[i]
        arm += p.radius[i] * loads[i]
        shift, _ = log_shift_factor(temps[i], tg, c1, c2)
        rate[i], _ = look_up(
            p.loss, p.table[i], first_x, step_x, p.first_log_load[i], p.step_log_load[i], shift + log_speed, math.log(loads[i])
        )
        own += p.radius[i] * rate[i] * sign
    arm /= weight
    driving = own + arm * (friction * weight * sign + drag * speed * abs(speed) + inertia * weight * accelerations[n])
    for i in range(loads.shape[0]):
        shift, _ = log_shift_factor(temps[i], tg, c1, c2)
        linear, square = look_up_drive(p.drive, p.table[i], first_x, step_x, shift + log_speed)
        drive = driving * loads[i] / weight
        force = rate[i] + drive * (linear + drive * square)
        cooling = (p.thermal[i, 2] + p.thermal[i, 3] * abs(speed)) * p.thermal[i, 1]
        rate[i] = (force * abs(speed) - cooling * (temps[i] - ambient)) / p.thermal[i, 0]
    return rate


def by_solve_ivp(p: Plain, road: Road) -> tuple[Array, Array]:
    """scipy's LSODA by `solve_ivp`, its right-hand side compiled."""
    extra = (p, road.time[1] - road.time[0], road.speed, road.acceleration, road.loads, road.ambient)
    solved = solve_ivp(
        rates, (0.0, road.time[-1]), np.full(len(road.loads), road.ambient), "LSODA", road.time, args=extra,
        rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE_K,
    )  # fmt: skip
    if not solved.success:
        raise RuntimeError(solved.message)
    return solved.y.T, torques(p, road, solved.y.T)


def by_odeint(p: Plain, road: Road) -> tuple[Array, Array]:
    """scipy's LSODA by `odeint`, which asks for every sample inside compiled code."""
    extra = (p, road.time[1] - road.time[0], road.speed, road.acceleration, road.loads, road.ambient)
    temps = odeint(
        rates, np.full(len(road.loads), road.ambient), road.time, args=extra, tfirst=True, rtol=RELATIVE_TOLERANCE,
        atol=ABSOLUTE_TOLERANCE_K, mxstep=100_000,
    )  # fmt: skip
    return temps, torques(p, road, temps)


class PaperAlgorithm:
    """The paper's chain for every sample: contact iteration, strain history, its cycles or harmonics, heat, torque, temperature."""

    def __init__(self, estimator: Estimator, road: Road) -> None:
        vehicle = estimator.vehicle
        rubber, method = RubberModel(vehicle.rubber), METHODS[vehicle.hysteresis]
        self._p, self._road = plain(estimator), road
        tracks = [a.track for a in vehicle.assemblies]
        self._methods: list[tuple[LossMethod, NDArray[np.intp]]] = [
            (method(vehicle.tracks[name], rubber), np.flatnonzero([t == name for t in tracks])) for name in vehicle.tracks
        ]

    def _loss(self, speed: float, temps: Array, drive: Array) -> Array:
        force = np.empty(len(temps))
        for method, which in self._methods:
            force[which] = method.loss_force(speed, temps[which], self._road.loads[which], drive[which]).total
        return force

    def sample(self, n: int, temps: Array, driving: float) -> tuple[Array, Array]:
        """Temperatures [degC] and torques (4,) [Nm] at sample n from the temperatures and the drive torque [Nm] one before."""
        p, road = self._p, self._road
        speed, dt = float(road.speed[n]), float(road.time[n] - road.time[n - 1])
        force = self._loss(speed, temps, driving * road.loads / road.loads.sum())
        capacity, area, film_offset, film_slope = p.thermal.T
        cooling = (film_offset + film_slope * abs(speed)) * area
        after = temps + dt * (force * abs(speed) - cooling * (temps - road.ambient)) / capacity
        one = Road(road.time[n : n + 1], road.speed[n : n + 1], road.acceleration[n : n + 1], road.loads, road.ambient)
        parts = torques(p, one, after[np.newaxis])[0]
        parts[0] = (force @ p.radius) * math.tanh(speed / STANDSTILL_SPEED)
        return after, parts

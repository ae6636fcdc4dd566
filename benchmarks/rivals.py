# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Other ways to the temperatures and torques of a whole recording, to compare the estimator with.

All use the same loss table and the same recording, and give the same: temperature of each belt and the torques by part at
every sample.
"""

from __future__ import annotations

import functools
import math
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import odeint, solve_ivp

from trackres_ros.building.kernel_source import built_in
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.belt_heat import SLOWEST_LOG_SPEED
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.hysteresis import METHODS, LossMethod
from trackres_ros.model.loss_table import look_up, look_up_drive
from trackres_ros.model.rubber import REFERENCE_ABOVE_TG, RubberModel, log_shift_factor
from trackres_ros.units import GRAVITY, STANDSTILL_MPS

Array = NDArray[np.float64]

TORQUES = ("hysteresis_nm", "bearing_nm", "wind_nm", "inertia_nm")
# Settings of LSODA that keep its torque within 0.1 %, which bench_recording.py measures. Without a longest step it jumps over
# whole stops of the vehicle and errs by several percent.
RELATIVE_TOLERANCE = 1e-4
ABSOLUTE_TOLERANCE_K = 1e-2
LONGEST_STEP_S = 5.0
SLOWEST = 10.0**SLOWEST_LOG_SPEED  # m/s


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
    thermal: Annotated[Array, (None, 4)]  # capacity, area, film offset, film slope
    first_log_load: Array
    step_log_load: Array
    radius: Array
    loss: Annotated[Array, (None, None, None)]
    drive: Annotated[Array, (None, None, 2)]
    numbers: tuple[float, float, float, float, float, float, float, float]


def plain(estimator: Estimator) -> Plain:
    """Constants of a vehicle with the lumped thermal model."""
    k, number = estimator.constants, estimator.constants.number
    if number.two_nodes:
        raise ValueError("the rivals know only the lumped thermal model")
    return Plain(
        k.assembly[:, at.Assembly.table].astype(np.int64),
        k.assembly[:, [at.Assembly.capacity, at.Assembly.area, at.Assembly.film_offset, at.Assembly.film_slope]].copy(),
        k.assembly[:, at.Assembly.first_log_load].copy(),
        k.assembly[:, at.Assembly.step_log_load].copy(),
        k.assembly[:, at.Assembly.radius].copy(),
        k.loss,
        k.drive,
        (
            number.first_x, number.step_x, number.glass_transition, number.wlf_c1, number.wlf_c2,
            number.bearing_friction, 0.5 * number.air_density * number.drag_area, number.rotating_mass_factor / GRAVITY,
        ),
    )  # fmt: skip


@functools.cache
def in_c() -> ModuleType:
    """The kernels of this file, compiled as ours are.

    Raises
    ------
    RuntimeError
        There is no C compiler.
    """
    with tempfile.TemporaryDirectory() as folder:
        found = built_in(Path(folder), {"plain_loop": plain_loop, "rates": rates})
    if found is None:
        raise RuntimeError("no C compiler: install gcc")
    return found


def plain_loop(
    p: Plain, time: Array, speeds: Array, accelerations: Array, loads: Array, ambient: float,
    temps: Annotated[Array, (None, None)], out: Annotated[Array, (None, 4)],
) -> None:  # fmt: skip
    """The limit: one loop over the samples that does the arithmetic and nothing else.

    Fills `temps` (times, assemblies) [degC] and `out` (times, 4) [Nm]. No guards, no uncertainty, no status, no other column; the
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
        log_middle = math.log10(max(abs(middle), SLOWEST))
        log_speed = math.log10(max(abs(speed), SLOWEST))
        sign = math.tanh(speed / STANDSTILL_MPS)
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
                signed, unsigned = look_up_drive(p.drive, table, first_x, step_x, shift + log_middle)
                force += drive * signed + abs(drive) * unsigned
                cooling = (p.thermal[i, 2] + p.thermal[i, 3] * abs(middle)) * p.thermal[i, 1]
                growth = (slope * shift_slope * abs(middle) - cooling) / p.thermal[i, 0]
                rate = (force * abs(middle) - cooling * (temp - ambient)) / p.thermal[i, 0]
                temp += rate * (math.expm1(growth * dt) / growth)
            temps[n, i] = temp
            shift, _ = log_shift_factor(temp, tg, c1, c2)
            force, _ = look_up(
                p.loss, table, first_x, step_x, p.first_log_load[i], p.step_log_load[i], shift + log_speed, log_load
            )
            signed, unsigned = look_up_drive(p.drive, table, first_x, step_x, shift + log_speed)
            own += p.radius[i] * (force + drive * signed + abs(drive) * unsigned) * sign
        out[n, 0] = own
        out[n, 1] = arm * friction * weight * sign
        out[n, 2] = arm * drag * speed * abs(speed)
        out[n, 3] = arm * inertia * weight * accelerations[n]
        driving = out[n, 0] + out[n, 1] + out[n, 2] + out[n, 3]


def limit(p: Plain, road: Road) -> tuple[Array, Array]:
    """Temperatures (times, assemblies) [degC] and torques (times, 4) [Nm] by `plain_loop`."""
    temps, out = np.empty((len(road.time), len(road.loads))), np.empty((len(road.time), len(TORQUES)))
    in_c().plain_loop(p, road.time, road.speed, road.acceleration, road.loads, road.ambient, temps, out)
    return temps, out


def torques(p: Plain, road: Road, temps: Array) -> Array:
    """Torques (times, 4) [Nm] at all samples at once from temperatures (times, assemblies), with numpy alone."""
    first_x, step_x, tg, c1, c2, friction, drag, inertia = p.numbers
    speed, weight = road.speed, road.loads.sum()
    share = road.loads / weight
    arm = p.radius @ share
    sign = np.tanh(speed / STANDSTILL_MPS)
    above, span = temps - tg, c2 - REFERENCE_ABOVE_TG
    warm = np.maximum(above, 0.0)
    x = -c1 * (warm - REFERENCE_ABOVE_TG) / (span + warm) - c1 * c2 / span**2 * (above - warm)
    x += np.log10(np.maximum(np.abs(speed), SLOWEST))[:, np.newaxis]
    u = np.clip((x - first_x) / step_x, 0.0, p.loss.shape[1] - 1.000001)
    i = u.astype(np.intp)
    u -= i
    w = np.clip((np.log(road.loads) - p.first_log_load) / p.step_log_load, 0.0, p.loss.shape[2] - 1.000001)
    own, linear, square = np.zeros(len(speed)), np.zeros(len(speed)), np.zeros(len(speed))
    for n, column in enumerate(w.astype(np.intp)):  # loads are constant: one column of the table an assembly
        part = w[n] - column
        curve = p.loss[p.table[n], :, column] * (1.0 - part) + p.loss[p.table[n], :, column + 1] * part
        before, after = i[:, n], i[:, n] + 1
        own += p.radius[n] * (curve[before] + u[:, n] * (curve[after] - curve[before]))
        for total, power in ((linear, 0), (square, 1)):
            coefficient = p.drive[p.table[n], :, power]
            value = coefficient[before] + u[:, n] * (coefficient[after] - coefficient[before])
            total += p.radius[n] * share[n] ** (power + 1) * value
    bearing, wind = arm * friction * weight * sign, arm * drag * speed * np.abs(speed)
    accelerating = arm * inertia * weight * road.acceleration
    hysteresis = own * sign
    for _ in range(2):  # the drive torque moves the loss by little: the second pass settles it
        driving = hysteresis + bearing + wind + accelerating
        hysteresis = (own + driving * (linear + driving * square)) * sign
    return np.stack([hysteresis, bearing, wind, accelerating], axis=1)


def rates(
    time: float,
    temps: Array,
    p: Plain,
    step: float,
    speeds: Array,
    accelerations: Array,
    loads: Array,
    ambient: float,
    rate: Array,
) -> None:
    """dT/dt [K/s] of all belts; the recorded speed is a straight line between samples."""
    first_x, step_x, tg, c1, c2, friction, drag, inertia = p.numbers
    place = min(max(time / step, 0.0), speeds.shape[0] - 1.000001)
    n = int(place)
    speed = speeds[n] + (place - n) * (speeds[n + 1] - speeds[n])
    log_speed, sign = math.log10(max(abs(speed), SLOWEST)), math.tanh(speed / STANDSTILL_MPS)
    weight, arm, own = 0.0, 0.0, 0.0
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
        signed, unsigned = look_up_drive(p.drive, p.table[i], first_x, step_x, shift + log_speed)
        drive = driving * loads[i] / weight
        force = rate[i] + drive * signed + abs(drive) * unsigned
        cooling = (p.thermal[i, 2] + p.thermal[i, 3] * abs(speed)) * p.thermal[i, 1]
        rate[i] = (force * abs(speed) - cooling * (temps[i] - ambient)) / p.thermal[i, 0]


def _rates(time: float, temps: Array, *more: Any) -> Array:
    """`rates` as the solvers call it."""
    rate = np.empty(len(temps))
    in_c().rates(time, temps, *more, rate)
    return rate


def _extra(p: Plain, road: Road) -> tuple[Any, ...]:
    return in_c().bind_plain(p), road.time[1] - road.time[0], road.speed, road.acceleration, road.loads, road.ambient


def by_solve_ivp(p: Plain, road: Road) -> tuple[Array, Array]:
    """LSODA by `solve_ivp` with a compiled right-hand side: temperatures and torques as `limit` gives them."""
    solved = solve_ivp(
        _rates, (road.time[0], road.time[-1]), np.full(len(road.loads), road.ambient), "LSODA", road.time, args=_extra(p, road),
        rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE_K, max_step=LONGEST_STEP_S,
    )  # fmt: skip
    if not solved.success:
        raise RuntimeError(solved.message)
    temps = np.ascontiguousarray(solved.y.T)
    return temps, torques(p, road, temps)


def by_odeint(p: Plain, road: Road) -> tuple[Array, Array]:
    """LSODA by `odeint`, the same right-hand side."""
    temps = odeint(
        _rates, np.full(len(road.loads), road.ambient), road.time, args=_extra(p, road), tfirst=True,
        rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE_K, hmax=LONGEST_STEP_S,
    )  # fmt: skip
    return temps, torques(p, road, temps)


def by_odeint_each_sample(p: Plain, road: Road) -> tuple[Array, Array]:
    """LSODA started anew at every sample, as where the next speed is not known yet."""
    temps = np.empty((len(road.time), len(road.loads)))
    temps[0] = road.ambient
    extra = _extra(p, road)
    for n in range(1, len(road.time)):
        temps[n] = odeint(
            _rates, temps[n - 1], road.time[n - 1 : n + 1], args=extra, tfirst=True, rtol=RELATIVE_TOLERANCE,
            atol=ABSOLUTE_TOLERANCE_K,
        )[1]  # fmt: skip
    return temps, torques(p, road, temps)


class PaperAlgorithm:
    """The paper's chain for every sample: contact iteration, strain history, cycles or harmonics, heat, torque, temperature."""

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
        friction, drag, inertia = p.numbers[5:]
        weight, sign = road.loads.sum(), math.tanh(speed / STANDSTILL_MPS)
        arm = (p.radius @ road.loads) / weight
        others = friction * weight * sign, drag * speed * abs(speed), inertia * weight * road.acceleration[n]
        return after, np.array([(force @ p.radius) * sign, *(arm * each for each in others)])

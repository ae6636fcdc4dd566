# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figure 24, torque at five speeds, each reached in a ramp, and the claims of section 4.2.1 and conclusion 2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from proofs.reproduce.bench import COMBINATIONS, Array, Bench
from proofs.reproduce.families import (
    Family,
    draw_combinations,
    draw_family,
    falls,
    run_family,
    same_stable,
    section_of,
)
from proofs.reproduce.section import FAILS, HOLDS, IN_PART, Claim, Section, percent, percents, span
from trackres_ros.estimator.drives import SimulatedDrive, ramp_and_hold
from trackres_ros.units import KMH_PER_MPS

SPEEDS_KMH = (10.0, 20.0, 30.0, 40.0, 50.0)
RAMP_S = 50.0
DURATION_S = 2500.0
TIMES_S = (50.0, 250.0, 600.0, 1000.0, 2500.0)
COMPARED_S = 250.0
FALLEN = 0.9  # settled, one reading: this share of the fall to the stable value is done
NEAR = 0.05  # the other: within this share of the stable value
WHERE = "section 4.2.1, Figure 24, conclusion 2"
ENDS = f"{SPEEDS_KMH[0]:g} and {SPEEDS_KMH[-1]:g} km/h"


def speeds(bench: Bench, out: Path) -> Section:
    """The figure and its claims."""

    def case(kmh: float) -> tuple[SimulatedDrive, None, None]:
        return ramp_and_hold(kmh / KMH_PER_MPS, RAMP_S, DURATION_S, bench.dt), None, None

    family = run_family(bench, "fig24_speeds", "speed [km/h]", "kmh", SPEEDS_KMH, case)
    vehicle, reached = bench.vehicle, {RAMP_S: "speed reached"}
    caption = "Resistance torque and belt temperature at five speeds (the paper's Figure 24)"
    title = f"{vehicle.weight / 1e3:g} kN, ambient {vehicle.chassis.ambient:g} °C, ramp of {RAMP_S:g} s"
    combined = "The same with every combination of loss method and thermal model; dashes at the right: the stable values."
    figures = [
        draw_family(out, family, bench.shipped, caption, title, reached),
        draw_combinations(out, family, combined, reached),
    ]
    held = RAMP_S + 2 * bench.dt  # the belt strain by the drive lags one step behind the torque
    claims = [
        falls("speeds", WHERE, family, held),
        same_stable(
            "speeds",
            WHERE,
            "All speeds tend to the same stable torque.",
            family,
            "Stable is F_h(T*) v = U(v) A (T* - Ta). A higher speed raises the loss modulus and the wind, and "
            "warms the belt more. The two effects pull against each other, so the stable values come close, but "
            "nothing makes them equal.",
        ),
        _warms_faster(family, held),
        _settles_sooner(family, held),
        _slower_is_larger(family, held),
    ]
    text = [
        f"From rest to each speed in {RAMP_S:g} s, then held to {DURATION_S:g} s. Resistance torque is hysteresis, bearings "
        "and wind of the whole vehicle. The inertia of the ramp is not included, as the paper excludes the first 50 s from "
        "its analysis.",
    ]
    return section_of(bench, family, "Figure 24: speed", TIMES_S, figures, claims, text)


def settling_times(family: Family, combination: str, start_s: float) -> tuple[Array, Array]:
    """Seconds from `start_s` until `FALLEN` of the fall is done, and until within `NEAR` of the stable value, shape (speeds,).

    Infinite where it is not reached within the run.
    """
    time = family.series(combination)[0]["time_s"]
    time = time[time >= start_s - 1e-9] - start_s
    torque, stable = family.torque(combination, start_s), family.stable_torque(combination)[:, np.newaxis]

    def first(hit: NDArray[np.bool_]) -> Array:
        return np.where(hit.any(axis=1), time[hit.argmax(axis=1)], np.inf)

    return (
        first(np.asarray(torque - stable <= (1.0 - FALLEN) * (torque[:, :1] - stable))),
        first(np.asarray(torque <= (1.0 + NEAR) * stable)),
    )


def _warms_faster(family: Family, start_s: float) -> Claim:
    rise = family.warmed(COMPARED_S)
    ordered = {}
    for c in COMBINATIONS:
        belts = np.stack([s["belt_degc"][s["time_s"] >= start_s - 1e-9] for s in family.series(c)])
        ordered[c] = bool((np.diff(belts, axis=0) > 0).all())
    return Claim(
        "faster_warms_faster",
        "section 4.2.1",
        "At a higher speed the temperature of the track rises faster.",
        ordered,
        f"By {COMPARED_S:g} s the belt has warmed {span((r[-1] / r[0] for r in rise.values()), 1)} times as much at "
        f"{SPEEDS_KMH[-1]:g} as at {SPEEDS_KMH[0]:g} km/h.",
        {HOLDS: "Heat is loss per metre times speed; the film coefficient grows much less than the speed."},
        {"rise_k": {c: r.tolist() for c, r in rise.items()}},
        {f"rise by {COMPARED_S:g} s at {ENDS}": {c: f"{r[0]:.1f} and {r[-1]:.1f} K" for c, r in rise.items()}},
    )


def _settles_sooner(family: Family, start_s: float) -> Claim:
    times = {c: settling_times(family, c, start_s) for c in COMBINATIONS}
    names = (f"{percent(FALLEN, 0)} of the fall", f"within {percent(NEAR, 0)}")

    def sooner(seconds: Array) -> bool:
        return bool((seconds[1:] <= seconds[:-1]).all() and seconds[-1] < seconds[0])

    def as_text(seconds: Array) -> str:
        return ", ".join("later" if np.isinf(t) else f"{t:.0f}" for t in seconds)

    return Claim(
        "faster_settles_sooner",
        WHERE,
        "At a higher speed the torque comes to its stable value sooner.",
        {name: all(sooner(times[c][i]) for c in COMBINATIONS) for i, name in enumerate(names)},
        "The paper gives no measure, so two are used, both from the end of the ramp. One is the time until "
        f"{percent(FALLEN, 0)} of the fall "
        f"to the stable value is done. The other is the time until the torque is within {percent(NEAR, 0)} of it.",
        {
            HOLDS: "The time constant is C / (U A - F_h' v). The film coefficient U grows with the speed, and so does the heat "
            "-F_h' v that a warmer belt saves.",
            IN_PART: "The time constant is C / (U A - F_h' v). U and -F_h' v grow with the speed, so a share of the fall is done "
            "sooner. But a slow speed warms the belt little and has little to fall: it is near its stable value from the "
            "start.",
        },
        {
            "seconds": {
                c: {name: [None if np.isinf(t) else float(t) for t in times[c][i]] for i, name in enumerate(names)}
                for c in COMBINATIONS
            }
        },
        {
            f"{name} after, {SPEEDS_KMH[0]:g} to {SPEEDS_KMH[-1]:g} km/h [s]": {c: as_text(times[c][i]) for c in COMBINATIONS}
            for i, name in enumerate(names)
        },
    )


def _order_from(torque: Array, time: Array) -> float | None:
    """Time [s] from which on the torque falls strictly from the slowest to the fastest, None if it does not at the end."""
    ordered = np.asarray(np.all(np.diff(torque, axis=0) < 0, axis=0))
    if not ordered[-1]:
        return None
    broken = np.flatnonzero(~ordered)
    return float(time[broken[-1] + 1]) if len(broken) else float(time[0])


def _slower_is_larger(family: Family, start_s: float) -> Claim:
    time = family.series(COMBINATIONS[0])[0]["time_s"]
    time = time[time >= start_s - 1e-9]
    torque = {c: family.torque(c, start_s) for c in COMBINATIONS}
    share = {c: float((np.diff(m, axis=0) < 0).all(axis=0).mean()) for c, m in torque.items()}
    total = {c: _order_from(m, time) for c, m in torque.items()}
    hysteresis = {c: _order_from(family.torque(c, start_s, "hysteresis_nm"), time) for c in COMBINATIONS}
    at = {c: m[:, int(np.argmin(np.abs(time - COMPARED_S)))] for c, m in torque.items()}

    def since(order: dict[str, float | None]) -> dict[str, str]:
        return {c: "never" if t is None else f"from {t:.0f} s on" for c, t in order.items()}

    return Claim(
        "slower_is_larger",
        WHERE,
        "At the same time the torque is the larger, the lower the speed.",
        {c: share[c] == 1.0 for c in COMBINATIONS},
        f"The torques of all five speeds are in this order during {percents(share.values(), 0)} of the time at constant speed. "
        f"At {COMPARED_S:g} s the torque at {SPEEDS_KMH[-1]:g} km/h is {span((m[-1] / m[0] for m in at.values()), 2)} times that "
        f"at {SPEEDS_KMH[0]:g} km/h. When the hysteresis torque alone, without wind and bearings, is in this order, is the last "
        "but one column.",
        {
            FAILS: "At equal temperature a higher speed means a higher frequency, and the loss modulus rises with frequency "
            "(Figure 16). The wind rises with the square of the speed. The order can turn only as the faster belt warms, "
            "which takes hundreds of seconds, and only where warming does more than frequency and wind.",
            IN_PART: "A higher speed means a higher frequency and loss modulus; "
            "the order can turn only as the faster belt warms.",
        },
        {
            "share_of_time_in_order": share,
            "order_from_s": total,
            "hysteresis_order_from_s": hysteresis,
            "at_250_s_nm": {c: m.tolist() for c, m in at.items()},
            "at_end_nm": {c: m[:, -1].tolist() for c, m in torque.items()},
        },
        {
            f"torque at {COMPARED_S:g} s, {ENDS}": {c: f"{m[0]:.0f} and {m[-1]:.0f} Nm" for c, m in at.items()},
            f"at {DURATION_S:g} s": {c: f"{m[0, -1]:.0f} and {m[-1, -1]:.0f} Nm" for c, m in torque.items()},
            "torque in the paper's order": since(total),
            "hysteresis torque in the paper's order": since(hysteresis),
        },
    )

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figures 24 to 26, torque at five speeds, four weights and four ambient temperatures, and the claims of section 4.2
and conclusions 2 to 4.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from proofs.reproduce.bench import (
    COMBINATIONS,
    FAILS,
    HOLDS,
    IN_PART,
    METHODS,
    SAME,
    THERMAL,
    Bench,
    Claim,
    Family,
    Figure,
    Section,
    colours,
    draw_family,
    falls,
    listed,
    mark_time,
    percent,
    percents,
    run_family,
    same_stable,
    section_of,
    span,
)
from trackres_ros.arrays import Array
from trackres_ros.estimator.drives import SimulatedDrive, ramp_and_hold
from trackres_ros.output.style import legend_beside, picture, thin_out
from trackres_ros.units import KMH_PER_MPS

SPEEDS_KMH = (10.0, 20.0, 30.0, 40.0, 50.0)
SPEED_KMH = 50.0  # of the studies of weight and ambient temperature
RAMP_S = 50.0
DURATION_S = 2500.0
TIMES_S = (50.0, 250.0, 600.0, 1000.0, 2500.0)
COMPARED_S = 250.0
FALLEN = 0.9  # settled, one reading: this share of the fall to the stable value is done
NEAR = 0.05  # the other: within this share of the stable value
SPEEDS_WHERE = "section 4.2.1, Figure 24, conclusion 2"
SPEEDS_ENDS = f"{SPEEDS_KMH[0]:g} and {SPEEDS_KMH[-1]:g} km/h"


def speeds(bench: Bench, out: Path) -> Section:
    """The figure and its claims."""

    def case(kmh: float) -> tuple[SimulatedDrive, None, None]:
        return ramp_and_hold(kmh / KMH_PER_MPS, RAMP_S, DURATION_S, bench.dt), None, None

    family = run_family(bench, "fig24_speeds", "speed [km/h]", "kmh", SPEEDS_KMH, case)
    vehicle, reached = bench.vehicle, {RAMP_S: "speed reached"}
    caption = "Resistance torque and belt temperature at five speeds (the paper's Figure 24)"
    title = f"{vehicle.weight / 1e3:g} kN, ambient {vehicle.chassis.ambient:g} °C, ramp of {RAMP_S:g} s"
    figures = [draw_family(out, family, bench.shipped, caption, title, reached)]
    held = RAMP_S + 2 * bench.dt  # the belt strain by the drive lags one step behind the torque
    claims = [
        falls("speeds", SPEEDS_WHERE, family, held),
        same_stable(
            "speeds",
            SPEEDS_WHERE,
            "All speeds tend to the same stable torque.",
            family,
            "A higher speed raises the loss modulus and the wind, and warms the belt more. The two pull against each other, so "
            "the stable torques come close; nothing makes them equal.",
        ),
        _warms_faster(family, held),
        _settles_sooner(family, held),
        _slower_is_larger(family, held),
    ]
    text = [
        f"From rest to each speed in {RAMP_S:g} s, then held to {DURATION_S:g} s. Resistance torque is hysteresis, bearings "
        "and wind of the whole vehicle, without inertia.",
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
        {f"rise by {COMPARED_S:g} s at {SPEEDS_ENDS}": {c: f"{r[0]:.1f} and {r[-1]:.1f} K" for c, r in rise.items()}},
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
        SPEEDS_WHERE,
        "At a higher speed the torque comes to its stable value sooner.",
        {name: all(sooner(times[c][i]) for c in COMBINATIONS) for i, name in enumerate(names)},
        f"The paper gives no measure. Here it is the time until {percent(FALLEN, 0)} of the fall is done, and the time until the "
        f"torque is within {percent(NEAR, 0)} of its stable value.",
        {
            HOLDS: "The time constant is C / (U A - F_h' v). The film coefficient U grows with the speed, and so does the heat "
            "-F_h' v that a warmer belt saves.",
            IN_PART: "The time constant C / (U A - F_h' v) falls with speed, so a share of the fall is done sooner. But a slow "
            "speed warms the belt little, so its torque is near the stable value from the start.",
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


def _first_order(order: dict[str, float | None]) -> str:
    """Between which times, over the combinations, an order holds from then on."""
    times = [time for time in order.values() if time is not None]
    return f"after {span(times)} s" if len(times) == len(order) else "with some combinations only" if times else "never"


def _slower_is_larger(family: Family, start_s: float) -> Claim:
    time = family.series(COMBINATIONS[0])[0]["time_s"]
    time = time[time >= start_s - 1e-9]
    torque = {c: family.torque(c, start_s) for c in COMBINATIONS}
    share = {c: float((np.diff(m, axis=0) < 0).all(axis=0).mean()) for c, m in torque.items()}
    total = {c: _order_from(m, time) for c, m in torque.items()}
    hysteresis = {c: _order_from(family.torque(c, start_s, "hysteresis_nm"), time) for c in COMBINATIONS}
    torques = {c: m[:, int(np.argmin(np.abs(time - COMPARED_S)))] for c, m in torque.items()}

    def since(order: dict[str, float | None]) -> dict[str, str]:
        return {c: "never" if t is None else f"from {t:.0f} s on" for c, t in order.items()}

    return Claim(
        "slower_is_larger",
        SPEEDS_WHERE,
        "At the same time the torque is the larger, the lower the speed.",
        {c: share[c] == 1.0 for c in COMBINATIONS},
        f"The torques of all five speeds are in this order during {percents(share.values(), 0)} of the time at constant speed. "
        f"At {COMPARED_S:g} s the torque at {SPEEDS_KMH[-1]:g} km/h is {span((m[-1] / m[0] for m in torques.values()), 2)} times "
        f"that at {SPEEDS_KMH[0]:g} km/h. Hysteresis alone comes into this order {_first_order(hysteresis)}.",
        {
            FAILS: "A higher speed means a higher frequency, a larger loss modulus and more wind. Only the warming of the faster "
            "belt can turn the order, after hundreds of seconds.",
            IN_PART: "A higher speed means a higher frequency and loss modulus; "
            "the order can turn only as the faster belt warms.",
        },
        {
            "share_of_time_in_order": share,
            "order_from_s": total,
            "hysteresis_order_from_s": hysteresis,
            "at_250_s_nm": {c: m.tolist() for c, m in torques.items()},
            "at_end_nm": {c: m[:, -1].tolist() for c, m in torque.items()},
        },
        {
            f"torque at {COMPARED_S:g} s, {SPEEDS_ENDS}": {c: f"{m[0]:.0f} and {m[-1]:.0f} Nm" for c, m in torques.items()},
            f"at {DURATION_S:g} s": {c: f"{m[0, -1]:.0f} and {m[-1, -1]:.0f} Nm" for c, m in torque.items()},
            "torque in the paper's order": since(total),
            "hysteresis torque in the paper's order": since(hysteresis),
        },
    )


WEIGHTS_KN = (200.0, 250.0, 300.0, 350.0)
WEIGHTS_WHERE = "section 4.2.2, Figure 25, conclusion 3"
WEIGHTS_ENDS = f"{WEIGHTS_KN[0]:g} and {WEIGHTS_KN[-1]:g} kN"


def weights(bench: Bench, out: Path) -> Section:
    """The figure and its claims."""
    drive = ramp_and_hold(SPEED_KMH / KMH_PER_MPS, RAMP_S, DURATION_S, bench.dt)
    family = run_family(bench, "fig25_weights", "weight [kN]", "kn", WEIGHTS_KN, lambda kn: (drive, kn * 1e3, None))
    caption = "Resistance torque and belt temperature at four weights (the paper's Figure 25)"
    title = f"{SPEED_KMH:g} km/h, ambient {bench.vehicle.chassis.ambient:g} °C, ramp of {RAMP_S:g} s"
    figures = [draw_family(out, family, bench.shipped, caption, title, {RAMP_S: "speed reached"})]
    claims = [
        falls("weights", WEIGHTS_WHERE, family, RAMP_S + 2 * bench.dt),
        _different_stable(family),
        _heavier_is_larger(family),
    ]
    text = [
        f"From rest to {SPEED_KMH:g} km/h in {RAMP_S:g} s, then held to {DURATION_S:g} s.",
    ]
    return section_of(bench, family, "Figure 25: load", TIMES_S, figures, claims, text)


def _different_stable(family: Family) -> Claim:
    stable = {c: family.stable_torque(c) for c in COMBINATIONS}
    least = {c: float(np.min(np.diff(m) / m[:-1])) for c, m in stable.items()}
    return Claim(
        "weights_different_stable_values",
        WEIGHTS_WHERE,
        "Different loads tend to different stable torques.",
        {c: least[c] > SAME for c in COMBINATIONS},
        f"Neighbouring weights differ by at least {percent(min(least.values()))} when stable.",
        {
            HOLDS: "The loss of a contact goes about as the power 4/3 of its load, and bearing friction as the load. The warmer "
            "belt takes back a part."
        },
        {"least_difference": least, "stable_nm": {c: m.tolist() for c, m in stable.items()}},
        {
            f"stable torque, {WEIGHTS_ENDS}": {c: f"{m[0]:.0f} and {m[-1]:.0f} Nm" for c, m in stable.items()},
            "least difference between neighbours": {c: percent(d) for c, d in least.items()},
        },
    )


def _heavier_is_larger(family: Family) -> Claim:
    moving = {c: np.stack([s["resistance_torque_nm"][s["speed_mps"] > 0.0] for s in family.series(c)]) for c in COMBINATIONS}
    least = {c: float(np.min(np.diff(m, axis=0))) for c, m in moving.items()}
    exponent = {c: float(np.log(m[-1, -1] / m[0, -1]) / np.log(WEIGHTS_KN[-1] / WEIGHTS_KN[0])) for c, m in moving.items()}
    return Claim(
        "heavier_is_larger",
        WEIGHTS_WHERE,
        "At any moment the torque increases with the load.",
        {c: least[c] > 0 for c in COMBINATIONS},
        f"At all times in motion each weight has at least {min(least.values()):.0f} Nm more torque than the next lighter one.",
        {HOLDS: "A warmer belt takes back a part of the larger loss, never all: with no larger loss it would be no warmer."},
        {"least_difference_nm": least, "exponent": exponent},
        {
            "least difference between neighbours": {c: f"{m:.0f} Nm" for c, m in least.items()},
            f"at {DURATION_S:g} s the torque goes as the weight to the power": {c: f"{e:.2f}" for c, e in exponent.items()},
        },
    )


AMBIENTS_DEGC = (-15.0, 0.0, 15.0, 30.0)
WEIGHT_N = 300e3
PAPER_END_S = 1000.0
CROSSING_S = 250.0
AMBIENTS_TIMES_S = (0.0, 250.0, 600.0, 1000.0, 2500.0)
AMBIENTS_WHERE = "section 4.2.3, Figure 26, conclusion 4"
AMBIENTS_ENDS = f"{AMBIENTS_DEGC[0]:g} and {AMBIENTS_DEGC[-1]:g} °C"
CROSSING = "paper's crossing"


def ambients(bench: Bench, out: Path) -> Section:
    """The figure and its claims."""
    drive = ramp_and_hold(SPEED_KMH / KMH_PER_MPS, 0.0, DURATION_S, bench.dt)
    family = run_family(bench, "fig26_ambients", "ambient [°C]", "degc", AMBIENTS_DEGC, lambda degc: (drive, WEIGHT_N, degc))
    caption = "Resistance torque and belt temperature at four ambient temperatures (the paper's Figure 26)"
    title = f"constant {SPEED_KMH:g} km/h, {WEIGHT_N / 1e3:g} kN, belt at ambient at the start"
    figures = [
        draw_family(out, family, bench.shipped, caption, title, {CROSSING_S: CROSSING, PAPER_END_S: "paper's end"}),
        _draw_differences(out, family),
    ]
    claims = [
        falls("ambients", AMBIENTS_WHERE, family, 2 * bench.dt),
        same_stable(
            "ambients",
            AMBIENTS_WHERE,
            "All ambient temperatures tend to the same stable torque.",
            family,
            "Stable is F_h(T*) v = U A (T* - Ta). With s = -F_h' v / (U A), dT*/dTa = 1 / (1 + s): a warmer ambient leaves a "
            "warmer belt.",
        ),
        _colder_is_larger_first(family),
        _warmer_is_larger_later(family),
        _colder_warms_more(family),
    ]
    kept = {
        c: [(family.stable[b][c].belt_degc - family.stable[a][c].belt_degc) / (b - a) for a, b in pairwise(AMBIENTS_DEGC)]
        for c in COMBINATIONS
    }
    text = [
        f"Constant {SPEED_KMH:g} km/h and {WEIGHT_N / 1e3:g} kN from the start; the belt starts at the ambient temperature. The "
        f"run goes on to {DURATION_S:g} s beyond the paper's {PAPER_END_S:g} s. Of a difference in ambient temperature, the "
        f"stable belt keeps {percents((share for shares in kept.values() for share in shares), 0)}.",
    ]
    return section_of(bench, family, "Figure 26: ambient temperature", AMBIENTS_TIMES_S, figures, claims, text, kept_share=kept)


def differences(family: Family, combination: str) -> Array:
    """Torque of each ambient less that of the next warmer one [Nm], shape (ambients - 1, times)."""
    return -np.diff(family.torque(combination, 0.0), axis=0)


def _draw_differences(out: Path, family: Family) -> Figure:
    figure = Figure(
        f"{family.name}_differences.png",
        (f"{family.name}.csv",),
        "Torque of each ambient temperature less that of the next warmer one, on a logarithmic axis. A crossing "
        "would show as a line that drops out of the picture.",
    )
    with picture(out / figure.png, 9.0, 5.6) as drawing:
        panels = drawing.subplots(len(METHODS), len(THERMAL), sharex=True, sharey=True)
        for axes, combination in zip(panels.flat, COMBINATIONS, strict=True):
            time = family.series(combination)[0]["time_s"]
            pairs = zip(colours(family)[1:], pairwise(AMBIENTS_DEGC), differences(family, combination), strict=True)
            for colour, (colder, warmer), difference in pairs:
                shown = np.where(difference > 0.0, difference, np.nan)
                axes.plot(*thin_out(time, shown), color=colour, label=f"{colder:g} less {warmer:g}")
            axes.set_yscale("log")
            axes.set_title(combination.replace("/", ", "))
            axes.margins(x=0.01)
            mark_time(axes, CROSSING_S, CROSSING)
        for axes in panels[:, 0]:
            axes.set_ylabel("torque difference [Nm]")
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        legend_beside(panels[0, -1], "ambients [°C]")
    return figure


def _colder_is_larger_first(family: Family) -> Claim:
    time = family.series(COMBINATIONS[0])[0]["time_s"]
    least = {c: float(differences(family, c)[:, time <= CROSSING_S].min()) for c in COMBINATIONS}
    start = {c: family.torque(c, 0.0)[:, 0] for c in COMBINATIONS}
    return Claim(
        "colder_is_larger_first",
        AMBIENTS_WHERE,
        "Within 0-250 s the torque at a lower ambient temperature is higher.",
        {c: least[c] > 0 for c in COMBINATIONS},
        f"Up to {CROSSING_S:g} s each ambient temperature has at least {min(least.values()):.0f} Nm more torque than the next "
        "warmer one.",
        {HOLDS: "The loss modulus is larger in the cold (Figure 16)."},
        {"least_difference_nm": least},
        {
            f"torque at the start, {AMBIENTS_ENDS}": {c: f"{m[0]:.0f} and {m[-1]:.0f} Nm" for c, m in start.items()},
            f"least difference up to {CROSSING_S:g} s": {c: f"{m:.0f} Nm" for c, m in least.items()},
        },
    )


def _warmer_is_larger_later(family: Family) -> Claim:
    time = family.series(COMBINATIONS[0])[0]["time_s"]
    later = {c: differences(family, c)[:, time > CROSSING_S] for c in COMBINATIONS}
    least = {c: float(m.min()) for c, m in later.items()}
    stable = {c: float(np.min(-np.diff(family.stable_torque(c)))) for c in COMBINATIONS}
    belts = {c: float(np.diff(np.stack([s["belt_degc"] for s in family.series(c)]), axis=0).min()) for c in COMBINATIONS}
    crosses = {c: bool((m < 0).any()) for c, m in later.items()}
    results = [c for c in COMBINATIONS if crosses[c]]
    return Claim(
        "warmer_is_larger_later",
        AMBIENTS_WHERE,
        "After 250 s the torque at a higher ambient temperature is slightly higher (section "
        "4.2.3 says so once, and the opposite a few lines below).",
        crosses,
        (f"There is a crossing with {listed(results)}. " if results else "There is no crossing. ")
        + f"The colder ambient temperature has at least {min(least.values()):.0f} Nm more torque up to {DURATION_S:g} s, and "
        f"{min(stable.values()):.0f} Nm more when stable. Its belt is at all times the colder one, by at least "
        f"{min(belts.values()):.1f} K.",
        {
            FAILS: "To overtake, the colder belt would first have to be as warm as the other. At that moment both make the same "
            "heat, and the one in colder air loses more of it. So it stays the colder one, with the larger loss.",
            IN_PART: "A crossing needs the belt in colder air to become the warmer one.",
        },
        {"least_difference_nm": least, "least_difference_stable_nm": stable, "least_belt_difference_k": belts},
        {
            f"least difference {CROSSING_S:g}-{DURATION_S:g} s": {c: f"{m:.0f} Nm" for c, m in least.items()},
            "when stable": {c: f"{m:.0f} Nm" for c, m in stable.items()},
            "least belt temperature difference": {c: f"{k:.1f} K" for c, k in belts.items()},
        },
    )


def _colder_warms_more(family: Family) -> Claim:
    rise = family.warmed(CROSSING_S)
    return Claim(
        "colder_warms_more",
        AMBIENTS_WHERE,
        "At a low ambient temperature much heat is generated and the track warms rapidly.",
        {c: bool((np.diff(r) < 0).all()) for c, r in rise.items()},
        f"In the first {CROSSING_S:g} s the belt warms {percents((r[0] / r[-1] - 1.0 for r in rise.values()), 0)} more at "
        f"{AMBIENTS_DEGC[0]:g} than at {AMBIENTS_DEGC[-1]:g} °C.",
        {HOLDS: "A larger loss modulus makes more heat per metre."},
        {"rise_k": {c: r.tolist() for c, r in rise.items()}},
        {f"rise by {CROSSING_S:g} s, {AMBIENTS_ENDS}": {c: f"{r[0]:.1f} and {r[-1]:.1f} K" for c, r in rise.items()}},
    )

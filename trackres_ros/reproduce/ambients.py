"""Figure 26: torque at four ambient temperatures; the claims of section 4.2.3 and conclusion 4."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.plots import legend_beside, picture, thinned
from trackres_ros.reproduce.bench import COMBINATIONS, KMH_PER_MPS, METHODS, THERMAL, Bench, at_times
from trackres_ros.reproduce.families import (
    Family,
    colours,
    draw_combinations,
    draw_family,
    family_numbers,
    run_family,
    stable_table,
    time_table,
)
from trackres_ros.reproduce.output import mark_time
from trackres_ros.reproduce.section import FAILS, HOLDS, Claim, Figure, Section, listed, percent
from trackres_ros.reproduce.speeds import falls, same_stable
from trackres_ros.simulate import ramp_and_hold

Array = NDArray[np.float64]

AMBIENTS_DEGC = (-15.0, 0.0, 15.0, 30.0)
SPEED_KMH = 50.0
WEIGHT_N = 300e3
PAPER_END_S = 1000.0
DURATION_S = 2500.0
CROSSING_S = 250.0
TIMES_S = (0.0, 250.0, 600.0, 1000.0, 2500.0)


def ambients(bench: Bench, out: Path) -> Section:
    """The figure and its claims."""
    drive = ramp_and_hold(SPEED_KMH / KMH_PER_MPS, 0.0, DURATION_S, bench.dt)
    family = run_family(bench, "fig26_ambients", "ambient [°C]", "degc", AMBIENTS_DEGC, lambda degc: (drive, WEIGHT_N, degc))
    marks = {CROSSING_S: "paper's crossing", PAPER_END_S: "paper's end"}
    figures = [draw_family(out, family, bench.shipped, f"Resistance torque and belt temperature at four ambient temperatures (the paper's Figure 26), {bench.shipped}.",
                           f"constant {SPEED_KMH:g} km/h, {WEIGHT_N / 1e3:g} kN, belt at ambient at the start, {bench.shipped.replace('/', ', ')}", marks),
               _draw_differences(out, family),
               draw_combinations(out, family, "Torque with every combination of loss method and thermal model; dashes at the right: the stable values.",
                                 {CROSSING_S: "paper's crossing"})]
    where = "section 4.2.3, Figure 26, conclusion 4"
    claims = [falls("ambients", where, family, 2 * bench.dt),
              same_stable("ambients", where, "All ambient temperatures tend to the same stable torque.", family,
                          "Stable is F_h(T*) v = U A (T* - Ta). With s = -F_h' v / (U A) a warmer ambient leaves a warmer belt, dT*/dTa = 1 / (1 + s), "
                          "which is more than zero and less than one."),
              _colder_is_larger_first(family, where), _warmer_is_larger_later(family, where), _colder_warms_more(family, where)]
    tables = [time_table(family, bench.shipped, TIMES_S, f"Resistance torque [Nm] / belt temperature [°C], {bench.shipped.replace('/', ', ')}."),
              stable_table(family, "Stable resistance torque [Nm] / belt temperature [°C] by combination.")]
    kept = {c: [float(np.diff([family.stable[a][c].belt_degc, family.stable[b][c].belt_degc])[0] / (b - a))
                for a, b in zip(AMBIENTS_DEGC, AMBIENTS_DEGC[1:], strict=False)] for c in COMBINATIONS}
    text = [f"Constant {SPEED_KMH:g} km/h and {WEIGHT_N / 1e3:g} kN from the start, without a ramp, as in the paper; run on to {DURATION_S:g} s beyond the paper's {PAPER_END_S:g} s. "
            "The belt starts at the ambient temperature.",
            "Of a difference in ambient temperature the stable belt keeps " + listed([f"{percent(min(k), 0)} to {percent(max(k), 0)} ({c})" for c, k in kept.items()]) + "."]
    numbers = {**family_numbers(family, TIMES_S), "kept_share": kept}
    return Section("Figure 26: ambient temperature", text, figures, claims, tables, numbers)


def _differences(family: Family, combination: str) -> Array:
    """Torque of each ambient less that of the next warmer one [Nm], shape (ambients - 1, times)."""
    return -np.diff(family.torque(combination, 0.0), axis=0)


def _draw_differences(out: Path, family: Family) -> Figure:
    figure = Figure(f"{family.name}_differences.png", f"{family.name}.csv",
                    "Torque of each ambient temperature less that of the next warmer one. A crossing would show as a line that ends; the axis is logarithmic.")
    with picture(out / figure.png, 9.0, 5.6) as drawn:
        panels = drawn.subplots(len(METHODS), len(THERMAL), sharex=True, sharey=True)
        for axes, combination in zip(panels.flat, (f"{m}/{t}" for m in METHODS for t in THERMAL), strict=True):
            time = family.series(combination)[0]["time_s"]
            for colour, colder, warmer, difference in zip(colours(family), AMBIENTS_DEGC, AMBIENTS_DEGC[1:], _differences(family, combination), strict=False):
                axes.plot(*thinned(time, np.where(difference > 0.0, difference, np.nan)), color=colour, label=f"{colder:g} less {warmer:g}")
            axes.set_yscale("log")
            axes.set_title(combination.replace("/", ", "))
            axes.margins(x=0.01)
            mark_time(axes, CROSSING_S, "paper's crossing")
        for axes in panels[:, 0]:
            axes.set_ylabel("torque difference [Nm]")
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        legend_beside(panels[0, -1], "ambients [°C]")
    return figure


def _colder_is_larger_first(family: Family, where: str) -> Claim:
    time = family.series(COMBINATIONS[0])[0]["time_s"]
    least = {c: float(_differences(family, c)[:, time <= CROSSING_S].min()) for c in COMBINATIONS}
    start = {c: family.torque(c, 0.0)[:, 0] for c in COMBINATIONS}
    return Claim(
        "colder_is_larger_first", where, "Within 0-250 s the torque at a lower ambient temperature is higher.", {c: least[c] > 0 for c in COMBINATIONS},
        f"At the start it is, from {AMBIENTS_DEGC[0]:g} to {AMBIENTS_DEGC[-1]:g} °C, " + listed([f"{start[c][0]:.0f} to {start[c][-1]:.0f} Nm ({c})" for c in COMBINATIONS])
        + f"; the least difference between neighbours up to 250 s is {min(least.values()):.0f} Nm.",
        {HOLDS: "The loss modulus is larger in the cold (Figure 16)."}, {"least_difference_nm": least})


def _warmer_is_larger_later(family: Family, where: str) -> Claim:
    time = family.series(COMBINATIONS[0])[0]["time_s"]
    later = {c: _differences(family, c)[:, time > CROSSING_S] for c in COMBINATIONS}
    least = {c: float(later[c].min()) for c in COMBINATIONS}
    stable = {c: float(-np.diff(family.stable_torque(c)).max()) for c in COMBINATIONS}
    crossing = {c: bool((later[c] < 0).any()) for c in COMBINATIONS}
    belts = {c: np.diff(np.stack([s["belt_degc"] for s in family.series(c)]), axis=0).min() for c in COMBINATIONS}
    return Claim(
        "warmer_is_larger_later", where, "After 250 s the torque at a higher ambient temperature is slightly higher (section 4.2.3 says so once, and the opposite a few lines below).",
        crossing, ("There is no crossing" if not any(crossing.values()) else "There is a crossing with " + listed([c for c, found in crossing.items() if found]))
        + f": after 250 s the colder one is above its warmer neighbour by at least {min(least.values()):.0f} Nm up to {DURATION_S:g} s (" + ", ".join(f"{c}: {least[c]:.0f}" for c in COMBINATIONS)
        + f") and by at least {min(stable.values()):.0f} Nm when stable. The warmer ambient has the warmer belt at all times, by at least {min(belts.values()):.1f} K.",
        {FAILS: "Two belts that start at their ambient temperatures obey the same equation. For the colder one to overtake it would have to be as warm as the other at some time; at that moment "
                "both make the same heat, and the one in colder air loses more of it. So it stays the colder one, and its loss, which falls with temperature, stays the larger. The paper's reason, "
                "that the cold belt makes more heat, lets it catch up; it cannot take it past."},
        {"least_difference_nm": least, "least_difference_stable_nm": stable, "least_belt_difference_k": belts})


def _colder_warms_more(family: Family, where: str) -> Claim:
    rise = {c: np.array([float(at_times(s, "belt_degc", CROSSING_S) - s["belt_degc"][0]) for s in family.series(c)]) for c in COMBINATIONS}
    return Claim(
        "colder_warms_more", where, "At a low ambient temperature much heat is generated and the track warms rapidly.", {c: bool((np.diff(rise[c]) < 0).all()) for c in COMBINATIONS},
        f"In the first 250 s the belt warms, from {AMBIENTS_DEGC[0]:g} to {AMBIENTS_DEGC[-1]:g} °C, by " + listed([f"{rise[c][0]:.1f} to {rise[c][-1]:.1f} K ({c})" for c in COMBINATIONS]) + ".",
        {HOLDS: "A larger loss modulus makes more heat per metre."}, {"rise_k": {c: r.tolist() for c, r in rise.items()}})

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figure 26, torque at four ambient temperatures, and the claims of section 4.2.3 and conclusion 4."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from proofs.reproduce.bench import COMBINATIONS, METHODS, THERMAL, Array, Bench
from proofs.reproduce.families import (
    Family,
    colours,
    draw_combinations,
    draw_family,
    falls,
    mark_time,
    run_family,
    same_stable,
    section_of,
)
from proofs.reproduce.section import FAILS, HOLDS, IN_PART, Claim, Figure, Section, listed, percents
from trackres_ros.estimator.drives import ramp_and_hold
from trackres_ros.output.style import legend_beside, picture, thinned
from trackres_ros.units import KMH_PER_MPS

AMBIENTS_DEGC = (-15.0, 0.0, 15.0, 30.0)
SPEED_KMH = 50.0
WEIGHT_N = 300e3
PAPER_END_S = 1000.0
DURATION_S = 2500.0
CROSSING_S = 250.0
TIMES_S = (0.0, 250.0, 600.0, 1000.0, 2500.0)
WHERE = "section 4.2.3, Figure 26, conclusion 4"
ENDS = f"{AMBIENTS_DEGC[0]:g} and {AMBIENTS_DEGC[-1]:g} °C"
CROSSING = "paper's crossing"


def ambients(bench: Bench, out: Path) -> Section:
    """The figure and its claims."""
    drive = ramp_and_hold(SPEED_KMH / KMH_PER_MPS, 0.0, DURATION_S, bench.dt)
    family = run_family(bench, "fig26_ambients", "ambient [°C]", "degc", AMBIENTS_DEGC, lambda degc: (drive, WEIGHT_N, degc))
    caption = "Resistance torque and belt temperature at four ambient temperatures (the paper's Figure 26)"
    title = f"constant {SPEED_KMH:g} km/h, {WEIGHT_N / 1e3:g} kN, belt at ambient at the start"
    combined = "Torque with every combination of loss method and thermal model; dashes at the right: the stable values."
    figures = [
        draw_family(out, family, bench.shipped, caption, title, {CROSSING_S: CROSSING, PAPER_END_S: "paper's end"}),
        _draw_differences(out, family),
        draw_combinations(out, family, combined, {CROSSING_S: CROSSING}),
    ]
    claims = [
        falls("ambients", WHERE, family, 2 * bench.dt),
        same_stable(
            "ambients",
            WHERE,
            "All ambient temperatures tend to the same stable torque.",
            family,
            "Stable is F_h(T*) v = U A (T* - Ta). With s = -F_h' v / (U A), a warmer ambient leaves a warmer belt: dT*/dTa = "
            "1 / (1 + s). This is more than zero and less than one.",
        ),
        _colder_is_larger_first(family),
        _warmer_is_larger_later(family),
        _colder_warms_more(family),
    ]
    kept = {
        c: [(family.stable[b][c].belt_degc - family.stable[a][c].belt_degc) / (b - a) for a, b in pairwise(AMBIENTS_DEGC)]
        for c in COMBINATIONS
    }
    kept_shares = [f"With {c.replace('/', ' and ')} it keeps {percents(shares, 0)}." for c, shares in kept.items()]
    text = [
        f"Constant {SPEED_KMH:g} km/h and {WEIGHT_N / 1e3:g} kN from the start, without a ramp, as in the paper. The run goes on "
        f"to {DURATION_S:g} s beyond the paper's {PAPER_END_S:g} s. The belt starts at the ambient temperature.",
        " ".join(["The stable belt keeps a part of a difference in ambient temperature.", *kept_shares]),
    ]
    return section_of(bench, family, "Figure 26: ambient temperature", TIMES_S, figures, claims, text, kept_share=kept)


def differences(family: Family, combination: str) -> Array:
    """Torque of each ambient less that of the next warmer one [Nm], shape (ambients - 1, times)."""
    return -np.diff(family.torque(combination, 0.0), axis=0)


def _draw_differences(out: Path, family: Family) -> Figure:
    figure = Figure(
        f"{family.name}_differences.png",
        f"{family.name}.csv",
        "Torque of each ambient temperature less that of the next warmer one, on a logarithmic axis. A crossing "
        "would show as a line that drops out of the picture.",
    )
    with picture(out / figure.png, 9.0, 5.6) as drawn:
        panels = drawn.subplots(len(METHODS), len(THERMAL), sharex=True, sharey=True)
        for axes, combination in zip(panels.flat, COMBINATIONS, strict=True):
            time = family.series(combination)[0]["time_s"]
            pairs = zip(colours(family)[1:], pairwise(AMBIENTS_DEGC), differences(family, combination), strict=True)
            for colour, (colder, warmer), difference in pairs:
                shown = np.where(difference > 0.0, difference, np.nan)
                axes.plot(*thinned(time, shown), color=colour, label=f"{colder:g} less {warmer:g}")
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
        WHERE,
        "Within 0-250 s the torque at a lower ambient temperature is higher.",
        {c: least[c] > 0 for c in COMBINATIONS},
        f"Up to {CROSSING_S:g} s each ambient temperature has at least {min(least.values()):.0f} Nm more torque than the next "
        "warmer one.",
        {HOLDS: "The loss modulus is larger in the cold (Figure 16)."},
        {"least_difference_nm": least},
        {
            f"torque at the start, {ENDS}": {c: f"{m[0]:.0f} and {m[-1]:.0f} Nm" for c, m in start.items()},
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
    found = [c for c in COMBINATIONS if crosses[c]]
    return Claim(
        "warmer_is_larger_later",
        WHERE,
        "After 250 s the torque at a higher ambient temperature is slightly higher (section "
        "4.2.3 says so once, and the opposite a few lines below).",
        crosses,
        (f"There is a crossing with {listed(found)}. " if found else "There is no crossing. ")
        + f"After {CROSSING_S:g} s an ambient temperature has more torque than the next warmer one. The least difference is "
        f"{min(least.values()):.0f} Nm up to {DURATION_S:g} s, and {min(stable.values()):.0f} Nm when stable. The belt in the "
        f"warmer ambient is the warmer one by at least {min(belts.values()):.1f} K at all times.",
        {
            FAILS: "Two belts that start at their ambient temperatures obey the same equation. To overtake, the colder one would "
            "first have to be as warm as the other. At that moment both make the same heat, and the one in colder air loses "
            "more of it. So it stays the colder one, and its loss, which falls with temperature, stays the larger. The "
            "paper's reason, that the cold belt makes more heat, lets it catch up in part; it cannot take it past.",
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
        WHERE,
        "At a low ambient temperature much heat is generated and the track warms rapidly.",
        {c: bool((np.diff(r) < 0).all()) for c, r in rise.items()},
        f"In the first {CROSSING_S:g} s the belt warms {percents((r[0] / r[-1] - 1.0 for r in rise.values()), 0)} more at "
        f"{AMBIENTS_DEGC[0]:g} than at {AMBIENTS_DEGC[-1]:g} °C.",
        {HOLDS: "A larger loss modulus makes more heat per metre."},
        {"rise_k": {c: r.tolist() for c, r in rise.items()}},
        {f"rise by {CROSSING_S:g} s, {ENDS}": {c: f"{r[0]:.1f} and {r[-1]:.1f} K" for c, r in rise.items()}},
    )

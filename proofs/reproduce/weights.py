# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figure 25, torque at four weights, and the claims of section 4.2.2 and conclusion 3."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from proofs.reproduce.bench import COMBINATIONS, Bench
from proofs.reproduce.families import SAME, Family, draw_family, falls, run_family, section_of
from proofs.reproduce.section import HOLDS, Claim, Section, percent
from trackres_ros.estimator.drives import ramp_and_hold
from trackres_ros.units import KMH_PER_MPS

WEIGHTS_KN = (200.0, 250.0, 300.0, 350.0)
SPEED_KMH = 50.0
RAMP_S = 50.0
DURATION_S = 2500.0
TIMES_S = (50.0, 250.0, 600.0, 1000.0, 2500.0)
WHERE = "section 4.2.2, Figure 25, conclusion 3"
ENDS = f"{WEIGHTS_KN[0]:g} and {WEIGHTS_KN[-1]:g} kN"


def weights(bench: Bench, out: Path) -> Section:
    """The figure and its claims."""
    drive = ramp_and_hold(SPEED_KMH / KMH_PER_MPS, RAMP_S, DURATION_S, bench.dt)
    family = run_family(bench, "fig25_weights", "weight [kN]", "kn", WEIGHTS_KN, lambda kn: (drive, kn * 1e3, None))
    caption = "Resistance torque and belt temperature at four weights (the paper's Figure 25)"
    title = f"{SPEED_KMH:g} km/h, ambient {bench.vehicle.chassis.ambient:g} °C, ramp of {RAMP_S:g} s"
    figures = [draw_family(out, family, bench.shipped, caption, title, {RAMP_S: "speed reached"})]
    claims = [falls("weights", WHERE, family, RAMP_S + 2 * bench.dt), _different_stable(family), _heavier_is_larger(family)]
    text = [
        f"From rest to {SPEED_KMH:g} km/h in {RAMP_S:g} s, then held to {DURATION_S:g} s. The weight is that of the whole "
        "vehicle with its assemblies, shared as nominal.",
    ]
    return section_of(bench, family, "Figure 25: load", TIMES_S, figures, claims, text)


def _different_stable(family: Family) -> Claim:
    stable = {c: family.stable_torque(c) for c in COMBINATIONS}
    least = {c: float(np.min(np.diff(m) / m[:-1])) for c, m in stable.items()}
    return Claim(
        "weights_different_stable_values",
        WHERE,
        "Different loads tend to different stable torques.",
        {c: least[c] > SAME for c in COMBINATIONS},
        f"Neighbouring weights differ by at least {percent(min(least.values()))} when stable.",
        {
            HOLDS: "A contact loses more under more load, about as the power 4/3 of it at constant modulus, and bearing friction "
            "goes with the load. The warmer belt takes back a part."
        },
        {"least_difference": least, "stable_nm": {c: m.tolist() for c, m in stable.items()}},
        {
            f"stable torque, {ENDS}": {c: f"{m[0]:.0f} and {m[-1]:.0f} Nm" for c, m in stable.items()},
            "least difference between neighbours": {c: percent(d) for c, d in least.items()},
        },
    )


def _heavier_is_larger(family: Family) -> Claim:
    moving = {c: np.stack([s["resistance_torque_nm"][s["speed_mps"] > 0.0] for s in family.series(c)]) for c in COMBINATIONS}
    least = {c: float(np.min(np.diff(m, axis=0))) for c, m in moving.items()}
    exponent = {c: float(np.log(m[-1, -1] / m[0, -1]) / np.log(WEIGHTS_KN[-1] / WEIGHTS_KN[0])) for c, m in moving.items()}
    return Claim(
        "heavier_is_larger",
        WHERE,
        "At any moment the torque increases with the load.",
        {c: least[c] > 0 for c in COMBINATIONS},
        f"At all times in motion each weight has at least {min(least.values()):.0f} Nm more torque than the next lighter one.",
        {
            HOLDS: "At equal temperature more load means more loss and more bearing friction. More loss warms the belt more, "
            "which takes back a part of it, but not all. Were the loss no larger, the belt would be no warmer."
        },
        {"least_difference_nm": least, "exponent": exponent},
        {
            "least difference between neighbours": {c: f"{m:.0f} Nm" for c, m in least.items()},
            f"at {DURATION_S:g} s the torque goes as the weight to the power": {c: f"{e:.2f}" for c, e in exponent.items()},
        },
    )

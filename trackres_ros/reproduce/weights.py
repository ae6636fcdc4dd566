"""Figure 25: torque at four weights; the claims of section 4.2.2 and conclusion 3."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trackres_ros.reproduce.bench import COMBINATIONS, KMH_PER_MPS, Bench
from trackres_ros.reproduce.families import Family, draw_family, family_numbers, run_family, stable_table, time_table
from trackres_ros.reproduce.section import HOLDS, Claim, Section, listed, percent
from trackres_ros.reproduce.speeds import SAME, falls
from trackres_ros.simulate import ramp_and_hold

WEIGHTS_KN = (200.0, 250.0, 300.0, 350.0)
SPEED_KMH = 50.0
RAMP_S = 50.0
DURATION_S = 2500.0
TIMES_S = (50.0, 250.0, 600.0, 1000.0, 2500.0)


def weights(bench: Bench, out: Path) -> Section:
    """The figure and its claims."""
    drive = ramp_and_hold(SPEED_KMH / KMH_PER_MPS, RAMP_S, DURATION_S, bench.dt)
    family = run_family(bench, "fig25_weights", "weight [kN]", "kn", WEIGHTS_KN, lambda kn: (drive, kn * 1e3, None))
    figures = [draw_family(out, family, bench.shipped, f"Resistance torque and belt temperature at four weights (the paper's Figure 25), {bench.shipped}.",
                           f"{SPEED_KMH:g} km/h, ambient {bench.vehicle.chassis.ambient:g} °C, ramp of {RAMP_S:g} s, {bench.shipped.replace('/', ', ')}",
                           {RAMP_S: "speed reached"})]
    where = "section 4.2.2, Figure 25, conclusion 3"
    claims = [falls("weights", where, family, RAMP_S + 2 * bench.dt), _different_stable(family, where), _heavier_is_larger(family, where)]
    tables = [time_table(family, bench.shipped, TIMES_S, f"Resistance torque [Nm] / belt temperature [°C], {bench.shipped.replace('/', ', ')}."),
              stable_table(family, "Stable resistance torque [Nm] / belt temperature [°C] by combination.")]
    text = [f"From rest to {SPEED_KMH:g} km/h in {RAMP_S:g} s, then held. The weight is that of the whole vehicle with its assemblies, shared as nominal."]
    return Section("Figure 25: load", text, figures, claims, tables, family_numbers(family, TIMES_S))


def _different_stable(family: Family, where: str) -> Claim:
    stable = {c: family.stable_torque(c) for c in COMBINATIONS}
    least = {c: float(np.min(np.diff(stable[c]) / stable[c][:-1])) for c in COMBINATIONS}
    return Claim(
        "weights_different_stable_values", where, "Different loads tend to different stable torques.", {c: least[c] > SAME for c in COMBINATIONS},
        f"From {WEIGHTS_KN[0]:g} to {WEIGHTS_KN[-1]:g} kN the stable torque goes " + listed([f"from {stable[c][0]:.0f} to {stable[c][-1]:.0f} Nm ({c})" for c in COMBINATIONS])
        + f"; neighbours differ by at least {percent(min(least.values()))}.",
        {HOLDS: "Each contact loses more under more load, about as its power 4/3 at constant modulus. Bearing friction goes with the load too. The warmer belt takes back a part."},
        {"least_difference": least})


def _heavier_is_larger(family: Family, where: str) -> Claim:
    def moving(combination: str) -> np.ndarray:  # type: ignore[type-arg]
        series = family.series(combination)
        return np.stack([s["resistance_torque_nm"][s["speed_mps"] > 0.0] for s in series])

    least = {c: float(np.min(np.diff(moving(c), axis=0))) for c in COMBINATIONS}
    exponent = {c: float(np.log(moving(c)[-1, -1] / moving(c)[0, -1]) / np.log(WEIGHTS_KN[-1] / WEIGHTS_KN[0])) for c in COMBINATIONS}
    return Claim(
        "heavier_is_larger", where, "At any moment the torque increases with the load.", {c: least[c] > 0 for c in COMBINATIONS},
        "The least difference between neighbours at any time in motion is " + listed([f"{least[c]:.0f} Nm ({c})" for c in COMBINATIONS])
        + f". At {DURATION_S:g} s the torque goes as the weight to the power " + listed([f"{exponent[c]:.2f} ({c})" for c in COMBINATIONS]) + ".",
        {HOLDS: "Indentation grows faster than the load at equal temperature, and the temperature that follows from it never lowers the loss by more than what caused it."},
        {"least_difference_nm": least, "exponent": exponent})

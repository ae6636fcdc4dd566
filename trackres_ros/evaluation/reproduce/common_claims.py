# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks the claims of the paper common to speed, weight and ambient temperature: falling torque, and its steady value."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trackres_ros.evaluation.reproduce.bench import COMBINATIONS, Bench
from trackres_ros.evaluation.reproduce.families import Family, family_numbers, first_comparable, stable_table, time_table
from trackres_ros.evaluation.reproduce.section import FAILS, HOLDS, Claim, Figure, Section, listed, percent, percents, span
from trackres_ros.text.numbers import figures

SAME = 0.01  # values are the same that differ by less than 1 %: three times the error of the program's own loss table


def spread(values: NDArray[np.float64]) -> float:
    """Greatest less least value over their mean."""
    return float(np.ptp(values) / np.mean(values))


def section_of(
    bench: Bench,
    family: Family,
    title: str,
    times_s: Sequence[float],
    pictures: Sequence[Figure],
    claims: Sequence[Claim],
    text: Sequence[str],
    **numbers: object,
) -> Section:
    """The section of a study: its tables at some times and when stable, and their numbers."""
    tables = [time_table(family, bench.shipped, times_s), stable_table(family)]
    of_all = [*text, *hot_belts(bench, family)]
    return Section(title, of_all, pictures, claims, tables, {**family_numbers(family, times_s), **numbers})


def hot_belts(bench: Bench, family: Family) -> list[str]:
    """A remark on steady belts that are hotter than the compound's sweep; empty without any."""
    last = float(bench.vehicle.rubber.sweep_degc[-1])
    hot = []
    for c in COMBINATIONS:
        values = [value for value in family.values if family.stable[value][c].belt_degc > last]
        if values:
            belts = span((family.stable[value][c].belt_degc for value in values), 0, " °C")
            hot.append(f"{c.replace('/', ', ')} at {family.quantity} {listed([f'{value:g}' for value in values])} ({belts})")
    remark = (
        f"The compound's sweep ends at {last:g} °C; above it the modulus keeps its last value. Stable belts that are "
        f"hotter: {'; '.join(hot)}."
    )
    return [remark] if hot else []


def falls(key: str, where: str, family: Family, start_s: float) -> Claim:
    """The torque only falls with time at constant speed, from a time [s] on."""
    torque = {c: family.torque(c, start_s) for c in COMBINATIONS}
    rises = {c: float(np.diff(m, axis=1).max()) for c, m in torque.items()}
    shares = {c: 1.0 - m[:, -1] / m[:, 0] for c, m in torque.items()}
    end = family.series(COMBINATIONS[0])[0]["time_s"][-1]
    largest = max(rises.values())
    return Claim(
        f"{key}_torque_falls",
        where,
        "The torque gradually decreases with time.",
        {c: rises[c] < 0 for c in COMBINATIONS},
        f"From {start_s:.0f} to {end:.0f} s it falls by {percents(np.concatenate(list(shares.values())), 0)}"
        + (
            ", from every sample to the next."
            if largest < 0
            else f", and rises by up to {figures(largest, 2)} Nm between samples."
        ),
        {HOLDS: "The belt starts at ambient temperature, the loss warms it, and a warmer compound loses less."},
        {"fall": {c: s.tolist() for c, s in shares.items()}, "largest_rise_nm": rises},
        {f"fall, over {family.quantity}": {c: percents(s, 0) for c, s in shares.items()}},
    )


def same_stable(key: str, where: str, paper: str, family: Family, why: str) -> Claim:
    """All values of a family have the same steady torque, within `SAME`."""
    stable = {c: family.stable_torque(c) for c in COMBINATIONS}
    start = {c: spread(family.torque(c, 0.0)[:, first_comparable(family)]) for c in COMBINATIONS}
    end = {c: spread(values) for c, values in stable.items()}
    shrinks = all(end[c] < start[c] for c in COMBINATIONS)
    return Claim(
        f"{key}_same_stable_value",
        where,
        paper,
        {c: end[c] < SAME for c in COMBINATIONS},
        f"The stable torques differ by {percents(end.values())} of their mean, after {percents(start.values())} when the speed "
        f"is reached. The same would be less than {percent(SAME, 0)}.",
        {FAILS: why + (" The differences shrink with time; they do not vanish." if shrinks else "")},
        {"spread_stable": end, "spread_start": start, "stable_nm": {c: values.tolist() for c, values in stable.items()}},
        {
            "stable torques": {c: span(values, 0, " Nm") for c, values in stable.items()},
            "their spread": {c: percent(s) for c, s in end.items()},
            "spread when the speed is reached": {c: percent(s) for c, s in start.items()},
        },
    )

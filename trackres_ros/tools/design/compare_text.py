# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Prints and draws a comparison of two designs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.text import alike, decimals, figures, table
from trackres_ros.tools.design.compare import DRIVEN, STEADY, interval

TABLES = ("Resistance [Nm]", "torque_nm", 1.0, 0), ("Resistance over weight [%]", "coefficient", 100.0, 2)
PLACES = {"Nm": 0, "degC": 1, "kWh/km": 3}
NAMES = {"load": "load", "ambient": "air"}
LOADS_DIFFER = 1e-6
HEAD = ("difference", "+- 95 %", "+- 95 % with\nchanged values", "change")


def designs_text(comparison: Mapping[str, Any]) -> str:
    """The headline, steady states, drives, and resistance over speed and belt temperature."""
    names = [design["vehicle"] for design in comparison["designs"]]
    parts = [*(f"note: {note}" for note in comparison["notes"]), *(f"  ! {remark}" for remark in comparison["remarks"])]
    first, place = comparison["drives"][0], _which(comparison["drives"])
    parts.append(headline({**first, "cycle": first["cycle"] + place}, names))
    parts += _conditions("Steady", comparison["steady"], "speed_kmh", "km/h", STEADY, names)
    parts += _conditions("Drives from cold", comparison["drives"], "cycle", "drive", DRIVEN, names)
    parts.append(
        "+- 95 %: from the ranges of the values that both files have alike, which move both together; the second column holds "
        "the ranges of the values that differ too. Parameters of effects are taken as known. In steady states, effects that "
        "warm up are warm, also with cold belts."
    )
    head = ("belt [degC]", *(f"{figures(kmh)} km/h" for kmh in comparison["speeds_kmh"]))
    weights = [design["weight_n"] for design in comparison["designs"]]
    same_load = abs(weights[0] - weights[1]) <= LOADS_DIFFER * weights[0]
    for quantity, key, scale, places in TABLES[:1] if same_load else TABLES:
        for design in comparison["designs"]:
            rows = [[decimals(scale * x, places) for x in row] for row in design[key]]
            parts.append(f"{quantity} of {design['vehicle']}{place}\n{_over_belts(comparison, rows, head)}")
    key = TABLES[0 if same_load else 1][1]
    first_grid, second_grid = (np.array(design[key]) for design in comparison["designs"])
    changes = [[f"{100.0 * x:+.1f}" for x in row] for row in second_grid / first_grid - 1.0]
    parts.append(f"{TABLES[0 if same_load else 1][0].partition(' [')[0]}, change from {names[0]} to {names[1]}{place} [%]")
    parts[-1] += f"\n{_over_belts(comparison, changes, head)}"
    for design in comparison["designs"]:
        drive = design["drive"]
        parts.append(
            f"{design['vehicle']}{place}: {decimals(drive['kwh_per_km'], 2)} kWh/km against resistance "
            f"on {decimals(drive['km'], 1)} km, {decimals(drive['wh_per_km_and_t'])} Wh/km for each tonne"
        )
    return "\n".join(parts)


def _which(drives: Sequence[Mapping[str, Any]]) -> str:
    """Air temperature and weight of the first drive, as far as there are several."""
    air = f", air {drives[0]['ambient_degc']:g} degC" if len({row["ambient_degc"] for row in drives}) > 1 else ""
    varies = len({tuple(row["weight_kn"]) for row in drives}) > 1
    return f"{air}, {figures(drives[0]['weight_kn'][0], 4)} kN" if varies else air


def headline(row: Mapping[str, Any], names: Sequence[str]) -> str:
    """The difference in energy on the first drive, in a sentence."""
    difference, base, half = row["difference"], row["one"], interval(row, "std")
    if not difference or not base or half is None:
        return f"On the drive {row['cycle']} both take the same energy."
    size, wide = alike((abs(difference), half), max(half, 1e-3 * abs(difference)))
    text = (
        f"On the drive {row['cycle']} {names[1]} takes {size} +- {wide} kWh/km {'more' if difference > 0.0 else 'less'} than "
        f"{names[0]} ({100.0 * difference / base:+.1f} %)"
    )
    return f"{text}." if abs(difference) > half else f"{text}: the ranges of the files do not decide which takes more."


def _conditions(
    title: str,
    rows: Sequence[Mapping[str, Any]],
    key: str,
    unit: str,
    outcomes: Mapping[str, tuple[str, str]],
    names: Sequence[str],
) -> list[str]:
    places: dict[tuple[float, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        places.setdefault((row["ambient_degc"], *row["weight_kn"]), []).append(row)
    parts = []
    for (air, first_weight, second_weight), group in places.items():
        load = (
            f"{figures(first_weight, 4)} kN"
            if abs(first_weight - second_weight) <= LOADS_DIFFER * first_weight
            else f"{figures(first_weight, 4)} and {figures(second_weight, 4)} kN"
        )
        lines = []
        for number, row in enumerate(group):
            first = number == 0 or group[number - 1][key] != row[key]
            place = f"{figures(row[key], 4)}" if key == "speed_kmh" else row[key]
            if row.get("recorded"):
                place = f"{place} ({' and '.join(NAMES[role] for role in row['recorded'])} as recorded)"
            lines.append((place if first else "", outcomes[row["outcome"]][0], row["unit"], *_cells(row)))
        head = (unit, "outcome", "unit", *names, *HEAD)
        parts.append(f"{title}, air {air:g} degC, {load}\n{table(lines, head, indent=2)}")
    return parts


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    values = [row["one"], row["other"], row["difference"], interval(row, "std"), interval(row, "std_with_changed")]
    texts = [decimals(value, PLACES[row["unit"]]) for value in values]
    relative = row["unit"] != "degC" and row["one"] and row["difference"] is not None
    return (*texts, f"{100.0 * row['difference'] / row['one']:+.1f} %" if relative else "")


def _over_belts(comparison: Mapping[str, Any], rows: Sequence[Sequence[str]], head: Sequence[str]) -> str:
    return table([(figures(degc), *row) for degc, row in zip(comparison["belts_degc"], rows, strict=True)], head, indent=2)


def draw_designs(comparison: Mapping[str, Any], path: Path) -> Path:
    """Resistance over weight of all designs over speed, a line for each belt temperature."""
    from trackres_ros.output.style import picture

    with picture(path, 8.0, 4.5) as figure:
        axes = figure.subplots(1, len(comparison["designs"]), sharey=True, squeeze=False)[0]
        speeds = np.array(comparison["speeds_kmh"])
        order = np.argsort(speeds)  # they may be listed in any order
        marker = "o" if len(speeds) == 1 else ""
        for panel, design in zip(axes, comparison["designs"], strict=True):
            for i, degc in enumerate(comparison["belts_degc"]):
                share = i / max(len(comparison["belts_degc"]) - 1, 1)
                percent, colour = 100.0 * np.array(design["coefficient"][i]), (share, 0.25, 1.0 - share)
                panel.plot(speeds[order], percent[order], color=colour, marker=marker, label=f"{degc:g} degC")
            panel.set_title(f"{design['vehicle']}, {figures(design['weight_n'] / 1e3, 4)} kN")
            panel.set_xlabel("speed [km/h]")
            panel.grid(alpha=0.3)
        axes[0].set_ylabel("resistance over weight [%]")
        axes[0].set_ylim(bottom=0.0)
        figure.legend(*axes[0].get_legend_handles_labels(), title="belt", loc="outside right center")
    return path

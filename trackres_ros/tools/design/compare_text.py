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


def designs_text(found: Mapping[str, Any]) -> str:
    """The headline, steady states, drives, and resistance over speed and belt temperature."""
    names = [design["vehicle"] for design in found["designs"]]
    parts = [*(f"note: {note}" for note in found["notes"]), *(f"  ! {remark}" for remark in found["remarks"])]
    first, at = found["drives"][0], _which(found["drives"])
    parts.append(headline({**first, "cycle": first["cycle"] + at}, names))
    parts += _conditions("Steady", found["steady"], "speed_kmh", "km/h", STEADY, names)
    parts += _conditions("Drives from cold", found["drives"], "cycle", "drive", DRIVEN, names)
    parts.append(
        "+- 95 %: from the ranges of the values that both files have alike, which move both together; the second column holds "
        "the ranges of the values that differ too. Parameters of effects are taken as known. In steady states, effects that "
        "warm up are warm, also with cold belts."
    )
    head = ("belt [degC]", *(f"{figures(kmh)} km/h" for kmh in found["speeds_kmh"]))
    weights = [design["weight_n"] for design in found["designs"]]
    same_load = abs(weights[0] - weights[1]) <= LOADS_DIFFER * weights[0]
    for what, key, scale, places in TABLES[:1] if same_load else TABLES:
        for design in found["designs"]:
            rows = [[decimals(scale * x, places) for x in row] for row in design[key]]
            parts.append(f"{what} of {design['vehicle']}{at}\n{_over_belts(found, rows, head)}")
    key = TABLES[0 if same_load else 1][1]
    one, other = (np.array(design[key]) for design in found["designs"])
    changes = [[f"{100.0 * x:+.1f}" for x in row] for row in other / one - 1.0]
    parts.append(f"{TABLES[0 if same_load else 1][0].partition(' [')[0]}, change from {names[0]} to {names[1]}{at} [%]")
    parts[-1] += f"\n{_over_belts(found, changes, head)}"
    for design in found["designs"]:
        of = design["drive"]
        parts.append(
            f"{design['vehicle']}{at}: {decimals(of['kwh_per_km'], 2)} kWh/km against resistance on {decimals(of['km'], 1)} km, "
            f"{decimals(of['wh_per_km_and_t'])} Wh/km for each tonne"
        )
    return "\n".join(parts)


def _which(drives: Sequence[Mapping[str, Any]]) -> str:
    """Air temperature and weight of the first drive, as far as there are several."""
    air = f", air {drives[0]['ambient_degc']:g} degC" if len({row["ambient_degc"] for row in drives}) > 1 else ""
    several = len({tuple(row["weight_kn"]) for row in drives}) > 1
    return f"{air}, {figures(drives[0]['weight_kn'][0], 4)} kN" if several else air


def headline(row: Mapping[str, Any], names: Sequence[str]) -> str:
    """The difference in energy on the first drive, in a sentence."""
    difference, one, half = row["difference"], row["one"], interval(row, "std")
    if not difference or not one or half is None:
        return f"On the drive {row['cycle']} both take the same energy."
    size, wide = alike((abs(difference), half), max(half, 1e-3 * abs(difference)))
    text = (
        f"On the drive {row['cycle']} {names[1]} takes {size} +- {wide} kWh/km {'more' if difference > 0.0 else 'less'} than "
        f"{names[0]} ({100.0 * difference / one:+.1f} %)"
    )
    return f"{text}." if abs(difference) > half else f"{text}: the ranges of the files do not decide which takes more."


def _conditions(
    title: str, rows: Sequence[Mapping[str, Any]], key: str, unit: str, named: Mapping[str, tuple[str, str]], names: Sequence[str]
) -> list[str]:
    places: dict[tuple[float, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        places.setdefault((row["ambient_degc"], *row["weight_kn"]), []).append(row)
    parts = []
    for (air, one, other), of in places.items():
        load = (
            f"{figures(one, 4)} kN" if abs(one - other) <= LOADS_DIFFER * one else f"{figures(one, 4)} and {figures(other, 4)} kN"
        )
        lines = []
        for number, row in enumerate(of):
            first = number == 0 or of[number - 1][key] != row[key]
            place = f"{figures(row[key], 4)}" if key == "speed_kmh" else row[key]
            if row.get("recorded"):
                place = f"{place} ({' and '.join(NAMES[role] for role in row['recorded'])} as recorded)"
            lines.append((place if first else "", named[row["outcome"]][0], row["unit"], *_cells(row)))
        head = (unit, "outcome", "unit", *names, *HEAD)
        parts.append(f"{title}, air {air:g} degC, {load}\n{table(lines, head, indent=2)}")
    return parts


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    values = [row["one"], row["other"], row["difference"], interval(row, "std"), interval(row, "std_with_changed")]
    shown = [decimals(value, PLACES[row["unit"]]) for value in values]
    relative = row["unit"] != "degC" and row["one"] and row["difference"] is not None
    return (*shown, f"{100.0 * row['difference'] / row['one']:+.1f} %" if relative else "")


def _over_belts(found: Mapping[str, Any], rows: Sequence[Sequence[str]], head: Sequence[str]) -> str:
    return table([(figures(degc), *row) for degc, row in zip(found["belts_degc"], rows, strict=True)], head, indent=2)


def draw_designs(found: Mapping[str, Any], path: Path) -> Path:
    """Resistance over weight of all designs over speed, a line for each belt temperature."""
    from trackres_ros.output.style import picture

    with picture(path, 8.0, 4.5) as figure:
        axes = figure.subplots(1, len(found["designs"]), sharey=True, squeeze=False)[0]
        speeds, order = np.array(found["speeds_kmh"]), np.argsort(found["speeds_kmh"])  # which may be listed in any order
        marker = "o" if len(speeds) == 1 else ""
        for one, design in zip(axes, found["designs"], strict=True):
            for i, degc in enumerate(found["belts_degc"]):
                share = i / max(len(found["belts_degc"]) - 1, 1)
                percent, colour = 100.0 * np.array(design["coefficient"][i]), (share, 0.25, 1.0 - share)
                one.plot(speeds[order], percent[order], color=colour, marker=marker, label=f"{degc:g} degC")
            one.set_title(f"{design['vehicle']}, {figures(design['weight_n'] / 1e3, 4)} kN")
            one.set_xlabel("speed [km/h]")
            one.grid(alpha=0.3)
        axes[0].set_ylabel("resistance over weight [%]")
        axes[0].set_ylim(bottom=0.0)
        figure.legend(*axes[0].get_legend_handles_labels(), title="belt", loc="outside right center")
    return path

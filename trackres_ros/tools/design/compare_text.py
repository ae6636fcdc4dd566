# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Prints and draws a comparison of two designs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.text import MISSING, alike, decimals, figures, table
from trackres_ros.tools.design.compare import DRIVEN, STEADY

TABLES = ("Resistance [Nm]", "torque_nm", 1.0, 0), ("Resistance over weight [%]", "coefficient", 100.0, 2)
PLACES = {"Nm": 0, "degC": 1, "kWh/km": 3}
NAMES = {"load": "load", "ambient": "air"}
LOADS_DIFFER = 1e-6
HEAD = ("difference", "95 %, changed\nvalues exact", "95 %, by\nall ranges", "lower with\nprobability", "change")
UNDECIDED = (0.05, 0.95)  # probabilities between which the ranges do not decide


def designs_text(comparison: Mapping[str, Any]) -> str:
    """The headline, steady states, drives, and resistance over speed and belt temperature."""
    names = [design["vehicle"] for design in comparison["designs"]]
    parts = [*(f"note: {note}" for note in comparison["notes"]), *(f"  ! {remark}" for remark in comparison["remarks"])]
    first, place = comparison["drives"][0], _which(comparison["drives"])
    parts.append(headline({**first, "cycle": first["cycle"] + place}, names))
    parts += _conditions("Steady", comparison["steady"], "speed_kmh", "km/h", STEADY, names)
    parts += _conditions("Drives from cold", comparison["drives"], "cycle", "drive", DRIVEN, names)
    parts.append(
        f"95 %: by {comparison['draws']} draws from the ranges of the files. A value that both files have alike is drawn once "
        "for both. The first column takes the values that differ exactly as the files say. The second column and the "
        "probability draw them too, in each file apart. Parameters of effects are taken as known. In steady states, effects "
        "that warm up are warm, also with cold belts."
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
    """The difference in energy on the first drive, and how sure it is, in sentences."""
    difference, base, interval, less = row["difference"], row["one"], row["difference_95"], row["probability_less"]
    if not difference or not base:
        return f"On the drive {row['cycle']} both take the same energy."
    size, *ends = alike((abs(difference), *(interval or ())), _span(interval) or 1e-3 * abs(difference))
    text = (
        f"On the drive {row['cycle']} {names[1]} takes {size} kWh/km {'more' if difference > 0.0 else 'less'} than {names[0]} "
        f"({100.0 * difference / base:+.1f} %{f'; 95 %: {ends[0]} to {ends[1]}' if ends else ''})."
    )
    if interval is None:
        return text
    with_changed = row["probability_less_with_changed"]
    text += f" The probability that {names[1]} takes less is {probability(less)}"
    if with_changed is not None:
        text += f", and {probability(with_changed)} with the ranges of the changed values"
    if is_undecided(less):
        return f"{text}: the ranges of the files do not decide which takes more."
    if is_undecided(with_changed):
        return f"{text}: these do not decide which takes more, so narrow them to what you can build."
    return f"{text}."


def probability(share: float | None) -> str:
    """A probability in per cent, never quite 0 or 1."""
    if share is None:
        return MISSING
    return "> 99 %" if share > 0.99 else "< 1 %" if share < 0.01 else f"{100.0 * share:.0f} %"


def is_undecided(share: float | None) -> bool:
    """Whether a probability is too close to one half to decide."""
    return share is not None and UNDECIDED[0] < share < UNDECIDED[1]


def _span(interval: Sequence[float] | None) -> float:
    """Half the width of an interval."""
    return 0.5 * (interval[1] - interval[0]) if interval else 0.0


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
    texts = [decimals(row[key], PLACES[row["unit"]]) for key in ("one", "other", "difference")]
    for key in ("difference_95", "difference_95_with_changed"):
        texts.append(" to ".join(alike(row[key], _span(row[key]))) if row[key] else MISSING)
    relative = row["unit"] != "degC" and row["one"] and row["difference"] is not None
    change = f"{100.0 * row['difference'] / row['one']:+.1f} %" if relative else ""
    return (*texts, probability(row["probability_less_with_changed"]), change)


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


def draw_energy(comparison: Mapping[str, Any], path: Path) -> Path:
    """Energy of both designs on the first drive over the air temperature, and its difference, with 95 % intervals."""
    from trackres_ros.output.style import BLACK, BLUE, GREY, ORANGE, picture, shorten

    first = comparison["drives"][0]
    rows = [row for row in comparison["drives"] if all(row[key] == first[key] for key in ("outcome", "cycle", "weight_kn"))]
    rows.sort(key=lambda row: row["ambient_degc"])
    air, names = np.array([row["ambient_degc"] for row in rows]), [design["vehicle"] for design in comparison["designs"]]
    load = "" if first["weight_kn"][0] != first["weight_kn"][1] else f", {figures(first['weight_kn'][0], 4)} kN"
    with picture(path, 7.5, 6.0) as figure:
        energy, difference = figure.subplots(2, sharex=True, height_ratios=(3, 2))
        shift = 0.008 * float(np.ptp(air) or 1.0)  # of the bars, so that both can be seen
        for key, name, colour, side in (("one_95", names[0], BLUE, -1), ("other_95", names[1], ORANGE, 1)):
            _intervals(energy, air + side * shift, rows, key, colour, shorten(name, 25))
        _intervals(difference, air, rows, "difference_95_with_changed", BLACK, "by all ranges")
        difference.vlines(air, *_ends(rows, "difference_95").T, color=BLACK, lw=4.0, alpha=0.5, label="changed values exact")
        difference.axhline(0.0, color=GREY, lw=1.0)
        for row in rows:
            text, place = probability(row["probability_less_with_changed"]), (row["ambient_degc"], 0.03)
            difference.text(*place, text, transform=difference.get_xaxis_transform(), ha="center")
        for axes in (energy, difference):
            axes.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
        energy.set(ylabel="energy [kWh/km]", title=f"Drive {shorten(first['cycle'], 40)}{load}, 95 % intervals")
        difference.set(xlabel="air temperature [degC]", ylabel="difference [kWh/km]")
        difference.set_title(f"Below: probability that\n{shorten(names[1], 40)} takes less")
        difference.margins(y=0.25)
    return path


def _intervals(axes: Any, air: Any, rows: Sequence[Mapping[str, Any]], ends: str, colour: str, label: str) -> None:
    """An outcome over the air temperature, with its 95 % intervals as bars; `ends`: their key."""
    values = [np.nan if row[ends.partition("_95")[0]] is None else row[ends.partition("_95")[0]] for row in rows]
    axes.plot(air, values, marker="o", ms=5, color=colour)
    axes.vlines(air, *_ends(rows, ends).T, color=colour, lw=1.5, label=label)


def _ends(rows: Sequence[Mapping[str, Any]], key: str) -> Any:
    return np.array([row[key] or (np.nan, np.nan) for row in rows])

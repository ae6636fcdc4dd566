# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes what was found of the trolley bus, unsealed: slopes against altitudes, masses against passengers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trackres_ros.evaluation.field.bus import CLOSE, LONG_STRETCH_S, PayloadFound, payload_found, slope_found
from trackres_ros.evaluation.field.run import FieldTrial
from trackres_ros.output.style import BLUE, GREY, VERMILION, picture
from trackres_ros.text.numbers import figures

SECONDS_PER_MIN = 60.0


def bus_page(tried: Sequence[FieldTrial], folder: Path, of_pictures: str = "") -> list[str]:
    """Lines of the page; pictures go to a folder, and links to them begin with `of_pictures`. None without a mission."""
    if not tried:
        return []
    given = next(t for t in tried if t.hidden == "nothing")
    lines = ["## The trolley bus, unsealed", ""]
    for t in tried:
        slope = slope_found(t, given)
        if slope is not None:
            lines.append(
                f"- Without {t.hidden}: the slope that was found has a correlation of {slope.correlation:.2f} with that of the "
                f"altitude averaged over all passes of a place and taken over 300 m, and {slope.coefficient:.2f} of it."
            )
    if len(lines) == 2:
        lines.append("- No slope was found.")
    hidden = next(t for t in tried if t.hidden == "passengers")
    payload = payload_found(hidden, given)
    if payload is None:
        return [*lines, "- Without passengers: no payload was found.", ""]
    lines.append(
        f"- Without passengers: the masses of {len(payload.mass)} stretches have a correlation of {payload.correlation:.2f} with "
        f"those of the passengers (70 kg each), which differ by {figures(float(payload.true.std()))} kg, and are "
        f"{figures(float(np.sqrt(np.mean((payload.mass - payload.true) ** 2))))} kg off; "
        f"{figures(float(payload.std.mean()))} kg is what they are said to be off. No stretch has more than "
        f"{payload.longest_s:.0f} s of driving; joined until they have {LONG_STRETCH_S:.0f} s, {payload.close} of {payload.long} "
        f"are within {CLOSE:.0%} of the passengers' weight."
    )
    _draw_payload(folder / "payload.png", payload)
    return [*lines, "", f"![Masses of stretches between stops, found and of passengers.]({of_pictures}payload.png)", ""]


def _draw_payload(path: Path, payload: PayloadFound) -> None:
    with picture(path, 9.0, 3.4) as figure:
        axes = figure.subplots()
        middle = 0.5 * (payload.begin_s + payload.end_s) / SECONDS_PER_MIN
        axes.errorbar(
            middle, payload.mass, 1.96 * payload.std, fmt="o", markersize=3, color=VERMILION, linewidth=1.0,
            label="found, and its 95 % interval",
        )  # fmt: skip
        axes.step(payload.begin_s / SECONDS_PER_MIN, payload.true, where="post", color=BLUE, label="passengers, 70 kg each")
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_xlabel("time [min]")
        axes.set_ylabel("mass beside its mean [kg]")
        axes.legend()

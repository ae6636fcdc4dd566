# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the unsealed findings on the trolley bus: slopes against altitudes, masses against passengers."""

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
    slopes = [(t.hidden, slope) for t in tried if (slope := slope_found(t, given)) is not None]
    if slopes:
        lines += ["The slope found, against that of the altitude averaged over all passes of a place and taken over 300 m:", ""]
        lines += ["| Concealed | Correlation | Coefficient |", "|---|---|---|"]
        lines += [f"| {hidden} | {slope.correlation:.2f} | {slope.coefficient:.2f} |" for hidden, slope in slopes]
        lines.append("")
    else:
        lines += ["No slope was found.", ""]
    hidden = next(t for t in tried if t.hidden == "passengers")
    payload = payload_found(hidden, given)
    if payload is None:
        return [*lines, "With the passengers concealed no payload was found.", ""]
    differ, error, stated = (
        figures(float(x)) for x in (payload.true.std(), np.sqrt(np.mean((payload.mass - payload.true) ** 2)), payload.std.mean())
    )
    lines.append(
        f"With the passengers concealed, the masses of {len(payload.mass)} stretches have a correlation of "
        f"{payload.correlation:.2f} with those of the passengers (70 kg each). These differ by {differ} kg. The masses are "
        f"{error} kg off; their stated standard deviation is {stated} kg. No stretch has more than {payload.longest_s:.0f} s of "
        f"driving. Joined until they have {LONG_STRETCH_S:.0f} s, {payload.close} of {payload.long} are within {CLOSE:.0%} of "
        "the passengers' weight."
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
        axes.set_ylabel("mass less its mean [kg]")
        axes.legend()

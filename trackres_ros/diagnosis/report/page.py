# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""report.html: one page without a network, readable on paper and on a phone."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trackres_ros.diagnosis.report.interactive import Interactive
from trackres_ros.diagnosis.report.picture import Picture
from trackres_ros.diagnosis.report.tiles import by_file, headline, lights, stage_of, tiles
from trackres_ros.text.numbers import alike, decimals, figures
from trackres_ros.text.templates import templates

KINDS = {".svg": "image/svg+xml", ".png": "image/png"}
VERDICTS = {
    "none": "No physics missing",
    "named": "Named",
    "one_of": "One of several",
    "described": "Described",
    "unexplained": "Unexplained",
}
GRADES = {
    "confirmed": "confirmed on hold-out laps",
    "suspected": "suspected: it fits, hold-out laps do not confirm it",
    "refuted": "refuted: hold-out laps get worse with it",
}


def write_page(
    path: Path,
    report: dict[str, Any],
    pictures: Sequence[Picture],
    title: str,
    plots: Interactive | str = "",
    provenance: Sequence[tuple[str, str]] = (),
) -> None:
    """Write the page of a report with its pictures in it.

    Parameters
    ----------
    plots
        Interactive plots, or the reason for having none.
    provenance
        Sources of the page: names and texts.

    Raises
    ------
    MissingExtraError
        Without jinja2.
    """
    environment = templates(
        "trackres_ros.diagnosis.report", "report.html", "diagnosis", figures=figures, interval=interval, r2=r2
    )
    page = environment.get_template("page.html").render(
        r=report,
        title=title,
        verdict=VERDICTS[report["verdict"]["status"]],
        grades=GRADES,
        headline=headline(report),
        tiles=tiles(report),
        by_file=by_file(report) if "written" in report else ([], []),
        lights=list(lights(report)),
        stage=stage_of(report),
        plots=plots if isinstance(plots, Interactive) else None,
        no_plots=plots if isinstance(plots, str) else "",
        script=script(),
        provenance=provenance,
        pictures=[(p, KINDS[p.path.suffix], base64.b64encode(p.path.read_bytes()).decode()) for p in pictures],
    )
    path.write_text(page, encoding="utf-8")


def script() -> str:
    """The script of the page."""
    return Path(__file__).with_name("page.js").read_text(encoding="utf-8")


def r2(value: float | None) -> str:
    """A coefficient of determination; a value below 1 is never rounded to 1."""
    text = decimals(value, 3)
    return "> 0.999" if text == "1.000" and value != 1.0 else text


def interval(parameter: dict[str, Any]) -> tuple[str, str, str]:
    """A parameter's value, its interval, and the vehicle file's value, all rounded to the precision of the interval."""
    values = parameter["value"], parameter.get("nominal")
    if not parameter["ci95"] or None in parameter["ci95"]:
        value, nominal = (figures(v) for v in values)
        return value, "only a bound" if parameter.get("bound_only") else "-", nominal
    low, high = parameter["ci95"]
    value, nominal, *ends = alike((*values, low, high), high - low)
    return value, " … ".join(ends), nominal

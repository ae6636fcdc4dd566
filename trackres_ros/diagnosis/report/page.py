# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""report.html: one page without a network, readable on paper and on a phone."""

from __future__ import annotations

import base64
import hashlib
import platform
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from trackres_ros.diagnosis.report.interactive import Interactive
from trackres_ros.diagnosis.report.picture import Picture
from trackres_ros.diagnosis.report.series import MOST_RECORDINGS
from trackres_ros.diagnosis.report.tiles import by_file, headline, lights, stage_of, tiles
from trackres_ros.files.file_sets import present
from trackres_ros.files.own_files import write
from trackres_ros.text import alike, decimals, figures, templates, told_apart
from trackres_ros.version import __version__

KINDS = {".svg": "image/svg+xml", ".png": "image/png"}
VERDICTS = {
    "none": "No physics missing",
    "named": "Named",
    "one_of": "One of several",
    "described": "Described",
    "unexplained": "Unexplained",
}
GRADES = {
    "confirmed": "confirmed by laps left out of the fit",
    "suspected": "suspected: it fits, but is not confirmed",
    "refuted": "refuted: laps left out of the fit get worse with it, or it replaces a given value",
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
    package = "trackres_ros.diagnosis.report"
    environment = templates(package, "report.html", "diagnosis", figures=figures, interval=interval, r2=r2)
    page = environment.get_template("page.html").render(
        r=report,
        title=title,
        verdict=VERDICTS[report["verdict"]["status"]],
        grades=GRADES,
        headline=headline(report),
        tiles=tiles(report),
        by_file=by_file(report),
        lights=list(lights(report)),
        stage=stage_of(report),
        most_recordings=MOST_RECORDINGS,
        plots=plots if isinstance(plots, Interactive) else None,
        no_plots=plots if isinstance(plots, str) else "",
        script=Path(__file__).with_name("page.js").read_text(encoding="utf-8"),
        provenance=provenance,
        pictures=[(p, KINDS[p.path.suffix], base64.b64encode(present(p.path) or b"").decode()) for p in pictures],
    )
    write(path, page.encode())


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


def provenance(read: Sequence[Path], seconds: float | None) -> list[tuple[str, str]]:
    """Name and text of each item of the provenance, from the read files and folders and the duration of the diagnosis."""
    program = Path(sys.argv[0])
    words = [program.name] if program.stem != "__main__" else ["python", "-m", program.parent.name]
    names = told_apart([str(path) for path in read])
    versions = f"trackres {__version__}, Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}"
    return [
        ("made", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"),
        ("version", versions),
        ("command", shlex.join([*words, *sys.argv[1:]])),
        *([] if seconds is None else [("duration", f"{seconds:.1f} s, without this page")]),
        *((name, f"SHA-256 {digest}") for name, path in zip(names, read, strict=True) if (digest := sha256(path))),
    ]


def sha256(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder in sequence; empty if neither exists."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else []
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as content:
            while block := content.read(1 << 20):
                digest.update(block)
    return digest.hexdigest() if files else ""

"""report.html: one page without a network, readable on paper and on a phone."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trackres_ros.errors import MissingExtraError
from trackres_ros.report.pictures import Picture

VERDICTS = {"none": "No physics missing", "named": "Named", "one_of": "One of several", "unexplained": "Unexplained"}


def write_page(path: Path, report: dict[str, Any], pictures: Sequence[Picture], title: str) -> None:
    """Write the page of a report with its pictures in it.

    Raises
    ------
    MissingExtraError
        Without jinja2.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError:
        raise MissingExtraError("report.html", "jinja2", "diagnosis") from None
    environment = Environment(loader=PackageLoader("trackres_ros.report", "."), autoescape=True, undefined=StrictUndefined)
    environment.filters["figures"] = figures
    page = environment.get_template("page.html").render(
        r=report,
        title=title,
        verdict=VERDICTS[report["verdict"]["status"]],
        pictures=[(p, base64.b64encode(p.path.read_bytes()).decode()) for p in pictures],
    )
    path.write_text(page, encoding="utf-8")


def figures(value: float | None, count: int = 3) -> str:
    """A number with a few figures."""
    return "-" if value is None else f"{value:.{count}g}"

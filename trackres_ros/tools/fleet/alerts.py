# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reports the changes of a fleet to other programs: a CSV table, and a message to a web address."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from trackres_ros.errors import InputError, one_line
from trackres_ros.files.own_files import write
from trackres_ros.tools.fleet.trends import change_sentence
from trackres_ros.version import __version__

FILE = "alerts.csv"
TIMEOUT_S = 10.0
OF_CHANGE = (
    "parameter", "kind", "since", "known", "recordings_until_known", "before", "size", "size_std", "unit", "file",
    "percent_of_file", "percent_of_torque", "gain",
)  # fmt: skip
OF_LIMIT = {"limit": "limit", "limit_reached": "reached", "limit_day": "day", "limit_from": "from", "limit_to": "to"}
COLUMNS = ("vehicle", *OF_CHANGE, "alike", *OF_LIMIT, "text", "ended")


def alerts(trends: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One row for each change of each vehicle, with the columns `COLUMNS`; None for a missing value.

    `trends`: from `trends.trends`.
    """
    rows = []
    for name, vehicle in trends["vehicles"].items():
        for change in vehicle["changes"]:
            forecast = change["forecast"] or {}
            row = {"vehicle": name, **{key: change[key] for key in OF_CHANGE}, "alike": " ".join(change["alike"])}
            row |= {column: forecast.get(key) for column, key in OF_LIMIT.items()}
            rows.append({**row, "text": change_sentence(name, change), "ended": change["ended"]})
    return rows


def write_alerts(path: Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write the rows as CSV; without any, the line of names alone."""
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write(path, text.getvalue().encode())
    return path


class _NoRedirect(HTTPRedirectHandler):
    """A redirected POST would lose its content."""

    def redirect_request(self, *_args: Any, **_kwargs: Any) -> None:
        """Follow no redirect; see `HTTPRedirectHandler`."""


def checked_url(url: str) -> str:
    """The address, if a message can be sent to it. Raises InputError otherwise."""
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and bool(parts.hostname) and (parts.port or 1) > 0
    except ValueError:
        usable = False
    if not usable or not url.isascii() or not url.isprintable() or " " in url:
        raise InputError("--webhook", url, "http://HOST[:PORT]/PATH or https://HOST[:PORT]/PATH")
    return url


def post_alerts(url: str, folder: Path, rows: Sequence[Mapping[str, Any]]) -> str:
    """Send the rows as JSON: ``{"program", "version", "results", "alerts"}``.

    Returns reason of a failure; empty if the address answered with 2xx. The path of the address is not shown: it may be secret.
    """
    content = {"program": "trackres", "version": __version__, "results": str(folder), "alerts": list(rows)}
    data = json.dumps(content, allow_nan=False).encode()
    headers = {"Content-Type": "application/json", "User-Agent": f"trackres/{__version__}"}
    parts = urlsplit(url)
    host = f"{parts.scheme}://{parts.hostname}{f':{parts.port}' if parts.port else ''}"
    try:
        with build_opener(_NoRedirect).open(Request(url, data, headers, method="POST"), timeout=TIMEOUT_S):
            return ""
    except HTTPError as error:
        with error:
            return f"{host} answered {error.code} {one_line(str(error.reason))}"
    except (OSError, HTTPException, ValueError) as error:
        return f"{host}: {one_line(str(getattr(error, 'reason', '') or error) or type(error).__name__)}"

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs the whole reproduction and writes pictures, tables, summary and page."""

from __future__ import annotations

import csv
import io
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from proofs.reproduce.bench import COMBINATIONS, HOLDS, Bench, Section
from proofs.reproduce.strain import compound, indentation, spectrum
from proofs.reproduce.studies import AMBIENTS_DEGC, SPEEDS_KMH, WEIGHTS_KN, ambients, speeds, weights
from proofs.reproduce.trials import TRIALS, trials
from trackres_ros.errors import InputError
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.own_files import write
from trackres_ros.vehicle import load

VEHICLE = "xgd24d"  # the paper's
STEP_S = 0.5  # the step follows the linearised model exactly; 0.1 s moves no number of the page
LONGEST_STEP_S = 5.0  # about the shortest ramp
RUNS = len(COMBINATIONS) * (len(SPEEDS_KMH) + len(WEIGHTS_KN) + len(AMBIENTS_DEGC) + len(TRIALS))
INDEX, SUMMARY, CLAIMS, TABLES = "index.md", "summary.json", "claims.csv", "tables.csv"
COMMAND = "python -m proofs reproduce -o docs/reproduction --page docs/reproduction.md"
CLAIMS_HEADER = ("section", "claim", "place", "verdict", "methods", "holds", "quantity", "value")
TABLES_HEADER = ("section", "table", "row", "quantity", "value")


@file_set()
def reproduce(
    out_dir: Path,
    progress: Callable[[str, float], None] | None = None,
    *,
    page: Path | None = None,
    dt: float = STEP_S,
) -> dict[str, Any]:
    """Reproduce the paper's Figures 6, 10, 11, 16 to 22 and 24 to 26, and check the claims of its text.

    The folder then has the pictures (PNG), their data, claims and tables (CSV), and `summary.json` with every number the page
    cites, which is returned. The page is `page`, with links from there into the folder, or `index.md` in the folder. `progress`
    is called with what was done last and the share done, 0 to 1. `dt` is the time step of the drives [s]; InputError if it is
    not positive or too long for the ramps. MissingExtraError without matplotlib.
    """
    if not 0.0 < dt <= LONGEST_STEP_S:
        raise InputError("dt", dt, f"a time step of more than 0 and at most {LONGEST_STEP_S:g} s")
    done = 0

    def advance(text: str) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(text, min(done / RUNS, 1.0))

    bench = Bench(load(VEHICLE), dt, advance)
    sections: list[Section] = [
        indentation(bench, out_dir),
        spectrum(bench, out_dir),
        compound(bench, out_dir),
        *trials(bench, out_dir),
        speeds(bench, out_dir),
        weights(bench, out_dir),
        ambients(bench, out_dir),
    ]
    vehicle = bench.vehicle
    summary = {
        "vehicle": {"name": vehicle.name, "title": vehicle.title, "weight_n": vehicle.weight, "methods": bench.shipped},
        "dt_s": dt,
        "text": _introduction(bench),
        "sections": [section.summary() for section in sections],
    }
    write(out_dir / SUMMARY, (json.dumps(summary, indent=1, ensure_ascii=False) + "\n").encode())
    for name, text in tables_of(summary).items():
        write(out_dir / name, text.encode())
    page = page or out_dir / INDEX
    folder = Path(os.path.relpath(out_dir, page.parent)).as_posix()
    write(page, page_of(summary, "" if folder == "." else f"{folder}/").encode())
    return summary


def _introduction(bench: Bench) -> list[str]:
    return [
        "The paper is Liang et al., Modeling and Verification of Rolling Resistance Torque of High-Speed Rubber Track "
        "Assembly Considering Hysteresis Loss, Polymers 2023. Only its text is public, not the numbers of its curves and "
        "measurements. So this page compares trends and stated numbers. Many values of the vehicle file are assumed, so the "
        "size of a torque is the program's, not the paper's.",
        "",
        "Four combinations of methods are run. The loss is by `spectral`, exact for linear viscoelasticity, or by the paper's "
        "`rainflow`. Rainflow counts a pulse as one cycle of one frequency, without its harmonics, so it has less loss. The belt "
        "temperature is by the paper's `lumped`, one mean, or by `core_surface`. That has a resistance inside the rubber, so "
        f"its belt runs hotter. Pictures show {bench.shipped.replace('/', ' and ')}, which the vehicle file names.",
    ]


def page_of(summary: Mapping[str, Any], prefix: str = "") -> str:
    """Markdown of a summary; `prefix` leads from the page to the folder of the pictures, as `reproduction/`."""
    sections = summary["sections"]
    verdicts = Counter(claim["verdict"] for section in sections for claim in section["claims"])
    lines = [
        "# The paper's figures and tests, reproduced",
        "",
        "Use this page to see which figures and claims of the paper the program confirms, how closely, and why it departs. This "
        f"writes the page, for the {summary['vehicle']['title']}:",
        "",
        f"    {COMMAND}",
        "",
        *summary["text"],
        "",
        f"[{CLAIMS}]({prefix}{CLAIMS}) has the numbers of each claim by combination, "
        f"[{TABLES}]({prefix}{TABLES}) torques and belt temperatures of each study. [{SUMMARY}]({prefix}{SUMMARY}) has all of "
        "it, and the reason for each verdict.",
        "",
        "## Departures",
        "",
        f"Of {verdicts.total()} claims {verdicts[HOLDS]} hold. The others:",
        "",
        "| Claim | Paper | Verdict |",
        "|---|---|---|",
    ]
    for section in sections:
        lines += [
            f"| {claim['paper']} | {claim['where']} | [{claim['verdict']}](#{anchor(section['title'])}) |"
            for claim in section["claims"]
            if claim["verdict"] != HOLDS
        ]
    for section in sections:
        lines += ["", *_section(section, prefix)]
    return "\n".join(lines) + "\n"


def tables_of(summary: Mapping[str, Any]) -> dict[str, str]:
    """The tables of claims and of studies, a number a row, by file name."""
    tables = {CLAIMS: (CLAIMS_HEADER, _claim_rows(summary)), TABLES: (TABLES_HEADER, _table_rows(summary))}
    files = {}
    for name, (header, rows) in tables.items():
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([header, *rows])
        files[name] = text.getvalue()
    return files


def _claim_rows(summary: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """For each claim and combination, or each part of a claim, its outcome and the numbers behind it."""
    for section in summary["sections"]:
        for claim in section["claims"]:
            shared = section["title"], claim["paper"], claim["where"], claim["verdict"]
            combinations = dict.fromkeys([*claim["holds"], *(name for values in claim["details"].values() for name in values)])
            for name in combinations or [""]:
                outcome = {True: "yes", False: "no"}.get(claim["holds"].get(name), "")
                numbers = [(what, values[name]) for what, values in claim["details"].items() if name in values]
                for quantity, value in numbers or [("", "")]:
                    yield (*shared, name.replace("/", ", "), outcome, quantity, value)


def _table_rows(summary: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for section in summary["sections"]:
        for table in section["tables"]:
            first, *quantities = table["header"]
            for row in table["rows"]:
                for quantity, value in zip(quantities, row[1:], strict=True):
                    yield section["title"], table["caption"], f"{first}: {row[0]}", quantity, value


def anchor(title: str) -> str:
    """The link target of a heading on a forge."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")


def _section(section: Mapping[str, Any], prefix: str) -> list[str]:
    lines = [f"## {section['title']}", ""]
    for figure in section["figures"]:
        lines += [f"![{figure['caption']}]({prefix}{figure['png']})", ""]
    data = dict.fromkeys(name for figure in section["figures"] for name in figure["data"])
    links = ", ".join(f"[{name}]({prefix}{name})" for name in data)
    lines += [" ".join([*section["text"], f"Data: {links}."]), ""]
    for claim in section["claims"]:
        text = f"- **{claim['paper']}** {claim['verdict'].capitalize()}{_which(claim)} {claim['shows']}"
        lines.append(f"{text} Why: {claim['why']}" if claim["why"] and claim["verdict"] != HOLDS else text)
    return lines


def _which(claim: Mapping[str, Any]) -> str:
    """For which combinations or parts a claim holds, if not for all."""
    true = [name for name, holds in claim["holds"].items() if holds]
    return f", for {'; '.join(name.replace('/', ', ') for name in true)} only." if 0 < len(true) < len(claim["holds"]) else "."

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs the whole reproduction and writes pictures, tables, summary and page."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from proofs.reproduce.bench import COMBINATIONS, Bench, Section
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
INDEX, SUMMARY = "index.md", "summary.json"
COMMAND = "python -m proofs reproduce -o docs/reproduction --page docs/reproduction.md"


@file_set()
def reproduce(
    out_dir: Path,
    progress: Callable[[str, float], None] | None = None,
    *,
    page: Path | None = None,
    dt: float = STEP_S,
) -> dict[str, Any]:
    """Reproduce the paper's Figures 6, 10, 11, 16 to 22 and 24 to 26, and check the claims of its text.

    The folder then has the pictures (PNG), their data (CSV), `summary.json` with every number the page cites, which is returned,
    and `index.md`, the page. `page` is another place to write it to, with links from there into the folder. `progress` is called
    with what was done last and the share done, 0 to 1. `dt` is the time step of the drives [s]; InputError if it is not positive
    or too long for the ramps. MissingExtraError without matplotlib.
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
    write(out_dir / INDEX, page_of(summary).encode())
    if page is not None:
        folder = Path(os.path.relpath(out_dir, page.parent)).as_posix()
        write(page, page_of(summary, f"{folder}/").encode())
    return summary


def _introduction(bench: Bench) -> list[str]:
    return [
        "The paper is Liang et al., Modeling and Verification of Rolling Resistance Torque of High-Speed Rubber Track "
        "Assembly Considering Hysteresis Loss, Polymers 2023. Its curves and measurements are not public in numbers, only "
        "its text. So this page compares trends and stated numbers. It does not reproduce the paper's mean absolute errors "
        "and R², as the measurements are not public. Many values of the vehicle file are assumed where the paper gives none. "
        "So the size of a torque here is the program's, not the paper's.",
        "",
        "Where it matters, four combinations are shown. The loss is by `spectral` (exact for linear viscoelasticity) or "
        "`rainflow` (the paper's), the belt temperature by `lumped` (the paper's) or `core_surface`. The vehicle file names "
        f"{bench.shipped.replace('/', ' and ')}; the paper's own is rainflow and lumped. A verdict is that of a predicate on "
        "the run; where the combinations disagree it says for which the claim holds.",
        "",
        "`lumped` is one mean temperature, and no resistance inside the rubber. `core_surface` has that resistance, so its "
        "belt, whose mean is shown, runs hotter. `rainflow` counts a pulse as one cycle of one frequency and ignores its "
        "harmonics, so it has less loss. The table of Figures 10 and 11 has both.",
    ]


def page_of(summary: Mapping[str, Any], prefix: str = "") -> str:
    """Markdown of a summary; `prefix` leads from the page to the folder of the pictures, as `reproduction/`."""
    sections = summary["sections"]
    lines = [
        "# The paper's figures and tests, reproduced",
        "",
        f"Written by `{COMMAND}`, for {summary['vehicle']['title']}. Verdicts and numbers are computed in the run; none is "
        "typed.",
        "",
        *summary["text"],
        "",
        "## Overview",
        "",
        "| Claim | Paper | Verdict |",
        "|---|---|---|",
    ]
    for section in sections:
        lines += [
            f"| {claim['paper']} | {claim['where']} | [{claim['verdict']}](#{anchor(section['title'])}) |"
            for claim in section["claims"]
        ]
    for section in sections:
        lines += ["", *_section(section, prefix)]
    return "\n".join(lines) + "\n"


def anchor(title: str) -> str:
    """The link target of a heading on a forge."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")


def _section(section: Mapping[str, Any], prefix: str) -> list[str]:
    lines = [f"## {section['title']}", ""]
    for paragraph in section["text"]:
        lines += [paragraph.replace("{prefix}", prefix), ""]
    for figure in section["figures"]:
        lines += [
            f"![{figure['caption']}]({prefix}{figure['png']})",
            "",
            f"*{figure['caption']} Data: [{figure['csv']}]({prefix}{figure['csv']}).*",
            "",
        ]
    for table in section["tables"]:
        lines += [table["caption"], "", f"| {' | '.join(table['header'])} |", "|" + "---|" * len(table["header"])]
        lines += [f"| {' | '.join(row)} |" for row in table["rows"]]
        lines.append("")
    for claim in section["claims"]:
        lines += [
            f"**{claim['paper']}** ({claim['where']})",
            "",
            f"- Verdict: **{claim['verdict']}**{_which(claim)}",
            f"- The program: {claim['shows']}",
        ]
        lines += [f"- Why: {claim['why']}"] if claim["why"] else []
        lines += ["", *_details(claim), ""] if claim["details"] else [""]
    return lines[:-1]


def _details(claim: Mapping[str, Any]) -> list[str]:
    """A row for each model combination, with the outcome if there is one for each."""
    details, holds = claim["details"], claim["holds"]
    combinations = list(next(iter(details.values())))
    by_method = set(combinations) == set(holds)
    lines = [
        f"| methods | {' | '.join(details)} |" + (" holds |" if by_method else ""),
        "|" + "---|" * (len(details) + 1 + by_method),
    ]
    for name in combinations:
        cells = [name.replace("/", ", "), *(texts[name] for texts in details.values())]
        cells += ["yes" if holds[name] else "no"] if by_method else []
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _which(claim: Mapping[str, Any]) -> str:
    true = [name for name, holds in claim["holds"].items() if holds]
    return f", for {'; '.join(name.replace('/', ', ') for name in true)} only." if 0 < len(true) < len(claim["holds"]) else "."

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the page of a reproduction, from its summary alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

COMMAND = "trackres reproduce -o docs/reproduction --page docs/reproduction.md"


def page(summary: Mapping[str, Any], prefix: str = "") -> str:
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

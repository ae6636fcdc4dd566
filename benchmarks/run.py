# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Run all benchmarks, or those whose titles are given; print what they show and write it to docs/performance.md."""

from __future__ import annotations

import argparse
import os
import platform
import re
import sys
from importlib import metadata

import bench_diagnosis
import bench_engine
import bench_live
import bench_memory
import bench_reading
import bench_replay
import bench_step
from measuring import ROOT, Row

sys.path.append(str(ROOT / "tools"))
from marks import write_page

PAGE = "docs/performance.md"
PACKAGES = ("numpy", "scipy", "rosbags", "cyclonedds")
BENCHMARKS = {
    "Replay": bench_replay,
    "A step": bench_step,
    "The live node": bench_live,
    "Diagnosis": bench_diagnosis,
    "Two workers": bench_engine,
    "Memory of a replay": bench_memory,
    "Reading": bench_reading,
}
HEAD = ["| | Measured | Rival | Ratio | Target |", "|---|---|---|---|---|"]


def formatted(value: float | None) -> str:
    """A number with three figures, or all before the point; empty for None."""
    return "" if value is None else f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def table(rows: list[Row]) -> list[str]:
    """Lines of a Markdown table; a missed target is bold."""
    lines = list(HEAD)
    for row in rows:
        target = formatted(row.target)
        cells = (row.name, *map(formatted, (row.measured, row.rival, row.ratio)), f"**{target}**" if row.missed else target)
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def section(title: str, rows: list[Row]) -> str:
    """A part of the page: a table, and what it is of."""
    return "\n".join(
        [f"## {title}", "", *(table(rows) if rows else ["Not measured."]), "", (BENCHMARKS[title].__doc__ or "").strip()]
    )


def missed(sections: dict[str, str]) -> str:
    """The rows of missed targets, a line for each section."""
    lines = []
    for title, text in sections.items():
        bold = [line.split(" | ")[0] for line in text.splitlines() if line.startswith("| ") and "**" in line]
        names = [cell.removeprefix("| ").rpartition(" [")[0] for cell in bold]
        if names:
            lines.append(f"- {title}: {'; '.join(names)}")
    return "\n".join(lines) or "None."


def machine() -> str:
    """Cores and versions, in one sentence."""
    versions = [f"Python {platform.python_version()}"]
    for name in PACKAGES:
        try:
            versions.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            versions.append(f"no {name}")
    return f"{len(os.sched_getaffinity(0))} cores, {platform.machine()}, {', '.join(versions)}"


def kept() -> dict[str, str]:
    """Sections of the page as it is, by title."""
    sections = (ROOT / PAGE).read_text(encoding="utf-8").partition("<!-- /sections -->")[0]
    parts = re.split(r"^## (.*)\n", sections, flags=re.MULTILINE)[1:]
    return {
        title: f"## {title}\n{text.rstrip()}" for title, text in zip(parts[::2], parts[1::2], strict=True) if title in BENCHMARKS
    }


def main(arguments: list[str]) -> int:
    """Run the benchmarks of some titles, or all; print them and write the page, in which the others stay as they are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("titles", nargs="*", metavar="TITLE", help=f"one of: {', '.join(BENCHMARKS)}; all without any")
    parser.add_argument("--small", action="store_true", help="tiny sizes, to see that all runs; leaves the page as it is")
    parser.add_argument("--print", action="store_true", dest="only_print", help="print the numbers, and leave the page as it is")
    given = parser.parse_args(arguments)
    titles = given.titles
    if unknown := [title for title in titles if title not in BENCHMARKS]:
        parser.error(f"no benchmark {unknown[0]!r}; there are: {', '.join(BENCHMARKS)}")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # of containers: where it is set, each process compiles all that it imports
    load_before = os.getloadavg()[0]
    sections = kept()
    for title in titles or list(BENCHMARKS):
        module = BENCHMARKS[title]
        print(f"{title} ...", file=sys.stderr, flush=True)
        sections[title] = section(title, module.run(**module.SMALL if given.small else {}))
        print(sections[title], flush=True)
    if given.only_print or given.small:
        return 0
    ordered = [sections[title] for title in BENCHMARKS if title in sections]
    parts = {"load": f"{load_before:.1f}", "sections": "\n\n".join(ordered), "missed": missed(sections)}
    write_page(PAGE, machine=machine(), **parts)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

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

import bench_controller
import bench_diagnosis
import bench_export
import bench_fleet
import bench_learning
import bench_live
import bench_reading
import bench_recording
import bench_route
import bench_step
import bench_table
import bench_ways
from measuring import ROOT, Target

sys.path.append(str(ROOT / "tools"))
from marks import write_page

PAGE = "docs/performance.md"
PACKAGES = ("numpy", "scipy", "rosbags", "cyclonedds")
BENCHMARKS = {
    "One step": bench_step,
    "On a route": bench_route,
    "A whole recording": bench_recording,
    "Reading and replay": bench_reading,
    "Loss table and start": bench_table,
    "The diagnosis": bench_diagnosis,
    "A fleet": bench_fleet,
    "The live node": bench_live,
    "The step as C": bench_export,
    "The step in a controller": bench_controller,
    "Learning": bench_learning,
    "Ways that were tried": bench_ways,
}


def formatted(value: float) -> str:
    """A number with three figures, or all before the point."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def rows(results: dict[str, float], targets: dict[str, Target]) -> list[str]:
    """Rows of a Markdown table; a target whose number is missing is said to be not measured."""
    lines = ["| What | Measured | Target | Met |", "|---|---|---|---|"]
    for name, value in results.items():
        target = targets.get(name)
        met = "" if target is None else "yes" if target.met(value) else "**no**"
        lines.append(f"| {name} | {formatted(value)} | {target or ''} | {met} |")
    lines += [f"| {name} | not measured | {target} | |" for name, target in targets.items() if name not in results]
    return lines


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
    parser.add_argument("--print", action="store_true", dest="only_print", help="print the numbers, and leave the page as it is")
    given = parser.parse_args(arguments)
    titles = given.titles
    if unknown := [title for title in titles if title not in BENCHMARKS]:
        parser.error(f"no benchmark {unknown[0]!r}; there are: {', '.join(BENCHMARKS)}")
    load_before = os.getloadavg()[0]
    sections = kept()
    for title in titles or list(BENCHMARKS):
        module = BENCHMARKS[title]
        print(f"{title} ...", file=sys.stderr, flush=True)
        results = module.run()
        sections[title] = "\n".join([f"## {title}", "", (module.__doc__ or "").strip(), "", *rows(results, module.TARGETS)])
        print(sections[title], flush=True)
    if given.only_print:
        return 0
    ordered = [sections[title] for title in BENCHMARKS if title in sections]
    missed = [
        f"- {title}: {line.split(' | ')[0].removeprefix('| ')}"
        for title in BENCHMARKS
        for line in sections.get(title, "").splitlines()
        if "**no**" in line
    ]
    parts = {"load": f"{load_before:.1f}", "sections": "\n\n".join(ordered), "missed": "\n".join(missed) or "None."}
    write_page(PAGE, machine=machine(), **parts)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

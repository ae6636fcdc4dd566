"""Run all benchmarks, print what they show and write it to docs/performance.md."""

from __future__ import annotations

import os
import platform
import re
import sys
from importlib import metadata
from pathlib import Path

import bench_live
import bench_reading
import bench_recording
import bench_step
import bench_table
from measuring import ROOT, Target

PAGE = ROOT / "docs" / "performance.md"
PACKAGES = ("numpy", "scipy", "numba", "rosbags", "cyclonedds")
BENCHMARKS = {
    "One step": bench_step,
    "A whole recording": bench_recording,
    "Reading and replay": bench_reading,
    "Loss table and start": bench_table,
    "The live node": bench_live,
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


def main() -> int:
    """Run, print, write."""
    load_before = os.getloadavg()[0]
    template = Path(__file__).with_name("performance.in.md").read_text(encoding="utf-8")
    sections, missed = [], []
    for title, module in BENCHMARKS.items():
        print(f"{title} ...", file=sys.stderr, flush=True)
        results = module.run()
        sections.append("\n".join([f"## {title}", "", module.__doc__.strip(), "", *rows(results, module.TARGETS)]))
        missed += [f"{title}: {name}" for name, t in module.TARGETS.items() if name in results and not t.met(results[name])]
    summary = "\n".join(f"- {name}" for name in missed) or "None."
    page = template.format(
        machine=machine(), load=f"{load_before:.1f}", sections="\n\n".join(sections), missed=summary
    )
    PAGE.write_text(re.sub(r"\n{3,}", "\n\n", page), encoding="utf-8")
    print(page)
    return 0


if __name__ == "__main__":
    sys.exit(main())

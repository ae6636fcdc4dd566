# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Process of a run in which an earlier version of this tool diagnoses the same cases, for comparison.

The earlier version is a checkout, and is run by its own command line, with the libraries installed here.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from trackres_ros.errors import InputError
from trackres_ros.evaluation.processes import each, unfinished


def main(cases: Path, results: Path, checkout: Path, first: int | None = None) -> None:
    """Have the version in a checkout diagnose the unfinished cases."""
    checkout = checkout.resolve()
    if not (checkout / "trackres_ros" / "__init__.py").is_file():
        raise InputError("--earlier", str(checkout), "a checkout of an earlier version, with its folder trackres_ros")
    work = partial(_diagnose, results.resolve(), checkout)
    each(work, unfinished(cases.resolve(), results, first), "diagnosed by the earlier version")


def _diagnose(results: Path, checkout: Path, folder: Path) -> None:
    with tempfile.TemporaryDirectory() as report:
        drives = [str(path) for path in sorted(folder.glob("drive_*.csv"))]
        command = [sys.executable, "-m", "trackres_ros", "diagnose", *drives, "--vehicle", str(folder / "vehicle.yaml")]
        environment = {**os.environ, "PYTHONPATH": str(checkout)}
        done = subprocess.run(
            [*command, "--quick", "-o", report], env=environment, cwd=report, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError(f"{folder.name}: the earlier version ended with exit code {done.returncode}: {done.stderr[-500:]}")
        shutil.move(Path(report) / "report.json", results / f"{folder.name}.json")

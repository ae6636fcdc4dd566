# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Process of a run in which an earlier version of this tool diagnoses the same cases, for comparison.

The earlier version is a checkout, and is run by its own command line, with the libraries installed here.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from functools import partial
from pathlib import Path

from proofs.processes import each, unfinished
from trackres_ros.errors import InputError
from trackres_ros.files.interpreter import python


def main(cases: Path, results: Path, checkout: Path, first: int | None = None) -> None:
    """Have the version in a checkout diagnose the unfinished cases."""
    checkout = checkout.resolve()
    if not (checkout / "trackres_ros" / "__init__.py").is_file():
        raise InputError("--earlier", str(checkout), "a checkout of an earlier version, with its folder trackres_ros")
    work = partial(_diagnose, results.resolve(), checkout)
    each(work, unfinished(cases.resolve(), results, first), "diagnosed by the earlier version")


def _diagnose(results: Path, checkout: Path, folder: Path) -> None:
    with tempfile.TemporaryDirectory() as report:
        drives = sorted(folder.glob("drive_*.csv"))
        words = ("diagnose", *drives, "--vehicle", folder / "vehicle.yaml", "--quick", "-o", report)
        earlier = python("trackres_ros", *words, PYTHONPATH=str(checkout))
        done = subprocess.run(**earlier, cwd=report, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{folder.name}: the earlier version ended with exit code {done.returncode}: {done.stderr[-500:]}")
        shutil.move(Path(report) / "report.json", results / f"{folder.name}.json")

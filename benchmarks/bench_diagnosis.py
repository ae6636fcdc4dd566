# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Three drives of 20 minutes at 10 Hz, with an effect that the vehicle file lacks. A diagnosis is the command `trackres
diagnose`, with page and pictures. Memory for each hour is the growth of the peak to three drives of an hour.
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from measuring import Ended, Row, alone, seconds, trackres

from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.synthetic import drives, write_recordings
from trackres_ros.effects import Active, catalogue

EFFECT = "viscous_bearing"
SEED = 2
DRIVES, LONGER = 3, 3
STEP_S = 0.1
SMALL = {"repeats": 1, "minutes": 2.5}
TARGET_S = 10.0


def run(repeats: int = 3, minutes: float = 20.0) -> list[Row]:
    """Measure drives of some minutes, medians of repeats, and one diagnosis of drives three times as long."""
    loaded = load_base("xgd24d")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = _recordings(loaded, folder / "short", minutes)
        sessions = gate(read_recordings(paths, None), loaded.known, hide=["belt"]).sessions
        problem = Problem(loaded.base, sessions, tuple(session.used for session in sessions))
        fits = [seconds(lambda: fit(problem, rounds=1)) for _ in range(repeats + 1)][1:]  # the first one imports
        ended = [_diagnosed(paths, folder / "report") for _ in range(repeats)]
        longer = _diagnosed(_recordings(loaded, folder / "long", LONGER * minutes), folder / "longer").peak_bytes
    peak = statistics.median(one.peak_bytes for one in ended)
    added_h = DRIVES * (LONGER - 1) * minutes / 60.0
    return [
        alone("fit of three drives [ms]", 1e3 * statistics.median(fits)),
        alone("diagnosis [s]", statistics.median(one.wall_s for one in ended), TARGET_S),
        alone("its peak memory [MB]", 1e-6 * peak),
        alone("memory for each hour [MB]", 1e-6 * (longer - peak) / added_h),
    ]


def _recordings(loaded: Any, folder: Path, minutes: float) -> list[Path]:
    """Drives with an effect that the vehicle file lacks, as tables."""
    folder.mkdir()
    rng, effect = np.random.default_rng(SEED), catalogue()[EFFECT]
    sessions = drives(loaded.base, loaded.known.max_speed, DRIVES, minutes, rng, STEP_S)
    return write_recordings(loaded.base, folder, sessions, [Active(effect, effect.values())], rng)


def _diagnosed(paths: list[Path], out: Path) -> Ended:
    return trackres("diagnose", *paths, "--vehicle", "xgd24d", "-o", out)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads speeds that real vehicles drove: only their speed is used, for drives of the simulated vehicle."""

from __future__ import annotations

import csv
import gzip
from pathlib import Path

import numpy as np

from proofs.sealed.drives import RESTING_MPS, STEP_S, Array
from trackres_ros.errors import InputError

SOURCES = {
    "bmw_i3/Trip*.csv.gz": (";", "Time [s]", "Velocity [km/h]", 1.0 / 3.6),
    "ztbus/*.csv.gz": (",", "time_unix", "odometry_vehicleSpeed", 1.0),
}  # files, delimiter, columns of time and speed, and the unit of the speed
SMOOTH_S = 1.5  # over which a speed recorded once a second is rounded


def profile_files(data: Path) -> list[tuple[Path, tuple[str, str, str, float]]]:
    """Recordings in the folder that `python -m proofs real --data` takes, each with how it is read."""
    found = [(path, how) for pattern, how in SOURCES.items() for path in sorted(data.glob(pattern))]
    if not found:
        raise InputError("--profiles", str(data), "a folder with bmw_i3/Trip*.csv.gz or ztbus/*.csv.gz")
    return found


def read_profiles(data: Path) -> list[Array]:
    """Speeds [m/s] by `STEP_S`, one series a recording that has a stop in it."""
    found = []
    for path, (delimiter, time_name, speed_name, unit) in profile_files(data):
        with gzip.open(path, "rt", encoding="latin-1", newline="") as lines:
            rows = [(row[time_name] or "nan", row[speed_name] or "nan") for row in csv.DictReader(lines, delimiter=delimiter)]
        table = np.array(rows, dtype=float)
        table = table[np.isfinite(table).all(axis=1)]
        _, first = np.unique(table[:, 0], return_index=True)
        time, speed = table[first].T
        even = np.interp(np.arange(time[0], time[-1], STEP_S), time, np.abs(speed) * unit)
        window = np.hanning(int(SMOOTH_S / STEP_S) + 2)[1:-1]
        smooth = np.convolve(even, window / window.sum(), mode="same")
        if (smooth < RESTING_MPS).any():
            found.append(smooth)
    return found

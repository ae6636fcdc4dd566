# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads public recordings of real vehicles into tables that `trackres diagnose` reads. The project holds none of them.

The car: Steinstraeter, Buberger, Trifonov, "Battery and Heating Data in Real Driving Cycles", IEEE DataPort,
doi:10.21227/6jr9-5235. The robots: norlab-ulaval, DRIVE, BSD-3.
"""

from __future__ import annotations

import csv
import gzip
import io
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.output.table import write_table
from trackres_ros.recording.slopes import slopes
from trackres_ros.units import EARTH_M, KMH_PER_MPS

Array = NDArray[np.float64]

FINAL_DRIVE = 9.665
SECONDS_PER_H = 3600.0
SLOWEST_MPS, YAW_OVER_S = 0.1, 0.5
NM_PER_A = 1.0  # assumed: unit of the results of the robots
POSITION = {"latitude_deg": "y", "longitude_deg": "x"}
RADIUS_M = {"husky": 0.159, "warthog": 0.3}
OF_CAR = ("Time [s]", "Velocity [km/h]", "Elevation [m]", "Motor Torque [Nm]", "Ambient Temperature")


def trips(data: Path) -> dict[str, dict[str, str]]:
    """Rows of the car's trips.csv by name."""
    with (data / "bmw_i3" / "trips.csv").open(encoding="utf-8") as lines:
        return {row["trip"]: row for row in csv.DictReader(lines)}


def car(data: Path, name: str, folder: Path, clock: bool = True, ground: str = "grade") -> Path:
    """Write one trip of the car: torque at the wheels, elevation as `ground` (`grade`, `altitude_m` or nothing), and its standing
    time before. Without `clock` it begins at 0 s, and the standing time is unknown.
    """
    text = gzip.decompress((data / "bmw_i3" / f"{name}.csv.gz").read_bytes()).decode("latin-1")
    header, *lines = [line.split(";") for line in text.splitlines()]
    place = [next(i for i, column in enumerate(header) if column.startswith(title)) for title in OF_CAR]
    table = np.array(
        [[float(line[i]) if line[i].strip() else np.nan for i in place] for line in lines if len(line) >= len(header) - 1]
    )
    _, first = np.unique(table[:, 0], return_index=True)
    time, kmh, height, torque, ambient = table[first].T
    speed = kmh / KMH_PER_MPS
    trip = trips(data)[name]
    start = datetime.fromisoformat(trip["start_local"]).replace(tzinfo=UTC).timestamp() if clock else 0.0
    stood_s = SECONDS_PER_H * float(trip["hours_since_previous_trip_ended"] or "nan") if clock else np.nan
    columns = {
        "time_s": start + time,
        "speed_mps": speed,
        "torque_nm": torque * FINAL_DRIVE,
        "ambient_degc": ambient,
        **({ground: slopes(time, speed, height).value if ground == "grade" else height} if ground else {}),
        "stood_s": np.full(len(time), stood_s),
    }
    return _write(folder / f"{name}.csv", columns)


def robot(data: Path, name: str, folder: Path) -> Path:
    """Write one recording of a skid-steered robot.

    Its sides turn at different speeds: the torque is the power of both sides' currents over the mean speed. Heading and yaw rate
    are those of the laser scans' position, as one of the robots records no gyroscope. The position is relative to a point on
    the equator.
    """
    text = gzip.decompress((data / "husky_warthog" / f"{name}.csv.gz").read_bytes()).decode()
    rows = list(csv.DictReader(io.StringIO(text)))

    def column(title: str) -> Array:
        return np.array([float(row[title]) if row[title] not in ("", "nan") else np.nan for row in rows])

    time = column("ros_time") * 1e-9
    there = np.concatenate(([False], np.diff(time) > 0.0)) & (time > 1.0)
    radius = RADIUS_M[name.partition("_")[0]]
    power, mean, rims = np.zeros(len(rows)), np.zeros(len(rows)), {}
    signed = float(np.nanmin(column("left_wheel_current"))) < -1.0
    for side in ("left", "right"):
        speed, current = radius * column(f"meas_{side}_vel"), column(f"{side}_wheel_current")
        power += current * (speed if signed else np.abs(speed))
        mean += 0.5 * speed
        rims[side] = speed
    moving = np.abs(mean) > SLOWEST_MPS
    yaw = np.unwrap(2.0 * np.arctan2(column("icp_quat_z"), column("icp_quat_w"))[there])
    at = time[there]
    after, before = (np.interp(at + side * 0.5 * YAW_OVER_S, at, yaw) for side in (1.0, -1.0))
    columns = {
        "time_s": at,
        "speed_mps": mean[there],
        "torque_nm": np.where(moving, NM_PER_A * power / np.where(moving, mean, 1.0), np.nan)[there],
        "yaw_rate_radps": (after - before) / YAW_OVER_S,
        "heading_rad": yaw,
        **{name: np.degrees(column(f"icp_pos_{axis}")[there] / EARTH_M) for name, axis in POSITION.items()},
        **{f"wheel_speed_mps/{side}": rim[there] for side, rim in rims.items()},
    }
    return _write(folder / f"{name}.csv", columns)


def _write(path: Path, columns: dict[str, Array]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_table(path, columns)
    return path

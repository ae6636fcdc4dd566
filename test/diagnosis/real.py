"""The public recordings that tests use where they are present, as tables that `trackres diagnose` reads."""

import csv
import gzip
import io
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
FINAL_DRIVE = 9.665
CLIPPED_NM = -80.0  # of the motor: below it torque and friction brakes cannot be told apart
SLOWEST_MPS, YAW_OVER_S = 0.1, 0.5
NM_PER_A = 1.0  # assumed: the base's scale is re-fitted
RADIUS_M = {"husky": 0.159, "warthog": 0.3}


def _write(path, columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.column_stack(list(columns.values()))
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(columns) + "\n")
        for row in rows:
            file.write(",".join("" if np.isnan(x) else f"{x:.6f}" for x in row) + "\n")
    return path


def trips():
    """Rows of trips.csv by name."""
    with (DATA / "bmw_i3" / "trips.csv").open(encoding="utf-8") as lines:
        return {row["trip"]: row for row in csv.DictReader(lines)}


def car(name, folder, elevation=True):
    """One trip of the car: torque at the wheels; elevation as a slope over 200 m."""
    text = gzip.decompress((DATA / "bmw_i3" / f"{name}.csv.gz").read_bytes()).decode("latin-1")
    header, *lines = [line.split(";") for line in text.splitlines()]
    want = [
        "Time [s]",
        "Velocity [km/h]",
        "Elevation [m]",
        "Motor Torque [Nm]",
        "Longitudinal Acceleration [m/s^2]",
        "Ambient Temperature",
    ]
    place = [next(i for i, column in enumerate(header) if column.startswith(name)) for name in want]
    table = np.array(
        [[float(line[i]) if line[i].strip() else np.nan for i in place] for line in lines if len(line) >= len(header) - 1]
    )
    time, speed, height, torque, _, ambient = table.T
    _, first = np.unique(time, return_index=True)
    time, speed, height, torque, ambient = (x[first] for x in (time, speed / 3.6, height, torque, ambient))
    start = datetime.fromisoformat(trips()[name]["start_local"]).replace(tzinfo=UTC).timestamp()
    columns = {
        "time_s": start + time,
        "speed_mps": speed,
        "torque_nm": np.where(torque < CLIPPED_NM, np.nan, torque * FINAL_DRIVE),
        "ambient_degc": ambient,
    }
    if elevation:
        distance = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))))
        at, index = np.unique(distance, return_index=True)
        climb = np.interp(distance + 100.0, at, height[index]) - np.interp(distance - 100.0, at, height[index])
        columns["grade"] = climb / 200.0
    return _write(folder / f"{name}.csv", columns)


def robot(name, folder, yaw_rate=True):
    """One recording of a skid-steered robot: power of both sides' currents over the mean speed, as its sides turn unalike."""
    text = gzip.decompress((DATA / "husky_warthog" / f"{name}.csv.gz").read_bytes()).decode()
    rows = list(csv.DictReader(io.StringIO(text)))

    def column(title):
        return np.array([float(row[title]) if row[title] not in ("", "nan") else np.nan for row in rows])

    time = column("ros_time") * 1e-9
    there = np.concatenate(([False], np.diff(time) > 0.0)) & (time > 1.0)
    left, right = (RADIUS_M[robot_of(name)] * column(f"meas_{side}_vel") for side in ("left", "right"))
    signs = [1.0, 1.0] if np.nanmin(column("left_wheel_current")) < -1.0 else [np.sign(left), np.sign(right)]
    power = signs[0] * column("left_wheel_current") * left + signs[1] * column("right_wheel_current") * right
    mean = 0.5 * (left + right)
    moving = np.abs(mean) > SLOWEST_MPS
    columns = {
        "time_s": time,
        "speed_mps": mean,
        "torque_nm": np.where(moving, NM_PER_A * power / np.where(moving, mean, 1.0), np.nan),
    }
    if yaw_rate:  # of the laser scans' position: the gyroscope is recorded for one of the robots alone
        yaw = np.unwrap(2.0 * np.arctan2(column("icp_quat_z"), column("icp_quat_w"))[there])
        at = time[there]
        before, after = (np.interp(at + side * 0.5 * YAW_OVER_S, at, yaw) for side in (-1.0, 1.0))
        columns["yaw_rate_radps"] = np.full(len(time), np.nan)
        columns["yaw_rate_radps"][there] = (after - before) / YAW_OVER_S
    return _write(folder / f"{name}.csv", {key: value[there] for key, value in columns.items()})


def robot_of(name):
    """Which robot a recording is of."""
    return name.partition("_")[0]

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A plain script for one recording: `plain_replay.py C_FOLDER BAG OUT.parquet` reads the sample, steps the exported C, writes and
draws.

It checks nothing, and knows the topics, the units and the columns: what a replay costs at least in Python. It compiles the step
at its first run and keeps it in the home, as `trackres replay` does with its tables.
"""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pyarrow import parquet
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

SPEED, LOAD, AMBIENT = 0, 1, 3
CHANNELS = {"/vehicle/speed": SPEED, "/vehicle/weight_kn": LOAD, "/vehicle/ambient": AMBIENT}
STATE_BYTES = 1 << 20
MOST_POINTS = 4000
BELTS = ("front_left", "front_right", "rear_left", "rear_right")


def library(source: Path) -> ctypes.CDLL:
    """The step; compiled if it is not there."""
    built = Path.home() / ".cache" / "plain_step.so"
    if not built.exists():
        built.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", str(source / "trackres.c"), "-o", str(built), "-lm"], check=True)
    return ctypes.CDLL(str(built))


def estimated(step: Any, bag: Path, row: np.dtype[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [ns] and rows of outputs, one for each accepted speed."""
    take, integer = step.trackres_message, ctypes.c_int64
    take.argtypes = [ctypes.c_void_p, ctypes.c_int, integer, integer, ctypes.c_double, ctypes.c_void_p]
    state, outputs = ctypes.create_string_buffer(STATE_BYTES), ctypes.create_string_buffer(row.itemsize)
    step.trackres_init(state)
    stamps, rows = [], bytearray()
    with AnyReader([bag], default_typestore=get_typestore(Stores.LATEST)) as reader:
        wanted = [one for one in reader.connections if one.topic in CHANNELS]
        for connection, arrival, raw in reader.messages(wanted):
            read = reader.deserialize(raw, connection.msgtype)
            channel = CHANNELS[connection.topic]
            if channel == LOAD:
                stamp, value = arrival, 1000.0 * read.data
            else:
                stamp = read.header.stamp.sec * 1_000_000_000 + read.header.stamp.nanosec
                value = read.twist.linear.x if channel == SPEED else read.temperature
            if take(state, channel, stamp, arrival, value, outputs) == 1:
                stamps.append(stamp)
                rows += outputs.raw
    return np.array(stamps), np.frombuffer(rows, row)


def draw(time: np.ndarray, rows: np.ndarray, path: Path) -> None:
    """Draw speed, torques with their standard deviation, and belt temperature, as `trackres replay` does."""
    every = slice(None, None, -(-len(time) // MOST_POINTS))
    time, rows = time[every], rows[every]
    figure = Figure(figsize=(9.0, 6.6), dpi=110, layout="constrained")
    speed, torque, belt = figure.subplots(3, 1, sharex=True, height_ratios=(1.0, 1.8, 1.4))
    speed.plot(time, 3.6 * rows["speed_mps"], label="speed")
    middle, std = rows["resistance_torque_nm"], rows["resistance_std_nm"]
    torque.fill_between(time, middle - std, middle + std, alpha=0.15, label="1 std")
    for name in ("resistance_torque_nm", "hysteresis_nm", "bearing_nm", "wind_nm"):
        torque.plot(time, rows[name], label=name)
    mean, std = (np.mean([rows[f"{kind}_{name}"] for name in BELTS], axis=0) for kind in ("belt_degc", "belt_std_k"))
    belt.fill_between(time, mean - std, mean + std, alpha=0.15, label="1 std")
    belt.plot(time, mean, label="belt")
    belt.plot(time, rows["ambient_degc"], label="ambient")
    for axes in (speed, torque, belt):
        axes.grid(visible=True)
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    FigureCanvasAgg(figure).print_png(path)


def main() -> None:
    """Replay the recording."""
    source, bag, out = map(Path, sys.argv[1:])
    struct = re.findall(r"typedef struct \{([^}]*)\}", (source / "trackres.h").read_text())[1]
    names = re.findall(r"trackres_real (\w+);", struct)
    row = np.dtype([*((name, "f8") for name in names), ("reasons", "u4"), ("level", "i4")])
    stamps, rows = estimated(library(source), bag, row)
    columns = {"stamp_ns": stamps, **{name: rows[name].astype("f4") for name in names}}
    parquet.write_table(pa.table(columns), out, compression="zstd", use_dictionary=False)
    draw(1e-9 * (stamps - stamps[0]), rows, out.with_suffix(".png"))


if __name__ == "__main__":
    main()

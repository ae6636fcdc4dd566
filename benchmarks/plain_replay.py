# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A plain script for one recording: `plain_replay.py LIBRARY BAG OUT.csv` reads the sample, steps exported C, writes and draws.

It checks nothing, and knows the topics, the vehicle and the place of each number: what a replay costs at least in Python.
"""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

CHANNELS = {"/vehicle/speed": 0, "/vehicle/weight_kn": 1, "/vehicle/ambient": 3}
STATE_BYTES, OUTPUTS = 1 << 20, 20
SHOWN = [1], [5, 12, 13], [19]  # speed, torques, a further one


def main() -> None:
    """Replay the recording."""
    library = ctypes.CDLL(sys.argv[1])
    message, integer = library.trackres_message, ctypes.c_int64
    message.argtypes = [ctypes.c_void_p, ctypes.c_int, integer, integer, ctypes.c_double, ctypes.c_void_p]
    state, outputs = ctypes.create_string_buffer(STATE_BYTES), (ctypes.c_double * 200)()
    library.trackres_init(state)
    rows = []
    with AnyReader([Path(sys.argv[2])], default_typestore=get_typestore(Stores.LATEST)) as reader:
        wanted = [one for one in reader.connections if one.topic in CHANNELS]
        for connection, arrival, raw in reader.messages(wanted):
            read = reader.deserialize(raw, connection.msgtype)
            channel = CHANNELS[connection.topic]
            if channel == 1:
                stamp, value = arrival, 1000.0 * read.data
            else:
                stamp = read.header.stamp.sec * 1_000_000_000 + read.header.stamp.nanosec
                value = read.twist.linear.x if channel == 0 else read.temperature
            if message(state, channel, stamp, arrival, value, outputs) == 1:
                rows.append((1e-9 * stamp, *outputs[:OUTPUTS]))
    table = np.array(rows)
    np.savetxt(sys.argv[3], table, delimiter=",", fmt="%.6g")
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(10, 8))
    for axis, columns in zip(axes, SHOWN, strict=True):
        axis.plot(table[:, 0] - table[0, 0], table[:, columns])
    figure.savefig(Path(sys.argv[3]).with_suffix(".png"))


if __name__ == "__main__":
    main()

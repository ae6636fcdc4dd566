# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Exports, compiles and runs the C of a vehicle, and the session that it must equal."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.tools.export.c_source import CSource, input_names
from trackres_ros.tools.export.parts import Parts

HERE = Path(__file__).parent
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")
SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
EQUAL = 1e-9
STEP_NS = 50_000_000


def have(*programs):
    """Whether all these programs are there."""
    return all(shutil.which(program) for program in programs)


def write(vehicle, folder, settings=None, learned=None, single=False):
    """The exported files in a folder, and the estimator."""
    estimator = Estimator(vehicle, settings)
    files = CSource(Parts(estimator, learned, single), vehicle.title, ("test",)).files()
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    return estimator


class Built:
    """The exported step as a library in this process."""

    def __init__(self, vehicle, folder, settings=None, learned=None, single=False, compiler="gcc", flags=("-O0",)):
        self.estimator, self.single = write(vehicle, folder, settings, learned, single), single
        library = folder / "step.so"
        sources = [folder / "trackres.c", HERE / "drive.c"]
        command = [compiler, *STRICT, *flags, "-shared", "-fPIC", f"-I{folder}", *map(str, sources), "-o", str(library), "-lm"]
        subprocess.run(command, check=True)
        self.library = ctypes.CDLL(str(library))
        self.library.drive_messages.restype = ctypes.c_int64
        for name in ("size_of_state", "size_of_outputs", "place_of_counters", "place_of_motion"):
            getattr(self.library, f"drive_{name}").restype = ctypes.c_int64
        self.state = ctypes.create_string_buffer(self.library.drive_size_of_state())
        self.library.trackres_init(self.state)
        real = np.float32 if single else np.float64
        self._columns = [name for name in self.estimator.columns if name != "reasons"]
        self._row = np.dtype([*((name, real) for name in self._columns), ("reasons", np.uint32), ("level", np.int32)])
        padded = self.library.drive_size_of_outputs()
        self._row = np.dtype({"names": self._row.names, "formats": [self._row[n] for n in self._row.names], "itemsize": padded})
        self.outputs = np.zeros(1, dtype=self._row)  # of the last call

    def run(self, messages):
        """Results in the columns of the estimator, and levels."""
        arrays = [np.ascontiguousarray(a, dtype=t) for a, t in zip(messages, ("i2", "i8", "i8", "f8"), strict=True)]
        rows = np.zeros(int((arrays[0] == 0).sum()) + 1, dtype=self._row)
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (*arrays, rows)]
        steps = self.library.drive_messages(self.state, ctypes.c_int64(len(arrays[0])), *pointers)
        assert steps >= 0
        result = np.stack([rows[name][:steps].astype(float) for name in self.estimator.columns], axis=1)
        return result, rows["level"][:steps]

    def step(self, given, dt):
        """One call of `trackres_step` with inputs by name; returns its result and the outputs by name."""
        real = ctypes.c_float if self.single else ctypes.c_double
        if not hasattr(self, "_inputs"):
            self._names = list(input_names(self.estimator.channels).values())
            self._inputs = (real * len(self._names))()
        self._inputs[:] = [given.get(name, float("nan")) for name in self._names]
        pointer = self.outputs.ctypes.data_as(ctypes.c_void_p)
        return self.library.trackres_step(self.state, self._inputs, real(dt), pointer), self.outputs[0]

    def message(self, channel, stamp, arrival, value):
        """One call of `trackres_message`; returns its result."""
        real = ctypes.c_float if self.single else ctypes.c_double
        times, pointer = (ctypes.c_int64(stamp), ctypes.c_int64(arrival)), self.outputs.ctypes.data_as(ctypes.c_void_p)
        return self.library.trackres_message(self.state, channel, *times, real(value), pointer)

    def rest(self, ambient, seconds):
        """As after power was off."""
        real = ctypes.c_float if self.single else ctypes.c_double
        self.library.trackres_rest(self.state, real(ambient), real(seconds))

    def array(self, place, like):
        """An array of the state."""
        return np.frombuffer(self.state, like.dtype, like.size, place).reshape(like.shape)


def difference(found, expected):
    """Largest difference of each column over the value, or over a thousandth of the column's largest where that is more."""
    assert found.shape == expected.shape
    same = (found == expected) | (np.isnan(found) & np.isnan(expected))
    floor = 1e-3 * np.nanmax(np.abs(np.where(np.isnan(expected), 0.0, expected)), axis=0, initial=1e-300)
    with np.errstate(invalid="ignore"):
        relative = np.where(same, 0.0, np.abs(found - expected) / np.maximum(np.abs(expected), floor))
    assert np.isfinite(relative).all()
    return relative.max(axis=0, initial=0.0)


def drive(estimator, hours, seed, faults=True):
    """A drive of messages in the order they arrive: channel, stamp, arrival, value.

    Speeds wander between reverse and full, with stops; all else that the vehicle knows comes at its own rate, some of it not for
    a while. With `faults` messages are late, double, no number, out of range, or missing for seconds and minutes, clocks jump and
    time goes back.
    """
    random = np.random.default_rng(seed)
    steps, chassis = int(hours * 3600 * SECOND_NS / STEP_NS), estimator.vehicle.chassis
    top = chassis.max_speed
    time = np.arange(steps) * STEP_NS + random.integers(0, STEP_NS // 4, steps)
    wanted = np.repeat(random.choice([0.0, 0.0, 0.2, 0.5, 0.9, 1.0, -0.15], steps // 400 + 1) * top, 400)[:steps]
    speed = np.empty(steps)
    time_now, most = 0.0, min(1.0, 0.2 * top) * STEP_NS / SECOND_NS
    for i, goal in enumerate(wanted.tolist()):
        time_now += min(max(goal - time_now, -most), most)
        speed[i] = time_now
    speed += np.where(np.abs(speed) > 0.0, random.normal(0.0, 0.003 * top, steps), 0.0)
    weight = float(estimator.vehicle.nominal_loads().sum())
    slow = 0.5 + 0.5 * np.sin(time / SECOND_NS / 137.0)
    series = {
        "load": (0.7 + 0.6 * slow) * weight,
        "torque": random.normal(0.0, 0.02 * weight, steps),
        "ambient": -10.0 + 40.0 * slow,
        "belt": 20.0 + 20.0 * slow,
        "accel": np.gradient(speed) * SECOND_NS / STEP_NS,
        "grade": 0.1 * (slow - 0.5),
        "yaw_rate": random.normal(0.0, 0.2, steps),
        "heading": 6.0 * slow,
        "distance": np.cumsum(np.abs(speed)) * STEP_NS / SECOND_NS,
        "passengers": np.floor(40.0 * slow),
        "enable": np.where(slow > 0.1, 1.0, 0.0),
        "wheel_speed": speed * 1.01,
    }
    series |= {name: series[name.partition("/")[0]] / 3.0 if name.startswith("load/") else series[name.partition("/")[0]]
               for name in estimator.channels if "/" in name}  # fmt: skip
    columns = [(0, np.arange(steps), speed)]
    for name, values in series.items():
        every, stretch = int(random.choice([1, 5, 8])), 700
        there = np.repeat(random.random(steps // stretch + 1) < 0.7, stretch)[:steps]
        at_rows = np.flatnonzero(there & (np.arange(steps) % every == 0))
        columns.append((estimator.channels.index(name), at_rows, values[at_rows]))
    channel = np.concatenate([np.full(len(rows), c, dtype=np.int16) for c, rows, _ in columns])
    stamp = START_NS + time[np.concatenate([rows for _, rows, _ in columns])]
    value = np.concatenate([values for *_, values in columns])
    order = np.lexsort((channel == 0, stamp))
    channel, stamp, value = channel[order], stamp[order], value[order]
    arrival = np.maximum.accumulate(stamp + random.integers(0, 3_000_000, len(stamp)))
    return with_faults(random, channel, stamp, arrival, value) if faults else (channel, stamp, arrival, value)


def with_faults(random, channel, stamp, arrival, value):
    """The same messages as a bad bus and a bad clock bring them."""
    count = len(stamp)
    stamp, arrival, value = stamp.copy(), arrival.copy(), value.copy()
    kept = np.ones(count, dtype=bool)
    for seconds in (2, 20, 45, 400, 3000):  # gaps
        if seconds * SECOND_NS > 0.1 * (stamp[-1] - stamp[0]):
            break
        first = random.integers(0, count)
        gap = (stamp >= stamp[first]) & (stamp < stamp[first] + seconds * SECOND_NS)
        kept &= ~gap
    some = random.random(count)
    value[some < 0.002] = np.nan
    value[(some > 0.002) & (some < 0.004)] = 1e7
    value[(some > 0.004) & (some < 0.006)] *= 1.7
    stamp[(some > 0.006) & (some < 0.008)] -= 300_000_000
    stamp[(some > 0.008) & (some < 0.010)] += 40 * SECOND_NS
    stamp[(some > 0.010) & (some < 0.012)] = 0
    stamp[count // 3 :] += 7 * SECOND_NS  # the sender's clock is set
    stamp[count // 2 :] -= 3600 * SECOND_NS  # both clocks are set back
    arrival[count // 2 :] -= 3600 * SECOND_NS
    order = np.flatnonzero(kept)
    twice = np.sort(np.concatenate([order, random.choice(order, count // 500)]))
    return channel[twice], stamp[twice], arrival[twice], value[twice]

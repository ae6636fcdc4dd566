# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""In plain Python the same bits come out: without numba, and of a first run, which changes over to compiled code on the way."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.effects import Active, Effect, catalogue, native
from trackres_ros.estimator import columns as at
from trackres_ros.estimator import warm_up
from trackres_ros.estimator.entry_points import COMPILED, interpreted_entries
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.settings import Settings
from trackres_ros.jit.compiled import HAVE_NUMBA, compiled
from trackres_ros.jit.rows import Real, Reals, Row, Whole
from trackres_ros.offline import replay as offline_replay
from trackres_ros.vehicle import load, load_any

PROGRAM = """
import numpy as np
from dataclasses import replace
from trackres_ros.jit.compiled import HAVE_NUMBA
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.vehicle import load
out = []
for thermal in ("lumped", "core_surface"):
    estimator = Estimator(replace(load("xgd24d"), thermal=thermal))
    random = np.random.default_rng(4)
    n = 400
    channel = random.choice([0, 0, 0, 1, 3, 4, 6], n).astype(np.int16)
    stamp = 10**18 + np.cumsum(random.integers(1, 3 * 10**9, n))
    kinds = [random.normal(8, 2, n), random.normal(272e3, 1e4, n), random.normal(0, .05, n)]
    value = np.select([channel == 0, channel == 1, channel == 6], kinds, 20.0)
    rows = estimator.session().handle_block(channel, stamp, stamp, value).rows
    out.append(np.where(np.isfinite(rows), rows, -1e9).tolist())
"""


@pytest.mark.long
@pytest.mark.skipif(not HAVE_NUMBA, reason="numba is not installed: there is nothing to compare")
def test_interpreted_equals_compiled_and_loads_no_scipy():
    found = {}
    exec(PROGRAM, found)  # its tables are in the cache from now on
    program = f"{PROGRAM}\nimport json, sys; print(json.dumps([HAVE_NUMBA, out, 'scipy.interpolate' in sys.modules]))"
    environment = {**os.environ, "TRACKRES_INTERPRETED": "1"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    numba, interpreted, loads_scipy = json.loads(done.stdout)
    assert (found["HAVE_NUMBA"], numba, loads_scipy) == (True, False, False)
    np.testing.assert_array_equal(np.array(found["out"]), np.array(interpreted))


@pytest.mark.parametrize("name", ["xgd24d", "ztbus_hess19"])
def test_messages_of_all_channels_give_the_same_bits(name):
    vehicle, n, rows = load_any(name), 3000, []
    for entries in (interpreted_entries(), COMPILED):
        session = Estimator(vehicle, Settings(enable_hold_s=0.5), entries=entries).session()
        random, channels = np.random.default_rng(3), range(len(session.estimator.channels))
        channel = np.where(random.random(n) < 0.4, at.SPEED, random.choice(channels, n)).astype(np.int16)
        stamp = 10**18 + np.cumsum(random.integers(1, 40_000_000, n))
        speed = 8.0 + 3.0 * np.sin(np.arange(n) / 300.0) + random.choice([0.0, 7.0, -15.0], n, p=[0.96, 0.02, 0.02])
        of_others = {at.LOAD: 1.02 * vehicle.weight, at.ENABLE: 1.0 * (random.random(n) > 0.2), at.DISTANCE: 0.16 * np.arange(n)}
        small = [at.ACCEL, at.GRADE, at.YAW_RATE, at.LATITUDE, at.LONGITUDE]
        value = np.select([channel == which for which in of_others], list(of_others.values()), speed)
        value[np.isin(channel, small)] *= 0.01
        rows.append(session.handle_block(channel, stamp, stamp, value).rows)
        assert session.memory.counters[at.SPEED, at.Count.IMPLAUSIBLE] > 50
    np.testing.assert_array_equal(*rows)


def a_drive(steps):
    """Through standstill, forward and backward, up and down, in curves, with gaps."""
    random = np.random.default_rng(8)
    time = np.cumsum(random.choice([0.02, 0.1, 0.5, 40.0], steps, p=[0.3, 0.5, 0.19, 0.01]))
    speed = 9.0 * np.sin(time / 31.0) + random.normal(0.0, 0.05, steps)
    load, air = 272e3 + 2e4 * np.sin(time / 200.0), 15.0 + 20.0 * np.sin(time / 500.0)
    accel, grade = np.cos(time / 31.0), 0.05 * np.sin(time / 90.0)
    return time, speed, load, air, accel, grade, 0.2 * np.sin(time / 7.0), np.mod(time / 60.0, 6.0), np.nancumsum(abs(speed))


def interpreted_and_compiled(vehicle):
    for entries in (interpreted_entries(), COMPILED):
        estimator = Estimator(vehicle, entries=entries)
        yield estimator.run(estimator.cold_start(estimator.inputs(0.0)), *a_drive(250))[1]


@pytest.mark.parametrize("names", [list(catalogue())[i::4] for i in range(4)])
def test_every_effect_gives_the_same_bits(names):
    base = load("xgd24d")
    for name in names:
        effect = catalogue()[name]
        away = {q.name: q.start + 0.1371 * (q.high - q.start) for q in effect.parameters}
        active = (Active(effect, away),)
        own = {"surroundings": active} if effect.belongs_to == "surroundings" else {"effects": active}
        plain, machine = interpreted_and_compiled(replace(base, **own))
        np.testing.assert_array_equal(plain, machine, err_msg=name)
        assert np.isfinite(machine[:, 0]).all()


@pytest.mark.long
def test_a_replay_that_changes_over_gives_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr(offline_replay, "BLOCK_ROWS", 1500)
    time, speed = a_drive(5000)[:2]
    drive = tmp_path / "drive.csv"
    np.savetxt(drive, np.column_stack([time, speed]), delimiter=",", header="time_s,speed_mps", comments="", fmt="%.3f")
    at_once = tr.replay(drive, "xgd24d")
    made = []

    class HalfWarm(warm_up.CompilerWarmUp):
        """As on a machine where compiling takes two blocks."""

        def __init__(self, work, **_):
            super().__init__(work, meanwhile=False)
            self.first = interpreted_entries()
            self.asked = 0
            made.append(self)

        def finished(self):
            self.asked += 1
            return COMPILED if self.asked == 3 else None

    monkeypatch.setattr(warm_up, "CompilerWarmUp", HalfWarm)
    changed = tr.replay(drive, "xgd24d")
    assert made[0].asked >= 3
    assert changed.estimator.entries.compiled
    for name in at_once:
        np.testing.assert_array_equal(at_once[name], changed[name], err_msg=name)


def test_the_first_simulation_is_the_second(monkeypatch):
    second = tr.simulate("agri3t", speed_kmh=12, duration_s=120)
    monkeypatch.setattr(warm_up, "is_warm", lambda _work: False)
    monkeypatch.setattr(warm_up.subprocess, "Popen", Never)
    first = tr.simulate("agri3t", speed_kmh=12, duration_s=120)
    assert not first.estimator.entries.compiled
    for name in second:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


class Never:
    """A compiling process that does not get there."""

    def __init__(self, **_):
        pass

    def wait(self):
        return 1

    def poll(self):
        return None


class Numbered(Row):
    first = Real()
    several = Reals(2)
    last = Real()


class Counted(Row):
    seen = Whole()
    since = Whole()


def moved(numbers, counts):
    row, count = Numbered(numbers[1]), Counted(counts)
    row.last = count.since / 2
    for i in range(2):
        row.several[i] += row.first * i
    count.seen += 2
    return row.several[1] + count.seen


def test_a_row_names_numbers_where_they_lie():
    assert (Numbered.first, Numbered.several, Numbered.last, Numbered.columns) == (0, slice(1, 3), 3, 4)
    found = []
    for function in (moved, compiled(moved)):
        numbers, counts = np.arange(8.0).reshape(2, 4), np.array([3, 5])
        found.append((function(numbers, counts), numbers.tolist(), counts.tolist()))
    assert found == [(15.0, [[0.0, 1.0, 2.0, 3.0], [4.0, 5.0, 10.0, 2.5]], [5, 5])] * 2


def test_an_effect_of_a_users_own_waits_for_compiled_steps():
    class Own(Effect):
        name = "own"

    ours = catalogue()["drivetrain_drag"]
    vehicle = load("xgd24d")
    assert warm_up.same_in_python(vehicle)
    assert warm_up.same_in_python(replace(vehicle, effects=(Active(ours, ours.values()),)))
    assert not warm_up.same_in_python(replace(vehicle, effects=(Active(Own(), {}),)))


def test_where_nothing_is_to_be_compiled_effects_are_not_either(monkeypatch):
    def refuse(*_):
        raise AssertionError("an effect is compiled")

    monkeypatch.setattr(native, "_machine_code", refuse)
    drag = catalogue()["drivetrain_drag"]
    vehicle = replace(load("xgd24d"), effects=(Active(drag, drag.values()),))
    estimator = Estimator(vehicle, entries=interpreted_entries())
    inputs = estimator.inputs(5.0, ambient=15.0)
    _, estimate = estimator.step(estimator.cold_start(inputs), inputs, 0.1)
    assert estimate["effects_nm"] == pytest.approx(drag.values()["drag"])

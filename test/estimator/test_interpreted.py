# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""C and plain Python give the same bits: every kernel, every vehicle, every effect."""

import copy
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

import trackres_ros
from trackres_ros.arrays import Array, IntArray
from trackres_ros.building import all_entries, built
from trackres_ros.effects import Active, catalogue
from trackres_ros.effects.stepping import fit_table, new_effect_scratch, new_memory
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.kernel import COMPILED, INTERPRETED
from trackres_ros.estimator.records import DriveSeries
from trackres_ros.estimator.settings import Settings
from trackres_ros.files.resources import shipped_road_vehicles, shipped_vehicles
from trackres_ros.kernels import marks
from trackres_ros.kernels.rows import Real, Reals, Row, Whole
from trackres_ros.model.track import vehicle_constants
from trackres_ros.route.follower import NOTHING_YET
from trackres_ros.vehicle import load, load_any

VEHICLES = [*shipped_vehicles(), *shipped_road_vehicles()]
RANDOM = np.random.default_rng(7)

pytestmark = pytest.mark.skipif(not COMPILED.compiled, reason="the kernels are not compiled: there is nothing to compare")


def messages(estimator, n, slowest_ns):
    """Of all channels, with speeds and loads that no vehicle has, and pauses."""
    random, channels = np.random.default_rng(3), range(len(estimator.channels))
    channel = np.where(random.random(n) < 0.4, layout.SPEED, random.choice(channels, n)).astype(np.int16)
    stamp = 10**18 + np.cumsum(random.integers(1, slowest_ns, n))
    speed = 8.0 + 3.0 * np.sin(np.arange(n) / 300.0) + random.choice([0.0, 7.0, -15.0], n, p=[0.96, 0.02, 0.02])
    of_others = {
        layout.LOAD: 1.02 * estimator.vehicle.weight,
        layout.ENABLE: 1.0 * (random.random(n) > 0.2),
        layout.DISTANCE: 0.16 * np.arange(n),
    }
    small_channels = [layout.ACCEL, layout.GRADE, layout.YAW_RATE, layout.LATITUDE, layout.LONGITUDE]
    value = np.select([channel == number for number in of_others], list(of_others.values()), speed)
    value[np.isin(channel, small_channels)] *= 0.01
    return channel, stamp, stamp, value


def rows_of(vehicle, entries, n, slowest_ns):
    """Results of a session, and of its state after a rest."""
    estimator = Estimator(vehicle, Settings(enable_hold_s=0.5), entries=entries)
    session = estimator.session()
    rows = session.handle_block(*messages(estimator, n, slowest_ns)).rows
    rest_state = estimator.rest(session.state, None, 3600.0)
    return np.concatenate([rows.ravel(), *map(np.ravel, rest_state), *map(np.ravel, session.memory)])


@pytest.mark.parametrize(("n", "slowest_ns"), [(3000, 40_000_000), (150, 3_000_000_000)], ids=["fast", "with gaps"])
@pytest.mark.parametrize("name", VEHICLES)
def test_messages_of_all_channels_give_the_same_bits(name, n, slowest_ns):
    vehicle = load_any(name)
    interpreted, compiled = (rows_of(vehicle, entries, n, slowest_ns) for entries in (INTERPRETED, COMPILED))
    np.testing.assert_array_equal(interpreted, compiled)


def test_two_nodes_of_a_belt_give_the_same_bits(xgd24d):
    vehicle = replace(xgd24d, thermal="core_surface")
    np.testing.assert_array_equal(*(rows_of(vehicle, entries, 600, 2_000_000_000) for entries in (INTERPRETED, COMPILED)))


PROGRAM = """
import sys
from trackres_ros.estimator.kernel import COMPILED
from trackres_ros.estimator.estimator import Estimator
session = Estimator("agri3t").session()
rows = [session.handle(0, 10**18 + i * 10**8, 10**18 + i * 10**8, 2.0 + 0.01 * i).row.tolist() for i in range(20)]
"""


def test_on_request_it_runs_in_plain_python_and_says_nothing(tmp_path):
    """With tables of its own, and without scipy, which takes longer to load than they take to build."""
    namespace = {}
    exec(PROGRAM, namespace)
    program = f"{PROGRAM}\nimport json; print(json.dumps([COMPILED.compiled, rows, 'scipy' in sys.modules]))"
    environment = {**os.environ, "TRACKRES_INTERPRETED": "1", "XDG_CACHE_HOME": str(tmp_path)}
    process = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert process.stderr == ""
    assert json.loads(process.stdout)[::2] == [False, False]
    np.testing.assert_array_equal(np.array(namespace["rows"]), np.array(json.loads(process.stdout)[1]))


def test_sources_changed_since_they_were_compiled_run_in_python(tmp_path):
    """A checkout whose kernels were edited never runs the old ones."""
    package = Path(trackres_ros.__file__).parent
    shutil.copytree(package, tmp_path / "trackres_ros", ignore=shutil.ignore_patterns("__pycache__"))
    source, outputs = tmp_path / "trackres_ros" / "effects" / "vehicle" / "air_drag.py", []
    for line in ("", "# edited\n", ""):
        source.write_text((package / "effects" / "vehicle" / "air_drag.py").read_text() + line)
        program = "from trackres_ros.kernels.marks import COMPILED; print(COMPILED)"
        process = subprocess.run([sys.executable, "-P", "-c", program], env={**os.environ, "PYTHONPATH": str(tmp_path)},
                              capture_output=True, text=True, check=True)  # fmt: skip
        outputs.append((process.stdout.strip(), "changed" in process.stderr, "times slower" in process.stderr))
    assert outputs == [("True", False, False), ("False", True, True), ("True", False, False)]


N, LAYERS = 400, 15
RISING = np.cumsum(RANDOM.uniform(0.01, 1.0, N))
LENGTH, FLAGS = (N,), bool
OF_SERIES = {
    "filter_forward": (RISING, LENGTH, FLAGS, FLAGS, LENGTH, 0.1, (N, 5), FLAGS),
    "smooth_backward": (RISING, FLAGS, FLAGS, LENGTH, FLAGS, (N, 5), LENGTH),
    "mark_corners": (RISING, LENGTH, 0.2, FLAGS),
    "pass": (LENGTH, LENGTH, FLAGS, 0.1, 0.3, 0.25, (N, 2), (N, 2), LENGTH),
    "follow_level": (LENGTH, LENGTH, FLAGS, 0.9, 0.4, LENGTH, LENGTH),
}  # fmt: skip
"""Arguments of kernels: numbers, shapes of random numbers, random flags."""


def drawn(kind):
    if kind is FLAGS:
        return (RANDOM.random(N) < 0.1) | (np.arange(N) == 0)
    return RANDOM.uniform(0.1, 1.0, kind) if isinstance(kind, tuple) else kind


OF_AN_ESTIMATOR = {"feed", "feed_all", "advance_along", "predict_along", "advance_once", "rest", "start", "follow_along"}
OF_AN_OWN_MODEL = {"own_along", "rest_effects"}


def test_each_kernel_that_python_calls_is_compared():
    """Those of an estimator and of a user's own model are below and in the tests of fits."""
    assert {*OF_SERIES, *OF_AN_ESTIMATOR, *OF_AN_OWN_MODEL} == set(all_entries())


@pytest.mark.parametrize("name", OF_SERIES)
def test_kernels_of_series_give_the_same_bits(name):
    python, arguments = all_entries()[name], [drawn(kind) for kind in OF_SERIES[name]]
    machine_arguments = copy.deepcopy(arguments)
    answers = python(*arguments), getattr(marks.MACHINE, name)(*machine_arguments)
    assert answers[0] == answers[1]
    for left, right in zip(arguments, machine_arguments, strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("name", ["headwind", "viscous_bearing", "warmup"])
def test_an_own_model_with_effects_gives_the_same_bits(name, xgd24d):
    effect, facts = catalogue()[name], vehicle_constants(xgd24d)
    table, results = fit_table([Active(effect, effect.values())]), []
    for kernels in (all_entries(), vars(marks.MACHINE)):
        scratch, memory, torque, outcome = new_effect_scratch(facts), new_memory(1), np.empty(250), np.empty(250, dtype=np.int64)
        time, speed, load, air, accel, _, yaw_rate, heading, _ = a_drive(250)
        kernels["own_along"](
            table, scratch, memory, 300.0 * speed, time, speed, accel, load, air, yaw_rate, heading, torque, outcome
        )
        kernels["rest_effects"](*table, memory, scratch, 5.0, 100.0)
        results.append(np.concatenate([torque, outcome, memory, scratch.terms]))
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize("name", ["xgd24d", "ztbus_hess19"])
def test_a_fit_and_a_route_give_the_same_bits(name):
    estimator, results = Estimator(name), []
    k, n = estimator.constants, 200
    time, speed, load, air, accel, grade, yaw_rate, heading, distance = a_drive(n)
    no_values = np.full(n, np.nan)
    drive = DriveSeries(
        time, speed, load, air, accel, grade, yaw_rate, heading, distance, no_values, np.zeros(n), no_values, no_values
    )
    kinds = len(estimator.assemblies)
    for entries in (INTERPRETED, COMPILED):
        state = estimator.cold_start(estimator.inputs(0.0))
        rows, ground = np.empty((n, 4)), np.empty((n, 4))
        entries.start_belts(k, state, 12.0, 1.0)
        entries.predict_series(k, state, estimator.scratch(), np.ones(max(kinds, 1)), drive, rows)
        entries.follow_series(k, np.array(NOTHING_YET), time, speed, 0.8 + 1e-6 * time, 0.1 + 1e-6 * time, ground)
        results.append(np.concatenate([rows.ravel(), ground.ravel(), *map(np.ravel, state)]))
    np.testing.assert_array_equal(*results)


def a_drive(steps):
    """Through standstill, forward and backward, up and down, in curves, with gaps."""
    random = np.random.default_rng(8)
    time = np.cumsum(random.choice([0.02, 0.1, 0.5, 40.0], steps, p=[0.3, 0.5, 0.19, 0.01]))
    speed = 9.0 * np.sin(time / 31.0) + random.normal(0.0, 0.05, steps)
    load, air = 272e3 + 2e4 * np.sin(time / 200.0), 15.0 + 20.0 * np.sin(time / 500.0)
    accel, grade = np.cos(time / 31.0), 0.05 * np.sin(time / 90.0)
    return time, speed, load, air, accel, grade, 0.2 * np.sin(time / 7.0), np.mod(time / 60.0, 6.0), np.nancumsum(abs(speed))


def interpreted_and_compiled(vehicle):
    for entries in (INTERPRETED, COMPILED):
        estimator = Estimator(vehicle, entries=entries)
        yield estimator.run(estimator.cold_start(estimator.inputs(0.0)), *a_drive(250))[1]


@pytest.mark.parametrize("names", [list(catalogue())[i::4] for i in range(4)])
def test_every_effect_gives_the_same_bits(names):
    base = load("xgd24d")
    for name in names:
        effect = catalogue()[name]
        values = {q.name: q.start + 0.1371 * (q.high - q.start) for q in effect.parameters}
        effects = (Active(effect, values),)
        effect_lists = {"surroundings": effects} if effect.belongs_to == "surroundings" else {"effects": effects}
        interpreted, machine = interpreted_and_compiled(replace(base, **effect_lists))
        np.testing.assert_array_equal(interpreted, machine, err_msg=name)
        assert np.isfinite(machine[:, 0]).all()


class Numbered(Row):
    first = Real()
    several = Reals(2)
    last = Real()


class Counted(Row):
    seen = Whole()
    since = Whole()


def moved(numbers: Annotated[Array, (None, 4)], counts: IntArray):
    row, count = Numbered(numbers[1]), Counted(counts)
    row.last = count.since / 2
    for i in range(2):
        row.several[i] += row.first * i
    count.seen += 2
    return row.several[1] + count.seen


def test_a_row_names_numbers_where_they_lie():
    assert (Numbered.first, Numbered.several, Numbered.last, Numbered.columns) == (0, slice(1, 3), 3, 4)
    results = []
    for function in (moved, built({"moved": moved}, "-O0").moved):
        numbers, counts = np.arange(8.0).reshape(2, 4), np.array([3, 5])
        results.append((function(numbers, counts), numbers.tolist(), counts.tolist()))
    assert results == [(15.0, [[0.0, 1.0, 2.0, 3.0], [4.0, 5.0, 10.0, 2.5]], [5, 5])] * 2

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The exported C gives the numbers of the live step: of a session that takes the same messages."""

import dataclasses
import itertools

import numpy as np
import pytest
from built import EQUAL, SECOND_NS, START_NS, Built, difference, drive, have

import trackres_ros as tr
from trackres_ros.effects.effect import Active
from trackres_ros.effects.learned import NAMES, learned_effect
from trackres_ros.effects.registry import catalogue
from trackres_ros.effects.stepping import EACH, FIRST_OWN
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.feedforward import FEEDFORWARD_STEP_S, rate_towards
from trackres_ros.estimator.settings import Settings
from trackres_ros.estimator.snapshot import after_time_off, resume, save
from trackres_ros.files.resources import shipped_road_vehicles, shipped_vehicles
from trackres_ros.node.inputs import NodeClock
from trackres_ros.node.output import FeedforwardFilter
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap
from trackres_ros.tools.export import step

pytestmark = pytest.mark.skipif(not have("gcc"), reason="gcc is not installed")

VEHICLES = (*shipped_vehicles(), *shipped_road_vehicles())
HOURS_EACH = 10.2 / len(VEHICLES)
ALL = Settings(feedforward_parts=("hysteresis", "bearing", "wind", "grade", "inertia"), enable_hold_s=0.5, belt_sensor="surface")


def held_against(vehicle, folder, hours, seed=1, settings=None, what=None):
    """Drive the export and a session; both, with the largest difference checked."""
    build = Built(vehicle, folder, settings, what)
    session = build.estimator.session()
    if what is not None:
        session.learned[:] = what
    messages = drive(build.estimator, hours, seed)
    expectation = session.handle_block(*messages).rows
    result, level = build.run(messages)
    assert len(expectation) > 100
    assert difference(result, expectation).max() <= EQUAL
    reasons = expectation[:, at.Results.reasons].astype(int)
    assert (result[:, at.Results.reasons] == reasons).all()
    assert (level == np.where(reasons & ~int(at.HARMLESS), 1, 0)).all()
    counters = build.array(build.library.drive_place_of_counters(), session.memory.counters)
    assert (counters == session.memory.counters).all()
    return build, session


@pytest.mark.parametrize("name", VEHICLES)
def test_ten_hours_of_the_shipped_vehicles_are_the_same(name, tmp_path):
    held_against(tr.load_vehicle(name), tmp_path, HOURS_EACH)


@pytest.mark.parametrize(("thermal", "method"), [("core_surface", "rainflow"), ("lumped", "spectral")])
def test_other_models_and_settings_are_the_same(thermal, method, tmp_path):
    held_against(tr.load_vehicle("agri3t", thermal=thermal, method=method), tmp_path, 0.15, settings=ALL)


def with_values(effect):
    """An effect at its typical values, with ranges so that it has a variance."""
    values = effect.values()
    ranges = {}
    for q in effect.parameters:
        if q.fitted and q.high > q.low:
            width = 0.05 * (q.high - q.low)
            ranges[q.name] = (max(q.low, values[q.name] - width), min(q.high, values[q.name] + width))
    return Active(effect, values, ranges)


def vehicle_for(effects):
    """A vehicle that some effects make sense of, with them and its surroundings."""
    name = "emps" if effects[0].only_of == "slides" else "agri3t" if any(e.belt_only for e in effects) else "ztbus_hess19"
    vehicle = tr.load_vehicle(name)
    sized = [with_values(effect.for_size(vehicle.size, name != "agri3t")) for effect in effects]
    return dataclasses.replace(
        vehicle,
        effects=tuple(a for a in sized if a.effect.belongs_to == "vehicle"),
        surroundings=tuple(a for a in sized if a.effect.belongs_to == "surroundings"),
    )


def groups():
    """All effects of the catalogue that a file may list, five at a time."""
    of_files = [effect for effect in catalogue().values() if effect.belongs_to != "sensor"]
    kinds = sorted(of_files, key=lambda e: (e.only_of == "slides", e.belt_only))
    by_kind = {}
    for effect in kinds:
        by_kind.setdefault((effect.only_of == "slides", effect.belt_only), []).append(effect)
    return [group for item in by_kind.values() for group in (item[i : i + 5] for i in range(0, len(item), 5))]


@pytest.mark.parametrize("effects", groups(), ids=lambda effects: "+".join(effect.name for effect in effects))
def test_every_effect_of_the_catalogue_is_the_same(effects, tmp_path):
    vehicle = vehicle_for(effects)
    build, session = held_against(vehicle, tmp_path, 0.15, settings=ALL)
    own = session.effects[FIRST_OWN:].reshape(-1, EACH)
    assert len(own) == len(vehicle.active)
    assert build.estimator.constants.effects.shape[0] > len(vehicle.active)


def test_every_empirical_effect_is_the_same(tmp_path):
    vehicle = tr.load_vehicle("agri3t")
    values = {"x1": 1.0, "x2": 2.0, "x3": 4.0, "y1": 20.0, "y2": -10.0, "y3": 30.0, "threshold": 1.5, "off": 1.2, "on": 1.8}
    results = []
    for name in NAMES:
        effect = learned_effect(name, dict.fromkeys(("y1", "y2", "y3"), 0.0), vehicle.size)
        known = {q.name: values.get(q.name, q.start) if not q.is_fixed else q.start for q in effect.parameters}
        results.append(Active(effect, known))
    held_against(dataclasses.replace(vehicle, effects=tuple(results)), tmp_path, 0.1)


def learned_numbers():
    """What learning may leave in a session."""
    numbers = np.zeros(at.Learned.columns)
    numbers[at.Learned.on] = 1.0
    numbers[at.Learned.departures] = [0.08, -0.1, 0.05, 1.5, -0.2, 0.1, 0.03]
    numbers[at.Learned.torque], numbers[at.Learned.slow] = 12.0, 5.0
    factor = np.tril(np.random.default_rng(2).normal(0.0, 0.02, (at.LEARNABLE, at.LEARNABLE)))
    numbers[at.Learned.factor] = factor.ravel()
    return numbers


@pytest.mark.parametrize("name", ["agri3t", "ztbus_hess19"])
def test_what_was_learned_moves_both_alike(name, tmp_path):
    held_against(tr.load_vehicle(name), tmp_path, 0.15, what=learned_numbers())


def test_learned_drag_moves_effects_of_wind_in_both_alike(tmp_path):
    held_against(vehicle_for([catalogue()[name] for name in ("air_drag", "headwind")]), tmp_path, 0.05, what=learned_numbers())


def test_rests_and_resumes_are_the_same(tmp_path):
    effects = [catalogue()[name] for name in ("roadwheel_tyres", "viscous_bearing", "vibration")]
    build = Built(vehicle_for(effects), tmp_path / "c", ALL)
    session = build.estimator.session()
    for n, (deviation, ambient) in enumerate([(1800.0, -5.0), (40000.0, None), (0.0, 10.0)]):
        messages = list(drive(build.estimator, 0.05, n, faults=n == 1))
        messages[1], messages[2] = messages[1] + n * 90000 * SECOND_NS, messages[2] + n * 90000 * SECOND_NS
        half = len(messages[0]) // 2
        for part in (slice(None, half), slice(half, None)):
            block = [array[part] for array in messages]
            expectation = session.handle_block(*block).rows
            result, _ = build.run(block)
            assert difference(result, expectation).max() <= EQUAL
            save(session, tmp_path / "state", 0.0)
            session = resume(build.estimator, tmp_path / "state")
            copy = bytes(build.state)  # as a controller keeps it
            build.library.trackres_init(build.state)
            build.state[:] = copy
        save(session, tmp_path / "state", 0.0)
        session, _ = after_time_off(build.estimator, tmp_path / "state", deviation, ambient)
        build.rest(np.nan if ambient is None else ambient, deviation)


def test_between_two_speeds_the_feedforward_goes_on_as_live(tmp_path):
    build = Built(tr.load_vehicle("ztbus_hess19"), tmp_path)
    session, k = build.estimator.session(), build.estimator.constants
    shown = []
    for tick in range(7000):  # 4 s of speeds at 50 Hz in a loop of 1 kHz, then silence
        speed = 5.0 + 0.001 * tick if tick % 20 == 0 and tick < 4000 else np.nan
        time_now = int(tick * 1_000_000)
        result, outputs = build.step({"speed_mps": speed}, 0.001 if tick else 0.0)
        if np.isfinite(speed):
            estimate = session.handle(at.SPEED, time_now, time_now, speed)
            assert result == 1
            assert outputs["resistance_torque_nm"] == estimate.resistance_torque_nm
        else:
            assert result == 0
        expectation = step.feedforward_now(k, session.memory, session.motion, time_now)
        assert outputs["feedforward_torque_nm"] == pytest.approx(expectation, rel=EQUAL)
        assert (outputs["level"] == 3) == (time_now - session.memory.times[at.SPEED, at.Times.last_arrival] > 500_000_000)
        shown.append(outputs["feedforward_torque_nm"])
    assert max(shown) > 100.0
    assert shown[-1] == 0.0


def stops_and_disables(seed, ticks):
    """At each tick a speed [m/s] and an enable, nan where none comes: dropouts, stops within a sample and disables."""
    random = np.random.default_rng(seed)

    def stretches(*values):
        return np.concatenate([np.full(random.integers(5, 60), random.choice(values)) for _ in range(ticks // 5)])[:ticks]

    driving = 6.0 + 2.0 * np.sin(np.arange(ticks) / 150.0)
    sent_message, every = random.random(ticks) < 0.8, random.choice([1, 2, 5])
    speed = np.where(stretches(0.0, 1.0, 1.0, 1.0) > 0.0, driving, 0.0)
    there = (stretches(0.0, 1.0, 1.0, 1.0) > 0.0) & sent_message & (np.arange(ticks) % every == 0)
    return np.where(there, speed, np.nan), np.where(sent_message, stretches(0.0, 1.0, 1.0, 1.0, np.nan), np.nan)


@pytest.fixture(scope="module")
def enabled(tmp_path_factory):
    """An export that needs an enable, and its new state."""
    settings = Settings(enable_hold_s=0.3, feedforward_rate=5000.0)
    build = Built(tr.load_vehicle("ztbus_hess19"), tmp_path_factory.mktemp("enabled"), settings)
    return build, bytes(build.state)


@pytest.mark.parametrize("seed", range(3))
def test_stopped_or_disabled_c_pushes_no_more_than_live(enabled, seed):
    build, build.state[:] = enabled
    session, k = build.estimator.session(), build.estimator.constants
    clock = NodeClock(None, False, lambda: 0, None)
    clock.offset_ns = 0
    live = FeedforwardFilter(session, clock)
    tick_ns = round(FEEDFORWARD_STEP_S * SECOND_NS)
    shown, guarded = [], set()
    for time_now, speed, enable in zip(itertools.count(tick_ns, tick_ns), *stops_and_disables(seed, 1500), strict=False):
        result, outputs = build.step({"speed_mps": speed, "enable": enable}, FEEDFORWARD_STEP_S)
        if np.isfinite(enable):
            session.handle(at.ENABLE, time_now, time_now, enable)
        estimate = session.handle(at.SPEED, time_now, time_now, speed) if np.isfinite(speed) else None
        assert result == (estimate is not None)
        if estimate is not None:
            assert outputs["feedforward_torque_nm"] == pytest.approx(estimate.feedforward_torque_nm, rel=EQUAL)
            live.take(time_now, 0)
        course = live.course(time_now)
        assert int(outputs["reasons"]) & course.stop_reason == course.stop_reason
        shown.append((float(outputs["feedforward_torque_nm"]), live.move(course) if np.isfinite(live.age_s(time_now)) else 0.0))
        guarded.add(course.stop_reason)
    of_c, of_live = np.abs(shown).T
    a_tick_later = (k.number.feedforward_rate + rate_towards(k.number, 0.0)) * FEEDFORWARD_STEP_S
    assert (of_c <= of_live + a_tick_later + 1e-6).all()
    assert of_c.max() > 500.0
    assert guarded == {0, at.Reason.SPEED_IMPLAUSIBLE, at.Reason.DISABLED, at.Reason.ENABLE_OLD}


EARTH_M, ROUND_M = 6371008.8, 300.0  # a round course of that radius


def around(turn):
    """Latitude and longitude at a place of the round course [rad]."""
    north, east = ROUND_M * np.sin(turn) / EARTH_M, ROUND_M * np.cos(turn) / EARTH_M
    return 0.8 + north, 0.2 + east / np.cos(0.8)


def test_slopes_and_torques_by_place_are_the_same(tmp_path):
    vehicle = tr.load_vehicle("ztbus_hess19")
    turn = np.arange(0.0, 2.0 * np.pi, 20.0 / ROUND_M)
    maps = [
        RouteMap(kind, *around(turn), turn + 0.5 * np.pi, np.stack([size * np.sin(turn), np.full(len(turn), np.nan)], axis=1),
                 np.full((len(turn), 2), 0.1 * size), np.full(len(turn), 3))
        for kind, size in ((SLOPE, 0.03), (TORQUE, 400.0))
    ]  # fmt: skip
    build = Built(dataclasses.replace(vehicle, route=tuple(maps)), tmp_path)
    session = build.estimator.session()
    time = START_NS + np.arange(36000) * 50_000_000
    speed = np.clip(8.0 + 7.0 * np.sin(np.arange(36000) / 900.0), 0.0, None)
    turn = np.cumsum(speed) * 0.05 / ROUND_M
    latitude, longitude = around(np.where(np.arange(36000) < 30000, turn, turn[30000]))  # the receiver repeats its last one
    fixes = np.flatnonzero((np.arange(36000) % 20 == 0) & (np.arange(36000) % 9000 < 8000))
    parts = [
        (build.estimator.channels.index(name), rows, values[rows])
        for name, rows, values in (
            ("latitude", fixes, latitude),
            ("longitude", fixes, longitude),
            ("speed", np.arange(36000), speed),
        )
    ]
    channel = np.concatenate([np.full(len(rows), c, dtype=np.int16) for c, rows, _ in parts])
    stamp, value = time[np.concatenate([rows for _, rows, _ in parts])], np.concatenate([values for *_, values in parts])
    stamp = np.where(channel == build.estimator.channels.index("longitude"), stamp + 5_000_000, stamp)
    order = np.lexsort((channel == 0, stamp))
    messages = channel[order], stamp[order], stamp[order], value[order]
    expectation = session.handle_block(*messages).rows
    result, _ = build.run(messages)
    assert np.abs(expectation[:, at.Results.grade_nm]).max() > 1000.0
    seen = session.reason_counts()
    assert at.Reason.PLACE_UNKNOWN in seen
    assert seen[at.Reason.PLACE_UNKNOWN] < 20000
    assert difference(result, expectation).max() <= EQUAL


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """An export, and its state after a minute of driving at 50 Hz."""
    build = Built(tr.load_vehicle("agri3t"), tmp_path_factory.mktemp("one"))
    for i in range(3000):
        build.step({"speed_mps": min(5.0, 0.01 * i), "ambient_degc": 15.0}, 0.02)
    return build, bytes(build.state)


@pytest.fixture
def driven(one):
    """That export, in that state."""
    build, state = one
    build.state[:] = state
    return build


ODD = (np.nan, np.inf, -np.inf, 1e30, -1e30)


@pytest.mark.parametrize(("ambient", "seconds"), [*((20.0, odd) for odd in ODD), *((odd, 600.0) for odd in ODD)])
def test_no_rest_leaves_a_state_that_is_no_number(ambient, seconds, driven):
    driven.rest(ambient, seconds)
    limit = driven.estimator.constants.number.feedforward_limit
    for i in range(100):
        result, outputs = driven.step({"speed_mps": 0.03 * i, "ambient_degc": 15.0}, 0.02)
        assert result == 1
        assert abs(outputs["feedforward_torque_nm"]) <= limit
        assert 0.0 < outputs["resistance_std_nm"] < np.inf
        assert all(-60.0 < outputs[f"belt_degc/{name}"] < 100.0 for name in driven.estimator.assemblies)


def test_messages_of_a_clock_that_went_back_make_the_speed_old(driven):
    driven.message(at.AMBIENT, 0, 0, np.nan)  # refused, and yet its arrival is the time
    assert driven.outputs["level"] == 3
    assert driven.outputs["feedforward_torque_nm"] == 0.0


def test_each_call_writes_all_outputs(driven):
    for given_values, dt in (
        ({"speed_mps": 5.0}, 0.02),
        ({}, 0.02),
        ({"speed_mps": np.inf}, 0.02),
        ({"ambient_degc": 15.0}, 0.0),
    ):
        result_before, written = bytes(driven.state), []
        for byte in (0x00, 0xAA):
            driven.state[:] = result_before
            driven.outputs.view(np.uint8)[:] = byte
            written.append(driven.step(given_values, dt)[1].tobytes())
        assert written[0] == written[1]


@pytest.mark.parametrize("far", [2**62, 2**63 - 1, -(2**62), -(2**63)])
def test_a_time_too_far_changes_nothing(far, driven):
    result_before = bytes(driven.state)
    for stamp, arrival in ((far, 0), (0, far), (far, far)):
        assert driven.message(0, stamp, arrival, 5.0) == -2
    assert bytes(driven.state) == result_before


def test_a_sum_of_times_too_far_changes_nothing(driven):
    driven.message(at.AMBIENT, 0, 2**62 - SECOND_NS, 15.0)
    assert driven.step({}, 0.9)[0] == 0
    result_before = bytes(driven.state)
    assert driven.step({"speed_mps": 5.0}, 0.2)[0] == -2
    assert bytes(driven.state) == result_before


def test_float_is_as_near_as_the_page_says(tmp_path):
    vehicle = tr.load_vehicle("agri3t")
    build = Built(vehicle, tmp_path, single=True)
    messages = drive(build.estimator, 0.3, 1, faults=False)
    expectation = build.estimator.session().handle_block(*messages).rows
    result, _ = build.run(messages)
    deviation = difference(result, expectation)
    names = build.estimator.columns
    assert deviation[names.index("belt_degc/left")] < 1e-3
    torque = expectation[:, at.Results.resistance_torque_nm]
    assert np.abs(result[:, at.Results.resistance_torque_nm] - torque).max() < 1e-3 * np.abs(torque).max()


def test_float_loses_no_small_step_of_a_belt_or_an_effect(tmp_path):
    effect, vehicle = catalogue()["warmup"], tr.load_vehicle("agri3t", thermal="core_surface")
    vehicle = dataclasses.replace(vehicle, effects=(Active(effect, effect.for_size(vehicle.size, False).values()),))
    build = Built(vehicle, tmp_path, single=True)
    stamp = np.arange(40_000) * 1_000_000  # 1 kHz
    messages = np.zeros(len(stamp), dtype=np.int16), stamp, stamp, np.full(len(stamp), 4.0)
    expectation, (result, _) = build.estimator.session().handle_block(*messages).rows, build.run(messages)
    for name in ("belt_degc/left", "effects_nm"):
        column = build.estimator.columns.index(name)
        assert np.ptp(expectation[:, column]) > 0.5
        assert np.abs(result[:, column] - expectation[:, column]).max() < 1e-4
    std = expectation[:, at.Results.resistance_std_nm]
    assert (np.abs(result[:, at.Results.resistance_std_nm] - std) <= 2e-3 * std).all()

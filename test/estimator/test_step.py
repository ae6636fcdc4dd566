# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pure step: the same everywhere, and lawful outputs."""

from copy import deepcopy
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.effects import Active, catalogue
from trackres_ros.effects.stepping import EACH, FIRST_OWN
from trackres_ros.errors import InputError
from trackres_ros.estimator.columns import Part, Reason, Results
from trackres_ros.estimator.drives import assembly_values
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import GroundSeries
from trackres_ros.estimator.settings import Settings
from trackres_ros.files.resources import config_dir
from trackres_ros.model.resistance import TORQUE_COLUMNS, TORQUE_TERMS
from trackres_ros.vehicle import load, load_any

SPEED = 30 / 3.6


def drive(estimator, speed, dt, steps, **known):
    inputs = estimator.inputs(speed, ambient=15.0, **known)
    state = estimator.cold_start(inputs)
    for _ in range(steps):
        state, estimate = estimator.step(state, inputs, dt)
    return state, estimate


def test_step_leaves_its_state_as_it_was(reference):
    inputs = reference.inputs(SPEED, ambient=15.0)
    state = reference.cold_start(inputs)
    belts, motion = state.belts.copy(), state.motion.copy()
    step_1 = reference.step(state, inputs, 1.0)
    step_2 = reference.step(state, inputs, 1.0)
    assert np.array_equal(state.belts, belts)
    assert np.array_equal(state.motion, motion)
    assert np.array_equal(step_1[1].row, step_2[1].row, equal_nan=True)


def test_step_by_step_equals_the_run_along_a_series(reference):
    times = np.cumsum(np.random.default_rng(1).uniform(0.01, 0.5, 200))
    speeds = np.abs(8 + 3 * np.sin(times / 7))
    state = reference.cold_start(reference.inputs(speeds[0], weight=250e3, ambient=5.0))
    _, rows = reference.run(state, times, speeds, 250e3, 5.0)
    for i, (time, speed) in enumerate(zip(times, speeds, strict=True)):
        inputs = reference.inputs(speed, weight=250e3, ambient=5.0)
        state, estimate = reference.step(state, inputs, time - times[i - 1] if i else 0.0)
        assert np.array_equal(estimate.row, rows[i], equal_nan=True)


def test_rows_have_the_terms_of_the_torque_in_their_order():
    """Topics, settings, tables and reports read them from one table; the rows of kernels name them once more."""
    place = Results.names.index("hysteresis_nm")
    assert Results.names[place : place + len(TORQUE_COLUMNS)] == tuple(TORQUE_COLUMNS.values())
    assert Part.names[: len(TORQUE_TERMS)] == TORQUE_TERMS


@given(
    speed=st.floats(-16, 16),
    ambient=st.floats(-40, 45),
    weight=st.floats(100e3, 600e3),
    grade=st.floats(-0.3, 0.3),
    acceleration=st.floats(-2, 2),
)
def test_parts_add_up(reference, speed, ambient, weight, grade, acceleration):
    inputs = reference.inputs(speed, weight=weight, ambient=ambient, grade=grade, acceleration=acceleration)
    state, estimate = reference.step(reference.cold_start(inputs), inputs, 0.1)
    parts = [estimate[name] for name in ("hysteresis_nm", "bearing_nm", "wind_nm")]
    assert estimate.resistance_torque_nm == pytest.approx(sum(parts), abs=1e-6)
    total = sum(parts) + estimate["grade_nm"] + estimate["inertia_nm"]
    assert estimate["drive_torque_nm"] == pytest.approx(total, abs=1e-6)
    by_assembly = assembly_values(estimate.row[np.newaxis], 4).sum()
    assert by_assembly == pytest.approx(estimate.resistance_torque_nm, abs=1e-6)
    assert estimate["weight_n"] == pytest.approx(weight)
    assert np.isfinite(state.belts).all()
    assert np.isfinite(estimate.feedforward_torque_nm)
    assert estimate.resistance_std_nm >= 0


@pytest.fixture(scope="module")
def of_two_radii(tmp_path_factory):
    """A vehicle whose rear tracks have larger sprockets, without and with an effect."""
    content = yaml.safe_load((config_dir() / "xgd24d.yaml").read_text())
    content["tracks"]["large"] = deepcopy(content["tracks"]["triangular"])
    content["tracks"]["large"]["sprocket_radius"].update(value=0.45, range=[0.4, 0.5])
    for assembly in content["assemblies"]:
        assembly["track"] = "large" if assembly["axle"] == "rear" else "triangular"
    path = tmp_path_factory.mktemp("mixed") / "mixed.yaml"
    path.write_text(yaml.safe_dump(content))
    scrub = catalogue()["turning_scrub"]
    return [Estimator(replace(load(path), effects=effects)) for effects in ((), (Active(scrub, scrub.values()),))]


def test_effects_are_shared_by_load_at_each_own_radius(of_two_radii):
    """An effect acts as one force on the whole vehicle: an assembly bears it by load, at the arm of its own sprocket."""
    loads = np.array([70e3, 66e3, 61e3, 58e3])
    rows = []
    for estimator in of_two_radii:
        inputs = estimator.inputs(SPEED, ambient=15.0, load=loads, yaw_rate=0.2)
        rows.append(estimator.step(estimator.cold_start(inputs), inputs, 0.0)[1])
    names = of_two_radii[0].assemblies
    bare_torques, with_effect = (np.array([row[f"resistance_torque_nm/{name}"] for name in names]) for row in rows)
    radii = of_two_radii[0].vehicle.sprocket_radii
    assert len(set(radii)) == 2
    shares = (with_effect - bare_torques) / rows[1]["effects_nm"]
    assert shares == pytest.approx(loads * radii / (loads @ radii), rel=1e-9)
    assert rows[1]["effects_nm"] > 100.0


def test_each_assembly_keeps_its_own_temperature(reference):
    nominal = reference.vehicle.nominal_loads()
    loads = nominal * np.array([1.2, 1.2, 0.8, 0.8])
    inputs = reference.inputs(SPEED, ambient=15.0, load=loads)
    state = reference.cold_start(inputs)
    for _ in range(300):
        state, estimate = reference.step(state, inputs, 1.0)
    front, rear = estimate.belt_degc()[:2], estimate.belt_degc()[2:]
    assert (front > rear.max() + 1.0).all()


@given(speed=st.sampled_from([-3.0, 3.0]), acceleration=st.floats(-3.0, 3.0))
def test_gears_lose_power_whether_the_motor_drives_or_brakes(carrier, speed, acceleration):
    chassis = carrier.vehicle.chassis
    ratio, efficiency = chassis.motor_ratio, chassis.motor_efficiency
    inputs = carrier.inputs(speed, ambient=15.0, acceleration=acceleration)
    estimate = carrier.step(carrier.cold_start(inputs), inputs, 0.0)[1]
    motor, sprockets = (speed * torque for torque in (estimate["motor_torque_nm"] * ratio, estimate["drive_torque_nm"]))
    assert motor >= sprockets
    if abs(sprockets / speed) > 0.01 * carrier.vehicle.size:
        assert motor == pytest.approx(sprockets / efficiency if sprockets > 0.0 else sprockets * efficiency)


def test_no_ratio_no_motor_torque(reference):
    assert np.isnan(drive(reference, SPEED, 1.0, 1)[1]["motor_torque_nm"])


def test_inertia_is_fed_forward_only_with_measured_acceleration():
    settings = Settings(feedforward_parts=("bearing", "inertia"), feedforward_rate=1e9)
    estimator = Estimator(load("xgd24d"), settings)
    given_one = estimator.inputs(SPEED, ambient=15.0, acceleration=0.3)
    _, estimate = estimator.step(estimator.cold_start(given_one), given_one, 0.1)
    assert estimate.feedforward_torque_nm == pytest.approx(estimate["bearing_nm"] + estimate["inertia_nm"])
    inputs_0 = estimator.inputs(SPEED, ambient=15.0)
    state = estimator.cold_start(inputs_0)
    for i in range(40):  # the speed rises, so the filter sees an acceleration; the feed-forward must not
        inputs = estimator.inputs(SPEED + 0.03 * i, ambient=15.0)
        state, estimate = estimator.step(state, inputs, 0.1)
    assert abs(estimate["inertia_nm"]) > 500
    assert estimate.feedforward_torque_nm == pytest.approx(estimate["bearing_nm"])


def test_feedforward_is_limited_in_rate_and_size():
    estimator = Estimator(load("xgd24d"), Settings(feedforward_rate=1000.0, feedforward_share=0.02))
    inputs = estimator.inputs(SPEED, ambient=15.0)
    state = estimator.cold_start(inputs)
    last_torque = 0.0
    limit = 0.02 * 272e3 * 0.36
    for _ in range(60):
        state, estimate = estimator.step(state, inputs, 0.05)
        assert abs(estimate.feedforward_torque_nm - last_torque) <= 1000.0 * 0.05 + 1e-9
        assert abs(estimate.feedforward_torque_nm) <= limit + 1e-9
        last_torque = estimate.feedforward_torque_nm
    assert last_torque == pytest.approx(limit)
    assert estimate.reasons & Reason.FEEDFORWARD_CLAMPED
    assert estimate.status == "warn"


def test_long_gap_lies_between_rest_and_driving_on_and_says_so(reference):
    inputs = reference.inputs(SPEED, ambient=15.0)
    state = reference.cold_start(inputs, belt_degc=30.0, belt_std_k=0.1)
    state, _ = reference.step(state, inputs, 0.0)
    drive_state = state
    for _ in range(600):
        drive_state, drive_estimate = reference.step(drive_state, inputs, 1.0)
    rest_state = reference.rest(state, 15.0, 600.0)
    _, estimate = reference.step(state, inputs, 600.0)
    assert estimate.reasons & Reason.GAP_UNKNOWN
    mean = (rest_state.belts[0, 0, 0] + drive_estimate.belt_degc()[0]) / 2
    assert estimate.belt_degc()[0] == pytest.approx(mean, abs=0.3)
    assert estimate.belt_std_k()[0] > abs(drive_estimate.belt_degc()[0] - rest_state.belts[0, 0, 0]) / 12**0.5


TIMES = 60
DATES = np.datetime64("2024-01-01T00:00") + np.arange(TIMES) * np.timedelta64(1, "s")
SERIES = ("time_s", "speed", "weight", "ambient", "acceleration", "grade", "yaw_rate", "heading", "distance")
POSITIONS = ("time_s", "speed", "latitude", "longitude")


def a_run(estimator, **changed):
    of_vehicle = {"state": estimator.cold_start(estimator.inputs(0.0)), "weight": estimator.vehicle.weight, "ambient": 15.0}
    return estimator.run(**({"time_s": np.arange(TIMES), "speed": np.full(TIMES, 5.0)} | of_vehicle | changed))


@pytest.mark.parametrize("name", ["load", "belt_measured"])
@pytest.mark.parametrize("shape", [(), (0,), (1,), (2,), (3,), (5,), (4, 1), (1, 4)])
def test_arrays_of_assemblies_have_one_value_for_each(reference, name, shape):
    with pytest.raises(InputError, match=f"{name}.*shape"):
        reference.inputs(SPEED, **{name: np.full(shape, 60.0)})


def test_step_rest_run_and_session_refuse_another_vehicle(reference, carrier):
    road = Estimator(load_any("bmw_i3"))
    for estimator, other_estimator in permutations((reference, carrier, road), 2):
        inputs, other_inputs = estimator.inputs(5.0), other_estimator.inputs(5.0)
        state, other_state = estimator.cold_start(inputs), other_estimator.cold_start(other_inputs)
        for call in (
            lambda estimator=estimator, other_state=other_state, inputs=inputs: estimator.step(other_state, inputs, 0.1),
            lambda estimator=estimator, state=state, other_inputs=other_inputs: estimator.step(state, other_inputs, 0.1),
            lambda estimator=estimator, other_state=other_state: estimator.rest(other_state, 15.0, 60.0),
            lambda estimator=estimator, other_state=other_state: a_run(estimator, state=other_state),
            lambda estimator=estimator, other_state=other_state: estimator.session().begin(other_state),
        ):
            with pytest.raises(InputError, match="shape"):
                call()
    effects = np.append(state.effects, 0.0)
    with pytest.raises(InputError, match=r"^state"):
        road.step(state._replace(effects=effects), inputs, 0.1)


@pytest.mark.parametrize("name", SERIES)
def test_a_run_refuses_dates_and_other_lengths(reference, name):
    for values in (DATES, DATES - DATES[0], list(DATES.tolist()), np.ones(TIMES - 1), np.ones((TIMES, 1)), "noon"):
        with pytest.raises(InputError, match=name):
            a_run(reference, **{name: values})


@pytest.mark.parametrize("at", range(len(GroundSeries._fields)))
def test_a_run_refuses_ground_of_another_length(reference, at):
    ground = GroundSeries(*(np.zeros(TIMES - (i == at)) for i in range(len(GroundSeries._fields))))
    with pytest.raises(InputError, match="place"):
        a_run(reference, ground=ground)


@pytest.mark.parametrize("name", POSITIONS)
def test_positions_along_a_route_have_the_length_of_its_times(reference, name):
    for values in (DATES, np.ones(TIMES - 1), np.ones(1)):
        with pytest.raises(InputError, match=r"shape|numbers"):
            reference.along_route(**{position: np.arange(TIMES) for position in POSITIONS} | {name: values})


NO_NUMBERS = (np.inf, -np.inf, 1e300, 10**400, "5", b"5", True, 5j, object(), DATES[0], DATES[1] - DATES[0], [5.0, 5.0])
UNKNOWN = (np.nan, None, np.ma.masked)
KNOWN = ("speed", "weight", "ambient")
OTHERS = ("acceleration", "grade", "yaw_rate", "heading", "distance", "measured_torque")


@pytest.mark.parametrize("name", [*KNOWN, *OTHERS])
def test_a_value_that_is_no_finite_number_is_refused(reference, name):
    inputs = reference.inputs(5.0)
    state = reference.cold_start(inputs)
    ways = [lambda value: reference.inputs(**({"speed": 5.0} | {name: value}))]
    if name in inputs._fields:
        ways += [lambda value: reference.step(state, inputs._replace(**{name: value}), 0.1)]
    if name in SERIES:
        ways += [lambda value: a_run(reference, **{name: value})]
    if name == "ambient":
        ways += [lambda value: reference.rest(state, value, 1.0)]
    for i, way in enumerate(ways):
        nominal = (name == "ambient" and i in (0, len(ways) - 1)) or (name == "weight" and i == 0)  # None is allowed
        for bad_value in (
            *NO_NUMBERS,
            *(unknown_value for unknown_value in UNKNOWN if name in KNOWN and not (unknown_value is None and nominal)),
        ):
            with pytest.raises(InputError, match=name):
                way(bad_value)


@given(st.lists(st.floats(), min_size=8, max_size=8), st.lists(st.floats(), min_size=4, max_size=4))
def test_accepted_inputs_give_a_finite_estimate_and_the_next(reference, values, of_assemblies):
    inputs = reference.inputs(5.0)
    one_by_one = [{name: value} for name, value in zip(("speed", "ambient", *OTHERS), values, strict=True)]
    for changes in (*one_by_one, {"weight": values[0]}, {"load": of_assemblies}, {"belt_measured": of_assemblies}):
        try:
            state, estimate = reference.step(reference.cold_start(inputs), reference.inputs(**({"speed": 5.0} | changes)), 0.1)
        except InputError:
            continue
        for next_estimate in (estimate, reference.step(state, inputs, 0.1)[1]):
            assert np.isfinite(
                [
                    next_estimate.resistance_torque_nm,
                    next_estimate.resistance_std_nm,
                    next_estimate.feedforward_torque_nm,
                    *next_estimate.belt_degc(),
                ]
            ).all()


def test_loads_are_not_negative_and_not_all_zero(reference):
    inputs = reference.inputs(5.0)
    state = reference.cold_start(inputs)
    for loads in (np.zeros(4), [-1.0, 68e3, 68e3, 68e3], [np.nan, 68e3, 68e3, 68e3], np.ma.array([68e3] * 4, mask=[1, 0, 0, 0])):
        for way in (lambda load: reference.inputs(5.0, load=load), lambda load: reference.inputs(5.0, weight=2e5, load=load)):
            with pytest.raises(InputError, match="load"):
                way(loads)
        with pytest.raises(InputError, match="load"):
            reference.step(state, inputs._replace(load=loads), 0.1)
    for loads in (0.0, -1.0):
        for way in (lambda weight: reference.inputs(5.0, weight=weight), lambda weight: a_run(reference, weight=weight)):
            with pytest.raises(InputError, match="weight"):
                way(loads)


def test_a_cold_start_has_one_temperature_of_all_belts(reference):
    inputs = reference.inputs(5.0)
    for arguments in ({"belt_degc": [10.0, 60.0]}, {"belt_degc": np.nan}, {"belt_std_k": -1.0}, {"belt_std_k": [1.0, 2.0]}):
        with pytest.raises(InputError, match=next(iter(arguments))):
            reference.cold_start(inputs, **arguments)


def test_a_masked_value_is_unknown(reference):
    nan = np.array([np.nan, 20.0, 20.0, 20.0])
    masked_degc = np.ma.array([1.0, 20.0, 20.0, 20.0], mask=[True, False, False, False])
    all_inputs = [reference.inputs(5.0, belt_measured=degc) for degc in (nan, masked_degc)]
    all_inputs += [reference.inputs(5.0)._replace(belt_measured=masked_degc)]
    state = reference.cold_start(all_inputs[0])
    rows = [reference.step(state, inputs, 0.1)[1].row for inputs in all_inputs]
    assert all(np.array_equal(row, rows[0], equal_nan=True) for row in rows)
    grades = np.ma.array(np.full(TIMES, 0.1), mask=np.arange(TIMES) > 5)
    assert np.array_equal(a_run(reference, grade=grades)[1], a_run(reference, grade=grades.filled(np.nan))[1], equal_nan=True)


def strange_arrays(given):
    """The same numbers in arrays of other types and of other places in memory."""
    read_only = np.repeat(given, 3)[::3]
    read_only.setflags(write=False)
    return (
        read_only,
        given[::-1].copy()[::-1],
        given.tolist(),
        given.astype(">f8"),
        given.astype("f4"),
        given.astype("i4"),
        given.astype("O"),
    )


def test_arrays_of_any_kind_and_layout_give_the_same(reference):
    loads, times, state = np.full(4, 68e3), np.arange(4.0), reference.cold_start(reference.inputs(5.0))
    stamps = np.arange(4) * 10**8

    def work(array, number):
        for inputs in (
            reference.inputs(number(5.0), load=array(loads)),
            reference.inputs(5.0)._replace(load=array(loads), speed=number(5)),
        ):
            row = reference.step(state, inputs, number(1.0))[1].row
        rows = reference.run(state, array(times), array(np.full(4, 5.0)), number(272e3), array(np.full(4, 15.0)))[1]
        reference.along_route(array(times), array(np.full(4, 5.0)), array(np.zeros(4)), array(np.zeros(4)))
        session = reference.session()
        steps = session.handle_block(array(np.zeros(4)), array(stamps), array(stamps), array(np.full(4, 5.0))).rows
        last_row = session.handle(number(0), number(2**29), number(2**29), number(5.0)).row
        return row, rows, steps, last_row

    base_results = work(lambda array: array, lambda value: value)
    for i in range(7):
        for number in (np.float32, np.int64, np.array):
            results = work(lambda array, i=i: strange_arrays(array)[i], number)
            assert all(
                np.array_equal(result, expected, equal_nan=True) for result, expected in zip(results, base_results, strict=True)
            )


def test_inputs_do_not_share_the_arrays_they_are_made_of(reference):
    load, degc = np.full(4, 68e3), np.full(4, 20.0)
    inputs = reference.inputs(5.0, load=load, belt_measured=degc)
    load[:] = degc[:] = 0.0
    assert inputs.load.tolist() == [68e3] * 4
    assert inputs.belt_measured.tolist() == [20.0] * 4


def test_a_session_refuses_what_is_no_channel_and_no_number(reference):
    session, stamp = reference.session(), 10**18
    old_counters = session.memory.counters.copy()
    for channel in (-1, len(reference.channels), 200_000, 2**70, None, "speed", np.nan, [0]):
        with pytest.raises(InputError, match="channel"):
            session.handle(channel, stamp, stamp, 5.0)
        with pytest.raises(InputError, match="channel"):
            session.handle_block([0, channel], [stamp] * 2, [stamp] * 2, [5.0] * 2)
    for value in (None, "1", np.nan, 2**63, 2**70, np.datetime64(stamp, "ns")):
        with pytest.raises(InputError, match="stamp_ns"):
            session.handle(0, value, stamp, 5.0)
        with pytest.raises(InputError, match="arrival_ns"):
            session.handle(0, stamp, value, 5.0)
    for value in ("1", True, 5j, 10**400):
        with pytest.raises(InputError, match="value"):
            session.handle(0, stamp, stamp, value)
    assert np.array_equal(session.memory.counters, old_counters)


def test_an_estimator_takes_the_name_of_a_vehicle(reference, tmp_path):
    assert repr(Estimator("bmw_i3", cache=str(tmp_path))) == repr(Estimator(load_any("bmw_i3")))
    for arguments in (
        {"vehicle": None},
        {"vehicle": 3},
        {"vehicle": "agri3t", "settings": {}},
        {"vehicle": "agri3t", "cache": 3},
    ):
        with pytest.raises(InputError):
            Estimator(**arguments)
    for call in (
        lambda: reference.step(None, reference.inputs(5.0), 0.1),
        lambda: reference.rest(3, 15.0, 1.0),
        lambda: reference.session().begin(None),
    ):
        with pytest.raises(InputError, match="state"):
            call()
    state = reference.cold_start(reference.inputs(5.0))
    for arguments in (None, 3, tuple(reference.inputs(5.0))):
        for call in (
            lambda arguments=arguments: reference.step(state, arguments, 0.1),
            lambda arguments=arguments: reference.cold_start(arguments),
        ):
            with pytest.raises(InputError, match="inputs"):
                call()


@pytest.mark.parametrize("wrong", [-0.1, np.nan, np.inf, np.timedelta64(100, "ms")])
def test_time_goes_on_in_seconds(reference, wrong):
    inputs = reference.inputs(5.0)
    state = reference.cold_start(inputs)
    for call in (lambda: reference.step(state, inputs, wrong), lambda: reference.rest(state, 15.0, wrong)):
        with pytest.raises(InputError, match="seconds"):
            call()
    if not isinstance(wrong, np.timedelta64):
        with pytest.raises(InputError, match=r"time_s\[7\]"):
            a_run(reference, time_s=np.append(np.arange(7.0), np.full(TIMES - 7, wrong)))


def test_a_block_of_messages_has_as_many_of_each_part(reference):
    stamps = np.arange(3) * 10**9
    for place in range(4):
        parts = [np.zeros(3, dtype=np.int16), stamps, stamps, np.ones(3)]
        parts[place] = parts[place][:2]
        with pytest.raises(InputError, match="one length"):
            reference.session().handle_block(*parts)


@pytest.mark.parametrize(("name", "effect"), [("bmw_i3", "warmup"), ("agri3t", "viscous_bearing"), ("agri3t", "roadwheel_tyres")])
def test_effects_pass_a_long_gap_between_rest_and_drive(name, effect):
    vehicle = load_any(config_dir() / f"{name}.yaml")
    typical = catalogue(size=vehicle.size, on_tyres=name == "bmw_i3")[effect]
    estimator = Estimator(replace(vehicle, effects=(Active(typical, typical.values()),)))
    fast_inputs, hour, ambient = estimator.inputs(0.5 * vehicle.chassis.max_speed), 3600.0, vehicle.chassis.ambient

    def effect_state(state):
        return float(np.nanmax(state.effects[FIRST_OWN::EACH]))

    def drive(state, inputs, steps, dt):
        for _ in range(steps):
            state, _ = estimator.step(state, inputs, dt)
        return state

    warm = drive(estimator.cold_start(fast_inputs), fast_inputs, 60, 30.0)
    rest_value = effect_state(estimator.rest(warm, ambient, hour))
    drive_value = effect_state(drive(warm, fast_inputs, 120, 30.0))
    assert effect_state(drive(warm, fast_inputs, 1, hour)) == pytest.approx(0.5 * (rest_value + drive_value), rel=1e-3)
    stop_state = drive(warm, estimator.inputs(0.0), 3, 1.0)
    rest_value = effect_state(estimator.rest(stop_state, ambient, hour))
    assert effect_state(drive(stop_state, estimator.inputs(0.0), 1, hour)) == pytest.approx(rest_value, rel=1e-6)
    assert abs(rest_value - effect_state(stop_state)) > 0.02 * abs(effect_state(stop_state))

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rules of learning: each by a drive that would break it."""

import copy
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.columns import HELD, learning_values, lines
from trackres_ros.learning.gate import UNSURE
from trackres_ros.learning.learner import Learner, apply_departures, target_departures
from trackres_ros.learning.parameters import (
    LEAST_FACTOR,
    REACH_STD,
    SLOW,
    STATES,
    STEP,
    VEHICLES_OWN,
    correct_estimate,
    learnables,
    limits_of,
    make_prior,
    rise_torques,
)
from trackres_ros.learning.state import BLOCK_S, LASTING_SHARE, LATE, ResidualBlock, close_block
from trackres_ros.learning.store import write_learned
from trackres_ros.vehicle import RoadVehicle
from trackres_ros.vehicle.writing.vehicle_file import open_document


@pytest.fixture(scope="module")
def learned(road):
    """A vehicle whose belts lose a fifth more than its file says, after twenty minutes."""
    return road("watch", {layout.OF_LOSS: 0.2}).drive(20.0)


@pytest.fixture(scope="module")
def driven_before(road):
    """A copy of a vehicle that has been driven for sixteen minutes, by mode and departure of its losses."""
    drives = {}

    def copy_of(mode, departure=0.1):
        key = mode, departure
        if key not in drives:
            drives[key] = road(mode, {layout.OF_LOSS: departure}).drive(16.0)
        estimator = drives[key].session.estimator
        return copy.deepcopy(drives[key], {id(estimator): estimator})

    return copy_of


def test_fifteen_minutes_suffice_to_learn_a_20_percent_error(learned):
    file, learned_error = learned.errors(5.0)
    assert file > 0.08
    assert learned_error < 0.02
    assert learned.learner.is_active
    assert learned.learner.has_evidence[layout.OF_LOSS]


def test_on_and_watching_learn_the_same(learned, road):
    active_drive = road("on", {layout.OF_LOSS: 0.2}).drive(20.0)
    states = list(VEHICLES_OWN)
    assert active_drive.learner.learned.mean[states] == pytest.approx(learned.learner.learned.mean[states], abs=2e-3)
    assert active_drive.errors(5.0)[0] < 0.02


def test_in_reverse_it_learns_as_ahead(road):
    ahead, reverse = (
        road("on", {layout.OF_LOSS: 0.2}).drive(1.0, speed=lambda t, way=way: way * (8.0 + 6.0 * math.sin(t / 10.0)), noise=0.0)
        for way in (1.0, -1.0)
    )
    assert reverse.learner.learned.seconds == ahead.learner.learned.seconds > 20.0
    states = [*range(layout.LEARNABLE), SLOW, STEP]  # against travel
    assert reverse.learner.learned.mean[states] == pytest.approx(ahead.learner.learned.mean[states], rel=1e-6, abs=1e-9)


def test_where_no_torque_is_measured_nothing_changes(road):
    drive = road("on", {layout.OF_LOSS: 0.2}).drive(6.0, lambda _torque, _i: None)
    assert not drive.session.learned[: layout.Learned.sensitivities.start].any()
    assert drive.learner.learned.seconds == 0.0


def test_a_file_that_is_right_stays_right(driven_before):
    drive = driven_before("on", 0.0)
    assert drive.errors(5.0)[1] < 0.01


def test_one_corner_is_not_the_whole(road):
    drive = road("on", {layout.OF_LOSS: 0.2}).drive(3.0, speed=lambda _t: 6.0)
    assert not any(drive.learner.has_evidence[state] for state in VEHICLES_OWN)
    assert drive.session.learned[layout.Learned.on] == 0.0


@pytest.mark.parametrize("share", [0.07, -0.07])
def test_another_sensor_is_a_step_and_not_the_rubber(driven_before, share):
    drive = driven_before("watch")
    old_departures = drive.learner.learned.applied.copy()
    drive.drive(4.0, lambda torque, _i: (1.0 + share) * torque)
    assert any(text.startswith("a disturbance of") for text in drive.said)
    assert drive.learner.learned.applied[VEHICLES_OWN,] == pytest.approx(old_departures[VEHICLES_OWN,], abs=0.03)
    frozen_mean = drive.learner.learned.mean[VEHICLES_OWN,].copy()
    drive.drive(0.1, lambda torque, _i: (1.0 + share) * torque)
    assert drive.learner.freeze_reason
    assert drive.learner.learned.mean[VEHICLES_OWN,] == pytest.approx(frozen_mean, abs=1e-12)


def test_a_pump_goes_as_it_came(driven_before):
    drive = driven_before("on")
    drive.drive(3.0, lambda torque, _i: torque + 300.0).drive(14.0)
    assert drive.errors(4.0)[1] < 0.025


@pytest.mark.parametrize(("gain", "words"), [(46.0, "46 Nm better"), (-8.0, "8 Nm worse")])
def test_the_status_says_if_used_values_fit_better_or_worse(driven_before, monkeypatch, gain, words):
    learner = driven_before("on").learner
    monkeypatch.setattr(learner.learned.fresh, "gain", gain)
    assert f", {words} than the vehicle file; used" in learner.text


def test_a_torque_from_outside_is_reported_while_it_lasts(driven_before):
    drive = driven_before("watch")
    assert drive.learner.disturbance == ""
    less_than_a_step = 0.025 * drive.learner.learned.rolling
    drive.drive(1.4, lambda torque, _i: torque + less_than_a_step)
    assert drive.learner.disturbance.startswith("a disturbance of +")
    assert drive.learner.disturbance in drive.learner.text
    old_text = drive.learner.disturbance
    parks = lambda t, begins=0.1 * drive.steps: max(8.0 + 6.0 * math.sin(begins / 60.0) - t + begins, 0.0)  # noqa: E731
    assert drive.drive(3.0, speed=parks).learner.disturbance in ("", old_text)  # a parked vehicle adds nothing
    drive.drive(10.0, speed=lambda t, begins=0.1 * drive.steps: 8.0 - 8.0 * math.cos((t - begins) / 60.0))
    assert drive.learner.disturbance == ""


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_disturbance_ends_at_its_change_of_sign(reference, way):
    """Of a torque that swings slowly; and a parked vehicle adds nothing to its time."""
    learner = Learner(reference)
    s, random = learner.learned, np.random.default_rng(3)
    for number in range(160):
        torque = 0.06 * s.rolling * (math.sin(number / 16.0) + 0.03 * random.normal())
        s.block = ResidualBlock(BLOCK_S, 1.0, way * torque, 0.0, way)
        close_block(s)
        if learner.disturbance:
            blocks = number - math.floor(number / 16.0 / math.pi) * math.pi * 16.0  # the torque crossed zero
            nm, seconds = re.match(r"a disturbance of ([+-]\d+) Nm for (\d+) s", learner.disturbance).groups()
            assert int(seconds) <= BLOCK_S * (blocks + 1.0)
            assert float(nm) * torque > 0.0 or blocks <= LATE
    assert s.disturbed_s > 0.0


def test_bumps_of_the_road_are_noise_and_hills_are_what_wanders(road):
    """Both of 100 Nm: one goes from block to block, the other within some minutes."""
    shares = []
    for keep in (0.0, np.exp(-1.0 / 9.0)):
        random, level = np.random.default_rng(6), [0.0]

        def shown(torque, i, random=random, level=level, keep=keep):
            if i % 200 == 0:
                level[0] = keep * level[0] + 100.0 * np.sqrt(1.0 - keep**2) * random.normal()
            return torque + level[0]

        learner = road("watch").drive(20.0, shown).learner
        levels = learner.learned.past
        shares.append(levels.slow / (levels.slow + levels.white))
    assert shares[0] < 0.2
    assert shares[1] > 0.5


def test_of_a_disturbance_no_more_is_fed_than_its_bound(driven_before):
    drive, watch_drive = (driven_before(mode).drive(5.0, lambda torque, _i: torque + 400.0) for mode in ("on", "watch"))
    assert watch_drive.rows[-1][1] + 200.0 < watch_drive.rows[-1][2] == pytest.approx(drive.rows[-1][1], rel=0.003)
    state = drive.learner.learned
    assert state.mean[[SLOW, STEP]].sum() == pytest.approx(watch_drive.learner.learned.mean[[SLOW, STEP]].sum(), rel=0.02)
    assert abs(state.lasting_nm) <= LASTING_SHARE * state.rolling * 1.01
    lasting = abs(state.lasting_nm)
    drive.drive(0.15, lambda _torque, _i: None)
    assert abs(drive.learner.learned.lasting_nm) < 0.05 * lasting + 0.1


@pytest.mark.parametrize(
    ("shown", "words"),
    [
        (lambda _torque, _i: 2500.0, "the measured torque is stuck"),
        (lambda torque, _i: -torque, "the measured torque has an impossible sign"),
        (lambda torque, i: torque if i % 40 < 10 else None, "no torque is measured"),
        (lambda torque, i: torque + (3000.0 if i % 4 == 0 else 0.0), "the measured torque is an outlier"),
    ],
)
def test_what_is_wrong_with_the_torque_is_told_and_not_learned(driven_before, shown, words):
    drive = driven_before("on")
    assert drive.learner.left_out == ""
    old_departures, seconds = drive.learner.learned.applied.copy(), drive.learner.learned.seconds
    drive.drive(2.0, shown, noise=0.0)
    assert drive.learner.left_out.startswith(f"{words} in ")
    assert drive.learner.text.endswith(drive.learner.left_out)
    if "stuck" in words or "sign" in words:
        assert drive.learner.learned.seconds < seconds + 15.0
        assert drive.learner.learned.applied[VEHICLES_OWN,] == pytest.approx(old_departures[VEHICLES_OWN,], abs=0.03)
    drive.drive(6.0)
    assert drive.learner.left_out == ""


def test_nothing_is_learned_from_a_doubtful_estimate(road):
    drive = road("watch").drive(0.05)
    gate, memory = drive.learner.gate, drive.session.memory
    time_ns, speed = int(memory.times[layout.SPEED, layout.Times.last_arrival]), float(memory.values[layout.SPEED])
    for reason in (layout.Reason.NONE, *(unsure_reason for unsure_reason in layout.REASON_TEXT if unsure_reason & UNSURE)):
        time_ns += 10**8
        row, old_count = drive.session.handle(layout.SPEED, time_ns, time_ns, speed).row, gate.second.taken
        columns = [layout.Results.measured_torque_nm, layout.Results.residual_nm, layout.Results.reasons]
        row[columns] = row[layout.Results.drive_torque_nm], 0.0, reason
        gate.take(time_ns, row.tolist(), drive.session)
        assert gate.second.taken - old_count == (not reason)


def test_a_yaw_rate_that_died_in_a_bend_stops_no_learning(road):
    drive = road("watch")
    drive.session.handle(layout.YAW_RATE, 1, 1, 1.0)
    assert drive.drive(2.0).learner.learned.seconds > 90.0


def test_nothing_is_wrong_with_a_torque_while_it_stands(road):
    drive = road("watch").drive(2.0, lambda _torque, _i: 0.0, speed=lambda _t: 0.0, noise=0.0)
    assert drive.learner.left_out == ""


def test_outliers_freeze_it(road):
    drive = road("on", {layout.OF_LOSS: 0.1})
    random = np.random.default_rng(5)
    drive.drive(10.0, lambda torque, _i: torque + (3000.0 if random.random() < 0.3 else 0.0))
    assert any("disagree" in text for text in drive.said)
    assert drive.errors(2.0)[1] < 1.02 * drive.errors(2.0)[0] + 0.02


def test_what_wanders_is_not_taken_for_the_vehicle(road):
    """Unknown hills of one in a hundred."""
    drive = road("on", {layout.OF_LOSS: -0.05})
    drive.drive(25.0, lambda torque, i: torque + 980.0 * np.sin(2.0 * np.pi * i / 1500.0))
    file, learned_error = drive.errors(10.0)
    assert learned_error < file + 0.02


def test_nothing_leaves_the_ranges_of_the_file(road):
    drive = road("on").drive(15.0, lambda torque, _i: 3.0 * torque)
    learner = drive.learner
    assert (learner.learned.mean <= learner.prior.high).all()
    assert (learner.learned.mean >= learner.prior.low).all()
    assert (learner.learned.applied <= learner.prior.high[: layout.LEARNABLE]).all()
    for state in VEHICLES_OWN:  # nor where none but this one is accepted
        departure = target_departures(learner.learned, learner.prior, np.arange(layout.LEARNABLE) == state)[state]
        assert learner.prior.low[state] <= departure <= learner.prior.high[state]


def test_acting_values_are_as_uncertain_as_they_lag_and_wander(reference):
    s, learned = Learner(reference).learned, np.zeros(layout.Learned.columns)
    s.mean[: layout.LEARNABLE], s.applied[:] = 0.03, 0.01
    s.mean[STEP], s.lasting_nm, s.step_s, s.past.white = 90.0, 40.0, 1.0, (0.1 * s.rolling) ** 2
    apply_departures(s, True, learned, s.second, 0.0)
    factor = layout.Learned(learned).factor.reshape(layout.LEARNABLE, layout.LEARNABLE)
    assert factor @ factor.T == pytest.approx(s.covariance[: layout.LEARNABLE, : layout.LEARNABLE] + 0.02**2, abs=1e-9)
    assert layout.Learned(learned).slow ** 2 == pytest.approx(s.slow_std**2 + s.hills_variance + 50.0**2)
    assert min(s.slow_std, s.hills_variance) > 0.0


def test_a_value_at_its_bound_is_neither_learned_nor_written(driven_before, tmp_path):
    drive = driven_before("on")
    learner = drive.learner
    assert HELD not in learning_values(learner)
    learner.learned.mean[layout.OF_LOSS] = learner.prior.high[layout.OF_LOSS]
    file = write_learned(learner, drive.session.estimator.vehicle, tmp_path / "v.yaml")
    assert (file.written, file.why_not) == ((), learner.text)
    assert learner.text.endswith("with an unknown error: loss_modulus_scale")
    assert HELD in learning_values(learner)


def test_time_off_makes_it_less_sure_and_forgets_what_wanders(learned):
    old_state, rises, prior_std = (
        learned.learner.learned,
        [],
        learned.learner.prior.covariance[layout.OF_LOSS, layout.OF_LOSS] ** 0.5,
    )
    for pieces, days in ((1, 10.0), (1, 30.0), (30, 1.0), (1, 1e4)):
        learner = copy.deepcopy(learned.learner)
        for _ in range(pieces):
            learner.age_values(days * 86400.0)
        new_state = learner.learned
        rises.append(
            new_state.covariance[layout.OF_LOSS, layout.OF_LOSS] ** 0.5
            - old_state.covariance[layout.OF_LOSS, layout.OF_LOSS] ** 0.5
        )
        assert new_state.mean[SLOW] == 0.0
        assert new_state.mean[layout.OF_LOSS] == old_state.mean[layout.OF_LOSS]
        assert np.linalg.eigvalsh(new_state.covariance).min() > -1e-9 * new_state.covariance.max()
    assert rises[0] == pytest.approx(0.5 * prior_std * 10.0 / 365.0)
    assert rises[1:3] == pytest.approx([3.0 * rises[0]] * 2)  # however the time is divided
    assert new_state.covariance[layout.OF_LOSS, layout.OF_LOSS] == pytest.approx(prior_std**2)


@pytest.mark.parametrize("days", [300, -300])
def test_a_jump_of_the_clock_is_no_time_off_and_stops_nothing(driven_before, days):
    drive = driven_before("watch")
    old_variance = drive.learner.learned.covariance[layout.OF_LOSS, layout.OF_LOSS]
    old_seconds = drive.drive(0.1, lambda _torque, _i: 2500.0, noise=0.0).learner.learned.seconds
    drive.ahead_ns = days * 86400 * 10**9
    seconds = drive.drive(0.1, lambda _torque, _i: 2500.0, noise=0.0).learner.learned.seconds
    assert seconds <= old_seconds + 3.0
    assert drive.drive(0.2).learner.learned.seconds >= seconds + 11.0
    now_ns = int(drive.session.memory.times[layout.SPEED, layout.Times.last_stamp])
    assert 0 <= now_ns // 10**9 - drive.learner.learned.second <= 1
    assert drive.learner.learned.covariance[layout.OF_LOSS, layout.OF_LOSS] <= old_variance * 1.001


def test_belts_that_move_to_known_air_are_learned_anew(road):
    drive = road("on").drive(0.01)
    for session, minutes in ((drive.true, 15.0), (drive.session, 2.0)):
        time_ns = int(session.memory.times[layout.SPEED, layout.Times.last_arrival])
        session.handle(layout.AMBIENT, time_ns, time_ns, -10.0)
        drive.drive(minutes)
    assert drive.errors(1.0)[0] < 0.03


def test_air_that_is_as_assumed_changes_nothing_learned(driven_before):
    drive = driven_before("on")
    old_mean, time_ns = (
        drive.learner.learned.mean.copy(),
        int(drive.session.memory.times[layout.SPEED, layout.Times.last_arrival]),
    )
    drive.session.handle(layout.AMBIENT, time_ns, time_ns, drive.session.motion[layout.Motion.air])
    drive.drive(0.02)
    assert old_mean[layout.OF_BELT] != 0.0
    assert drive.learner.learned.mean == pytest.approx(old_mean, rel=0.1)


def rest(driven, how):
    """Two hours, with the node off or on."""
    driven.steps += 72_000
    if how == "off":
        driven.learner.age_values(7200.0)


@pytest.mark.parametrize("how", ["off", "on"])
def test_a_vehicle_repaired_at_rest_has_its_file_in_a_minute(driven_before, how):
    drive = driven_before("on")
    rest(drive, how)
    layout.Learned(drive.true.learned).departures[layout.OF_LOSS] = 0.0
    assert drive.learner.is_active
    drive.drive(1.2)
    assert not drive.learner.is_active


@pytest.mark.parametrize("how", ["off", "on"])
def test_a_rest_alone_takes_nothing_learned_away(driven_before, how):
    drive = driven_before("on")
    rest(drive, how)
    drive.drive(3.0)
    assert drive.learner.is_active
    assert drive.errors(3.0)[1] < 0.01


@pytest.mark.parametrize("how", ["silent", "parked", "stopped", "frozen"])
def test_unrenewed_belt_departures_fade_but_not_the_vehicles(driven_before, how):
    drive = driven_before("on")
    s, begins_s = drive.learner.learned, 0.1 * drive.steps
    sensor, speed = (lambda torque, _i: torque), (lambda t: 8.0 + 6.0 * math.sin(t / 60.0))
    if how == "parked":
        speed = lambda t: max(8.0 + 6.0 * math.sin(begins_s / 60.0) - (t - begins_s), 0.0)  # noqa: E731
    elif how != "stopped":
        sensor = lambda torque, i: None if how == "silent" else torque * (3.0 if i % 3 == 0 else 1.0)  # noqa: E731
        drive.drive(1.0, sensor, speed)
    s.applied[layout.OF_BELT], s.seconds = 10.0, 1.0
    s.aim[:] = s.applied
    old_departures = s.applied.copy()
    drive.steps += 9000 if how == "stopped" else 0
    drive.drive(0.02 if how == "stopped" else 15.0, sensor, speed)
    assert bool(drive.learner.freeze_reason) is (how == "frozen")
    departures = layout.Learned(drive.session.learned).departures
    assert departures[layout.OF_BELT] == pytest.approx(10.0 * math.exp(-1.0), rel=0.05)
    assert np.delete(departures, layout.OF_BELT) == pytest.approx(np.delete(old_departures, layout.OF_BELT), abs=1e-12)
    acts_by_name = {
        name: dict(facts)["acts"] == "true" for name, _, facts in lines(drive.learner, learning_values(drive.learner))
    }
    assert acts_by_name == {
        learnable.name: learnable.state in VEHICLES_OWN and old_departures[learnable.state] != 0.0
        for learnable in drive.learner.learnables
    }


class Sure(Learner):
    """A learner that accepts whatever it has of the vehicle."""

    is_active, is_at_bound = True, np.zeros(layout.LEARNABLE, dtype=bool)

    @property
    def has_evidence(self):
        return np.isin(np.arange(layout.LEARNABLE), self.own)


@pytest.fixture(scope="module", params=["xgd24d", "bmw_i3", "husky"])
def sure(request, tmp_path_factory):
    """A learner of each vehicle of a kind, by what its values are in the file."""
    folder, learners = tmp_path_factory.mktemp("sure"), {}

    def learner_of(end):
        if end not in learners:
            source = tr.load_vehicle(request.param)
            document = open_document(source.source)
            if not isinstance(source, RoadVehicle):
                document.set(("rubber", "file"), str(source.rubber_source))
            paths = {path for learnable in learnables(source) for path in learnable.paths}
            for path in (path for path in paths if path.startswith(("chassis", "road_load"))):  # no belt burns
                limits = limits_of(path)
                low = 0.0 if path.endswith("rolling_rise") else limits.low  # from a coefficient of 0 it may not fall
                value = {"file": source.parameters[path].value, "low": low, "high": limits.high}[end]
                document.set((*path.split("."), "value"), value)
                document.set((*path.split("."), "range"), [limits.low, limits.high])
            (folder / f"{end}.yaml").write_text(document.text())
            vehicle = tr.load_vehicle(folder / f"{end}.yaml")
            learners[end] = vehicle, Sure(Estimator(vehicle))
        return learners[end]

    return learner_of


@settings(max_examples=10)
@given(st.sampled_from(["file", "low", "high"]), st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7), st.floats(1e-3, 1.0))
def test_a_written_file_has_each_learned_value_within_its_range(sure, tmp_path_factory, end, shares, known):
    vehicle, learner = sure(end)
    file, s = tmp_path_factory.getbasetemp() / "learned.yaml", learner.learned
    s.covariance[:] = known**2 * learner.prior.covariance
    for state, share in zip(learner.own, shares, strict=False):
        low, high = learner.prior.low[state], learner.prior.high[state]
        assert low <= 0.0 <= high
        s.mean[state] = low + share * (high - low)
    departures = target_departures(s, learner.prior, learner.has_evidence)
    write_learned(learner, vehicle, file)
    quantities = tr.load_vehicle(file).parameters
    stds = learner.stds(s.covariance, learner.own)
    for learnable in learner.learnables:
        for path in learnable.paths:
            old_quantity, new_quantity = vehicle.parameters[path], quantities[path]
            rounding = 1e-5 * max(
                abs(new_quantity.value), abs(new_quantity.low), abs(new_quantity.high)
            )  # a file has six figures of each
            if path == learnable.paths[0] and old_quantity.value:  # as uncertain as published, and the file's range is plausible
                limits, deviation = limits_of(path), learnable.factor * REACH_STD * stds[learnable.state] * old_quantity.value
                assert new_quantity.low <= max(new_quantity.value - abs(deviation), limits.low) + rounding
                assert new_quantity.high >= min(new_quantity.value + abs(deviation), limits.high) - rounding
                ends = sorted(
                    old_quantity.value * (1.0 + learnable.factor * end[learnable.state])
                    for end in (learner.prior.low, learner.prior.high)
                )
                assert (
                    ends[0] <= max(old_quantity.low, (1.0 + learnable.factor * (LEAST_FACTOR - 1.0)) * old_quantity.value) + 1e-9
                )
                assert ends[1] >= old_quantity.high - 1e-9
            if path != learnable.paths[0] and old_quantity.value:  # only scaled with the first: known no better than before
                limits, scale = limits_of(path), new_quantity.value / old_quantity.value
                assert new_quantity.low <= max(old_quantity.low * scale, limits.low) + rounding
                assert new_quantity.high >= min(old_quantity.high * scale, limits.high) - rounding
            acts_live = old_quantity.value * (1.0 + learnable.factor * departures[learnable.state])  # at last
            assert new_quantity.value == pytest.approx(acts_live, rel=1e-5)
            assert new_quantity.low <= new_quantity.value <= new_quantity.high
            assert new_quantity.high > new_quantity.low
            assert new_quantity == old_quantity or old_quantity.value


@pytest.mark.parametrize(("slowest", "fastest"), [(0.05, 0.78), (0.05, 0.4), (0.5, 0.78)])
def test_an_error_of_the_rise_is_in_the_stated_stds(slowest, fastest):
    """Coefficient and drag take up a rise that is off by one standard deviation of its range."""
    vehicle = tr.load_vehicle("bmw_i3")
    learner = Learner(Estimator(vehicle))
    random, rolling, noise = np.random.default_rng(7), (layout.OF_BEARING, layout.OF_DRAG), 5.0
    mean, covariance = np.zeros(STATES), learner.prior.covariance.copy()
    learner.learned.noise = noise**2
    for speed in random.uniform(slowest, fastest, 900) * vehicle.chassis.max_speed:
        of_rolling, of_drag, rise_torque = rise_torques(vehicle, np.array([speed]))[:, 0]
        sensitivities = np.zeros(STATES)
        sensitivities[list(rolling)] = of_rolling, of_drag
        residual = rise_torque + random.normal(0.0, noise)
        correct_estimate(mean, covariance, sensitivities, residual - mean @ sensitivities, noise**2, np.ones(STATES, dtype=bool))
        learner.buckets.count(speed, 20.0, vehicle.weight, 0.0)
    stds, own_stds = learner.stds(covariance, learner.own), np.sqrt(np.diag(covariance))
    for state in rolling:
        assert abs(mean[state]) == pytest.approx(np.sqrt(stds[state] ** 2 - own_stds[state] ** 2), rel=0.3)


def test_a_value_of_0_cannot_depart_by_a_share_of_itself():
    car, path = tr.load_vehicle("bmw_i3"), "road_load.drag_area"

    def prior(high):
        parameters = {**car.parameters, path: replace(car.parameters[path], value=0.0, low=0.0, high=high)}
        return make_prior(Estimator(replace(car, values={**car.values, "drag_area": 0.0}, parameters=parameters))).covariance

    assert np.array_equal(prior(0.5), prior(0.0))


def test_one_drive_against_learned_values_does_not_outweigh_all(reference):
    """After a pause they act by the evidence of all drives, and go on by that since then."""
    rng, state = np.random.default_rng(3), Learner(reference).learned

    def drive(gain, blocks):
        state.require_evidence()
        for block_gain in rng.normal(gain, 8.0, blocks):
            state.contest.add(block_gain)
            state.fresh.add(block_gain)
        return state.fresh.better

    assert drive(10.0, 60)
    assert drive(10.0, 30)
    assert not drive(-10.0, 15)
    state.require_evidence()
    assert state.fresh.better
    assert not any(drive(-10.0, 30) for _ in range(3))
    state.require_evidence()
    assert not state.fresh.better

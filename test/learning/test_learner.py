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
from trackres_ros.estimator import columns as at
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
    return road("watch", {at.OF_LOSS: 0.2}).drive(20.0)


@pytest.fixture(scope="module")
def driven_before(road):
    """A copy of a vehicle that has been driven for sixteen minutes, by mode and departure of its losses."""
    made = {}

    def given(mode, departure=0.1):
        key = mode, departure
        if key not in made:
            made[key] = road(mode, {at.OF_LOSS: departure}).drive(16.0)
        estimator = made[key].session.estimator
        return copy.deepcopy(made[key], {id(estimator): estimator})

    return given


def test_fifteen_minutes_suffice_to_learn_a_20_percent_error(learned):
    file, with_it = learned.errors(5.0)
    assert file > 0.08
    assert with_it < 0.02
    assert learned.learner.is_active
    assert learned.learner.has_evidence[at.OF_LOSS]


def test_on_and_watching_learn_the_same(learned, road):
    on = road("on", {at.OF_LOSS: 0.2}).drive(20.0)
    own = list(VEHICLES_OWN)
    assert on.learner.learned.mean[own] == pytest.approx(learned.learner.learned.mean[own], abs=2e-3)
    assert on.errors(5.0)[0] < 0.02


def test_in_reverse_it_learns_as_ahead(road):
    ahead, back = (
        road("on", {at.OF_LOSS: 0.2}).drive(1.0, speed=lambda t, way=way: way * (8.0 + 6.0 * math.sin(t / 10.0)), noise=0.0)
        for way in (1.0, -1.0)
    )
    assert back.learner.learned.seconds == ahead.learner.learned.seconds > 20.0
    alike = [*range(at.LEARNABLE), SLOW, STEP]  # against travel
    assert back.learner.learned.mean[alike] == pytest.approx(ahead.learner.learned.mean[alike], rel=1e-6, abs=1e-9)


def test_where_no_torque_is_measured_nothing_changes(road):
    driven = road("on", {at.OF_LOSS: 0.2}).drive(6.0, lambda _torque, _i: None)
    assert not driven.session.learned[: at.Learned.sensitivities.start].any()
    assert driven.learner.learned.seconds == 0.0


def test_a_file_that_is_right_stays_right(driven_before):
    driven = driven_before("on", 0.0)
    assert driven.errors(5.0)[1] < 0.01


def test_one_corner_is_not_the_whole(road):
    driven = road("on", {at.OF_LOSS: 0.2}).drive(3.0, speed=lambda _t: 6.0)
    assert not any(driven.learner.has_evidence[state] for state in VEHICLES_OWN)
    assert driven.session.learned[at.Learned.on] == 0.0


@pytest.mark.parametrize("share", [0.07, -0.07])
def test_another_sensor_is_a_step_and_not_the_rubber(driven_before, share):
    driven = driven_before("watch")
    before = driven.learner.learned.applied.copy()
    driven.drive(4.0, lambda torque, _i: (1.0 + share) * torque)
    assert any(text.startswith("a disturbance of") for text in driven.said)
    assert driven.learner.learned.applied[VEHICLES_OWN,] == pytest.approx(before[VEHICLES_OWN,], abs=0.03)
    frozen = driven.learner.learned.mean[VEHICLES_OWN,].copy()
    driven.drive(0.1, lambda torque, _i: (1.0 + share) * torque)
    assert driven.learner.freeze_reason
    assert driven.learner.learned.mean[VEHICLES_OWN,] == pytest.approx(frozen, abs=1e-12)


def test_a_pump_goes_as_it_came(driven_before):
    driven = driven_before("on")
    driven.drive(3.0, lambda torque, _i: torque + 300.0).drive(14.0)
    assert driven.errors(4.0)[1] < 0.025


@pytest.mark.parametrize(("gain", "words"), [(46.0, "46 Nm better"), (-8.0, "8 Nm worse")])
def test_the_status_says_if_used_values_fit_better_or_worse(driven_before, monkeypatch, gain, words):
    learner = driven_before("on").learner
    monkeypatch.setattr(learner.learned.fresh, "gain", gain)
    assert f", {words} than the vehicle file; used" in learner.text


def test_a_torque_from_outside_is_reported_while_it_lasts(driven_before):
    driven = driven_before("watch")
    assert driven.learner.disturbance == ""
    less_than_a_step = 0.025 * driven.learner.learned.rolling
    driven.drive(1.4, lambda torque, _i: torque + less_than_a_step)
    assert driven.learner.disturbance.startswith("a disturbance of +")
    assert driven.learner.disturbance in driven.learner.text
    before = driven.learner.disturbance
    parks = lambda t, begins=0.1 * driven.steps: max(8.0 + 6.0 * math.sin(begins / 60.0) - t + begins, 0.0)  # noqa: E731
    assert driven.drive(3.0, speed=parks).learner.disturbance in ("", before)  # a parked vehicle adds nothing
    driven.drive(10.0, speed=lambda t, begins=0.1 * driven.steps: 8.0 - 8.0 * math.cos((t - begins) / 60.0))
    assert driven.learner.disturbance == ""


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
            since = number - math.floor(number / 16.0 / math.pi) * math.pi * 16.0  # the torque crossed zero
            nm, seconds = re.match(r"a disturbance of ([+-]\d+) Nm for (\d+) s", learner.disturbance).groups()
            assert int(seconds) <= BLOCK_S * (since + 1.0)
            assert float(nm) * torque > 0.0 or since <= LATE
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
        past = learner.learned.past
        shares.append(past.slow / (past.slow + past.white))
    assert shares[0] < 0.2
    assert shares[1] > 0.5


def test_of_a_disturbance_no_more_is_fed_than_its_bound(driven_before):
    driven, watching = (driven_before(mode).drive(5.0, lambda torque, _i: torque + 400.0) for mode in ("on", "watch"))
    assert watching.rows[-1][1] + 200.0 < watching.rows[-1][2] == pytest.approx(driven.rows[-1][1], rel=0.003)
    state = driven.learner.learned
    assert state.mean[[SLOW, STEP]].sum() == pytest.approx(watching.learner.learned.mean[[SLOW, STEP]].sum(), rel=0.02)
    assert abs(state.lasting_nm) <= LASTING_SHARE * state.rolling * 1.01
    lasting = abs(state.lasting_nm)
    driven.drive(0.15, lambda _torque, _i: None)
    assert abs(driven.learner.learned.lasting_nm) < 0.05 * lasting + 0.1


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
    driven = driven_before("on")
    assert driven.learner.left_out == ""
    before, seconds = driven.learner.learned.applied.copy(), driven.learner.learned.seconds
    driven.drive(2.0, shown, noise=0.0)
    assert driven.learner.left_out.startswith(f"{words} in ")
    assert driven.learner.text.endswith(driven.learner.left_out)
    if "stuck" in words or "sign" in words:
        assert driven.learner.learned.seconds < seconds + 15.0
        assert driven.learner.learned.applied[VEHICLES_OWN,] == pytest.approx(before[VEHICLES_OWN,], abs=0.03)
    driven.drive(6.0)
    assert driven.learner.left_out == ""


def test_nothing_is_learned_from_a_doubtful_estimate(road):
    driven = road("watch").drive(0.05)
    gate, memory = driven.learner.gate, driven.session.memory
    now, speed = int(memory.times[at.SPEED, at.Times.last_arrival]), float(memory.values[at.SPEED])
    for reason in (at.Reason.NONE, *(one for one in at.REASON_TEXT if one & UNSURE)):
        now += 10**8
        row, before = driven.session.handle(at.SPEED, now, now, speed).row, gate.second.taken
        changed = [at.Results.measured_torque_nm, at.Results.residual_nm, at.Results.reasons]
        row[changed] = row[at.Results.drive_torque_nm], 0.0, reason
        gate.take(now, row.tolist(), driven.session)
        assert gate.second.taken - before == (not reason)


def test_a_yaw_rate_that_died_in_a_bend_stops_no_learning(road):
    driven = road("watch")
    driven.session.handle(at.YAW_RATE, 1, 1, 1.0)
    assert driven.drive(2.0).learner.learned.seconds > 90.0


def test_nothing_is_wrong_with_a_torque_while_it_stands(road):
    driven = road("watch").drive(2.0, lambda _torque, _i: 0.0, speed=lambda _t: 0.0, noise=0.0)
    assert driven.learner.left_out == ""


def test_outliers_freeze_it(road):
    driven = road("on", {at.OF_LOSS: 0.1})
    random = np.random.default_rng(5)
    driven.drive(10.0, lambda torque, _i: torque + (3000.0 if random.random() < 0.3 else 0.0))
    assert any("disagree" in text for text in driven.said)
    assert driven.errors(2.0)[1] < 1.02 * driven.errors(2.0)[0] + 0.02


def test_what_wanders_is_not_taken_for_the_vehicle(road):
    """Unknown hills of one in a hundred."""
    driven = road("on", {at.OF_LOSS: -0.05})
    driven.drive(25.0, lambda torque, i: torque + 980.0 * np.sin(2.0 * np.pi * i / 1500.0))
    file, with_it = driven.errors(10.0)
    assert with_it < file + 0.02


def test_nothing_leaves_the_ranges_of_the_file(road):
    driven = road("on").drive(15.0, lambda torque, _i: 3.0 * torque)
    learner = driven.learner
    assert (learner.learned.mean <= learner.prior.high).all()
    assert (learner.learned.mean >= learner.prior.low).all()
    assert (learner.learned.applied <= learner.prior.high[: at.LEARNABLE]).all()
    for state in VEHICLES_OWN:  # nor where none but this one is accepted
        alone = target_departures(learner.learned, learner.prior, np.arange(at.LEARNABLE) == state)[state]
        assert learner.prior.low[state] <= alone <= learner.prior.high[state]


def test_acting_values_are_as_uncertain_as_they_lag_and_wander(reference):
    s, learned = Learner(reference).learned, np.zeros(at.Learned.columns)
    s.mean[: at.LEARNABLE], s.applied[:] = 0.03, 0.01
    s.mean[STEP], s.lasting_nm, s.step_s, s.past.white = 90.0, 40.0, 1.0, (0.1 * s.rolling) ** 2
    apply_departures(s, True, learned, s.second, 0.0)
    factor = at.Learned(learned).factor.reshape(at.LEARNABLE, at.LEARNABLE)
    assert factor @ factor.T == pytest.approx(s.covariance[: at.LEARNABLE, : at.LEARNABLE] + 0.02**2, abs=1e-9)
    assert at.Learned(learned).slow ** 2 == pytest.approx(s.slow_std**2 + s.hills_variance + 50.0**2)
    assert min(s.slow_std, s.hills_variance) > 0.0


def test_a_value_at_its_bound_is_neither_learned_nor_written(driven_before, tmp_path):
    driven = driven_before("on")
    learner = driven.learner
    assert HELD not in learning_values(learner)
    learner.learned.mean[at.OF_LOSS] = learner.prior.high[at.OF_LOSS]
    refused = write_learned(learner, driven.session.estimator.vehicle, tmp_path / "v.yaml")
    assert (refused.written, refused.why_not) == ((), learner.text)
    assert learner.text.endswith("with an unknown error: loss_modulus_scale")
    assert HELD in learning_values(learner)


def test_time_off_makes_it_less_sure_and_forgets_what_wanders(learned):
    before, rises, most = learned.learner.learned, [], learned.learner.prior.covariance[at.OF_LOSS, at.OF_LOSS] ** 0.5
    for pieces, days in ((1, 10.0), (1, 30.0), (30, 1.0), (1, 1e4)):
        learner = copy.deepcopy(learned.learner)
        for _ in range(pieces):
            learner.age_values(days * 86400.0)
        after = learner.learned
        rises.append(after.covariance[at.OF_LOSS, at.OF_LOSS] ** 0.5 - before.covariance[at.OF_LOSS, at.OF_LOSS] ** 0.5)
        assert after.mean[SLOW] == 0.0
        assert after.mean[at.OF_LOSS] == before.mean[at.OF_LOSS]
        assert np.linalg.eigvalsh(after.covariance).min() > -1e-9 * after.covariance.max()
    assert rises[0] == pytest.approx(0.5 * most * 10.0 / 365.0)
    assert rises[1:3] == pytest.approx([3.0 * rises[0]] * 2)  # however the time is divided
    assert after.covariance[at.OF_LOSS, at.OF_LOSS] == pytest.approx(most**2)


@pytest.mark.parametrize("days", [300, -300])
def test_a_jump_of_the_clock_is_no_time_off_and_stops_nothing(driven_before, days):
    driven = driven_before("watch")
    before = driven.learner.learned.covariance[at.OF_LOSS, at.OF_LOSS]
    stuck = driven.drive(0.1, lambda _torque, _i: 2500.0, noise=0.0).learner.learned.seconds
    driven.ahead_ns = days * 86400 * 10**9
    seconds = driven.drive(0.1, lambda _torque, _i: 2500.0, noise=0.0).learner.learned.seconds
    assert seconds <= stuck + 3.0
    assert driven.drive(0.2).learner.learned.seconds >= seconds + 11.0
    now_ns = int(driven.session.memory.times[at.SPEED, at.Times.last_stamp])
    assert 0 <= now_ns // 10**9 - driven.learner.learned.second <= 1
    assert driven.learner.learned.covariance[at.OF_LOSS, at.OF_LOSS] <= before * 1.001


def test_belts_that_move_to_known_air_are_learned_anew(road):
    late = road("on").drive(0.01)
    for session, minutes in ((late.true, 15.0), (late.session, 2.0)):
        now = int(session.memory.times[at.SPEED, at.Times.last_arrival])
        session.handle(at.AMBIENT, now, now, -10.0)
        late.drive(minutes)
    assert late.errors(1.0)[0] < 0.03


def test_air_that_is_as_assumed_changes_nothing_learned(driven_before):
    driven = driven_before("on")
    before, now = driven.learner.learned.mean.copy(), int(driven.session.memory.times[at.SPEED, at.Times.last_arrival])
    driven.session.handle(at.AMBIENT, now, now, driven.session.motion[at.Motion.air])
    driven.drive(0.02)
    assert before[at.OF_BELT] != 0.0
    assert driven.learner.learned.mean == pytest.approx(before, rel=0.1)


def rest(driven, how):
    """Two hours, with the node off or on."""
    driven.steps += 72_000
    if how == "off":
        driven.learner.age_values(7200.0)


@pytest.mark.parametrize("how", ["off", "on"])
def test_a_vehicle_repaired_at_rest_has_its_file_in_a_minute(driven_before, how):
    driven = driven_before("on")
    rest(driven, how)
    at.Learned(driven.true.learned).departures[at.OF_LOSS] = 0.0
    assert driven.learner.is_active
    driven.drive(1.2)
    assert not driven.learner.is_active


@pytest.mark.parametrize("how", ["off", "on"])
def test_a_rest_alone_takes_nothing_learned_away(driven_before, how):
    driven = driven_before("on")
    rest(driven, how)
    driven.drive(3.0)
    assert driven.learner.is_active
    assert driven.errors(3.0)[1] < 0.01


@pytest.mark.parametrize("how", ["silent", "parked", "stopped", "frozen"])
def test_unrenewed_belt_departures_fade_but_not_the_vehicles(driven_before, how):
    driven = driven_before("on")
    s, begins_s = driven.learner.learned, 0.1 * driven.steps
    sensor, speed = (lambda torque, _i: torque), (lambda t: 8.0 + 6.0 * math.sin(t / 60.0))
    if how == "parked":
        speed = lambda t: max(8.0 + 6.0 * math.sin(begins_s / 60.0) - (t - begins_s), 0.0)  # noqa: E731
    elif how != "stopped":
        sensor = lambda torque, i: None if how == "silent" else torque * (3.0 if i % 3 == 0 else 1.0)  # noqa: E731
        driven.drive(1.0, sensor, speed)
    s.applied[at.OF_BELT], s.seconds = 10.0, 1.0
    s.aim[:] = s.applied
    before = s.applied.copy()
    driven.steps += 9000 if how == "stopped" else 0
    driven.drive(0.02 if how == "stopped" else 15.0, sensor, speed)
    assert bool(driven.learner.freeze_reason) is (how == "frozen")
    acting = at.Learned(driven.session.learned).departures
    assert acting[at.OF_BELT] == pytest.approx(10.0 * math.exp(-1.0), rel=0.05)
    assert np.delete(acting, at.OF_BELT) == pytest.approx(np.delete(before, at.OF_BELT), abs=1e-12)
    said = {name: dict(known)["acts"] == "true" for name, _, known in lines(driven.learner, learning_values(driven.learner))}
    assert said == {one.name: one.state in VEHICLES_OWN and before[one.state] != 0.0 for one in driven.learner.learnables}


class Sure(Learner):
    """A learner that accepts whatever it has of the vehicle."""

    is_active, is_at_bound = True, np.zeros(at.LEARNABLE, dtype=bool)

    @property
    def has_evidence(self):
        return np.isin(np.arange(at.LEARNABLE), self.own)


@pytest.fixture(scope="module", params=["xgd24d", "bmw_i3", "husky"])
def sure(request, tmp_path_factory):
    """A learner of each vehicle of a kind, by what its values are in the file."""
    folder, made = tmp_path_factory.mktemp("sure"), {}

    def by(end):
        if end not in made:
            described = tr.load_vehicle(request.param)
            document = open_document(described.source)
            if not isinstance(described, RoadVehicle):
                document.set(("rubber", "file"), str(described.rubber_source))
            paths = {path for one in learnables(described) for path in one.paths}
            for path in (path for path in paths if path.startswith(("chassis", "road_load"))):  # no belt burns
                limits = limits_of(path)
                low = 0.0 if path.endswith("rolling_rise") else limits.low  # from a coefficient of 0 it may not fall
                value = {"file": described.parameters[path].value, "low": low, "high": limits.high}[end]
                document.set((*path.split("."), "value"), value)
                document.set((*path.split("."), "range"), [limits.low, limits.high])
            (folder / f"{end}.yaml").write_text(document.text())
            vehicle = tr.load_vehicle(folder / f"{end}.yaml")
            made[end] = vehicle, Sure(Estimator(vehicle))
        return made[end]

    return by


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
    found = target_departures(s, learner.prior, learner.has_evidence)
    write_learned(learner, vehicle, file)
    written = tr.load_vehicle(file).parameters
    stds = learner.stds(s.covariance, learner.own)
    for one in learner.learnables:
        for path in one.paths:
            old, new = vehicle.parameters[path], written[path]
            rounding = 1e-5 * max(abs(new.value), abs(new.low), abs(new.high))  # a file has six figures of each
            if path == one.paths[0] and old.value:  # as uncertain as published, and the file's range is plausible
                limits, off = limits_of(path), one.factor * REACH_STD * stds[one.state] * old.value
                assert new.low <= max(new.value - abs(off), limits.low) + rounding
                assert new.high >= min(new.value + abs(off), limits.high) - rounding
                ends = sorted(old.value * (1.0 + one.factor * end[one.state]) for end in (learner.prior.low, learner.prior.high))
                assert ends[0] <= max(old.low, (1.0 + one.factor * (LEAST_FACTOR - 1.0)) * old.value) + 1e-9
                assert ends[1] >= old.high - 1e-9
            if path != one.paths[0] and old.value:  # only scaled with the first: known no better than before
                limits, scale = limits_of(path), new.value / old.value
                assert new.low <= max(old.low * scale, limits.low) + rounding
                assert new.high >= min(old.high * scale, limits.high) - rounding
            acts_live = old.value * (1.0 + one.factor * found[one.state])  # at last
            assert new.value == pytest.approx(acts_live, rel=1e-5)
            assert new.low <= new.value <= new.high
            assert new.high > new.low
            assert new == old or old.value


@pytest.mark.parametrize(("slowest", "fastest"), [(0.05, 0.78), (0.05, 0.4), (0.5, 0.78)])
def test_an_error_of_the_rise_is_in_the_stated_stds(slowest, fastest):
    """Coefficient and drag take up a rise that is off by one standard deviation of its range."""
    vehicle = tr.load_vehicle("bmw_i3")
    learner = Learner(Estimator(vehicle))
    random, rolling, noise = np.random.default_rng(7), (at.OF_BEARING, at.OF_DRAG), 5.0
    mean, covariance = np.zeros(STATES), learner.prior.covariance.copy()
    learner.learned.noise = noise**2
    for speed in random.uniform(slowest, fastest, 900) * vehicle.chassis.max_speed:
        of_rolling, of_drag, off = rise_torques(vehicle, np.array([speed]))[:, 0]
        looks = np.zeros(STATES)
        looks[list(rolling)] = of_rolling, of_drag
        measured = off + random.normal(0.0, noise)
        correct_estimate(mean, covariance, looks, measured - mean @ looks, noise**2, np.ones(STATES, dtype=bool))
        learner.buckets.count(speed, 20.0, vehicle.weight, 0.0)
    stated, known = learner.stds(covariance, learner.own), np.sqrt(np.diag(covariance))
    for state in rolling:
        assert abs(mean[state]) == pytest.approx(np.sqrt(stated[state] ** 2 - known[state] ** 2), rel=0.3)


def test_a_value_of_0_cannot_depart_by_a_share_of_itself():
    car, path = tr.load_vehicle("bmw_i3"), "road_load.drag_area"

    def prior(high):
        known = {**car.parameters, path: replace(car.parameters[path], value=0.0, low=0.0, high=high)}
        return make_prior(Estimator(replace(car, values={**car.values, "drag_area": 0.0}, parameters=known))).covariance

    assert np.array_equal(prior(0.5), prior(0.0))


def test_one_drive_against_learned_values_does_not_outweigh_all(reference):
    """After a pause they act by the evidence of all drives, and go on by that since then."""
    rng, state = np.random.default_rng(3), Learner(reference).learned

    def drive(gain, blocks):
        state.require_evidence()
        for one in rng.normal(gain, 8.0, blocks):
            state.contest.add(one)
            state.fresh.add(one)
        return state.fresh.better

    assert drive(10.0, 60)
    assert drive(10.0, 30)
    assert not drive(-10.0, 15)
    state.require_evidence()
    assert state.fresh.better
    assert not any(drive(-10.0, 30) for _ in range(3))
    state.require_evidence()
    assert not state.fresh.better

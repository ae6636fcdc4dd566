# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The smoothed speed: what it is off is what it says, whatever the sensor rounds, repeats, loses or shows at rest."""

import copy
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from trackres_ros.diagnosis import DiagnosisOptions, diagnose, read_recordings
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.prepare import resample as resample_module
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.sampling import means, sort_samples
from trackres_ros.diagnosis.prepare.speed_smoothing import (
    SmoothedSpeed,
    at_rest,
    noise_of_means,
    rounding_step,
    smooth_speed,
    without_repeats,
)
from trackres_ros.diagnosis.report.content import report
from trackres_ros.diagnosis.selection.locate import residual_sources
from trackres_ros.diagnosis.synthetic import STEP_S, TORQUE_NOISE_NM

GAP_S = 2.0


def driven(seconds, jerk, rng, rate=100.0):
    """Times, and a speed that white jerk drives, held back from leaving the speeds of a vehicle."""
    count = int(seconds * rate)
    sample_times, speed, accel = np.arange(count) / rate, np.empty(count), 0.0
    time_now = 8.0
    for i, kick in enumerate(rng.normal(0.0, jerk / np.sqrt(rate), count)):
        speed[i] = time_now
        accel += kick - (0.3 * accel + 0.03 * (time_now - 8.0)) / rate
        time_now += accel / rate
    return sample_times, speed


def standardised(smooth, true, times, at):
    """Errors of the changes over what they are said to be."""
    change = np.diff(smooth.speed) - np.diff(np.interp(times, at, true))
    known = smooth.change_std > 0.0
    return change[known] / smooth.change_std[known]


@pytest.mark.parametrize("jerk", [0.08, 0.2, 0.6])
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_the_stated_std_of_speed_changes_holds_for_white_noise(jerk, noise):
    rng = np.random.default_rng(1)
    place, true = driven(1800.0, jerk, rng)
    shown = true[::10] + rng.normal(0.0, noise, len(true[::10]))
    times = np.arange(0.0, 1799.0)
    smooth = smooth_speed(place[::10], shown, times, GAP_S)
    assert 0.85 < standardised(smooth, true, times, place).std() < 1.15
    assert smooth.noise == pytest.approx(noise, rel=0.1)
    assert smooth.jerk == pytest.approx(jerk, rel=0.3)
    raw = np.diff(np.interp(times, place[::10], shown)) - np.diff(np.interp(times, place, true))
    assert smooth.change_std.mean() < 0.75 * raw.std()


@pytest.mark.parametrize("slope", [0.0, 0.4, -0.4])
def test_a_constant_speed_and_a_ramp_are_not_bent(slope):
    rng = np.random.default_rng(2)
    sample_times = np.arange(0.0, 300.0, 0.1)
    true = (1.0 if slope >= 0.0 else 121.0) + slope * sample_times
    times = np.arange(0.0, 299.0)
    smooth = smooth_speed(sample_times, true + rng.normal(0.0, 0.02, len(sample_times)), times, GAP_S)
    assert np.diff(smooth.speed).mean() == pytest.approx(slope, abs=1e-3)
    assert standardised(smooth, true, times, sample_times).std() < 1.15
    assert np.abs(standardised(smooth, true, times, sample_times)).max() < 4.5
    assert smooth.change_std.max() < 0.02


@pytest.mark.parametrize("step", [0.0, 0.04])
def test_a_held_speed_shows_slow_variation_and_no_sensor_error(step):
    rng = np.random.default_rng(7)
    sample_times = np.arange(0.0, 720.0, 0.1)
    true = 6.0 * np.minimum(1.0, sample_times / 30.0) * (1.0 + 0.02 * np.sin(sample_times / 40.0))
    shown = true + rng.normal(0.0, 0.015, len(sample_times))
    times = np.arange(60.0, 719.0)
    smooth = smooth_speed(sample_times, np.round(shown / step) * step if step else shown, times, GAP_S)
    change = np.diff(np.interp(times, sample_times, true))
    assert (np.diff(smooth.speed) - change).std() < 0.3 * change.std()


@pytest.mark.parametrize(("step", "noise"), [(0.05, 0.01), (0.05, 0.0), (0.02, 0.005), (0.2, 0.02)])
@pytest.mark.parametrize("every", [1, 10])
def test_rounding_is_part_of_what_is_said(step, noise, every):
    rng = np.random.default_rng(3)
    place, true = driven(1200.0, 0.2, rng)
    shown = np.round((true + rng.normal(0.0, noise, len(true)))[::every] / step) * step
    times = np.arange(0.0, 1199.0)
    smooth = smooth_speed(place[::every], shown, times, GAP_S)
    assert smooth.step == pytest.approx(step)
    assert smooth.noise >= step / np.sqrt(12.0)
    assert smooth.jerk == pytest.approx(0.2, rel=0.3)
    assert 0.8 < standardised(smooth, true, times, place).std() < 1.55  # rounding is no white noise


def test_repeated_samples_of_a_slow_sensor_are_counted_once():
    rng = np.random.default_rng(4)
    place, true = driven(1200.0, 0.2, rng)
    shown = np.repeat((true + rng.normal(0.0, 0.02, len(true)))[::10], 10)
    assert without_repeats(shown).sum() == len(true) // 10
    times = np.arange(0.0, 1199.0)
    assert 0.8 < standardised(smooth_speed(place, shown, times, GAP_S), true, times, place).std() < 1.2


@pytest.mark.parametrize(("scale", "offset", "expected"), [(1.0, 0.0, 0.05), (1.0 / 3.6, 0.0, 0.05 / 3.6), (1.0, 0.013, 0.05)])
def test_what_a_sensor_rounds_to_is_found(scale, offset, expected):
    rng = np.random.default_rng(5)
    shown = (np.round(rng.normal(6.0, 2.0, 3000) / 0.05) * 0.05 + offset) * scale
    assert rounding_step(np.round(shown, 9)) == pytest.approx(expected, rel=1e-4)


def test_a_sensor_that_does_not_round_has_no_step():
    rng = np.random.default_rng(6)
    assert rounding_step(rng.normal(6.0, 2.0, 3000)) == 0.0
    assert rounding_step(np.full(3000, 5.0)) == 0.0
    assert rounding_step(rng.choice([1.0, 1.31, 2.0, 2.47, 3.9, 5.03], 3000)) == 0.0


def test_a_vehicle_at_rest_is_at_rest():
    rng = np.random.default_rng(7)
    sample_times = np.arange(0.0, 600.0, 0.1)
    true = np.maximum(0.0, 5.0 * np.sin(sample_times / 30.0))
    shown = np.where(true > 0.0, true + rng.normal(0.0, 0.02, len(sample_times)), 0.0)
    times = np.arange(0.0, 599.0)
    smooth = smooth_speed(sample_times, shown, times, GAP_S)
    still = at_rest(sample_times, shown)
    is_inside = (
        still[np.clip(np.searchsorted(sample_times, times), 0, len(sample_times) - 1)]
        & still[np.clip(np.searchsorted(sample_times, times) - 1, 0, None)]
    )
    assert is_inside.sum() > 200
    assert not smooth.speed[is_inside].any()
    pair = is_inside[1:] & is_inside[:-1]
    assert not np.diff(smooth.speed)[pair].any()
    assert not smooth.change_std[pair].any()
    is_moving = ~is_inside[1:] & ~is_inside[:-1]
    assert np.all(smooth.change_std[is_moving] > 0.0)
    assert np.abs(standardised(smooth, true, times, sample_times)).max() < 6.0


def test_a_vehicle_that_never_moves_has_nothing_to_smooth():
    assert smooth_speed(np.arange(0.0, 600.0, 0.1), np.zeros(6000), np.arange(0.0, 599.0), GAP_S) is None


def test_a_short_zero_is_a_sample_and_no_rest():
    sample_times = np.arange(0.0, 20.0, 0.1)
    shown = np.where((sample_times > 5.0) & (sample_times < 5.5), 0.0, 3.0)
    assert not at_rest(sample_times, shown).any()
    shown[100:115] = 0.0
    assert at_rest(sample_times, shown).sum() == 15


def test_no_acceleration_is_made_up_over_a_gap():
    rng = np.random.default_rng(8)
    sample_times = np.arange(0.0, 400.0, 0.1)
    true = 6.0 + 3.0 * np.sin(sample_times / 15.0)
    keep = (sample_times < 150.0) | (sample_times > 180.0)
    times = np.arange(0.0, 399.0)
    smooth = smooth_speed(sample_times[keep], (true + rng.normal(0.0, 0.02, len(sample_times)))[keep], times, GAP_S)
    is_inside = (times > 151.0) & (times < 179.0)
    change = np.diff(smooth.speed[is_inside])
    assert np.ptp(change) < 1e-9  # a straight line
    assert np.isnan(smooth.change_std[is_inside[:-1]]).all()
    is_outside = (times[:-1] < 149.0) | (times[:-1] > 181.0)
    assert np.all(smooth.change_std[is_outside] > 0.0)
    error = smooth.speed - np.interp(times, sample_times, true)
    assert np.abs(error[(times < 149.0) | (times > 181.0)]).max() < 0.05


def test_samples_that_are_lost_do_not_pull_the_rest():
    rng = np.random.default_rng(9)
    place, true = driven(900.0, 0.15, rng, 10.0)
    shown = true + rng.normal(0.0, 0.02, len(place))
    times = np.arange(0.0, 899.0)
    total = smooth_speed(place, shown, times, GAP_S)
    lost = np.where(rng.random(len(place)) < 0.003, 0.0, shown)
    assert (lost != shown).sum() > 10
    torn = smooth_speed(place, lost, times, GAP_S)
    assert torn.noise < 1.3 * total.noise
    assert np.std(np.diff(torn.speed) - np.diff(total.speed)) < 0.5 * np.sqrt(np.mean(total.change_std**2))


def test_irregular_stamps_are_as_good_as_even_ones():
    rng = np.random.default_rng(10)
    place, true = driven(1200.0, 0.2, rng)
    some = np.sort(rng.choice(len(place), len(place) // 10, replace=False))
    times = np.arange(1.0, 1199.0)
    smooth = smooth_speed(place[some], true[some] + rng.normal(0.0, 0.02, len(some)), times, GAP_S)
    assert 0.85 < standardised(smooth, true, times, place).std() < 1.15


def test_braking_and_starting_are_not_eased():
    """A vehicle that brakes and starts within a second: what changes in a step stays in it."""
    rng = np.random.default_rng(11)
    corners = np.cumsum([0.0, *rng.uniform(5.0, 20.0, 80)])
    speeds = rng.uniform(2.0, 12.0, len(corners))
    ramps = [(t, v) for (t, v), (nxt, _) in pairwise(zip(corners, speeds, strict=True)) for t, v in ((t, v), (nxt - 4.0, v))]
    sample_times = np.arange(0.0, corners[-2], 0.1)
    true = np.interp(sample_times, *np.array(ramps).T)
    times = np.arange(0.0, sample_times[-1])
    smooth = smooth_speed(sample_times, np.round((true + rng.normal(0.0, 0.01, len(sample_times))) / 0.05) * 0.05, times, GAP_S)
    change, real = np.diff(smooth.speed), np.diff(np.interp(times, sample_times, true))
    assert np.polyfit(change, real, 1)[0] == pytest.approx(1.0, abs=0.01)
    assert np.polyfit(real, change, 1)[0] == pytest.approx(1.0, abs=0.02)
    assert (change - real).std() < 1.3 * np.sqrt(np.mean(smooth.change_std**2))


@pytest.mark.parametrize("rate", [5.0, 10.0, 100.0])
@pytest.mark.parametrize("step", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("brakes_s", [2.0, 10.0])
def test_a_braking_after_a_smooth_drive_is_followed(rate, step, brakes_s):
    sample_times = np.arange(0.0, 600.0, 1.0 / rate)
    true = (6.0 + 2.0 * np.sin(sample_times / 41.0)) * np.clip((sample_times[-1] - sample_times) / brakes_s, 0.0, 1.0)
    times = np.arange(0.0, 599.5)
    smooth = smooth_speed(sample_times, np.round(true / step) * step if step else true, times, GAP_S)
    error = np.abs(smooth.speed - np.interp(times, sample_times, true))
    assert error.max() < 0.35  # at the corner; a speed that is rounded at 100 Hz stays the same for seconds
    assert error[:-15].max() < max(0.02, 2.0 * step)


@pytest.mark.parametrize("lasts_s", [0.4, 3.0, 30.0])
def test_a_level_no_vehicle_reaches_is_followed_if_it_stays(lasts_s):
    rng = np.random.default_rng(16)
    sample_times = np.arange(0.0, 900.0, 0.1)
    true = 6.0 + 2.0 * np.sin(sample_times / 41.0)
    wrong = (sample_times > 400.0) & (sample_times <= 400.0 + lasts_s)
    times = np.arange(0.0, 899.0)
    smooth = smooth_speed(
        sample_times, np.where(wrong, 0.3 * true, true) + rng.normal(0.0, 0.01, len(sample_times)), times, GAP_S
    )
    stays = (times > 400.0) & (times <= 400.0 + lasts_s) & (lasts_s > 5.0)
    error = np.abs(smooth.speed - np.where(stays, 0.3, 1.0) * np.interp(times, sample_times, true))
    jumps = np.minimum(np.abs(times - 400.0), np.abs(times - 400.0 - lasts_s)) < 3.0
    assert error[~jumps | (lasts_s < 5.0)].max() < 0.2


def test_slow_and_few_samples_are_left_as_they_are():
    sample_times = np.arange(0.0, 600.0, 0.5)
    assert smooth_speed(sample_times, np.sin(sample_times / 20.0) + 5.0, np.arange(0.0, 599.0), GAP_S) is None
    assert smooth_speed(sample_times[:50] / 10.0, np.ones(50), np.arange(0.0, 2.0), GAP_S) is None


def test_an_hour_at_100_hz_takes_a_fraction_of_a_second():
    import time

    rng = np.random.default_rng(12)
    sample_times = np.arange(0.0, 3600.0, 0.01)
    shown = np.round((8.0 + 5.0 * np.sin(sample_times / 40.0) + rng.normal(0.0, 0.01, len(sample_times))) / 0.05) * 0.05
    times = np.arange(0.0, 3599.0)
    smooth_speed(sample_times[:2000], shown[:2000], times[:19], GAP_S)  # compiled
    begin = time.process_time()
    smooth_speed(sample_times, shown, times, GAP_S)
    assert time.process_time() - begin < 1.5


# Through the gate and the diagnosis


def coarse(recording, step=0.05, seed=13):
    """A recording of which no acceleration is known, its speed rounded."""
    series = {role: s for role, s in recording.series.items() if role != "accel"}
    noise = np.random.default_rng(seed).normal(0.0, 0.01, len(series["speed"].value))  # beside what is in it
    shown = np.round((series["speed"].value + noise) / step) * step
    return replace(recording, series={**series, "speed": replace(series["speed"], value=shown)})


def unsmoothed(at, shown, times, _):
    change = np.zeros(len(times) - 1)
    return SmoothedSpeed(np.interp(times, at, shown), np.zeros(len(times)), change, 1.0, 0.0, 0.0)


def test_the_order_of_a_recordings_parts_changes_nothing(recorded, loaded):
    (recording, *_) = read_recordings(recorded(), None)
    recording = coarse(recording)
    rng, shuffled = np.random.default_rng(14), {}
    for role, series in recording.series.items():
        pieces = np.array_split(np.arange(len(series.value)), 20)
        order = np.concatenate([pieces[i] for i in rng.permutation(20)])
        shuffled[role] = replace(series, stamp_ns=series.stamp_ns[order], value=series.value[order])
    item = gate([recording], loaded.known).sessions[0]
    several = (Path("1.mcap"), Path("2.mcap"))  # bags that are given in another order
    other = gate([replace(recording, series=shuffled, paths=several)], loaded.known).sessions[0]
    assert np.array_equal(item.accel, other.accel)
    assert item.accel_noise == other.accel_noise > 0.0


def test_a_recorded_acceleration_stays_what_it_is(recorded, loaded):
    (recording, *_) = read_recordings(recorded(), None)
    session = gate([recording], loaded.known).sessions[0]
    assert session.accel_noise == 0.0
    mean, there = means(
        *sort_samples(recording.series["accel"], recording.start_ns), np.append(session.time, session.time[-1] + 1.0)
    )
    np.testing.assert_array_equal(session.accel[there], mean[there])


@pytest.mark.parametrize(
    ("name", "parameter"), [("rotating_inertia", "factor"), ("torque_gain", "error"), ("drivetrain_efficiency", "efficiency")]
)
def test_what_looks_like_an_inertia_is_found_at_its_true_size(name, parameter, recorded, loaded, effects):
    """What a smoothed speed is off does not vary with what it is said to be, so it takes nothing off a slope."""
    recordings = [coarse(r) for r in read_recordings(recorded(name), None)]
    sessions = gate(recordings, loaded.known).sessions
    result = fit(Problem(loaded.base, sessions, tuple(s.used for s in sessions)), [effects[name]])
    true = effects[name].values()[parameter]
    assert result.effects[0].values[parameter] == pytest.approx(true, abs=max(0.006, 3.5 * result.std_of(name, parameter)))


def test_the_residual_of_a_coarse_speed_falls(recorded, loaded, check_form, monkeypatch):
    recordings = [coarse(r) for r in read_recordings(recorded(), None)]

    def left(sessions, predicted):
        return np.concatenate([(s.torque - p.torque)[s.used] for s, p in zip(sessions, predicted, strict=True)]).std()

    result = diagnose(recordings, loaded, DiagnosisOptions(quick=True))
    smooth = left(result.gated.sessions, result.refitted.predicted)
    monkeypatch.setattr(resample_module, "smooth_speed", unsmoothed)
    sessions = gate(recordings, loaded.known).sessions
    rough = left(sessions, fit(Problem(loaded.base, sessions, tuple(s.used for s in sessions))).predicted)
    assert smooth < 0.6 * rough
    assert not result.found
    text = report(result, [Path("drive.csv")])
    check_form(json.loads(json.dumps(text)))
    assert text["residual_sources"]["total"] == pytest.approx(smooth, rel=0.2)
    assert text["residual_sources"]["speed_sensor"] > 0.3 * smooth


@pytest.mark.parametrize("rate", [5.0, 50.0])
@pytest.mark.parametrize("repeats", [1, 4])
def test_noise_of_a_mean_is_that_of_its_samples(rate, repeats):
    rng = np.random.default_rng(15)
    own = np.arange(0.0, 600.0, 1.0 / rate)
    value = np.repeat(2000.0 + 500.0 * np.sin(own / 20.0) + rng.normal(0.0, 40.0, len(own)), repeats)
    sample_times = np.arange(len(value)) / (rate * repeats)
    assert noise_of_means(sample_times, value, 1.0) == pytest.approx(40.0 / np.sqrt(rate), rel=0.05)


def test_noise_of_slow_samples_cannot_be_told():
    sample_times = np.arange(0.0, 600.0, 0.5)
    assert noise_of_means(sample_times, np.random.default_rng(16).normal(0.0, 40.0, len(sample_times)), 1.0) == 0.0


def test_what_is_left_is_split_by_where_it_comes_from(recorded, loaded):
    recordings = [coarse(r) for r in read_recordings(recorded(), None)]
    sessions = gate(recordings, loaded.known).sessions
    result = fit(Problem(loaded.base, sessions, tuple(s.used for s in sessions)))
    sources = residual_sources(result)
    assert sources.torque_sensor == pytest.approx(TORQUE_NOISE_NM / np.sqrt(1.0 / STEP_S), rel=0.15)
    (of_a_gear := copy.copy(loaded.base)).torque_scale = 0.3  # the torques of sessions are at the wheels already
    assert residual_sources(replace(result, problem=replace(result.problem, base=of_a_gear))) == sources
    known = sources.torque_sensor**2 + sources.speed_sensor**2
    assert sources.model == pytest.approx(np.sqrt(max(sources.total**2 - known, 0.0)))
    assert sources.model < 0.6 * sources.total  # the recordings are made by the model that is fitted


def test_what_cannot_be_told_is_not_said(recorded, loaded):
    sessions = gate(read_recordings(recorded(), None), loaded.known).sessions
    result = fit(Problem(loaded.base, sessions, tuple(s.used for s in sessions)))
    sources = residual_sources(result)
    assert sources.speed_sensor is None  # the acceleration was recorded
    assert sources.torque_sensor > 0.0
    assert "the speed sensor an unknown part" in sources.text
    loud = replace(result.problem, sessions=tuple(replace(s, torque_noise=1e5) for s in sessions))
    assert residual_sources(replace(result, problem=loud)).model == 0.0

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A missing yaw rate is computed from heading, wheel speeds or positions, and equals that of the drive."""

import numpy as np
import pytest
from csv_tables import written

from trackres_ros.diagnosis import read_recordings
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.resample import turn_rates
from trackres_ros.diagnosis.prepare.session import GateSettings
from trackres_ros.recording.samples import Series
from trackres_ros.units import EARTH_M

STEP_S, RATE_HZ = 1.0, 10.0
WIDTH_M = 1.5


def drive(seconds=300.0, noise_m=0.0, seed=1):
    """Times, speed, yaw rate, heading and positions of a drive with bends and a stop."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    speed = 8.0 + 2.0 * np.sin(time / 23.0)
    speed[(time > 100.0) & (time < 120.0)] = 0.0
    yaw = np.where(speed > 0.0, 0.15 * np.sin(time / 11.0) + 0.05, 0.0)
    heading = np.cumsum(yaw) / RATE_HZ
    x, y = (np.cumsum(speed * f(heading)) / RATE_HZ + rng.normal(0.0, noise_m, len(time)) for f in (np.cos, np.sin))
    return time, speed, yaw, heading, x, y


def series(time, value):
    stamps = (time * 1e9).astype(np.int64)
    return Series(stamps, stamps, np.asarray(value, dtype=float))


def made(time, speed, yaw, of, width=None):
    """Values computed from series, and the true means over steps."""
    edges = np.arange(0.0, time[-1], STEP_S)
    over = [np.diff(np.interp(edges, time, np.concatenate(([0.0], np.cumsum(z[:-1])))) / RATE_HZ) / STEP_S for z in (speed, yaw)]
    return turn_rates({role: series(time, z) for role, z in of.items()}, 0, edges, over[0], 0.3, width), over[1], over[0]


def wheels(speed, yaw):
    return {"wheel_speed/front_left": speed - 0.5 * WIDTH_M * yaw, "wheel_speed/front_right": speed + 0.5 * WIDTH_M * yaw}


def test_a_heading_that_jumps_at_pi_gives_the_yaw_rate():
    time, speed, yaw, heading, *_ = drive()
    result, true, _ = made(time, speed, yaw, {"heading": np.angle(np.exp(1j * heading))})
    assert result.made_of == "heading"
    known = np.isfinite(result.yaw_rate)
    assert known.mean() > 0.98
    np.testing.assert_allclose(result.yaw_rate[known], true[known], atol=0.012)


def test_wheel_speeds_give_it_where_the_track_width_is_known():
    time, speed, yaw, *_ = drive()
    result, true, _ = made(time, speed, yaw, wheels(speed, yaw), WIDTH_M)
    np.testing.assert_allclose(result.yaw_rate, true, atol=0.012)
    assert made(time, speed, yaw, wheels(speed, yaw))[0] is None


def test_positions_give_it_where_the_vehicle_moves():
    time, speed, yaw, _, x, y = drive(noise_m=0.02)
    positions = {"latitude": 0.8 + y / EARTH_M, "longitude": 0.2 + x / EARTH_M / np.cos(0.8)}
    result, true, over = made(time, speed, yaw, positions)
    known = np.isfinite(result.yaw_rate)
    assert 0.8 < known.mean() < 0.97
    assert not known[over < 0.1].any()
    assert np.sqrt(np.mean((result.yaw_rate - true)[known] ** 2)) < 0.02


def test_positions_that_scatter_too_much_give_none():
    time, speed, yaw, _, x, y = drive(noise_m=8.0)
    assert made(time, speed, yaw, {"latitude": y / EARTH_M, "longitude": x / EARTH_M})[0] is None


def test_a_heading_with_gaps_is_not_known_in_them():
    time, speed, yaw, heading, *_ = drive()
    distance = (time > 50.0) & (time < 60.0)
    result, *_ = made(time, speed, yaw, {"heading": np.where(distance, np.nan, heading)})
    assert np.isnan(result.yaw_rate[51:59]).all()
    assert np.isfinite(result.yaw_rate[:49]).all()


@pytest.mark.parametrize("recorded", [True, False])
def test_the_gate_makes_one_only_where_none_was_recorded(tmp_path, recorded):
    time, speed, yaw, heading, *_ = drive()
    columns = {"time_s": time, "speed_mps": speed, "torque_nm": 20.0 + 100.0 * np.gradient(speed, time), "heading_rad": heading}
    columns |= {"yaw_rate_radps": 2.0 * yaw} if recorded else {}
    gate_result = gate(read_recordings([written(tmp_path / "drive.csv", columns)], None), GateSettings(700.0, 20.0, 15.0, False))
    (session,) = gate_result.sessions
    texts = [note for note in gate_result.notes if "the yaw rate is computed from heading" in note]
    assert len(texts) == (0 if recorded else 1)
    assert session.computed == {"accel", *([] if recorded else ["yaw_rate"])}
    expectation = np.interp(session.time + 0.5, time, yaw) * (2.0 if recorded else 1.0)
    assert np.abs(session.yaw_rate - expectation)[1:-1].max() < 0.02 * (2.0 if recorded else 1.0)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a recording has beside speed and torque reaches the session: position, passengers, brakes."""

import numpy as np
import pytest
from csv_tables import written

import trackres_ros as tr
from trackres_ros.diagnosis.base.loading import load_base
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.session import GateSettings
from trackres_ros.units import GRAVITY

EMPTY_KG, SECONDS, RATE_HZ = 19000.0, 600, 5


def drive(folder, **columns):
    """A table of stop and go, with what else is given once in a second."""
    time = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    speed = np.clip(8.0 * np.sin(2.0 * np.pi * time / 60.0), 0.0, None)
    torque = 0.47 * (EMPTY_KG * np.gradient(speed, time) + 1500.0)
    table = {"time_s": time, "speed_mps": speed, "torque_nm": torque}
    for name, values in columns.items():
        table[name] = np.full(len(time), np.nan)
        table[name][::RATE_HZ] = values
    return written(folder / "drive.csv", table, "%.17g")


def gated(folder, topics=None, friction_brakes=True, hide=(), axles=(), **columns):
    known = GateSettings(EMPTY_KG * GRAVITY, 20.0, 15.0, friction_brakes, axles=dict(axles))
    return gate([tr.read(drive(folder, **columns), topics=topics)], known, hide)


def test_position_altitude_and_steering_exist_where_measured(tmp_path):
    time = np.arange(float(SECONDS))
    tunnel = (time > 100) & (time < 150)
    latitude = np.where(tunnel, np.nan, 47.0 + 1e-5 * time)
    longitude = np.where(tunnel, np.nan, 180.0 - 1e-5 * (time - 300.0))
    longitude = np.where(longitude > 180.0, longitude - 360.0, longitude)
    position, flat = {"latitude_deg": latitude, "longitude_deg": longitude}, 400.0 + 0.0 * time
    result = gated(tmp_path, **position, altitude_m=flat, steering_angle_rad=0.1 + 0.0 * time)
    (session,) = result.sessions
    middle = session.time + 0.5
    known = np.isfinite(session.latitude)
    assert not known[102:148].any()
    assert known[:99].all()
    assert known[152:].all()
    np.testing.assert_allclose(session.latitude[known], np.radians(47.0 + 1e-5 * middle[known]), atol=1e-12)
    assert np.abs(session.longitude[known]).min() > np.radians(179.9)  # nothing lies on the far side of the date line
    np.testing.assert_allclose(session.altitude, 400.0)
    np.testing.assert_allclose(session.steering_angle, 0.1)
    assert {"position", "altitude", "steering_angle"} <= session.given
    assert "grade" not in session.given  # a flat altitude says nothing that its error does not
    hidden = gated(tmp_path, hide=("latitude",), **position).sessions[0]
    assert "position" not in hidden.given
    assert np.isnan(hidden.longitude).all()


def test_passengers_are_carried_on_and_weigh(tmp_path):
    count = np.full(SECONDS, np.nan)
    count[[100, 300]] = 10.0, 40.0
    topics = {"passengers": {"column": "passengers"}}
    result = gated(tmp_path, topics, passengers=count)
    (session,) = result.sessions
    assert np.isnan(session.passengers[:99]).all()
    assert (session.passengers[101:299] == 10.0).all()
    assert (session.passengers[301:] == 40.0).all()
    np.testing.assert_allclose(session.payload, np.nan_to_num(session.passengers) * 70.0 * GRAVITY)
    np.testing.assert_allclose(session.weight, EMPTY_KG * GRAVITY + session.payload)
    assert any("empty until the first count, 100 s" in note for note in result.notes)
    loaded = gated(tmp_path, passengers=count, weight_n=np.full(SECONDS, 200e3)).sessions[0]
    np.testing.assert_allclose(loaded.weight, 200e3)
    assert not loaded.payload.any()
    axles = {name: {name: share * EMPTY_KG * GRAVITY} for name, share in (("front", 0.3), ("rear", 0.7))}
    rear = {"weight_n/rear": np.full(SECONDS, 150e3)}
    partly = gated(tmp_path, passengers=count, axles=axles, **rear).sessions[0]
    np.testing.assert_allclose(partly.weight, 150e3 + 0.3 * session.weight)


@pytest.mark.parametrize("of", ["front", "front rear", "front_left", "front rear_left", "front front_left", "left right"])
def test_loads_of_parts_weigh_what_they_weigh_in_a_replay(tmp_path, of):
    loads = {"front": 200e3, "rear": 100e3, "front_left": 50e3, "rear_left": 90e3, "left": 120e3, "right": 130e3}
    path = drive(tmp_path, **{f"weight_n/{part}": np.full(SECONDS, loads[part]) for part in of.split()})
    sides = {f"load/{side}": {"column": f"weight_n/{side}"} for side in ("left", "right")}
    topics = sides if of == "left right" else None
    weight = gate([tr.read(path, topics=topics)], load_base("xgd24d").known).sessions[0].weight
    expectation = 250e3 if topics else tr.replay(path, "xgd24d")["weight_n"][0]
    np.testing.assert_allclose(weight, expectation)


def test_mass_and_passengers_are_one_weight_in_the_base(tmp_path):
    road = load_base("ztbus_hess19")
    path = drive(tmp_path, passengers=np.full(SECONDS, 50.0))
    session = gate([tr.read(path)], road.known).sessions[0]
    mass = road.base.vehicle.values["mass"]
    lighter = gate([tr.read(path)], road.known, ("passengers",)).sessions[0]
    loaded = road.base.predict([session], {}, ())[0].torque
    as_mass = road.base.predict([lighter], {"mass": mass + 50.0 * 70.0}, ())[0].torque
    # The torque around 0 over which the gears' efficiency changes its direction is a share of the mass in the file.
    np.testing.assert_allclose(loaded, as_mass, rtol=1e-9, atol=1e-6 * np.abs(as_mass).max())


def test_a_recorded_brake_excludes_only_the_times_it_is_on(tmp_path):
    pressure = np.zeros(SECONDS)
    pressure[20:25] = 2e5
    pressure[200] = 500.0  # none at all
    result = gated(tmp_path, brake_pa=pressure)
    (session,) = result.sessions
    assert not session.used[19:25].any()
    assert session.used[25]
    assert session.used[200]
    assert result.exclusions["brakes on"] == 6
    assert "may brake" not in result.exclusions
    assert (session.torque[session.used] < 0.0).any()
    assert any("brakes on in 6 s of" in note for note in result.notes)
    unknown = gated(tmp_path)
    assert unknown.exclusions["may brake"] > 100


@pytest.mark.parametrize(("column", "topics"), [("brake_on", None), ("valve", {"brake": {"column": "valve", "threshold": 3.0}})])
def test_a_switch_and_a_threshold_do_as_well(tmp_path, column, topics):
    value = np.zeros(SECONDS)
    value[20:25] = 1.0 if column == "brake_on" else 3.0
    value[100] = 0.0 if column == "brake_on" else 2.9
    assert gated(tmp_path, topics, **{column: value}).exclusions["brakes on"] == 6

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the rubber data end, where a belt settles, and that forward and reverse are one."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.effects import Active, catalogue
from trackres_ros.errors import InputError
from trackres_ros.estimator.columns import Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.resources import config_dir, shipped_road_vehicles, shipped_vehicles
from trackres_ros.model.coverage import (
    DESTROYED_DEGC,
    OVERSPEED,
    balance_degc,
    beyond_data,
    beyond_loads,
    check_heat,
    check_speed,
    coverage,
)
from trackres_ros.model.loss_table import loss_table, reverse_share
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.track import load_range, track_model, with_methods
from trackres_ros.vehicle import load, load_any


def cut(vehicle, low, high):
    """The same vehicle with a sweep that begins and ends elsewhere."""
    rubber = vehicle.rubber
    is_inside = (rubber.sweep_degc >= low) & (rubber.sweep_degc <= high)
    parts = (rubber.sweep_degc[is_inside], rubber.storage_pa[is_inside], rubber.loss_pa[is_inside])
    return replace(vehicle, rubber=replace(rubber, sweep_degc=parts[0], storage_pa=parts[1], loss_pa=parts[2]))


@settings(max_examples=12)
@given(low=st.sampled_from([-60, -40, -20, 0, 20]), share=st.floats(0.02, 1.0), factor=st.floats(1.02, 3.0))
def test_colder_or_faster_than_the_data_leaves_the_sweep(xgd24d, low, share, factor):
    vehicle = cut(xgd24d, low, 120)
    name, speed = next(iter(vehicle.tracks)), share * xgd24d.chassis.max_speed
    rubber, model, load_n = RubberModel(vehicle.rubber), track_model(vehicle, name), load_range(vehicle, name).nominal
    end_degc = coverage(vehicle, name).coldest(rubber, speed)

    def equivalent(v):
        frequency = model.loss.contacts(v, end_degc, load_n).frequency.mean()
        return float(rubber.equivalent_temperature(rubber.reduced_frequency(frequency, end_degc)))

    assert equivalent(speed / factor) > low  # slower it is within the sweep
    assert equivalent(speed * factor) == pytest.approx(low)  # faster it is held at the end


def test_a_longer_sweep_covers_more(xgd24d):
    rubber, name = RubberModel(xgd24d.rubber), next(iter(xgd24d.tracks))
    ends = [coverage(cut(xgd24d, low, 100), name).coldest(rubber, 10.0) for low in (-40, -20, 0, 20)]
    assert ends == sorted(ends)
    assert [coverage(cut(xgd24d, -90, high), name).hottest for high in (20, 60, 100)] == [20, 60, 100]


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The reference vehicle with a sweep from 0 to 60 degC."""
    folder = tmp_path_factory.mktemp("short")
    (folder / "rubber").mkdir()
    header, *rows = (config_dir() / "rubber" / "nr_sbr_10hz.csv").read_text(encoding="utf-8").splitlines()
    inner_rows = [row for row in rows if 0 <= float(row.split(",")[0]) <= 60]
    (folder / "rubber" / "nr_sbr_10hz.csv").write_text("\n".join([header, *inner_rows]), encoding="utf-8")
    (folder / "mine.yaml").write_text((config_dir() / "xgd24d.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    return folder / "mine.yaml"


@pytest.fixture(scope="module")
def short_estimator(short):
    return Estimator(load(short))


@settings(max_examples=60)
@given(speed=st.floats(-16.0, 16.0), belt=st.floats(-50.0, 110.0))
def test_the_status_says_where_the_data_end(short_estimator, speed, belt):
    vehicle = short_estimator.vehicle
    limits, rubber = coverage(vehicle, "triangular"), RubberModel(vehicle.rubber)
    inputs = short_estimator.inputs(speed, ambient=15.0)
    _, estimate = short_estimator.step(short_estimator.cold_start(inputs, belt), inputs, 0.0)
    end_degc = limits.coldest(rubber, max(abs(speed), 1e-6))
    if abs(belt - end_degc) < 0.01 or abs(belt - limits.hottest) < 0.01:
        return
    assert bool(estimate.reasons & Reason.OUTSIDE_TABLE) == (belt < end_degc or belt > limits.hottest)


def test_shipped_vehicles_stay_in_their_data_from_minus_50_degc(reference, carrier):
    for estimator in (reference, carrier):
        max_speed = estimator.vehicle.chassis.max_speed
        name = next(iter(estimator.vehicle.tracks))
        balance = balance_degc(estimator.vehicle, name, loss_table(estimator.vehicle, name), max_speed, 45.0)
        for speed in (0.0, 0.3 * max_speed, max_speed):
            for belt in (-50.0, 0.0, balance):
                inputs = estimator.inputs(speed, ambient=15.0)
                _, estimate = estimator.step(estimator.cold_start(inputs, belt), inputs, 0.0)
                assert not estimate.reasons & Reason.OUTSIDE_TABLE


def parted(vehicle, thermal, resistance):
    """The same vehicle with a thermal model and the effect `core_surface` [K/W]."""
    effect = Active(catalogue()["core_surface"], {"resistance": resistance})
    return replace(with_methods(vehicle, thermal=thermal), effects=(effect,))


@pytest.mark.parametrize(("thermal", "resistance"), [("lumped", 0.0), ("lumped", 0.004), ("core_surface", 0.0)])
def test_the_balance_is_where_a_long_drive_ends(xgd24d, thermal, resistance):
    vehicle = parted(xgd24d, thermal, resistance)
    estimator = Estimator(vehicle)
    speed = vehicle.chassis.max_speed
    inputs = estimator.inputs(speed, ambient=vehicle.chassis.ambient, acceleration=0.0)
    times = np.arange(0.0, 30_000.0, 5.0)
    _, rows = estimator.run(estimator.cold_start(inputs), times, np.full(len(times), speed), vehicle.weight, 15.0)
    belt = rows[-1, estimator.column_index["belt_degc/front_left"]]
    assert belt == pytest.approx(balance_degc(vehicle, "triangular", loss_table(vehicle, "triangular"), speed, 15.0), abs=0.2)


def changed(tmp_path, change):
    content = yaml.safe_load((config_dir() / "xgd24d.yaml").read_text(encoding="utf-8"))
    for path, value in change.items():
        section = content
        for key in path.split("."):
            section = section[key]
        section.update(value=value, range=[min(value, section["range"][0]), max(value, section["range"][1])])
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return tmp_path / "mine.yaml"


def test_a_fitted_resistance_in_a_belt_refuses_no_vehicle():
    vehicle = parted(load("xgd24d", {"chassis.ambient": 45.0}), "core_surface", 0.01)
    assert check_heat(vehicle, "triangular", loss_table(vehicle, "triangular")) > DESTROYED_DEGC


BURNS = {
    "tracks.triangular.belt.film_offset": 0.5,
    "tracks.triangular.belt.film_slope": 0.01,
    "rubber.loss_modulus_scale": 10.0,
}


def test_a_vehicle_that_overheats_is_refused_with_temperature(tmp_path, trackres):
    path = changed(tmp_path, BURNS)
    vehicle = load(path)
    with pytest.raises(InputError, match=r"settles at \d+ degC"):
        check_heat(vehicle, "triangular", loss_table(vehicle, "triangular"))
    assert balance_degc(vehicle, "triangular", loss_table(vehicle, "triangular"), 16.7, 15.0) > DESTROYED_DEGC
    for arguments in (("vehicle", "check", path), ("simulate", "--vehicle", path, "--speed-kmh", 50, "-o", tmp_path / "out.csv")):
        answer = trackres(*arguments)
        assert answer.returncode == 2
        assert "settles at" in answer.stderr
        assert answer.stderr.strip().splitlines()[-1].startswith("trackres: error: ")


def test_vehicle_check_says_what_the_data_cover(short, good):
    text = good("vehicle", "check", short)
    assert "  ! track triangular: the rubber data end at" in text
    assert "settles at" in text
    assert "warmer, to 60 degC" in text
    assert "  ! " not in good("vehicle", "check", "xgd24d")


# Forward and reverse


@settings(max_examples=15)
@given(speeds=st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=30), ambient=st.floats(-30.0, 40.0), grade=st.floats(-0.2, 0.2))
@pytest.mark.parametrize("which", ["reference", "carrier"])
def test_a_mirrored_drive_reverses_the_sign_of_every_torque(request, which, speeds, ambient, grade):
    """To rounding where the drive's strain does not meet bending, else to what `vehicle check` says of the vehicle."""
    estimator = request.getfixturevalue(which)
    vehicle = estimator.vehicle
    name = next(iter(vehicle.tracks))
    share = reverse_share(loss_table(vehicle, name), load_range(vehicle, name), vehicle.tracks[name].sprocket_radius)
    rows = []
    for sign in (1.0, -1.0):
        session = estimator.cold_start(estimator.inputs(0.0, ambient=ambient))
        for speed in speeds:
            inputs = estimator.inputs(sign * speed * vehicle.chassis.max_speed, ambient=ambient, grade=sign * grade)
            session, estimate = estimator.step(session, inputs, 0.5)
        rows.append(estimate)
    signed_names = (
        "resistance_torque",
        "hysteresis",
        "bearing",
        "wind",
        "grade",
        "inertia",
        "drive_torque",
        "feedforward_torque",
    )
    scale = 1e-9 + 10.0 * share  # 10: the table's share is of a torque of 0.15 of the load, a hard brake has more
    for column in (f"{name}_nm" for name in signed_names):
        assert rows[1][column] == pytest.approx(-rows[0][column], rel=scale, abs=1e-6 + scale * abs(rows[0]["hysteresis_nm"]))
    assert rows[1].belt_degc() == pytest.approx(rows[0].belt_degc(), rel=scale, abs=1e-9)
    assert rows[1].reasons == rows[0].reasons
    assert math.isclose(rows[1].resistance_std_nm, rows[0].resistance_std_nm, rel_tol=scale)


@given(speed=st.floats(0.1, 16.0), belt=st.floats(-90.0, 150.0), share=st.floats(0.1, 2.5))
def test_remarks_and_status_name_the_same_belts(short_estimator, speed, belt, share):
    vehicle = short_estimator.vehicle
    inputs = short_estimator.inputs(speed, ambient=15.0, weight=share * vehicle.weight)
    _, estimate = short_estimator.step(short_estimator.cold_start(inputs, belt), inputs, 0.0)
    remarks = beyond_data(vehicle, speed, {a.name: belt for a in vehicle.assemblies})
    remarks += beyond_loads(vehicle, {a.name: estimate[f"load_n/{a.name}"] for a in vehicle.assemblies})
    assert bool(remarks) == bool(estimate.reasons & Reason.OUTSIDE_TABLE)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.long
def test_commands_say_that_they_extrapolate(short, good, tmp_path):
    (tmp_path / "drive.csv").write_text("time_s,speed_kmh,belt_degc\n0,0,40\n10,36,40\n60,36,40\n")
    (tmp_path / "hot.csv").write_text("time_s,speed_kmh,belt_degc\n0,10,90\n10,20,90\n60,20,90\n")
    remark = "The torque is extrapolated, and the status shows OUTSIDE_TABLE"
    explain_command = "explain", "--vehicle", short, "--speed-kmh", "50", "--belt-degc"
    assert f"a belt is at 90 degC at 50 km/h, but the rubber data end at 60 degC. {remark}" in good(*explain_command, "90")
    assert "a belt is at -20 degC at 50 km/h, but the rubber data end at" in good(*explain_command, "-20")
    assert "extrapolated" not in good(*explain_command, "40")
    assert json.loads(good(*explain_command, "90", "--json"))["remarks"]
    simulate_command = "simulate", "--vehicle", short, "--speed-kmh", "30", "--duration-s", "60", "-o", tmp_path / "out.csv"
    assert "but the rubber data end at 60 degC (above that: 100% of the samples)" in good(
        *simulate_command, "--initial-degc", "90"
    )
    assert json.loads(good(*simulate_command, "--initial-degc", "90", "--json"))["remarks"]
    assert "extrapolated" not in good(*simulate_command, "--initial-degc", "40")
    assert "carries 7.5 kN, but the table ends at" in good(*simulate_command, "--initial-degc", "40", "--weight-kn", "30")
    replay_command = "replay", "--vehicle", short, "-o", tmp_path / "replayed.csv"
    assert remark in good(*replay_command, tmp_path / "hot.csv")
    assert json.loads(good(*replay_command, tmp_path / "hot.csv", "--json"))["remarks"]
    assert remark not in good(*replay_command, tmp_path / "drive.csv")


@pytest.mark.parametrize("name", [*shipped_vehicles(), *shipped_road_vehicles()])
def test_a_refused_speed_is_above_the_limit_that_is_shown(name):
    vehicle = load_any(name)
    with pytest.raises(InputError) as refusal:
        check_speed(vehicle, 1.001 * OVERSPEED * vehicle.chassis.max_speed)
    limit = refusal.value.allowed.partition("max_speed, ")[2]
    assert float(refusal.value.given.split()[0]) > float(limit.split()[0])

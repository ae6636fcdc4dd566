# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Coast-downs: true values are found, within their ranges, and only improvements are written."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.diagnosis.base.loading import load_base
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.samples import Series
from trackres_ros.route.learned import SLOPE, RouteMap
from trackres_ros.tools.coastdown.stretches import NO_TORQUE_SHARE, in_driving_order, rollouts
from trackres_ros.units import EARTH_M, GRAVITY

DT_S, FROM_MPS, ACCELERATION = 0.05, 12.0, 0.3
HEADER = "time_s,speed_mps,torque_nm,grade"
COLUMNS = f"{HEADER},altitude_m,latitude_deg,longitude_deg".split(",")


def drive(vehicle, times=4, noise=0.01, slope=0.0, seed=1):
    """It is driven up to a speed and rolls out, there and back; time [s], speed [m/s], torque [Nm], slope."""
    estimator = tr.Estimator(vehicle)
    state = estimator.cold_start(estimator.inputs(0.0))
    inertia = estimator.step(state, estimator.inputs(1.0, acceleration=1.0), DT_S)[1]["inertia_nm"]
    rows, speed = [], 0.0

    def step(acceleration):
        nonlocal state
        state, estimate = estimator.step(state, estimator.inputs(speed, acceleration=acceleration, grade=grade), DT_S)
        return estimate

    for number in range(times):
        grade = slope if number % 2 else -slope
        while speed < FROM_MPS:
            speed += ACCELERATION * DT_S
            rows.append((speed, step(ACCELERATION)["drive_torque_nm"], grade))
        while speed > 0.1:
            time_now = step(0.0)
            speed -= (time_now["resistance_torque_nm"] + time_now["grade_nm"]) / inertia * DT_S
            rows.append((speed, 0.0, grade))
        speed = 0.0
        rows += [(0.0, step(0.0)["drive_torque_nm"], grade)] * 200
    table = np.column_stack([np.arange(len(rows)) * DT_S, rows])
    table[:, 1] += noise * np.random.default_rng(seed).normal(size=len(rows))
    return table


def heavier_bearings(vehicle, factor=1.4):
    chassis = vehicle.chassis
    return replace(vehicle, chassis=replace(chassis, bearing_friction=factor * chassis.bearing_friction))


def written(path, table, columns=HEADER):
    item = [COLUMNS.index(name) for name in columns.split(",")]
    np.savetxt(path, table[:, item], delimiter=",", header=columns, comments="", fmt="%.7f")
    return path


@pytest.fixture(scope="module")
def rolled(xgd24d):
    return drive(heavier_bearings(xgd24d))


@pytest.fixture
def of_car(tmp_path):
    """What a table of the car's speeds gives, by a file that knows only its mass, or by another."""

    def found(table, file=None):
        roll = written(tmp_path / "roll.csv", table, "time_s,speed_mps")
        return tr.coastdown(roll, file or cart(tmp_path / "car.yaml", CAR_KG))

    return found


def cart(path, mass, rise=(-0.002, 0.002)):
    """File of a car with a known mass and an unknown resistance; `rise` is the range of its rise by speed."""
    text = (
        "schema: 1\nname: cart\ntitle: a cart\nfriction_brakes: false\nroad_load:\n"
        "  rolling_coefficient: {value: 0.02, unit: '1', flag: A, range: [0.0, 0.1], reason: not known}\n"
        f"  rolling_rise: {{value: {sum(rise) / 2}, unit: s/m, flag: A, range: {list(rise)}, reason: not known}}\n"
        "  drag_area: {value: 4.0, unit: m^2, flag: A, range: [0.0, 20.0], reason: not known}\n"
    )
    held = {
        "air_density": (1.2, "kg/m^3"), "mass": (mass, "kg"), "rotating_mass_factor": (1.1, "1"), "wheel_radius": (0.4, "m"),
        "torque_scale": (0.3, "1"), "efficiency": (1.0, "1"), "torque_delay": (0.0, "s"), "contact_length": (3.0, "m"),
        "max_speed": (25.0, "m/s"), "ambient": (15.0, "degC"),
    }  # fmt: skip
    text += "".join(
        f"  {name}: {{value: {value}, unit: '{unit}', flag: A, range: [{value}, {value}], reason: held}}\n"
        for name, (value, unit) in held.items()
    )
    path.write_text(text)
    return path


TRUE_CAR, CAR_KG = {"rolling_coefficient": 0.0105, "rolling_rise": 0.00015, "drag_area": 0.66}, 1600.0
HILL_M, HILLY = 300.0, 0.006  # their length over 2 pi, and their slope


def car_force(values, speed, mass=CAR_KG):
    """At a speed [N]."""
    f, rise, area = (values[name] for name in TRUE_CAR)
    return mass * GRAVITY * (f + rise * speed) + 0.6 * area * speed**2


def car_drive(seed=0, step=0.2, noise=0.05, hills=0.0, slope=0.0, times=4):
    """A road car is driven up to a speed, holds it, rolls, and holds again, so many times, eastwards over hills; as `drive`, with
    its places. Every other time it is on a `slope` from the other side.
    """
    speed, way, rows, side = 8.0, 0.0, [], -1.0

    def resists():
        uphill = hills * np.sin(way / HILL_M) + side * slope
        return car_force(TRUE_CAR, speed) + CAR_KG * GRAVITY * uphill

    def row(torque):
        nonlocal way
        way += speed * step
        height = hills * HILL_M * (1.0 - np.cos(way / HILL_M))
        rows.append((speed, torque, hills * np.sin(way / HILL_M), height, 1.0, *np.degrees(longitude_at([way]))))

    for _ in range(times):
        side = -side
        while speed < 25.0:
            speed += step
            row(0.4 * (resists() + 1.1 * CAR_KG))
        for _ in range(round(10.0 / step)):
            row(0.4 * resists())
        while speed > 8.0:
            speed -= resists() / (1.1 * CAR_KG) * step
            row(0.0)
        for _ in range(round(10.0 / step)):
            row(0.4 * resists())
    table = np.column_stack([np.arange(len(rows)) * step, rows])
    table[:, 1] += noise * np.random.default_rng(seed).normal(size=len(rows))
    return table


def longitude_at(way):
    """At a degree of latitude [rad]."""
    return 0.1 + np.asarray(way) / (EARTH_M * np.cos(np.radians(1.0)))


@pytest.mark.parametrize("seed", range(3))
def test_ranges_hold_the_truth_after_a_release_and_with_noise(of_car, seed):
    table = car_drive(seed)
    result = of_car(table).coastdown
    (session,), rolls = result.runs.sessions, table[:, 2] == 0.0
    for stretch, (release, repetition) in zip(result.runs.stretches, np.flatnonzero(np.diff(rolls)).reshape(4, 2), strict=True):
        assert 0.0 <= session.time[stretch.begin] - table[release, 0] < 3.0
        assert 0.0 <= table[repetition, 0] - session.time[stretch.end] < 7.0
    for parameter in result.parameters:
        assert parameter.determined
        assert parameter.interval.low < TRUE_CAR[parameter.name] < parameter.interval.high


@pytest.mark.parametrize(("every", "gap"), [(1, 0.0), (10, 0.0), (1, 1.0)])
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("slope", [0.002, 0.005])
def test_there_and_back_on_a_slope_is_as_on_level_ground(of_car, slope, noise, every, gap):
    """With a speed every so many steps, and without those so near [m/s] to 16 m/s, which makes two pieces of a coast-down."""
    table = car_drive(slope=slope, times=8, noise=noise)[::every]
    table = table[(table[:, 2] != 0.0) | (np.abs(table[:, 1] - 16.0) >= gap)]
    result = of_car(table)
    assert result.coastdown.runs.count == 8
    assert result.better
    values = {p.name: p.value for p in result.coastdown.parameters}
    for speed in (8.0, 15.0, 25.0):
        assert car_force(values, speed) == pytest.approx(car_force(TRUE_CAR, speed), rel=0.01)
    for p in result.coastdown.parameters:
        half = 0.5 * (p.interval.high - p.interval.low)
        assert noise == 0.0 or abs(p.value - TRUE_CAR[p.name]) < 1.5 * half  # three standard deviations


@pytest.mark.parametrize("times", [4, 5])
def test_few_coast_downs_have_a_hidden_slope_in_their_ranges(of_car, times):
    slope = 0.005
    item = of_car(car_drive(slope=slope, times=times)).coastdown.parameters[0]
    assert item.interval.high - item.interval.low > 2.0 * slope


@pytest.mark.parametrize(
    ("name", "value", "ends"),
    [("offset", 8.0, (8.0, 8.0)), ("offset", 0.0, (-15.0, 15.0)), ("scale", 1.2, (1.2, 1.2)), ("delay", 0.3, (0.0, 0.5))],
)
def test_a_torque_sensor_does_not_matter_without_a_torque(tmp_path, of_car, name, value, ends):
    file = cart(tmp_path / "car.yaml", CAR_KG)
    without = of_car(car_drive(), file).coastdown
    text = "".join(line for line in file.read_text().splitlines(True) if f" torque_{name}:" not in line)
    unit = {"offset": "Nm", "scale": "1", "delay": "s"}[name]
    file.write_text(f"{text}  torque_{name}: {{value: {value}, unit: '{unit}', flag: A, range: {list(ends)}, reason: sensor}}\n")
    result = of_car(car_drive(), file).coastdown
    for p, q in zip(result.parameters, without.parameters, strict=True):
        assert (p.name, p.value, p.interval.low, p.interval.high) == pytest.approx(
            (q.name, q.value, q.interval.low, q.interval.high)
        )


def test_an_unknown_mass_widens_only_the_range_of_forces(tmp_path, of_car):
    """The weight of a vehicle on tyres is no part of its rolling coefficient."""
    file, share = cart(tmp_path / "car.yaml", CAR_KG), 0.1
    known = of_car(car_drive(), file).coastdown
    ends = [CAR_KG * (1.0 - share), CAR_KG * (1.0 + share)]
    file.write_text(file.read_text().replace(f"range: [{CAR_KG}, {CAR_KG}]", f"range: {ends}"))
    result = of_car(car_drive(), file).coastdown
    for p, q in zip(result.parameters, known.parameters, strict=True):
        of_mass = 0.98 * share * p.value if p.name == "drag_area" else 0.0
        assert p.value - p.interval.low == pytest.approx(np.hypot(q.value - q.interval.low, of_mass), rel=0.02)


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_track_ranges_hold_the_truth_for_any_mass_of_the_file(tmp_path, xgd24d, factor):
    heavy = replace(xgd24d, axles=tuple(replace(a, load=factor * a.load) for a in xgd24d.axles))
    roll = written(tmp_path / "roll.csv", drive(heavy, times=6), "time_s,speed_mps,grade")
    for p in tr.coastdown(roll, "xgd24d").coastdown.parameters:
        assert p.interval.low < p.file_value < p.interval.high


@pytest.mark.parametrize(("rolling", "area"), [(0.0105, 1.0), (0.008, 0.3), (0.02, 4.0)])
def test_the_speed_by_the_file_is_that_of_its_forces(tmp_path, of_car, rolling, area):
    file = cart(tmp_path / "car.yaml", CAR_KG)
    file.write_text(file.read_text().replace("value: 0.02,", f"value: {rolling},").replace("value: 4.0,", f"value: {area},"))
    result = of_car(car_drive(noise=0.0), file)
    values = {p.name: p.value for p in result.coastdown.parameters}
    for item in result.as_dict()["rollouts"]:
        for value, by in (("file", {"rolling_coefficient": rolling, "rolling_rise": 0.0, "drag_area": area}), ("found", values)):
            speed, dt = item["from_mps"], 0.01
            for _ in range(round(item["seconds"] / dt)):
                speed = max(0.0, speed - car_force(by, speed) / (1.1 * CAR_KG) * dt)
            near = pytest.approx(speed - item["to_mps"], abs=0.1)  # friction fades near standstill
            assert item["too_fast_at_the_end_mps"][value] == near


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("roll_1.csv roll_10.csv roll_2.csv", "roll_1.csv roll_2.csv roll_10.csv"),  # as a shell gives them
        ("there_1.csv back_1.csv there_2.csv back_2.csv", "there_1.csv back_1.csv there_2.csv back_2.csv"),
        ("b@20 a@0 c@10", "a@0 c@10 b@20"),  # one after another: a common clock
        ("b@20 a@0 c@9", "b@20 a@0 c@9"),
        ("roll_10@1 roll_1@4 roll_2@30", "roll_1@4 roll_2@30 roll_10@1"),
    ],
)
def test_coast_downs_keep_the_order_driven(given, expected):
    """Each lasts ten from its start @; those at the same time have clocks of their own."""
    starts = {name: int(name.partition("@")[2] or 0) for name in given.split()}
    for is_set in (1, 0):  # or never set
        logged = {name: np.array([place, place + 10]) for name, place in starts.items()}
        recordings = [Recording(name, {"speed": Series(is_set * place, place, 0.0 * place)}) for name, place in logged.items()]
        assert " ".join(item.name for item in in_driving_order(recordings)) == expected


@pytest.mark.parametrize("least", [0.00015, 0.0003, 0.001])
def test_no_value_beyond_its_range_in_the_file_is_written(tmp_path, of_car, least):
    result = of_car(car_drive(), cart(tmp_path / "car.yaml", CAR_KG, rise=(least, 0.002)))
    beyond = [p.name for p in result.coastdown.parameters if p.is_outside]
    assert result.better == (not beyond)
    if beyond:
        assert all(name in result.why_not for name in beyond)
    else:
        for p in result.coastdown.parameters:
            assert p.by_file[0] <= p.interval.low <= p.value <= p.interval.high <= p.by_file[1]


def test_values_that_no_file_may_hold_are_not_written(tmp_path, of_car, monkeypatch):
    monkeypatch.setitem(TRUE_CAR, "rolling_rise", -0.0003)  # no resistance at 35 m/s, which it does not reach
    table, file = car_drive(noise=0.0), cart(tmp_path / "car.yaml", CAR_KG)
    assert of_car(table, file).better
    file.write_text(file.read_text().replace("25.0", "60.0"))
    result = of_car(table, file)
    assert not result.better
    assert "no command would accept" in repr(result)
    with pytest.raises(tr.InputError, match="rolling_coefficient / max_speed"):
        result.save_vehicle(tmp_path / "new.yaml")


@pytest.mark.parametrize("scale", [0.0, 1e-3])
def test_a_torque_that_does_not_drive_is_not_used(tmp_path, scale):
    loaded = load_base(cart(tmp_path / "car.yaml", CAR_KG))

    def rolled(name, table, columns="time_s,speed_mps,torque_nm"):
        return rollouts([tr.read(written(tmp_path / name, table, columns))], loaded, 1.0)

    right = car_drive()
    wrong = right * [1.0, 1.0, scale, 1.0, 1.0, 1.0, 1.0]
    without, unused = rolled("without.csv", right, "time_s,speed_mps"), rolled("wrong.csv", wrong)
    assert unused.stretches == without.stretches
    assert not unused.sessions[0].torque.any()
    assert "hardly exceeds" in unused.notes[0]
    release = int(np.argmax(right[:, 2] == 0.0))
    for used in (right, right[release : release + int(np.argmax(right[release:, 2] > 0.0))]):  # driven, or rolling only
        assert not rolled("right.csv", used).notes


def test_other_clocks_are_moved_and_set_ones_refused(tmp_path):
    """By the log, as in a diagnosis."""
    recording = tr.read(written(tmp_path / "roll.csv", car_drive(hills=HILLY), "time_s,speed_mps,grade"))
    loaded, speed = load_base(cart(tmp_path / "car.yaml", CAR_KG)), recording.series["speed"]

    def rolled(stamp_ns):
        made = replace(recording, series={**recording.series, "speed": replace(speed, stamp_ns=stamp_ns)})
        return rollouts([made], loaded, 1.0)

    for off_ns in (-3_600_000_000_000, 3_600_000_000_000):
        np.testing.assert_array_equal(*(rolled(speed.stamp_ns + deviation).sessions[0].grade for deviation in (0, off_ns)))
    set_back = np.where(speed.stamp_ns > speed.stamp_ns[900], speed.stamp_ns - 30_000_000_000, speed.stamp_ns)
    with pytest.raises(tr.InputError, match="times that go back by 30 s"):
        rolled(set_back)
    for clock in (set_back, speed.stamp_ns + 37_000_000_000):  # a dead sensor's matters to nobody
        dead = replace(speed, stamp_ns=clock, value=0.0 * speed.value)
        result = rollouts([replace(recording, series={**recording.series, "torque": dead})], loaded, 1.0)
        assert len(result.stretches) == len(rolled(speed.stamp_ns).stretches)
        assert "clock is not the speed's" in " ".join(result.notes)


def slope_error(rolled, table):
    """Root mean square error of the slopes in coast-downs."""
    item = [(s.grade - np.interp(s.time + 0.5 * s.step, table[:, 0], table[:, 3]))[s.used] for s in rolled.sessions]
    return float(np.sqrt(np.mean(np.concatenate(item) ** 2)))


@pytest.mark.parametrize("factor", [1.0, 0.0, -1.0])
def test_decelerations_decide_on_the_slopes_of_an_altitude(tmp_path, factor):
    """Each coast-down is a recording of its own."""
    table = car_drive(hills=HILLY)
    ends = np.flatnonzero((table[1:, 2] > 0.0) & (table[:-1, 2] == 0.0))[:3] + 1
    shown = table * [1.0, 1.0, 1.0, 1.0, factor, 1.0, 1.0] + [0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0]
    files = [written(tmp_path / f"{i}.csv", part, "time_s,speed_mps,altitude_m") for i, part in enumerate(np.split(shown, ends))]
    result = rollouts([tr.read(file) for file in files], load_base(cart(tmp_path / "car.yaml", CAR_KG)), 1.0)
    assert len(result.stretches) == 4
    assert [("grade" in s.given) for s in result.sessions] == [factor == 1.0] * 4
    if factor == -1.0:
        assert all("no usable slope" in note for note in result.notes if "altitude" in note)


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_coast_downs_have_the_slopes_of_a_route_and_end_with_it(tmp_path, share):
    table = car_drive(hills=HILLY)
    way = np.arange(0.0, share * np.sum(table[:, 1]) * 0.2, 20.0)
    slope, item = HILLY * np.sin(way / HILL_M), np.ones(len(way))
    value, std = np.stack([slope, -slope], axis=1), np.full((len(way), 2), 0.001)
    route = RouteMap(SLOPE, np.radians(item), longitude_at(way), 0.0 * item, value, std, 4 * item.astype(int))
    file = written(tmp_path / "roll.csv", table, "time_s,speed_mps,latitude_deg,longitude_deg")
    level = load_base(cart(tmp_path / "car.yaml", CAR_KG))
    without, result = (rollouts([tr.read(file)], replace(level, route=maps), 1.0) for maps in ((), (route,)))
    assert slope_error(result, table) < 0.001 < slope_error(without, table)
    assert (result.sessions[0].used.sum() < 0.9 * without.sessions[0].used.sum()) == (share < 1.0)
    nowhere = rollouts([tr.read(written(file, table, "time_s,speed_mps"))], replace(level, route=(route,)), 1.0)
    assert any("slope of the route" in note and "as position is not known" in note for note in nowhere.notes)


def resistance(vehicle, speed_kmh, found=None):
    """Of a vehicle, or with the values found; at one temperature [Nm]."""
    if found is not None:
        values = {p.name: p.value for p in found.coastdown.parameters}
        of_chassis = {name: values[name] for name in ("bearing_friction", "drag_coefficient")}
        rubber = replace(vehicle.rubber, loss_modulus_scale=values["loss_modulus_scale"])
        vehicle = replace(vehicle, chassis=replace(vehicle.chassis, **of_chassis), rubber=rubber)
    return tr.explain(vehicle, speed_kmh=speed_kmh, belt_degc=20)["torque_nm"]["resistance"]


@pytest.mark.parametrize("columns", ["time_s,speed_mps", "time_s,speed_mps,torque_nm"])
def test_what_resists_is_found_within_its_ranges(tmp_path, xgd24d, rolled, columns):
    result = tr.coastdown(written(tmp_path / "roll.csv", rolled, columns), "xgd24d")
    true = heavier_bearings(xgd24d)
    by_name = {p.name: p for p in result.coastdown.parameters}
    item = by_name["bearing_friction"]
    assert item.determined
    assert item.interval.low < true.chassis.bearing_friction < item.interval.high
    for name in ("loss_modulus_scale", "drag_coefficient"):
        assert by_name[name].interval.low < by_name[name].file_value < by_name[name].interval.high
    assert "loss_modulus_scale" in item.with_others  # a force that hardly varies: only both together are told
    for speed_kmh in (10.0, 25.0, 40.0):
        assert resistance(xgd24d, speed_kmh, result) == pytest.approx(resistance(true, speed_kmh), rel=0.01)
    assert result.better
    assert result.coastdown.improvement.after < 0.1 * result.coastdown.improvement.before


@pytest.mark.parametrize("times", [1, 2])
def test_fewer_than_three_coast_downs_confirm_nothing(tmp_path, rolled, times):
    begins = np.flatnonzero((rolled[1:, 2] > 0.0) & (rolled[:-1, 2] <= 0.0)) + 1  # of the later drives
    result = tr.coastdown(written(tmp_path / "roll.csv", rolled[: begins[times - 1]], "time_s,speed_mps"), "xgd24d")
    assert len(result.coastdown.runs.stretches) == times
    assert any(p.determined for p in result.coastdown.parameters)
    assert repr(result).count("not told") == sum(not p.determined for p in result.coastdown.parameters) > 0
    assert not result.better
    assert "record three or more" in result.why_not


def test_what_the_file_says_already_is_not_written_anew(tmp_path, xgd24d):
    result = tr.coastdown(written(tmp_path / "roll.csv", drive(xgd24d)), "xgd24d")
    for speed_kmh in (10.0, 40.0):
        assert resistance(xgd24d, speed_kmh, result) == pytest.approx(resistance(xgd24d, speed_kmh), rel=0.01)
    if not result.better:
        with pytest.raises(tr.InputError, match="save_vehicle"):
            result.save_vehicle(tmp_path / "new.yaml")
    assert not (tmp_path / "new.yaml").exists()


def test_all_scales_with_the_mass(tmp_path, rolled):
    """Of a vehicle on tyres: of one that is twice as heavy it takes twice the force, at the same decay of speed."""
    roll = written(tmp_path / "roll.csv", rolled, "time_s,speed_mps")

    def force(mass, speed):
        file = cart(tmp_path / "cart.yaml", mass)
        result = tr.coastdown(roll, file)
        assert result.better
        return car_force({p.name: p.value for p in result.coastdown.parameters}, speed, mass)

    for speed in (3.0, 10.0):
        assert force(20000.0, speed) == pytest.approx(2.0 * force(10000.0, speed), rel=0.02)


def test_a_vehicle_of_which_all_is_known_is_refused(tmp_path, rolled, repository):
    text = (repository / "config" / "bmw_i3.yaml").read_text()
    text = re.sub(r"value: ([-0-9.e]+)(.*?)range: \[[^\]]*\]", r"value: \1\2range: [\1, \1]", text)
    (tmp_path / "known.yaml").write_text(text)
    with pytest.raises(tr.InputError, match="widen"):
        tr.coastdown(written(tmp_path / "roll.csv", rolled), tmp_path / "known.yaml")


def test_a_slope_that_is_known_does_not_matter(tmp_path, xgd24d):
    true = heavier_bearings(xgd24d)
    sloped = drive(true, slope=0.004, times=6)
    for columns in (HEADER, "time_s,speed_mps"):  # known or hidden
        result = tr.coastdown(written(tmp_path / "roll.csv", sloped, columns), "xgd24d")
        assert result.better
        assert resistance(xgd24d, 25.0, result) == pytest.approx(resistance(true, 25.0), rel=0.01)


def test_each_rolling_out_may_be_a_recording_of_its_own(tmp_path, xgd24d, rolled):
    speed, torque = rolled[:, 1], rolled[:, 2]
    begins = np.flatnonzero((torque[1:] == 0.0) & (torque[:-1] > 0.0)) + 1
    files = []
    for number, begin in enumerate(begins):
        piece = rolled[begin : begin + int(np.argmax(speed[begin:] < 0.05))].copy()
        piece[:, 0] -= piece[0, 0]
        files.append(written(tmp_path / f"roll_{number}.csv", piece, "time_s,speed_mps"))
    assert len(files) == 4
    result = tr.coastdown(files, "xgd24d")
    assert [s.session for s in result.coastdown.runs.stretches] == [0, 1, 2, 3]
    true = resistance(heavier_bearings(xgd24d), 25.0)
    assert resistance(xgd24d, 25.0, result) == pytest.approx(true, rel=0.05)  # how warm it was before is not known


def test_a_coast_down_given_twice_is_refused(tmp_path, rolled):
    item = written(tmp_path / "roll.csv", rolled)
    repetition = written(tmp_path / "again.csv", rolled, "time_s,speed_mps")
    for files in ([item, item], [item, repetition]):
        with pytest.raises(tr.InputError, match="each drive once") as error:
            tr.coastdown(files, "xgd24d")
        assert sorted(error.value.where.split(", ")) == sorted(map(str, files))


def test_what_is_driven_or_braked_is_not_taken(tmp_path, xgd24d, rolled):
    car = cart(tmp_path / "car.yaml", CAR_KG)
    for vehicle, table, weight, shown in (("xgd24d", rolled, xgd24d.weight, 1.0), (car, car_drive(), CAR_KG * GRAVITY, 0.3)):
        driven = table[:, :4] * [1.0, 1.0, shown, 1.0]
        offset = shown * 3.0 * NO_TORQUE_SHARE * weight * 0.4
        driven[:, 2] += offset  # somebody keeps his foot on it
        with pytest.raises(tr.InputError, match="no coast-down") as error:
            tr.coastdown(written(tmp_path / "driven.csv", driven), vehicle)
        assert "both directions" in error.value.remedy
        assert "slowing down with a torque above" in error.value.given
        assert f"offset: {-float(f'{offset:.3g}')}}}" in error.value.remedy  # or it is the sensor's
    time = np.arange(0.0, 200.0, DT_S)
    saw = np.interp(time % 50.0, [0.0, 30.0, 45.0, 50.0], [0.0, 14.0, 0.0, 0.0])
    braked = np.column_stack([time, saw, 0.0 * time, 0.0 * time])
    with pytest.raises(tr.InputError, match="brakes"):
        tr.coastdown(written(tmp_path / "braked.csv", braked, "time_s,speed_mps"), "xgd24d")


@pytest.mark.parametrize("every", [4, 40])
def test_a_speed_that_comes_slowly_will_do(tmp_path, xgd24d, rolled, every):
    result = tr.coastdown(written(tmp_path / "slow.csv", rolled[::every], "time_s,speed_mps"), "xgd24d")
    assert resistance(xgd24d, 25.0, result) == pytest.approx(resistance(heavier_bearings(xgd24d), 25.0), rel=0.01)
    assert result.coastdown.better


def test_too_little_of_it_is_refused_with_what_there_is(tmp_path, rolled):
    with pytest.raises(tr.InputError, match=r"s of .*: ") as error:
        tr.coastdown(written(tmp_path / "slow.csv", rolled[::100], "time_s,speed_mps"), "xgd24d")
    assert "no coast-down" in str(error.value)
    begin = int(np.argmax(rolled[:, 1])) - 200
    with pytest.raises(tr.InputError, match=r"1 coast-downs, .* s in all, in steps of 1 s"):
        tr.coastdown(written(tmp_path / "short.csv", rolled[begin : begin + 600], "time_s,speed_mps"), "xgd24d")


def test_the_command_writes_what_is_better_and_says_what_is_not(tmp_path, rolled, good, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "roll.csv", rolled, "time_s,speed_mps")
    shown = good("coastdown", "roll.csv", "--vehicle", "xgd24d", "--save-vehicle", "new.yaml", "--picture", "roll.png")
    assert "4 coast-downs" in shown
    assert "Written: new.yaml, rubber/nr_sbr_10hz.csv, roll.png" in shown
    assert (tmp_path / "roll.png").stat().st_size > 10000
    repetition = json.loads(good("coastdown", "roll.csv", "--vehicle", "new.yaml", "--save-vehicle", "newer.yaml", "--json"))
    assert repetition["held_out_nm"]["file"] < 10.0
    assert repetition["better"] == (tmp_path / "newer.yaml").exists()
    reason = tr.load_vehicle("new.yaml").parameters["chassis.bearing_friction"].reason
    assert reason.startswith("re-fitted by trackres coastdown; before it 0.0075 (")

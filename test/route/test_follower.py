# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Slope and torque under a vehicle by its positions: equal from each message, and none off the route."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streets import LATITUDE, LONGITUDE, autoregression

import trackres_ros as tr
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator import snapshot
from trackres_ros.estimator.columns import Count, Reason
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.settings import Settings
from trackres_ros.route.learned import SLOPE, TORQUE, RouteMap
from trackres_ros.route.table import write_route
from trackres_ros.route.track import Frame, on_same_turn
from trackres_ros.units import SECOND_NS

STREET_M = 1000.0
START_NS = 1_700_000_000 * SECOND_NS
SOFT_NM, BACK_NM, STD_NM = 900.0, 300.0, 120.0
POSITIONS = layout.LATITUDE, layout.LONGITUDE
WAY = np.arange(50.0, 950.0, 8.0)  # of most drives, at 8 m/s


def slope_at(way):
    return 0.04 * np.sin(2.0 * np.pi * way / 500.0)


def street(kind, value, std):
    """A street to the east, with learned values in both directions."""
    way = np.arange(0.0, STREET_M + 1.0, 20.0)
    latitude, longitude = Frame(LATITUDE, LONGITUDE).position(way, np.zeros_like(way))
    value = np.stack([np.broadcast_to(column, way.shape) for column in value(way)], axis=1).astype(float)
    counts = np.full(len(way), 5)
    return RouteMap(kind, latitude, longitude, np.zeros_like(way), value, np.full((len(way), 2), std), counts)


@pytest.fixture(scope="module")
def slopes():
    return street(SLOPE, lambda way: (slope_at(way), -slope_at(way)), 0.002)


@pytest.fixture(scope="module")
def torques():
    """Soft ground on the middle third; nobody has driven the first third to the west."""

    def value(way):
        is_soft = (way > 333.0) & (way < 667.0)
        return np.where(is_soft, SOFT_NM, 0.0), np.where(way < 333.0, np.nan, np.where(is_soft, BACK_NM, 0.0))

    return street(TORQUE, value, STD_NM)


@pytest.fixture(scope="module")
def on(slopes, torques):
    """Estimators on a route with slopes, with torques, with both, and without one."""
    vehicle = tr.load_vehicle("xgd24d")
    routes = {"slopes": (slopes,), "torques": (torques,), "both": (slopes, torques), "none": ()}
    return {name: Estimator(replace(vehicle, route=route)) for name, route in routes.items()}


def messages(way=WAY, speed=8.0, aside=0.0, scatter_m=0.0, hidden=(), step_s=1.0, more=()):
    """Messages of a vehicle in each second: channel, stamp and value; `more` of (sample, channel, value) come before the
    speed.
    """
    rng, n, speed = np.random.default_rng(1), len(way), np.broadcast_to(speed, way.shape)
    x, y = (autoregression(n, rng, 30.0, scatter_m) + centre for centre in (way, np.broadcast_to(aside, way.shape)))
    latitude, longitude = Frame(LATITUDE, LONGITUDE).position(x, y)
    content = []
    for i in range(n):
        stamp = START_NS + round((i + 1) * step_s * SECOND_NS)
        if i not in hidden:
            content += [(layout.LATITUDE, stamp, latitude[i]), (layout.LONGITUDE, stamp, longitude[i])]
        content += [(channel, stamp, value) for sample, channel, value in more if sample == i]
        content.append((layout.SPEED, stamp, float(speed[i])))
    return content


def driven(estimator, content, session=None):
    """Rows of results, one a speed."""
    channel, stamp, value = (np.array(column) for column in zip(*content, strict=True))
    steps = (session or estimator.session()).handle_block(channel.astype(np.int16), stamp, stamp, value.astype(float))
    return steps.rows.copy()


def one_by_one(session, content):
    """The same by single messages, each with its arrival."""
    estimates = (session.handle(channel, stamp, arrival, float(value)) for channel, stamp, arrival, value in content)
    return np.array([estimate.row for estimate in estimates if estimate is not None])


def late(content, offset_s):
    """Messages with arrivals, their positions on the clock of a receiver that is so far ahead."""
    ahead = dict.fromkeys(POSITIONS, round(offset_s * SECOND_NS))
    return [(channel, stamp + ahead.get(channel, 0), stamp, value) for channel, stamp, value in content]


def slope_of(estimator, rows):
    """The slope used by a step; nan off the route."""
    radius = estimator.vehicle.track_of(estimator.vehicle.assemblies[0]).sprocket_radius
    sine = rows[:, layout.Results.grade_nm] / (radius * rows[:, layout.Results.weight_n])
    is_off = (rows[:, layout.Results.reasons].astype(int) & Reason.OFF_ROUTE) > 0
    return np.where(is_off, np.nan, sine / np.sqrt(1.0 - sine**2))


def reasons_of(rows):
    return rows[:, layout.Results.reasons].astype(int)


def followed(estimator, *way_and_speed, **given):
    return slope_of(estimator, driven(estimator, messages(*way_and_speed, **given)))


def test_the_slope_is_that_of_the_place_either_way(on):
    slopes_ahead = followed(on["slopes"])
    reverse_slopes = followed(on["slopes"], WAY[::-1])[::-1]
    assert np.abs(slopes_ahead - slope_at(WAY))[3:-3].max() < 0.004
    assert np.abs(reverse_slopes + slope_at(WAY))[3:-3].max() < 0.004


def test_scatter_of_positions_leaves_it_usable(on):
    found_slopes = followed(on["slopes"], scatter_m=6.0)
    is_known = np.isfinite(found_slopes)
    assert is_known.mean() > 0.9
    assert np.abs(found_slopes - slope_at(WAY))[is_known].mean() < 0.008


@pytest.mark.parametrize("back", [3.0, 0.2])
def test_backing_down_a_slope_it_still_points_up(on, back):
    way = np.concatenate([np.arange(50.0, 130.0, 5.0), np.full(5, 125.0), np.arange(125.0, 70.0, -back)])
    speed = np.concatenate([np.full(16, 5.0), np.zeros(5), np.full(len(way) - 21, -back)])
    found_slopes = followed(on["slopes"], way, speed)
    assert np.abs(found_slopes - slope_at(way))[25:].max() < 0.01


def test_standing_it_keeps_its_slope_whatever_positions_scatter(on):
    way = np.concatenate([np.arange(50.0, 130.0, 8.0), np.full(600, 122.0)])
    speed = np.concatenate([np.full(10, 8.0), np.zeros(600)])
    found_slopes = followed(on["slopes"], way, speed, scatter_m=8.0)[12:]
    is_known = np.isfinite(found_slopes)
    assert is_known.mean() > 0.95
    assert (found_slopes[is_known] > 0.02).all()


def test_a_short_gap_is_bridged_and_a_long_one_is_not(on):
    gaps = (*range(20, 26), *range(50, 90))
    rows = driven(on["slopes"], messages(hidden=gaps))
    found_slopes = slope_of(on["slopes"], rows)
    assert np.abs(found_slopes - slope_at(WAY))[20:26].max() < 0.006
    assert np.isnan(found_slopes[66:90]).all()
    assert (reasons_of(rows)[66:90] & Reason.PLACE_UNKNOWN).all()


@pytest.mark.parametrize("offset_s", [0.0, 3600.0])
def test_a_repeated_position_is_none_whatever_its_clock(slopes, offset_s):
    count = 40
    estimator = Estimator(replace(tr.load_vehicle("xgd24d"), route=(slopes,)), Settings(position_hold_s=60.0))
    all_messages, gap_messages = (messages(hidden=hidden) for hidden in ((), range(count, len(WAY))))
    last_position = {channel: value for channel, _, value in all_messages[: 3 * count] if channel in POSITIONS}
    tail = [(channel, stamp, last_position.get(channel, value)) for channel, stamp, value in all_messages[3 * count :]]
    rows = one_by_one(estimator.session(), late([*all_messages[: 3 * count], *tail], offset_s))
    np.testing.assert_array_equal(rows, driven(estimator, gap_messages))
    assert (reasons_of(rows)[count + 13 :] & Reason.PLACE_UNKNOWN).all()


def test_without_a_position_it_comes_back_on_its_way(on):
    speed = np.concatenate([np.full(19, 8.0), [4.0, 0.0, -4.0], np.full(4, -8.0)])
    way = 50.0 + np.cumsum(speed)
    found_slopes = followed(on["slopes"], way, speed, hidden=range(17, len(way)))
    assert np.abs(found_slopes - slope_at(way))[5:].max() < 0.007


@pytest.mark.parametrize(("apart_ns", "is_one"), [(-5_000_000, True), (5_000_000, True), (100_000_000, False)])
def test_halves_of_a_position_are_at_most_50_ms_apart(on, apart_ns, is_one):
    stream = messages()
    shifted_stream = [
        (channel, stamp + (apart_ns if channel == layout.LONGITUDE else 0), value) for channel, stamp, value in stream
    ]
    is_unknown = reasons_of(driven(on["slopes"], shifted_stream)) & Reason.PLACE_UNKNOWN > 0
    assert not is_unknown[5:].any() if is_one else is_unknown.all()


def test_how_long_a_position_holds_is_a_setting(slopes):
    way = np.arange(50.0, 950.0, 2.0)
    stream = messages(way, 2.0, hidden=range(100, 140))
    for hold_s, end in ((3.0, 103), (30.0, 130)):
        estimator = Estimator(replace(tr.load_vehicle("xgd24d"), route=(slopes,)), Settings(position_hold_s=hold_s))
        is_unknown = reasons_of(driven(estimator, stream)) & Reason.PLACE_UNKNOWN > 0
        assert not is_unknown[60:end].any()
        assert is_unknown[end + 1 : 140].all()
        assert not is_unknown[145:].any()


def test_a_measured_slope_comes_before_that_of_the_place(on):
    more = [(i, layout.GRADE, 0.07) for i in range(60)]
    rows = driven(on["slopes"], messages(more=more))
    found_slopes = slope_of(on["slopes"], rows)
    assert found_slopes[10:60] == pytest.approx(0.07)
    assert not (reasons_of(rows)[:60] & (Reason.OFF_ROUTE | Reason.PLACE_UNKNOWN)).any()
    assert np.abs(found_slopes - slope_at(WAY))[62:].max() < 0.004


def test_the_torque_of_a_place_is_signed_against_travel(on):
    rows = driven(on["torques"], messages())
    is_soft = (WAY > 370.0) & (WAY < 630.0)
    assert rows[is_soft, layout.Results.effects_nm] == pytest.approx(SOFT_NM, rel=1e-6)
    reverse_rows = driven(on["torques"], messages(WAY[::-1]))[::-1]
    assert reverse_rows[is_soft, layout.Results.effects_nm] == pytest.approx(BACK_NM, rel=1e-6)
    reverse = driven(on["torques"], messages(WAY[::-1], -4.0, step_s=2.0))[::-1]
    assert reverse[is_soft, layout.Results.effects_nm] == pytest.approx(-BACK_NM, rel=1e-6)


def test_an_undriven_direction_expects_nothing_and_is_reported(on):
    way = WAY[::-1]
    rows = driven(on["torques"], messages(way))
    is_undriven, is_driven = way < 290.0, (way > 350.0) & (way < 900.0)
    assert (rows[is_undriven, layout.Results.effects_nm] == 0.0).all()
    assert (reasons_of(rows)[is_undriven] & Reason.OFF_ROUTE).all()
    assert not (reasons_of(rows)[is_driven] & Reason.OFF_ROUTE).any()


def test_the_torque_of_a_place_enters_drive_torque_and_its_std(on):
    stream = messages()
    bare_rows, rows = (driven(on[name], stream) for name in ("none", "torques"))
    place = rows[:, layout.Results.effects_nm]
    np.testing.assert_allclose(
        rows[:, layout.Results.resistance_torque_nm] - bare_rows[:, layout.Results.resistance_torque_nm], place, atol=1.0
    )  # it strains belts too
    np.testing.assert_allclose(
        rows[:, layout.Results.drive_torque_nm] - bare_rows[:, layout.Results.drive_torque_nm], place, atol=1.0
    )
    is_known = np.arange(len(WAY)) > 5
    of_place = np.sqrt(rows[:, layout.Results.resistance_std_nm] ** 2 - bare_rows[:, layout.Results.resistance_std_nm] ** 2)
    assert of_place[is_known] == pytest.approx(STD_NM, rel=0.05)


@pytest.mark.parametrize("name", ["slopes", "torques", "both"])
def test_nothing_of_it_is_fed_forward_whatever_parts_are(name, slopes, torques):
    settings = Settings(feedforward_parts=("hysteresis", "bearing", "wind", "grade", "inertia"))
    vehicle = replace(tr.load_vehicle("xgd24d"), thermal="lumped")
    route = {"slopes": (slopes,), "torques": (torques,), "both": (slopes, torques)}[name]
    stream = messages()
    rows, bare_rows = (driven(Estimator(replace(vehicle, route=maps), settings), stream) for maps in (route, ()))
    assert np.abs(rows[:, layout.Results.drive_torque_nm] - bare_rows[:, layout.Results.drive_torque_nm]).max() > 800.0
    np.testing.assert_allclose(
        rows[:, layout.Results.feedforward_torque_nm], bare_rows[:, layout.Results.feedforward_torque_nm], atol=1.0
    )


@settings(max_examples=30)
@given(
    torque=st.floats(-1e5, 1e5),
    slope=st.floats(-0.5, 0.5),
    parts=st.sets(st.sampled_from(["hysteresis", "bearing", "wind", "grade", "inertia"]), min_size=1),
)
def test_at_a_standstill_nothing_pushes_whatever_the_table_says(torque, slope, parts):
    route = street(TORQUE, lambda way: (torque, torque), 10.0), street(SLOPE, lambda way: (slope, -slope), 0.01)
    vehicle = replace(tr.load_vehicle("xgd24d"), route=route)
    estimator = Estimator(vehicle, Settings(feedforward_parts=tuple(parts)))
    way = np.concatenate([np.arange(400.0, 500.0, 5.0), np.full(30, 500.0)])
    speed = np.concatenate([np.full(20, 5.0), np.zeros(30)])
    rows = driven(estimator, messages(way, speed))
    assert not (reasons_of(rows)[-5:] & Reason.OFF_ROUTE).any()
    assert rows[-5:, layout.Results.feedforward_torque_nm] == pytest.approx(0.0, abs=1e-9)
    assert rows[-5:, layout.Results.effects_nm] == pytest.approx(0.0, abs=1e-9)


def test_single_messages_and_blocks_give_the_same_bits(on):
    way = np.arange(50.0, 950.0, 3.0)
    stream = messages(way, 3.0, scatter_m=4.0, hidden=range(90, 130))
    np.testing.assert_array_equal(one_by_one(on["both"].session(), late(stream, 0.0)), driven(on["both"], stream))


def test_resumed_on_the_way_the_numbers_are_the_same_bits(on, tmp_path):
    way = np.arange(50.0, 950.0, 3.0)
    stream = messages(way, 3.0, scatter_m=4.0)
    all_rows = driven(on["both"], stream)
    first_session = on["both"].session()
    first_rows = driven(on["both"], stream[:400], first_session)
    snapshot.save(first_session, tmp_path / "state.json", saved_at=1.0)
    second_rows = driven(on["both"], stream[400:], snapshot.resume(on["both"], tmp_path / "state.json"))
    np.testing.assert_array_equal(np.concatenate([first_rows, second_rows]), all_rows)


def test_a_state_of_another_route_is_refused(on, slopes, tmp_path):
    session = on["slopes"].session()
    driven(on["slopes"], messages(WAY[:5]), session)
    snapshot.save(session, tmp_path / "state.json", saved_at=1.0)
    other_estimator = Estimator(replace(on["slopes"].vehicle, route=(slopes.times(2.0),)))
    with pytest.raises(tr.InputError, match="other values"):
        snapshot.resume(other_estimator, tmp_path / "state.json")


@pytest.mark.parametrize("broken", [math.nan, 7.0])
def test_a_position_of_which_one_half_is_refused_is_none(on, broken):
    stream = messages()
    broken_stream = [
        (c, stamp, broken if c == layout.LONGITUDE and i > 180 else value) for i, (c, stamp, value) in enumerate(stream)
    ]
    session = on["slopes"].session()
    rows = driven(on["slopes"], broken_stream, session)
    is_unknown = reasons_of(rows) & Reason.PLACE_UNKNOWN > 0
    assert not is_unknown[10:60].any()
    assert is_unknown[73:].all()
    counter = Count.NON_FINITE if math.isnan(broken) else Count.OUT_OF_RANGE
    assert ("longitude", counter) in {(name, count) for name, count, _ in session.counts()}


def test_a_receiver_whose_clock_is_another_is_followed_too(on):
    stream = messages()
    for offset_s in (-3600.0, -0.4, 0.4, 3600.0):
        found_slopes = slope_of(on["slopes"], one_by_one(on["slopes"].session(), late(stream, offset_s)))
        assert np.abs(found_slopes - slope_at(WAY))[5:-3].max() < 0.007, offset_s


def test_time_that_goes_back_forgets_the_place(on):
    stream = messages(WAY[WAY < 450.0])
    session = on["slopes"].session()
    driven(on["slopes"], stream, session)
    session.start_anew()
    rows = driven(on["slopes"], [message for message in stream if message[0] == layout.SPEED], session)
    assert (reasons_of(rows) & Reason.PLACE_UNKNOWN).all()


@pytest.fixture(scope="module")
def replays(slopes, torques, tmp_path_factory):
    """Replays of one drive: with its slope recorded, with its position on the route, and with neither; none beyond 500 m."""
    folder = tmp_path_factory.mktemp("replays")
    write_route(folder / "route.csv", (slopes, torques))
    (folder / "surroundings.yaml").write_text("schema: 1\nvehicle: xgd24d\nroute: route.csv\neffects: {}\n")
    speed = np.concatenate([np.linspace(0.0, 8.0, 20), np.full(60, 8.0), np.linspace(8.0, 0.0, 20), np.zeros(60)])
    way = np.cumsum(speed)
    time = 1.76e9 + np.arange(len(way))
    latitude, longitude = np.degrees(Frame(LATITUDE, LONGITUDE).position(way, np.where(way > 500.0, 400.0, 0.0)))
    columns = {
        "grade": [slope_at(way)],
        "latitude_deg,longitude_deg": [latitude, longitude],
        "ambient_degc": [np.full(len(way), 15.0)],
    }
    tables = {}
    for name, series in columns.items():
        path = folder / f"{name[:5]}.csv"
        header = f"time_s,speed_mps,{name}"
        np.savetxt(path, np.column_stack([time, speed, *series]), delimiter=",", header=header, comments="", fmt="%.8f")
        vehicle = tr.load_vehicle("xgd24d", surroundings=folder / "surroundings.yaml")
        tables[name[:5]] = tr.replay(tr.read(path), vehicle).to_pandas()
    return way, folder, tables


def test_a_replay_has_slope_and_torque_of_the_route(replays):
    way, _, tables = replays
    on_it = (way > 60.0) & (way < 480.0)
    recorded_nm, by_place = (tables[name]["grade_nm"].to_numpy() for name in ("grade", "latit"))
    assert np.abs(recorded_nm[on_it]).max() > 1000.0
    assert np.abs(by_place - recorded_nm)[on_it].mean() < 0.1 * np.abs(recorded_nm[on_it]).mean()
    assert tables["latit"]["effects_nm"].to_numpy()[(way > 370.0) & (way < 480.0)] == pytest.approx(SOFT_NM, rel=1e-3)


def test_off_the_route_the_ground_is_level_and_firm_and_flagged(replays):
    way, _, tables = replays
    table, is_off = tables["latit"], way > 620.0
    assert (table["grade_nm"].to_numpy()[is_off] == 0.0).all()
    assert (table["effects_nm"].to_numpy()[is_off] == 0.0).all()
    reasons = table["reasons"].to_numpy().astype(int)
    assert ((reasons[is_off] & (Reason.OFF_ROUTE | Reason.PLACE_UNKNOWN)) == Reason.OFF_ROUTE).all()
    assert not (reasons[(way > 60.0) & (way < 480.0)] & Reason.OFF_ROUTE).any()
    reasons_without = tables["ambie"]["reasons"].to_numpy().astype(int)
    assert (reasons_without & Reason.OFF_ROUTE).all()
    assert (reasons_without & Reason.PLACE_UNKNOWN).all()


def test_a_simulation_follows_the_positions_of_its_profile(replays):
    way, folder, tables = replays
    vehicle = tr.load_vehicle("xgd24d", surroundings=folder / "surroundings.yaml")
    drive = tr.simulate(vehicle, profile=folder / "latit.csv", dt=0.5)
    time = drive["time_s"]
    way_m = np.interp(time, np.arange(len(way), dtype=float), way)
    is_soft, is_off = (way_m > 370.0) & (way_m < 470.0), way_m > 620.0
    assert drive["effects_nm"][is_soft] == pytest.approx(SOFT_NM, rel=1e-3)
    assert np.abs(drive["effects_nm"][is_off]).max() == 0.0
    replay_nm = np.interp(way_m, way, tables["latit"]["grade_nm"].to_numpy())
    uphill = (way_m > 60.0) & (way_m < 480.0)
    assert np.abs(drive["grade_nm"] - replay_nm)[uphill].mean() < 0.1 * np.abs(replay_nm[uphill]).mean()


@pytest.mark.parametrize("ends", [(0, 0), (30, 70)])
def test_a_place_is_unknown_in_a_simulation_as_in_a_replay(replays, tmp_path, ends):
    _, folder, _ = replays
    head, *lines = (folder / "latit.csv").read_text().splitlines()
    lines = [line if ends[0] <= i < ends[1] else line.rsplit(",", 2)[0] + ",," for i, line in enumerate(lines)]
    (tmp_path / "drive.csv").write_text("\n".join([head, *lines]))
    vehicle = tr.load_vehicle("xgd24d", surroundings=folder / "surroundings.yaml")
    drive, replay = tr.simulate(vehicle, profile=tmp_path / "drive.csv", dt=1.0), tr.replay(tmp_path / "drive.csv", vehicle)
    count = int((replay["reasons"].astype(int) & Reason.PLACE_UNKNOWN > 0).sum())
    assert 0 < count <= len(lines)
    assert f"{layout.REASON_TEXT[Reason.PLACE_UNKNOWN]} ({count} steps)" in drive.remarks


def test_a_simulation_over_the_date_line_is_as_elsewhere(replays, slopes, torques, tmp_path):
    _, folder, _ = replays
    table = np.genfromtxt(folder / "latit.csv", delimiter=",", names=True)
    shift = np.pi - np.quantile(slopes.longitude, 0.25)
    write_route(tmp_path / "route.csv", [replace(m, longitude=on_same_turn(m.longitude + shift, 0.0)) for m in (slopes, torques)])
    shutil.copy(folder / "surroundings.yaml", tmp_path)
    table["longitude_deg"] = (table["longitude_deg"] + np.degrees(shift) + 180.0) % 360.0 - 180.0
    assert np.ptp(table["longitude_deg"]) > 350.0
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", header=",".join(table.dtype.names), comments="", fmt="%.8f")
    base_run, date_line_run = (
        tr.simulate(tr.load_vehicle("xgd24d", surroundings=site / "surroundings.yaml"), profile=site / name, dt=0.5)
        for site, name in ((folder, "latit.csv"), (tmp_path, "drive.csv"))
    )
    for column in ("grade_nm", "effects_nm"):
        assert date_line_run[column] == pytest.approx(base_run[column], rel=0.01, abs=20.0)

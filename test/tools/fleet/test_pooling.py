# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pooling and changes: laws of the likelihoods, and findings in vehicles drawn by them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.tools.fleet.changes import (
    DAY_S,
    LASTING,
    RAMP,
    STEP,
    TrendLine,
    VehicleChange,
    VehicleHistory,
    exceeded,
    first_detection,
    fit,
    gains,
    lines_of,
    search,
    shapes,
    size_of,
    variants,
    vehicle_changes,
)  # fmt: skip
from trackres_ros.tools.fleet.pooling import Vehicles, pool, softened
from trackres_ros.tools.fleet.trends import forecast

NAMES = ("bearing_friction", "loss_modulus_scale", "drag_coefficient")
BETWEEN, WITHIN = np.array([0.3, 0.2, 0.1]), np.array([0.08, 0.05, 0.1])
MEAN = np.array([-0.5, 0.4, 0.0])


def drawn(vehicles=8, recordings=24, seed=3, moved=None, alike=0.0):
    """Vehicles whose bearing and loss look nearly alike; `moved(vehicle, recording)` is what changed, shape (p,), and `alike` how
    bearing and loss of a recording scatter together.
    """
    rng, p = np.random.default_rng(seed), len(NAMES)
    root = np.linalg.cholesky([[1.0, alike, 0.0], [alike, 1.0, 0.0], [0.0, 0.0, 1.0]])
    columns = {key: [] for key in ("vehicle", "time", "air", "precision", "linear")}
    for v in range(vehicles):
        own = MEAN + BETWEEN * rng.standard_normal(p)
        for r in range(recordings):
            slopes = rng.standard_normal((30, p)) * (8.0, 8.0, 3.0)
            slopes[:, 1] = slopes[:, 0] + 0.3 * slopes[:, 1]
            precision = slopes.T @ slopes
            true = own + WITHIN * (root @ rng.standard_normal(p)) + (0.0 if moved is None else moved(v, r))
            linear = precision @ true + np.linalg.cholesky(precision) @ rng.standard_normal(p)
            row = (f"v{v}", 1.7e9 + 2.0 * DAY_S * r, 0.5 * rng.standard_normal(), precision, linear)
            for key, value in zip(columns, row, strict=True):
                columns[key].append(value)
    arrays = {key: np.array(value) for key, value in columns.items()}
    return Vehicles(
        NAMES, ("1",) * p, np.ones(p), np.full(p, 0.1), arrays["vehicle"], arrays["time"], arrays["air"], arrays["precision"],
        arrays["linear"], tuple(map(str, range(len(arrays["vehicle"])))),
    )  # fmt: skip


@pytest.fixture(scope="module")
def quiet():
    return pool(drawn())


@given(st.integers(0, 10_000), st.floats(0.0, 2.0))
def test_a_scatter_takes_information_away_and_no_scatter_none(seed, std):
    rng = np.random.default_rng(seed)
    slopes = rng.standard_normal((5, 3))
    precision, linear = slopes.T @ slopes, rng.standard_normal(3)
    softer, moved = softened(precision, linear, std**2 * np.eye(3))
    assert np.linalg.eigvalsh(precision - softer).min() > -1e-9
    unchanged, same = softened(precision, linear, np.zeros((3, 3)))
    assert np.allclose(unchanged, precision)
    assert np.allclose(same, linear)
    # As a Gaussian with a known value and covariance: the two add.
    assert np.allclose(np.linalg.inv(softer), np.linalg.inv(precision) + std**2 * np.eye(3), rtol=1e-4)
    assert np.allclose(np.linalg.solve(softer, moved), np.linalg.solve(precision, linear), rtol=1e-4, atol=1e-6)


def test_what_differs_among_vehicles_and_recordings_is_found(quiet):
    assert np.abs(quiet.mean - MEAN).max() < 0.35
    within, between = (np.sqrt(np.diag(covariance)) for covariance in (quiet.recording_scatter, quiet.vehicle_scatter))
    assert np.all((within / WITHIN > 0.6) & (within / WITHIN < 1.6))
    assert np.all((between / BETWEEN > 0.4) & (between / BETWEEN < 2.5))


def test_what_scatters_together_is_found_to():
    def correlation(alike):
        within = pool(drawn(vehicles=12, recordings=40, alike=alike)).recording_scatter
        assert np.linalg.eigvalsh(within).min() > 0.0
        return within[0, 1] / np.sqrt(within[0, 0] * within[1, 1])

    opposed, apart, together = (correlation(alike) for alike in (-0.9, 0.0, 0.9))
    assert opposed < -0.6
    assert abs(apart) < 0.4
    assert together > apart + 0.2


def test_a_day_of_rain_counts_little_and_hides_no_change():
    def moved(v, r):
        return np.array([0.5 * (v == 2 and r >= 12) + 2.0 * ((5 * v + r) % 12 == 0), 0.0, 0.0])

    pooled = pool(drawn(moved=moved))
    wet = np.array([(5 * v + r) % 12 == 0 for v in range(8) for r in range(24)])
    assert pooled.weight[wet].max() < 0.2 * np.median(pooled.weight[~wet])
    found = {v: vehicle_changes(pooled, v)[0] for v in pooled.by_vehicle}
    assert [c.parameter for c in found.pop("v2")] == ["bearing_friction"]
    assert not any(found.values())


def test_an_uninformative_vehicle_is_pooled_to_its_types_mean():
    data = drawn(recordings=12)
    known = pool(data)
    faint = np.where(data.vehicle == "v0", 1e-9, 1.0)
    weak = replace(data, precision=data.precision * faint[:, None, None], linear=data.linear * faint[:, None])
    mean, covariance = pool(weak).by_vehicle["v0"]
    assert np.allclose(mean, pool(weak).mean, atol=1e-3)
    assert np.all(np.diag(covariance) > np.diag(known.by_vehicle["v0"][1]))


def test_more_vehicles_make_the_type_surer():
    few, many = (pool(drawn(vehicles=n, recordings=10)) for n in (3, 12))
    assert np.all(np.diag(many.covariance) < np.diag(few.covariance))


def test_the_order_of_rows_makes_no_difference():
    data = drawn(vehicles=3, recordings=8)
    rows = [
        {
            "status": "good", "names": list(NAMES), "units": ["1"] * 3, "nominal": [1.0] * 3, "std": [0.1] * 3, "vehicle": str(v),
            "start_s": float(t), "url": url, "mean_ambient": 15.0 + 10.0 * float(a),
            "precision": p[np.triu_indices(3)].tolist(), "linear": x.tolist(),
        }
        for v, t, a, p, x, url in zip(data.vehicle, data.time_s, data.air, data.precision, data.linear, data.urls, strict=True)
    ]  # fmt: skip
    (forward,), (backward,) = Vehicles.by_type(rows), Vehicles.by_type(rows[::-1])
    assert np.array_equal(forward.linear, backward.linear)
    assert np.allclose(forward.precision, data.precision)
    other = [{**row, "nominal": [2.0] * 3} if row["vehicle"] == "v1" else row for row in rows]
    assert sorted(len(of) for of in Vehicles.by_type(other)) == [8, 16]
    # What a factor multiplies is of the type; rows of earlier versions lack it.
    for of_files, sizes in (({"v1": 40.0}, [24]), ({"v1": 40.0, "v2": 48.0}, [8, 8, 8]), ({"v1": None}, [24])):
        found = Vehicles.by_type(
            [{**row, "of_file": [None, of_files[row["vehicle"]]]} if row["vehicle"] in of_files else row for row in rows]
        )
        assert sorted(len(of) for of in found) == sizes


@pytest.mark.parametrize("size", [0.4, -0.4])
def test_a_step_is_found_with_day_and_size_in_its_vehicle_alone(size):
    pooled = pool(drawn(moved=lambda v, r: np.array([size * (v == 2 and r >= 12), 0.0, 0.0])))
    found = {v: vehicle_changes(pooled, v)[0] for v in pooled.by_vehicle}
    (change,) = found.pop("v2")
    assert change.parameter == "bearing_friction"
    assert change.kind == STEP
    assert abs(change.since_s - (1.7e9 + 24.0 * DAY_S)) <= 2.0 * DAY_S
    assert abs(change.size - 0.1 * size) < 3.0 * change.size_std + 0.01
    assert change.recordings <= 10
    assert not any(found.values())


def test_what_rises_more_and_more_is_a_ramp_with_a_forecast():
    pooled = pool(drawn(moved=lambda v, r: np.array([0.08 * max(0, r - 8) * (v == 1), 0.0, 0.0])))
    change = vehicle_changes(pooled, "v1")[0][0]
    assert change.kind == RAMP
    assert change.parameter == "bearing_friction"
    last = 1.7e9 + 46.0 * DAY_S
    now = change.level + change.size
    told = forecast(change, last, now + change.size, 1.0)
    days = change.size / change.lines[0].slope
    assert days == pytest.approx((last - change.since_s) / DAY_S + 2.0)  # from the recording before its first
    assert told is not None
    assert told["from"] <= told["day"] <= (told["to"] or "9999")
    expected = np.datetime64("1970-01-01") + np.timedelta64(int((last + days * DAY_S) // DAY_S), "D")
    assert told["day"] == str(expected)
    assert forecast(change, last, None, 1.0) is None


@given(st.sampled_from([1.0, -1.0]), st.floats(0.1, 10.0), st.floats(-10.0, 10.0), st.floats(0.1, 10.0))
def test_a_limit_is_reached_only_on_the_way_of_the_trend(sign, size, before, far):
    line = TrendLine(sign * (before + size), 0.01 * sign * size, 0.0, (0.001 * size) ** 2, 0.0, 0.0)
    change = VehicleChange("x", (), RAMP, 0.0, DAY_S, 8, sign * before, sign * size, 0.1 * size, 20.0, (line,))

    def told(limit, in_file):  # both along the trend, which goes up or down
        return forecast(change, 100.0 * DAY_S, sign * limit, sign * in_file)

    behind, passed, ahead = before - far, before + 0.5 * size, before + size + far
    assert told(behind, before) is None  # the trend leads away, and the vehicle file is on the same side
    assert told(behind, behind - far)["reached"]  # it began beyond
    for in_file in (behind, before, ahead):
        assert told(passed, in_file)["reached"]
        assert told(ahead, in_file)["reached"] is False


LEAST = 9.0  # gain of a change, in log-likelihood


def history(true, seed, std=0.29):
    """Recordings every three days, each with the parameters `true`, shape (n, p), and noise."""
    (n, p), rng = true.shape, np.random.default_rng(seed)
    precision, value = np.tile(np.eye(p) / std**2, (n, 1, 1)), true + std * rng.standard_normal(true.shape)
    return VehicleHistory(precision, value / std**2, np.eye(p), np.zeros(p), 1.7e9 + 3.0 * DAY_S * np.arange(n), tuple(range(p)))


@pytest.mark.parametrize("seed", range(6))
def test_sizes_of_two_changes_are_true_within_three_stds(seed):
    day = 3.0 * np.arange(51)
    repaired = np.where(day < 40.0, 0.0, -1.5 + 0.02 * np.maximum(0.0, day - 60.0))
    of = history(repaired[:, None], seed)
    found = search(of, LEAST)
    whole, varied = fit(of, found), variants(of, found)
    assert sorted(change.kind for change in found) == [RAMP, STEP]
    for j, change in enumerate(found):
        size, std = size_of(whole, found, varied, j)
        assert abs(size - (-1.5 if change.kind == STEP else 1.8)) < 3.0 * std < 1.5


@pytest.mark.parametrize("kind", [STEP, RAMP])
def test_a_change_that_ended_is_found_as_before_its_end(kind):
    during = np.arange(40) - 11
    true = np.where((during > 0) & (during <= 16), 1.2 if kind == STEP else 0.12 * during, 0.0)
    for seed in range(6):
        of = history(true[:, None], seed)
        (change,) = found = search(of, LEAST)
        assert (change.kind, abs(change.end - 28) <= 1) == (kind, True)
        whole = fit(of, found)
        size, std = size_of(whole, found, variants(of, found), 0)
        assert abs(size - true.max()) < 3.0 * std < 1.5
        before = of.head(change.end)
        assert first_detection(of, found, 0, (), LEAST) == first_detection(before, search(before, LEAST), 0, (), LEAST)


@pytest.mark.parametrize("rest", [0.75, -0.8])
def test_a_fault_repaired_in_part_is_two_lasting_changes(rest):
    true = np.repeat([0.0, 1.5, rest], [12, 16, 12])
    for seed in range(6):
        of = history(true[:, None], seed)
        found = sorted(search(of, LEAST), key=lambda change: change.begin)
        assert [(change.kind, change.end) for change in found] == [(STEP, LASTING)] * 2
        for j, size in enumerate((1.5, rest - 1.5)):
            assert abs(size_of(fit(of, found), found, variants(of, found), j)[0] - size) < 0.6


def test_what_a_search_finds_a_search_until_then_found():
    ended = 0
    for seed in range(40):
        of = history(np.zeros((40, 4)), seed)
        found = search(of, 4.0)
        ended += any(change.end < 40 for change in found)
        assert not found or max(gains(of.head(count), ()).max() for count in range(4, 41)) >= 4.0
    assert ended


def test_a_change_that_others_explain_is_not_kept():
    day = 3.0 * np.arange(51)
    worn = np.where(day < 100.0, 0.03 * np.maximum(0.0, day - 30.0), 0.02 * np.maximum(0.0, day - 100.0))
    of = history(worn[:, None], seed=0)
    found = search(of, LEAST)
    assert len(found) == 2  # and a third on the way to them
    assert fit(of, found).gain.min() >= LEAST


def test_the_range_of_a_forecast_covers_the_truth():
    day, inside, begin = 3.0 * np.arange(31), 0, np.datetime64("2023-11-14")
    for seed in range(30):
        of = history(0.02 * np.maximum(0.0, day - 30.0)[:, None], seed, std=0.15)
        found = search(of, LEAST)[:1]
        lines = lines_of(variants(of, found), 0, 0.0, 1.0)
        change = VehicleChange("x", (), RAMP, 0.0, 0.0, 8, 0.0, 1.2, 0.1, 20.0, lines)
        told = forecast(change, of.time_s[-1], 2.4, 0.0)
        inside += np.datetime64(told["from"]) <= begin + 151 and begin + 149 <= np.datetime64(told["to"] or "2099")
    assert inside >= 27


def test_a_change_is_known_when_a_search_until_then_finds_it():
    day = 3.0 * np.arange(51)
    for seed in range(3):
        of = history(np.stack((1.2 * (day >= 20.0), 0.03 * np.maximum(0.0, day - 60.0)), axis=1), seed)
        found = search(of, LEAST)
        assert sorted(change.parameter for change in found) == [0, 1]
        for j, change in enumerate(found):
            seen = first_detection(of, found, j, (), LEAST)
            for count, there in ((seen, False), (seen + 1, True)):
                assert (change.parameter in {f.parameter for f in search(of.head(count), LEAST)}) is there


def test_a_ramp_begins_with_the_recording_before_its_first():
    time = 86400.0 * np.arange(5.0)
    assert shapes(time, 2, RAMP).tolist() == [0.0, 0.0, 1.0, 2.0, 3.0]
    assert shapes(time, 2, STEP).tolist() == [0.0, 0.0, 1.0, 1.0, 1.0]


def test_a_rarer_false_alarm_asks_for_more():
    highest = np.random.default_rng(0).gumbel(4.0, 1.0, 400)
    least = [exceeded(highest, share) for share in (0.3, 0.05, 0.001)]
    assert least == sorted(least)
    assert least[-1] > highest.mean() + 4.0
    assert np.mean(highest > least[1]) <= 0.05


def test_one_recording_of_one_vehicle_can_be_pooled():
    pooled = pool(drawn(vehicles=1, recordings=1))
    assert vehicle_changes(pooled, "v0")[0] == []

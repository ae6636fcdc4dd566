# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Standard deviations of the estimate due to the plausible ranges of the vehicle file.

Each value is changed slightly, the vehicle driven again, and the change compared with the estimator's departures.
"""

from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.effects import Active, catalogue
from trackres_ros.estimator.constants import REFERENCE_SPEED_SHARE, logarithms_at, spread
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.kernel import LEAST_STD_SHARE
from trackres_ros.estimator.settings import Settings
from trackres_ros.model.track import load_range, track_model, with_methods
from trackres_ros.vehicle import load, variants
from trackres_ros.vehicle.belt_bulk import heat_capacity

CERTAIN = Settings(initial_belt_std_k=0.0, process_noise_k=0.0, ambient_std_k=0.0, ambient_unknown_std_k=0.0)
BELT = "tracks.triangular.belt"
ALL = (
    f"{BELT}.exposed_share",
    f"{BELT}.film_slope",
    "rubber.loss_modulus_scale",
    "rubber.heat_capacity",
    "tracks.triangular.sprocket_radius",
    "chassis.bearing_friction",
    "chassis.drag_coefficient",
)
TIME_S = np.arange(0.0, 3000.0, 1.0)
STEP = 0.2  # of a standard deviation


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache of its own: the varied vehicles are of no use to anybody else."""
    return tmp_path_factory.mktemp("cache")


def with_open_ranges(vehicle, paths):
    """The vehicle with every quantity certain but those named."""
    fixed_quantities = {
        path: q if path in paths or isinstance(q.value, tuple) else replace(q, low=q.value, high=q.value)
        for path, q in vehicle.parameters.items()
    }
    return replace(vehicle, parameters=fixed_quantities)


def drive(vehicle, cache, speed, config=CERTAIN, ambient=15.0):
    """Columns of a drive at constant speed from belts at the ambient temperature."""
    estimator = Estimator(vehicle, config, cache)
    start = estimator.cold_start(estimator.inputs(speed, ambient=ambient))
    _, rows = estimator.run(start, TIME_S, np.full_like(TIME_S, speed), vehicle.weight, ambient, 0.0)
    return {name: rows[:, i] for name, i in estimator.column_index.items()}


@pytest.fixture(scope="module")
def ends(cache):
    """The drives with a quantity moved up and down, each made once."""
    cache_of = {}

    def end_drives(vehicle, path):
        if (vehicle.thermal, path) not in cache_of:
            quantity, build = vehicle.parameters[path], variants(vehicle)
            variants_of = [build({path: quantity.value + sign * STEP * quantity.standard_deviation}) for sign in (1, -1)]
            cache_of[vehicle.thermal, path] = [
                drive(with_open_ranges(variant, []), cache, reference_speed(vehicle)) for variant in variants_of
            ]
        return cache_of[vehicle.thermal, path]

    return end_drives


def by_differences(vehicle, ends, paths, column):
    """Standard deviation of a column: root of the sum of squares over the quantities, each by a central difference."""
    squares = np.zeros_like(TIME_S)
    for path in paths:
        high_end, low_end = (end[column] for end in ends(vehicle, path))
        squares += ((high_end - low_end) / (2 * STEP)) ** 2
    return np.sqrt(squares)


def at_least(expected, carried, column):
    """A standard deviation of the torque is never less than the error of a torque transducer."""
    return np.maximum(expected, LEAST_STD_SHARE * carried["resistance_torque_nm"]) if column == "resistance_std_nm" else expected


def reference_speed(vehicle):
    return REFERENCE_SPEED_SHARE * vehicle.chassis.max_speed


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "tolerance"),
    [
        (f"{BELT}.exposed_share", 0.01),
        (f"{BELT}.film_slope", 0.01),
        ("rubber.heat_capacity", 0.01),
        ("rubber.loss_modulus_scale", 0.03),
    ],
)
def test_uncertainty_of_one_quantity_is_the_change_it_makes(xgd24d, cache, ends, path, tolerance):
    rows = drive(with_open_ranges(xgd24d, [path]), cache, reference_speed(xgd24d))
    for std_column, column in (("belt_std_k/front_left", "belt_degc/front_left"), ("resistance_std_nm", "resistance_torque_nm")):
        expected = at_least(by_differences(xgd24d, ends, [path], column), rows, std_column)
        assert rows[std_column] == pytest.approx(expected, rel=tolerance, abs=0.003 * expected.max() + 0.01)
        assert expected.max() > 0.1


@pytest.mark.long
@pytest.mark.parametrize("thermal", ["lumped", "core_surface"])
def test_the_uncertainty_of_many_quantities_adds_in_squares(xgd24d, cache, ends, thermal):
    vehicle = with_methods(xgd24d, thermal=thermal)
    rows = drive(with_open_ranges(vehicle, ALL), cache, reference_speed(vehicle))
    for std_column, column in (("belt_std_k/front_left", "belt_degc/front_left"), ("resistance_std_nm", "resistance_torque_nm")):
        expected = at_least(by_differences(vehicle, ends, ALL, column), rows, std_column)
        assert rows[std_column] == pytest.approx(expected, rel=0.04, abs=0.02 * expected.max())


def test_a_certain_vehicle_is_certain(xgd24d, cache):
    rows = drive(with_open_ranges(xgd24d, []), cache, 10.0)
    assert rows["belt_std_k/front_left"].max() < 1e-3
    assert rows["resistance_std_nm"] == pytest.approx(LEAST_STD_SHARE * rows["resistance_torque_nm"], rel=1e-6)
    rest_rows = drive(with_open_ranges(xgd24d, []), cache, 0.0)
    assert rest_rows["resistance_std_nm"][0] == pytest.approx(rows["resistance_std_nm"][0], rel=0.5)  # friction has a size


def test_the_uncertainty_of_the_ambient_temperature(xgd24d, cache):
    """An offset of the ambient temperature that was there from the start."""
    offset = 0.5
    rows = drive(with_open_ranges(xgd24d, []), cache, 10.0, replace(CERTAIN, ambient_std_k=offset))
    ends = [drive(xgd24d, cache, 10.0, ambient=15.0 + sign * offset) for sign in (1, -1)]
    for std_column, column in (("belt_std_k/front_left", "belt_degc/front_left"), ("resistance_std_nm", "resistance_torque_nm")):
        assert rows[std_column] == pytest.approx(
            at_least(np.abs(ends[0][column] - ends[1][column]) / 2, rows, std_column), rel=0.01, abs=1e-3
        )


def test_uncertainty_of_the_start_fades(xgd24d, cache):
    """A belt 5 K warmer or colder is forgotten during the drive; random departures stay bounded."""
    stds = drive(with_open_ranges(xgd24d, []), cache, 10.0, replace(CERTAIN, initial_belt_std_k=5.0))["belt_std_k/front_left"]
    assert stds[0] == pytest.approx(5.0, rel=1e-3)
    assert (np.diff(stds) < 0.0).all()
    assert stds[-1] < 0.1
    walk = drive(with_open_ranges(xgd24d, []), cache, 10.0, replace(CERTAIN, process_noise_k=0.02))["belt_std_k/front_left"]
    assert (np.diff(walk) > -1e-9).all()
    assert walk[-1] == pytest.approx(walk[-600], rel=0.02)


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("convection", 0.02), ("ground_conduction", 0.02), ("compound_temperature", 0.02), ("frequency", 0.02),
        ("core_surface", 0.1),  # which takes longer to heat the inside than less film does
    ],
)  # fmt: skip
def test_uncertainty_of_an_effect_is_the_change_it_makes(xgd24d, cache, name, tolerance):
    """Of a warm belt, whose heat it changes; all its ranges add in squares."""
    effect, fixed_vehicle, speed = catalogue()[name], with_open_ranges(xgd24d, []), 0.8 * xgd24d.chassis.max_speed
    values, width = effect.values(), {q.name: 0.1 * (q.high - q.low) for q in effect.parameters if q.off is not None}

    def drive_with(changes, ranges):
        return drive(replace(fixed_vehicle, effects=(Active(effect, {**values, **changes}, ranges),)), cache, speed)

    rows = drive_with(
        {}, {parameter: (values[parameter] - width[parameter], values[parameter] + width[parameter]) for parameter in width}
    )
    for std_column, column in (("belt_std_k/front_left", "belt_degc/front_left"), ("resistance_std_nm", "resistance_torque_nm")):
        squares = 0.0
        for parameter, span in width.items():
            high_end, low_end = (
                drive_with({parameter: values[parameter] + sign * STEP * span / 2.0}, {})[column][-1] for sign in (1, -1)
            )
            squares += ((high_end - low_end) / (2.0 * STEP)) ** 2
        assert rows[std_column][-1] == pytest.approx(squares**0.5, rel=tolerance)
        assert squares**0.5 > 0.1


def test_one_quantity_moves_loss_cooling_and_capacity_together(xgd24d, cache):
    """A wider belt cools better and holds more heat at once: the covariance keeps that, it has rank one."""
    belt, rubber, path = xgd24d.tracks["triangular"].belt, xgd24d.rubber, f"{BELT}.width"
    std = xgd24d.parameters[path].standard_deviation
    covariance = (factor := spread(with_open_ranges(xgd24d, [path]), "triangular", cache).factor) @ factor.T
    heat = heat_capacity(belt, rubber) / belt.loop_length
    cooling, capacity = std / (belt.width + belt.thickness), std * belt.thickness * rubber.density * rubber.heat_capacity / heat
    assert covariance[1, 1] == pytest.approx(cooling**2, rel=1e-3)
    assert covariance[2, 2] == pytest.approx(capacity**2, rel=1e-3)
    assert covariance[1, 2] == pytest.approx(cooling * capacity, rel=1e-3)
    assert np.linalg.matrix_rank(covariance, tol=1e-3 * covariance[2, 2]) == 1


@pytest.mark.parametrize("hysteresis", ["spectral", "rainflow"])
def test_an_uncertain_loss_is_that_of_the_vehicles_method(xgd24d, hysteresis):
    vehicle, belts = with_methods(xgd24d, hysteresis=hysteresis), np.array([10.0, 60.0])
    exact_loss = track_model(vehicle, "triangular").loss.loss_force(8.0, belts, load_range(vehicle, "triangular").nominal).total
    assert np.exp(logarithms_at(vehicle, "triangular", 8.0, belts, vehicle)[:2]) == pytest.approx(exact_loss, rel=0.01)


@pytest.mark.parametrize("path", ["chassis.bearing_friction", "chassis.drag_coefficient"])
def test_a_value_of_0_is_as_uncertain_as_one_next_to_it(path):
    def std(vehicle):
        estimator = Estimator(vehicle)
        inputs = estimator.inputs(8.0, acceleration=0.0)
        return float(estimator.step(estimator.cold_start(inputs), inputs, 0.0)[1].resistance_std_nm)

    build = variants(load("agri3t"))
    zero_vehicle = build({path: 0.0})
    fixed = replace(zero_vehicle.parameters[path], low=0.0, high=0.0)
    assert std(zero_vehicle) == pytest.approx(std(build({path: 1e-9})), rel=1e-6)
    assert std(zero_vehicle) > std(replace(zero_vehicle, parameters={**zero_vehicle.parameters, path: fixed}))


def test_every_range_of_the_shipped_file_counts(vehicle, cache):
    """The variance from all ranges is the sum of the variances from each half of them."""
    name = next(iter(vehicle.tracks))
    paths = [path for path in vehicle.parameters if path.startswith(("rubber.", "tracks."))]
    parts = [spread(with_open_ranges(vehicle, half), name, cache).factor for half in (paths[::2], paths[1::2])]
    total = spread(vehicle, name, cache).factor
    assert total @ total.T == pytest.approx(sum(part @ part.T for part in parts), rel=1e-6, abs=1e-9)
    assert (np.diag(total) > 0.03).all()

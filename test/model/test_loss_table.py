# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The loss on a grid: how near it is to the exact method, and when its cached form may be used."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.model import loss_table as lt
from trackres_ros.model.coverage import coverage
from trackres_ros.model.hysteresis import METHODS
from trackres_ros.model.loss_table import fingerprint, interpolation_error, loss_table
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.track import load_range, track_model, with_methods
from trackres_ros.vehicle import load, variants

LARGEST_ERROR = {"spectral": 0.003, "rainflow": 0.003}  # of the loss


@pytest.mark.long
@pytest.mark.parametrize("method", list(METHODS))
def test_the_table_is_as_good_as_it_says(vehicle, method):
    """At random speeds, temperatures, loads and torques of the whole range."""
    vehicle = with_methods(vehicle, hysteresis=method)
    name = next(iter(vehicle.tracks))
    errors = interpolation_error(
        track_model(vehicle, name),
        loss_table(vehicle, name),
        load_range(vehicle, name),
        vehicle.chassis.max_speed,
        points=600,
        seed=7,
    )
    assert np.abs(errors).max() < LARGEST_ERROR[method]


@pytest.mark.parametrize("moved", [-49.0, -20.0, 10.0])
def test_another_reference_of_the_same_shift_changes_nothing(xgd24d, moved):
    """WLF constants about another reference, as a fit or a data sheet gives them: their product and their pole are the same."""
    r, kind = xgd24d.rubber, "triangular"
    constants = {"glass_transition": r.glass_transition + moved, "wlf_c2": r.wlf_c2 + moved}
    constants["wlf_c1"] = r.wlf_c1 * r.wlf_c2 / constants["wlf_c2"]
    variant = variants(xgd24d)({f"rubber.{name}": value for name, value in constants.items()})
    belts, speed, load_n = np.array([[0.0], [40.0], [110.0]]), np.array([0.05, 2.0, 15.0]), 60e3
    base_loss, variant_loss = (
        loss_table(v, kind).loss_at(np.log10(speed) + RubberModel(v.rubber).log_shift(belts), load_n) for v in (xgd24d, variant)
    )
    assert variant_loss == pytest.approx(base_loss, rel=1e-4)


def test_a_shift_too_wide_for_the_axis_is_outside_where_it_ends(xgd24d):
    vehicle = variants(xgd24d)({"rubber.glass_transition": -20.0, "rubber.wlf_c2": 51.0})
    low, high = lt.log_speeds(RubberModel(vehicle.rubber))
    assert high - low == lt.WIDEST
    assert coverage(vehicle, "triangular").log_reduced_speed <= high


@pytest.fixture(scope="module")
def table(xgd24d):
    return loss_table(xgd24d, "triangular")


@given(x=st.floats(-20.0, 20.0), share=st.floats(0.0, 1.0), reach=st.floats(1.0, 100.0))
def test_beyond_its_edges_the_table_holds_its_values(table, x, share, reach):
    last_x = table.first_x + table.step_x * (len(table.loss) - 1)
    low, high = table.first_log_load, table.first_log_load + table.step_log_load * (table.loss.shape[1] - 1)
    load_n = float(np.exp(low + share * (high - low)))
    assert table.loss_at(x, load_n) == pytest.approx(float(table.loss_at(np.clip(x, table.first_x, last_x), load_n)), rel=1e-5)
    assert table.loss_at(0.0, np.exp(low) / reach) == pytest.approx(float(table.loss_at(0.0, np.exp(low))), rel=1e-5)
    assert table.loss_at(0.0, np.exp(high) * reach) == pytest.approx(float(table.loss_at(0.0, np.exp(high))), rel=1e-5)


@given(x=st.floats(-7.9, 9.4), log_load=st.floats(9.6, 11.9))
def test_the_slope_is_that_of_the_interpolation(table, x, log_load):
    arguments = (table.loss[np.newaxis], 0, table.first_x, table.step_x, table.first_log_load, table.step_log_load)
    value, slope = lt.look_up(*arguments, x, log_load)
    cell = int((x - table.first_x) / table.step_x)
    left_x, right_x = (table.first_x + table.step_x * (cell + share) for share in (0.25, 0.75))
    chord = (lt.look_up(*arguments, right_x, log_load)[0] - lt.look_up(*arguments, left_x, log_load)[0]) / (right_x - left_x)
    assert slope == pytest.approx(chord, rel=1e-6, abs=1e-6)
    assert value > 0.0


def test_the_table_covers_a_bare_frame_and_an_overloaded_vehicle(vehicle):
    """From hardly more than the assembly itself to two and a half times the nominal load."""
    for name, track in vehicle.tracks.items():
        loads, losses = load_range(vehicle, name), loss_table(vehicle, name)
        assert track.own_weight < loads.low < track.own_weight + 0.05 * (loads.nominal - track.own_weight)
        assert loads.high == pytest.approx(2.5 * loads.nominal)
        end = losses.first_log_load + losses.step_log_load * (losses.loss.shape[1] - 1)
        assert np.exp([losses.first_log_load, end]) == pytest.approx([loads.low, loads.high])


def test_speed_and_temperature_enter_as_one_number(xgd24d):
    """The table has one axis for both: equal a_T v must mean equal loss by the exact methods."""
    rng = np.random.default_rng(4)
    for method in METHODS:
        model = track_model(with_methods(xgd24d, hysteresis=method), "triangular")
        belt_degc, speed = rng.uniform(-40.0, 100.0, 10), np.exp(rng.uniform(np.log(0.1), np.log(16.0), 10))
        other_degc = belt_degc + rng.uniform(-8.0, 8.0, 10)
        equal_speed = speed * 10.0 ** (model.rubber.log_shift(belt_degc) - model.rubber.log_shift(other_degc))
        loss_1, loss_2 = (
            model.loss.loss_force(speed, belt_degc, 68e3).total,
            model.loss.loss_force(equal_speed, other_degc, 68e3).total,
        )
        assert loss_2 == pytest.approx(loss_1, rel=1e-7)


# The cache


@pytest.fixture
def built(monkeypatch, xgd24d, table):
    """Grows by one each time a table is built; the building itself is replaced by a table there is."""
    calls = []
    arrays = {
        "axes": np.array([table.first_x, table.step_x, table.first_log_load, table.step_log_load]),
        "loss": table.loss,
        "drive": table.drive,
    }

    def build(*_):
        calls.append("built")
        return arrays

    monkeypatch.setattr(lt, "build", build)
    return calls


def same(table_a, table_b):
    return (
        np.array_equal(table_a.loss, table_b.loss)
        and np.array_equal(table_a.drive, table_b.drive)
        and (table_a.first_x, table_a.step_x, table_a.first_log_load, table_a.step_log_load)
        == (table_b.first_x, table_b.step_x, table_b.first_log_load, table_b.step_log_load)
    )


def stored(folder):
    files = list(folder.iterdir())
    assert len(files) == 1  # no temporary file stays behind
    return files[0]


def test_the_second_call_takes_the_cache(xgd24d, built, tmp_path):
    table_1, table_2 = loss_table(xgd24d, "triangular", tmp_path), loss_table(xgd24d, "triangular", tmp_path)
    assert len(built) == 1
    assert same(table_1, table_2)
    assert xgd24d.name not in stored(tmp_path).name  # the key is a fingerprint, so a renamed vehicle finds its table


def test_the_table_of_the_cache_is_the_one_built(agri3t, tmp_path):
    """Built in earnest: to the last bit what comes out of the file."""
    name = next(iter(agri3t.tracks))
    assert same(loss_table(agri3t, name, tmp_path), loss_table(agri3t, name, tmp_path))


# Inputs of the fingerprint


def relevant(vehicle):
    """Scalar quantities of rubber, track and axle loads."""
    return [
        path
        for path, quantity in vehicle.parameters.items()
        if path.startswith(("rubber.", "tracks.", "chassis.axles.")) and not isinstance(quantity.value, tuple)
    ]


def nudge(quantity):
    assert isinstance(quantity.value, float)
    return quantity.value * (1.0 + 1e-7) if abs(quantity.value) < 1e9 else quantity.value + 1.0


def test_any_value_changes_the_fingerprint(vehicle):
    name, build = next(iter(vehicle.tracks)), variants(vehicle)
    base, paths = fingerprint(vehicle, name), relevant(vehicle)
    assert len(paths) > 40
    for path in paths:
        assert fingerprint(build({path: nudge(vehicle.parameters[path])}), name) != base, path


def test_the_fingerprint_follows_the_loss_method_not_other_parts(xgd24d):
    base = fingerprint(xgd24d, "triangular")
    assert fingerprint(with_methods(xgd24d, hysteresis="rainflow"), "triangular") != base
    assert fingerprint(with_methods(xgd24d, thermal="core_surface"), "triangular") == base
    assert fingerprint(variants(xgd24d)({"chassis.drag_coefficient": 0.9}), "triangular") == base
    assert fingerprint(replace(xgd24d, name="another"), "triangular") == base


def test_comments_and_reasons_do_not_change_the_fingerprint(xgd24d, configuration):
    path = configuration / "xgd24d.yaml"
    text = path.read_text(encoding="utf-8")
    path.write_text("# one more remark\n" + text.replace('geometry"', 'geometry, measured again"'), encoding="utf-8")
    assert fingerprint(load(path), "triangular") == fingerprint(xgd24d, "triangular")
    path.write_text(yaml.safe_dump(yaml.safe_load(text)), encoding="utf-8")  # keys in another order, no comments
    assert fingerprint(load(path), "triangular") == fingerprint(xgd24d, "triangular")


@pytest.mark.parametrize("column", ["T_degC", "E_storage_MPa_10Hz", "E_loss_MPa_10Hz"])
def test_any_number_of_the_rubber_file_changes_the_fingerprint(xgd24d, configuration, column):
    path = configuration / "rubber" / xgd24d.source.parent.joinpath("rubber", "nr_sbr_10hz.csv").name
    with path.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    rows[20][column] = str(float(rows[20][column]) + 1e-3)
    with path.open("w", newline="", encoding="utf-8") as lines:
        writer = csv.DictWriter(lines, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    assert fingerprint(load(configuration / "xgd24d.yaml"), "triangular") != fingerprint(xgd24d, "triangular")


def test_a_further_column_of_the_rubber_file_does_not(xgd24d, configuration):
    path = configuration / "rubber" / "nr_sbr_10hz.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([lines[0] + ",remark", *(line + ",x" for line in lines[1:])]) + "\n", encoding="utf-8")
    assert fingerprint(load(configuration / "xgd24d.yaml"), "triangular") == fingerprint(xgd24d, "triangular")

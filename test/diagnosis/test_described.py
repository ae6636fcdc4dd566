# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A torque that the catalogue does not know, added to simulated recordings: described, and written where it is known ahead."""

import re
from dataclasses import replace
from typing import get_args

import csv_tables
import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.diagnosis import DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.diagnosis.empirical.term import Form
from trackres_ros.diagnosis.report.content import report
from trackres_ros.diagnosis.report.pictures import term_chart
from trackres_ros.diagnosis.report.static import draw
from trackres_ros.diagnosis.synthetic import drives, write_recordings
from trackres_ros.estimator.disturbance import BLOCK_S
from trackres_ros.files.resources import config_dir
from trackres_ros.vehicle import load, load_any

TURN_NM = 600.0
DRIFT_NM, DRIFT_S = 200.0, 240.0
PUMP_NM, ON_S, OFF_S = 400.0, 70.0, 110.0
SLOPE_NM, LAP_M, BEGIN_M, END_M = 500.0, 700.0, 200.0, 320.0


def with_added(recordings, adds):
    """Recordings with a torque added, of (recording, times [s])."""
    results = []
    for r in recordings:
        torque = r.series["torque"].value + adds(r, r.time_s("torque"))
        results.append(replace(r, series={**r.series, "torque": replace(r.series["torque"], value=torque)}))
    return results


def at(r, role, times):
    return np.interp(times, r.time_s(role), r.series[role].value)


def test_report_json_may_have_each_form_of_a_term(forms_in_schema):
    assert sorted(forms_in_schema) == sorted(get_args(Form))


@pytest.fixture(scope="module")
def bus():
    return load_base("ztbus_hess19")


@pytest.fixture(scope="module")
def of_bus(bus, tmp_path_factory):
    """Recordings of a bus with nothing hidden: it is fitted in a fraction of the time of belts."""
    rng = np.random.default_rng(1)
    sessions = [replace(s, given=s.given | {"load"}) for s in drives(bus.base, 14.0, 2, 10.0, rng)]
    return read_recordings(write_recordings(bus.base, tmp_path_factory.mktemp("bus"), sessions, [], rng), None)


def described(recordings, loaded):
    """The diagnosis of recordings in which one term without a name is confirmed, and that term."""
    result = diagnose(recordings, loaded, DiagnosisOptions(quick=True))
    assert (result.verdict.status, result.verdict.grade) == ("described", "confirmed")
    (statement,) = result.described
    return result, statement


def written(found, folder, **changes):
    """The vehicle file that a diagnosis leaves."""
    path = folder / "vehicle.yaml"
    found.base.write(path, replace(found.kept, **changes), "Written by trackres diagnose from x.")
    return path


@pytest.mark.long
def test_a_torque_in_left_turns_is_described_and_written(of_bus, bus, tmp_path):
    def adds(r, times):
        return TURN_NM * ((at(r, "yaw_rate", times) > 0.01) & (at(r, "speed", times) > 0.1))

    result, statement = described(with_added(of_bus, adds), bus)
    assert result.found == ()
    assert statement.form == "step"
    assert statement.variable == "yaw rate to the left"
    assert statement.size_nm == pytest.approx(TURN_NM, rel=0.15)
    (effect,) = load_any(written(result, tmp_path)).effects
    assert effect.effect.name == statement.name
    assert effect.effect.name == "step_of_yaw_rate"
    sessions, values = result.sessions, result.final.base_values
    for s, bare, p in zip(sessions, *(result.base.predict(sessions, values, e) for e in ((), (effect,))), strict=True):
        adds = p.torque - bare.torque
        remainder = (s.yaw_rate > 0.05) & (s.speed > 1.0)
        assert np.median(adds[remainder]) == pytest.approx(TURN_NM, rel=0.1)
        assert np.abs(adds[s.yaw_rate < 0.0]).max() < 1e-3


@pytest.fixture(scope="module")
def pumped(recorded, loaded):
    """Three recordings with a pump, the diagnosis of two of them, and when the pump runs [s] in each."""
    rng, changes = np.random.default_rng(4), []

    def adds(r, times):
        changes.append(np.cumsum(rng.uniform(0.6, 1.4, 200) * np.tile([OFF_S, ON_S], 100)))
        return PUMP_NM * runs(changes[-1], times) * (at(r, "speed", times) > 0.1)

    recordings = with_added(read_recordings(recorded(count=3), None), adds)
    return recordings, diagnose(recordings[:2], loaded, DiagnosisOptions(quick=True)), changes


def runs(changes, times):
    return np.searchsorted(changes, times) % 2


@pytest.mark.long
def test_spells_are_described_and_written_only_as_a_disturbance(pumped, tmp_path):
    _, result, changes = pumped
    (statement,) = [t for t in result.described if t.form == "spells"]
    assert not statement.predictable
    runs_of = [np.sum(value[::2][:100] < s.time[s.used][-1]) for value, s in zip(changes, result.sessions, strict=False)]
    counted = int(re.search(r"(\d+) times in these recordings", statement.sentence)[1])
    assert abs(counted - sum(runs_of)) <= 2  # on all laps, over stops
    assert statement.size_nm == pytest.approx(PUMP_NM, rel=0.2)
    assert 0.5 * ON_S < statement.memory < 2.0 * ON_S
    assert statement.name not in {a.effect.name for a in result.kept.effects}
    vehicle = load(written(result, tmp_path))
    assert statement.name not in {a.effect.name for a in vehicle.effects}
    spells = vehicle.disturbance
    assert spells.level - spells.rest == pytest.approx(PUMP_NM, rel=0.2)
    assert 0.5 * ON_S < spells.mean_there < 2.0 * ON_S
    assert 0.5 * OFF_S < spells.mean_away < 2.0 * OFF_S
    assert spells.noise < 0.5 * PUMP_NM


@pytest.mark.long
def test_a_replay_follows_the_spells_and_changes_no_other_column(pumped, tmp_path):
    recordings, result, changes = pumped
    watching, bare = (tr.replay(recordings[2], written(result, tmp_path, **changes)) for changes in ({}, {"disturbance": None}))
    assert set(watching.columns) - set(bare.columns) == {"disturbance_probability", "disturbance_torque_nm"}
    for name in bare.columns:
        assert watching[name].tobytes() == bare[name].tobytes()
    table = np.genfromtxt(watching.save(tmp_path / "out.csv"), delimiter=",", names=True, deletechars="")
    assert table.dtype.names == watching.columns
    np.testing.assert_array_equal(table["disturbance_torque_nm"], watching["disturbance_torque_nm"])
    counts = (watching["speed_mps"] > 1.0) & (np.abs(watching["accel_mps2"]) < 0.3) & np.isfinite(watching["residual_nm"])
    time = watching["time_s"]
    block = (time[counts] // BLOCK_S).astype(int)
    number = np.maximum(np.bincount(block), 1)

    def error(residual):
        return np.abs(np.bincount(block, residual[counts]) / number)[np.bincount(block) > 0].mean()

    without, with_it = error(watching["residual_nm"]), error(watching["residual_nm"] - watching["disturbance_torque_nm"])
    assert with_it < 0.6 * without
    on, there = runs(changes[2], time)[counts] > 0, watching["disturbance_probability"][counts]
    assert np.mean(there[on]) > 0.8
    assert np.mean(there[~on]) < 0.2


@pytest.mark.long
def test_a_drift_is_judged_by_following_it_and_written_as_such(recorded, loaded, check_form, tmp_path):
    rng = np.random.default_rng(4)

    def adds(r, times):
        keep, wander = np.exp(-1.0 / DRIFT_S), [0.0]
        for shock in rng.normal(0.0, DRIFT_NM * np.sqrt(1.0 - keep**2), int(times[-1]) + 1):
            wander.append(keep * wander[-1] + shock)
        return np.interp(times, np.arange(len(wander)), wander) * (at(r, "speed", times) > 0.1)

    recordings = with_added(read_recordings(recorded(minutes=15.0), None), adds)
    result = diagnose(recordings, loaded, DiagnosisOptions(quick=True))
    assert (result.verdict.status, result.verdict.grade) == ("described", "confirmed")
    assert "a torque sensor with a drifting zero" in result.verdict.sentence
    text = report(result, [])
    check_form({**text, "recordings": ["x"]})
    (drift,) = [item for item in text["described"] if item["form"] == "drift"]
    assert drift["grade"] == "confirmed"
    assert drift["heldout"]["mae"][1] < 0.5 * drift["heldout"]["mae"][0]
    assert text["written"]["disturbance"] == "drift"
    learned_values = load(written(result, tmp_path)).disturbance
    assert 0.5 * DRIFT_NM < learned_values.size < 2.0 * DRIFT_NM
    assert learned_values.noise < 0.5 * learned_values.size


@pytest.mark.long
def test_a_torque_repeated_at_a_place_is_described_never_written(of_bus, bus, check_form, tmp_path):
    def adds(r, times):
        speed = np.abs(at(r, "speed", times))
        place = np.cumsum(speed * np.gradient(times)) % LAP_M
        return SLOPE_NM * ((place > BEGIN_M) & (place < END_M)) * (speed > 0.1)

    result, statement = described(with_added(of_bus, adds), bus)
    assert statement.form == "place"
    assert statement.period_m == pytest.approx(LAP_M, rel=0.01)
    assert statement.size_nm == pytest.approx(SLOPE_NM, rel=0.2)
    assert "passes" in statement.sentence
    assert result.kept.effects == ()
    check_form(report(result, []) | {"recordings": ["drive_1.csv"]})
    pytest.importorskip("matplotlib")
    assert "place on the route" in draw(term_chart(result, statement), tmp_path / "place.svg").alternative


def test_where_nothing_is_hidden_nothing_is_described(diagnoses):
    result = diagnoses()
    assert result.described == ()
    assert result.verdict.status == "none"


@pytest.mark.long
def test_written_spells_are_those_of_a_replay_with_the_new_scale(tmp_path):
    content = yaml.safe_load((config_dir() / "bmw_i3.yaml").read_text())
    content["road_load"]["mass"]["range"] = [1400.0, 1400.0]
    content["road_load"]["torque_scale"].update(value=0.3, range=[0.2, 0.5])
    (tmp_path / "car.yaml").write_text(yaml.safe_dump(content))
    base, rng, paths = load_base(tmp_path / "car.yaml").base, np.random.default_rng(5), []
    for session in drives(base, 30.0, 2, 20.0, rng):
        on = np.repeat(np.arange(100) % 2, rng.integers(60, 180, 100) * 5)[: len(session)] * (session.speed > 0.5)
        torque = base.predict([session], base.nominal, ())[0].at_sprockets + PUMP_NM * on + rng.normal(0.0, 15.0, len(session))
        columns = {"time_s": session.time, "speed_mps": session.speed, "accel_mps2": session.accel, "torque_nm": 0.42 * torque}
        columns |= {"grade": 0.0 * torque, "weight_n": session.weight}
        paths.append(csv_tables.written(tmp_path / f"{session.name}.csv", columns))
    vehicle = tr.diagnose(paths, tmp_path / "car.yaml", quick=True).vehicle
    assert vehicle.values["torque_scale"] == pytest.approx(0.42, rel=0.1)
    assert vehicle.disturbance.level - vehicle.disturbance.rest == pytest.approx(PUMP_NM, rel=0.1)

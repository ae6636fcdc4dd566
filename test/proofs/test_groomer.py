# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The groomer, a third truth: what it hides, what its logger writes, and when a statement on it is true."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

import trackres_ros as tr
from proofs import pipeline
from proofs.sealed import second
from proofs.sealed.diagnosing import opened
from proofs.sealed.drives import SealedDrive
from proofs.sealed.groomer import (
    AT_DEGC,
    DRIVES,
    GEARBOX,
    GEARS,
    HEAVY_T,
    HIDDEN,
    KINDS,
    LATE_S,
    RATIO,
    SIZES_NM,
    VEHICLE,
    Groomer,
    _simulated,
    draw_groomers,
    snow_drives,
)
from proofs.sealed.groomer import label as label_of
from proofs.sealed.second import CLEAR, SIZE_SHARE, THRESHOLD_K, threshold_and_size


def generate(folder, seed, **counts):
    """Draw, seal and record."""
    pipeline.begin("groomer", folder, {"seed": seed, "counts": counts})
    pipeline.draw(folder)


GROOMER = Groomer("none", 350.0, -5.0, 0.93, (9.4, 10.2), 100)


@pytest.fixture(scope="module")
def plain():
    return snow_drives(GROOMER)


@pytest.mark.parametrize("kind", HIDDEN)
def test_hidden_drag_is_zero_at_standstill_and_never_pushes(plain, kind):
    for without, snow in zip(plain, snow_drives(replace(GROOMER, hide=kind)), strict=True):
        still = snow.drive.speed == 0.0
        assert 0.02 < still.mean() < 0.6
        assert np.abs(snow.hidden[still]).max() == 0.0
        assert (snow.hidden * snow.drive.speed >= 0.0).all()
        np.testing.assert_allclose(snow.torque - without.torque, snow.hidden, atol=1e-6)
        np.testing.assert_array_equal(snow.drive.ambient, without.drive.ambient)
    assert max(np.abs(snow.hidden).max() for snow in snow_drives(replace(GROOMER, hide=kind))) > 0.19 * GROOMER.size
    assert all(np.abs(snow.hidden).max() == 0.0 for snow in plain)


def at_speed(kind, **given):
    """Hidden torque, air, time and mass of all samples that drive."""
    g = replace(GROOMER, hide=kind, **given)
    for snow, mass in zip(snow_drives(g), g.masses, strict=True):
        drives = snow.drive.speed > 1.0
        time = np.arange(len(drives)) * snow.drive.step
        yield snow.hidden[drives], snow.drive.ambient[drives], time[drives], mass


@pytest.mark.parametrize("at", [-7.0, -3.0])
def test_cold_and_cool_follow_the_air_that_crosses_the_threshold(at):
    for hidden, air, _, _ in at_speed("cold", at=at, size=400.0):
        assert air.min() < at - 0.9
        assert air.max() > at + 0.9
        np.testing.assert_allclose(hidden[air < at - 0.8], 400.0, rtol=0.02)
        np.testing.assert_allclose(hidden[air > at + 0.8], 0.0, atol=4.0)
    for hidden, air, _, _ in at_speed("cool", at=at, size=400.0):
        np.testing.assert_allclose(hidden, 40.0 * np.maximum(at - air, 0.0), rtol=0.01)


def test_load_and_late_follow_the_mass_and_the_time():
    for hidden, _, _, mass in at_speed("load"):
        np.testing.assert_allclose(hidden, GROOMER.size * (mass > HEAVY_T), rtol=0.01)
    for hidden, _, time, _ in at_speed("late"):
        np.testing.assert_allclose(hidden, GROOMER.size * (time > LATE_S), rtol=0.01)


def test_a_gearbox_takes_from_the_motor_in_both_directions(plain):
    for snow in plain:
        behind, result_before = snow.torque * snow.drive.speed, RATIO * snow.motor * snow.drive.speed
        np.testing.assert_allclose(
            np.where(behind > 0.0, result_before * 0.93, behind * 0.93), np.where(behind > 0.0, behind, result_before)
        )
    for snow in snow_drives(replace(GROOMER, gear=1.0)):
        np.testing.assert_allclose(RATIO * snow.motor, snow.torque)


def test_a_warm_belt_rolls_easier_and_a_heavy_groomer_harder():
    n = 15_000
    still, speed = np.zeros(n), np.full(n, 4.0)
    item = SealedDrive(0.1, speed, still, still, still, np.full(n, 92_000.0), np.full(n, -5.0))
    light, heavy = (_simulated(GROOMER, item, mass) for mass in (9.4, 10.34))
    assert 3.0 < light.belt[-1] - light.belt[0] < 20.0
    assert (np.diff(light.torque) < 0.0).all()
    assert 0.80 < light.torque[-1] / light.torque[0] < 0.97
    assert 1.09 < heavy.torque[0] / light.torque[0] < 1.15


def test_draws_vary_and_stay_in_their_ranges():
    drawing = draw_groomers(dict.fromkeys(KINDS, 12), 3)
    assert draw_groomers(dict.fromkeys(KINDS, 12), 3) == drawing != draw_groomers(dict.fromkeys(KINDS, 12), 4)
    assert {len(g.masses) for g in drawing} == set(range(DRIVES[0], DRIVES[1] + 1))
    for g in drawing:
        assert SIZES_NM[0] <= g.size <= SIZES_NM[1]
        assert AT_DEGC[0] <= g.at <= AT_DEGC[1]
        assert g.gear == 1.0 or GEARS[0] <= g.gear <= GEARS[1]
        assert min(g.masses) < HEAVY_T < max(g.masses)
    assert {g.gear == 1.0 for g in drawing} == {True, False}


def test_its_vehicle_file_is_valid_and_says_why_each_value(tmp_path):
    generate(tmp_path, 5, none=1)
    (folder,) = (tmp_path / "cases").iterdir()
    assert tr.load_vehicle(folder / "vehicle.yaml").title
    text = VEHICLE.read_text()
    assert text.count("flag: A") == text.count("reason:") == text.count("range:") > 50


def test_the_seal_is_of_labels_that_no_recording_shows(tmp_path, capsys):
    generate(tmp_path, 7, none=1, cold=1)
    sealed = tmp_path / "sealed" / "labels.json"
    assert hashlib.sha256(sealed.read_bytes()).hexdigest() in capsys.readouterr().out
    labels = json.loads(sealed.read_text())["cases"]
    assert {label["level"] for label in labels} == {"none", "outside"}
    for label in labels:
        files = {path.name for path in (tmp_path / "cases" / label["case"]).iterdir()}
        tables = {f"session{i + 1}.csv" for i in range(len(label["masses"]))}
        assert files == {*tables, "vehicle.yaml", "topics.yaml"}
        assert label["tolerated"] == ([] if label["gear"] == 1.0 else [GEARBOX])
    assert all(e["d_prime"] > CLEAR for label in labels for e in label["effects"])


def test_the_loggers_tables_hold_what_was_driven(tmp_path):
    generate(tmp_path, 7, cold=1)
    (folder,) = (tmp_path / "cases").iterdir()
    (g,) = draw_groomers({"cold": 1}, 7)
    _, recordings, loaded = opened(folder)
    assert loaded.known.gears.ratio == RATIO
    by_name = sorted(recordings, key=lambda r: r.name)
    for recording, snow, mass in zip(by_name, snow_drives(g), g.masses, strict=True):
        read = {role: recording.series[role].value for role in ("speed", "torque", "ambient", "load")}
        np.testing.assert_allclose(read["speed"], snow.drive.speed, atol=0.1)
        np.testing.assert_allclose(read["ambient"], snow.drive.ambient, atol=0.6)
        np.testing.assert_allclose(read["torque"], RATIO * snow.motor, atol=6.0 * RATIO)
        np.testing.assert_allclose(read["load"], 9810.0 * mass, rtol=1e-3)


AIR = np.sort(np.random.default_rng(1).uniform(-10.0, 0.0, 200))


@pytest.mark.parametrize(("off", "share"), [(0.0, 1.0), (0.9, 1.0), (-0.9, 1.05), (1.2, 1.0), (0.0, 0.85), (0.0, 1.15)])
@pytest.mark.parametrize("kind", ["cold", "cool"])
def test_a_described_threshold_and_size_must_be_close(kind, off, share):
    place, size = -5.0 + off, 350.0 * share
    torque = size * (place > AIR) - 0.4 * size if kind == "cold" else 0.1 * size * np.maximum(place - AIR, 0.0) - 20.0
    assert threshold_and_size(AIR, torque, kind == "cool") == pytest.approx((place, size), rel=0.02, abs=0.1)
    effect = {"name": kind, "threshold": -5.0, "size_nm": 350.0}
    term = {"form": "step", "name": "a", "variable": "ambient temperature"}
    report = {"verdict": {"status": "described"}, "described": [term]}
    expectation = abs(off) <= THRESHOLD_K and abs(share - 1.0) <= SIZE_SHARE

    def stated(points, variable="ambient temperature"):
        return second._stated([effect], {**report, "described": [{**term, "variable": variable}]}, points)

    assert stated({"a": [AIR.tolist(), torque.tolist()]}) == expectation
    assert not stated({"a": [AIR.tolist(), (-torque).tolist()]})  # less in the cold
    assert not stated({"a": [AIR.tolist(), torque.tolist()]}, "belt temperature")
    assert not stated({})


def answered(status, effects=(), described=()):
    named = [{"name": name, "class": [name], "parameters": {}, "grade": "confirmed"} for name in effects]
    return {
        "report": {
            "verdict": {"status": status, "grade": "confirmed"}, "effects": named, "described": list(described),
            "heldout": {"mae": {"nominal": 200.0, "refitted": 160.0, "with_effects": 110.0}},
        },
        "simple": {}, "learned": {"base": 160.0},
    }  # fmt: skip


def test_a_gearbox_may_be_named_and_counts_for_nothing():
    def wrong(kind, gear, result):
        return second.scored(None, label_of(replace(GROOMER, hide=kind, gear=gear)), result).wrong

    late = {"form": "step", "name": "b", "variable": "time since start", "gate": None, "grade": "confirmed"}
    assert wrong("late", 0.93, answered("named", [GEARBOX], [late])) == ""
    assert wrong("late", 0.93, answered("named", [GEARBOX])) == "unknown not noticed"
    assert wrong("late", 1.0, answered("named", [GEARBOX], [late])) == "a name for what is not in the catalogue"
    assert wrong("load", 0.93, answered("described", [], [late])) == "described, and not true"


def test_the_command_draws_kinds_and_refuses_others(good, refused, tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(pipeline, "run_step", lambda step, _as_json: started.append(step))
    good("proofs", "groomer", "--hide", "cold=3", "--hide", "none", "--cases", "2", "--seed", "5", "-o", tmp_path / "out")
    settings = json.loads((tmp_path / "out" / "settings.json").read_text())
    assert (settings["seed"], settings["counts"]) == (5, {"cold": 3, "none": 2})
    assert [step[0] for step in started] == ["pipeline.draw", "pipeline.answer", "pipeline.score"]
    for item in ("warm", "cold=0"):
        assert item in refused("proofs", "groomer", "--hide", item, "-o", tmp_path / "other")

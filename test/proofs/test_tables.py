# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables of the proofs from small results: they have the columns of docs/trust/, whose page is made from them."""

import gzip
import json
import runpy
from dataclasses import replace

import numpy as np
import pytest

from proofs import fleet
from proofs.commands import _finish
from proofs.field import emps
from proofs.field.live import LiveError, Taught, learned_row, replay_row
from proofs.field.results import route_numbers, start_numbers, start_rows, verdict_rows
from proofs.field.trials import NOTHING, UPHILL, FieldTrial, PayloadFound, RepeatedRoute, Start, payload_numbers, slope_row
from proofs.tables import FOLDER, read_table, shown, write_tables
from proofs.unsealed import ClosedLoop, loop_tables, paper_row
from trackres_ros.diagnosis import DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.diagnosis.inference.fitting import fit
from trackres_ros.diagnosis.synthetic import drives, write_recordings
from trackres_ros.effects import catalogue
from trackres_ros.recording.bindings import Topics


@pytest.fixture(scope="module")
def published(repository):
    """The rows of a table in docs/trust/, by its name."""
    return lambda name: read_table(repository / "docs" / "trust" / f"{name}.csv")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A diagnosis of three short drives with nothing hidden."""
    loaded, rng = load_base("bmw_i3"), np.random.default_rng(2)
    sessions = drives(loaded.base, 20.0, 3, 4.0, rng)
    paths = write_recordings(loaded.base, tmp_path_factory.mktemp("drives"), sessions, [], rng)
    return diagnose(read_recordings(paths, None), loaded, DiagnosisOptions(quick=True))


@pytest.fixture(scope="module")
def slide(tmp_path_factory):
    """A diagnosis of a carriage to and fro, whose last fit has both frictions."""
    rng, path = np.random.default_rng(2), tmp_path_factory.mktemp("slide") / "emps.csv.gz"
    speed = np.tile(np.repeat([0.12, -0.06, 0.03, -0.1, 0.05, -0.02, 0.08, -0.12], 25), 5)
    speed = np.convolve(speed, np.ones(10) / 10.0, "same")
    force = 95.0 * np.gradient(speed, 0.01) + 205.0 * speed - 37.0 * np.abs(speed) + 20.0 * np.sign(speed) - 3.0
    columns = np.column_stack([0.01 * np.arange(len(speed)), 0.01 * np.cumsum(speed), force + rng.normal(0.0, 0.5, len(force))])
    with gzip.open(path, "wt") as lines:
        np.savetxt(lines, columns, delimiter=",", header="time_s,position_m,force_n", comments="")
    made = diagnose(read_recordings([path], Topics.load("emps")), load_base("emps"), DiagnosisOptions(quick=True))
    effects = [catalogue()[name] for name in (emps.COULOMB, emps.DIRECTION)]
    return replace(made, final=fit(made.refitted.problem, effects, made.refitted.estimates))


def test_verdicts_on_real_recordings(found, published):
    (row,) = verdict_rows([FieldTrial("car", "nothing", NOTHING, UPHILL, found)])
    assert list(row) == list(published("real")[0])
    assert (row["recordings"], row["concealed"], row["outcome"]) == ("car", "nothing", "right")
    assert row["verdict"] == found.verdict.sentence


def test_starts_and_single_numbers_of_real_recordings(published):
    begun = [Start("A", 30.0, 2.5, 65.0, 0.5, 0.4), Start("B", 0.1, 7.0, 3.0, 0.2, 0.4), Start("C", 9.0, 1.0, np.nan, 0.4, 2.0)]
    rows = start_rows(begun)
    assert list(rows[0]) == list(published("real_starts")[0])
    assert [row["trip"] for row in rows] == ["A", "C", "B"]
    assert rows[1]["lacks_nm"] == ""
    payload = PayloadFound(np.array([1.0, -1.0]), np.ones(2), np.array([2.0, -2.0]), 0.9, 1, 2, 150.0)
    numbers = [*start_numbers(begun, [60.0, 90.0, 70.0]), *payload_numbers(payload), *route_numbers(RepeatedRoute(0.9, 0.2))]
    assert {quantity for quantity, _ in numbers} == {row["quantity"] for row in published("real_numbers")}
    assert dict(numbers)["car, after a night or a day: lacks in the first 180 s [Nm]"] == "65"
    assert dict(numbers)["bus: error of the masses [kg]"] == "1"


def test_slopes_replays_and_learning_of_real_recordings(published):
    assert list(slope_row("altitude", 0.7, 0.8)) == list(published("real_slopes")[0])
    replayed = replay_row("the bus", LiveError("vehicle.yaml", 1130.4, 47.1))
    assert list(replayed) == list(published("real_replays")[0])
    assert replayed["error_nm"] == "1130"
    assert list(learned_row(Taught("the car", 56.71, 42.5))) == list(published("real_learning")[0])


def test_a_slide_next_to_its_published_values(slide, published):
    tables = emps.tables_of(emps.SlideTrial(slide, slide))
    assert {name: list(rows[0]) for name, rows in tables.items()} == {name: list(published(name)[0]) for name in tables}
    assert [row["value"] for row in tables["emps_values"]] == [row["value"] for row in published("emps_values")]
    assert [row["model"] for row in tables["emps_errors"]] == [row["model"] for row in published("emps_errors")]
    with_both = tables["emps_errors"][2]
    assert float(with_both["here_percent"]) < 0.5 * float(tables["emps_errors"][0]["here_percent"])
    assert float(tables["emps_values"][2]["here_95"].split()[0]) == pytest.approx(20.0, rel=0.2)


def test_the_papers_test_and_the_loop(found, published):
    row = paper_row("laps", found)
    assert list(row) == list(published("paper")[0])
    assert row["true_in_a_class"] == ""
    time = np.arange(0.0, 600.0, 0.1)
    torque, late = np.full(len(time), 1000.0), time > 300.0
    tables = loop_tables(ClosedLoop("It drags.", time, torque, torque - 100.0, torque - np.where(late, 0.0, 10.0), late))
    assert {name: list(rows[0]) for name, rows in tables.items()} == {name: list(published(name)[0]) for name in tables}
    assert [row["part"] for row in tables["loop"]] == [row["part"] for row in published("loop")]
    assert tables["loop"][1]["before_nm"] == "100"


def test_tables_are_written_and_printed(tmp_path, capsys):
    tables = {"some": [{"a": "1", "b": "x, y"}, {"a": "2", "b": "long " * 40}], "none": []}
    _finish(tmp_path, tables, as_json=True)
    assert json.loads(capsys.readouterr().out) == tables
    assert [path.name for path in (tmp_path / FOLDER).iterdir()] == ["some.csv"]
    assert read_table(tmp_path / FOLDER / "some.csv") == tables["some"]
    lines = shown(tables).splitlines()
    assert lines[0] == "some"
    assert lines[-1].endswith(" ...")


def test_changes_of_a_fleet(published):
    step = fleet.Hidden("bearing_friction", "step", 6, 0.1)
    scored = [
        fleet.ScoredVehicle("truck-01", None, False, None, False, False, 0, 3.0),
        fleet.ScoredVehicle("truck-02", step, True, 5, False, True, 1, 3.0),
        fleet.ScoredVehicle("truck-03", step, False, None, False, False, 0, 3.0),
    ]
    known = [{"vehicles": 1, "settled": 3.8, "std": dict.fromkeys(list(published("fleet_type")[0])[2:], 0.5)}]
    tables = fleet.tables_of(fleet.summary(scored, 1, "seal") | {"known_of_the_type": known})
    assert {name: list(rows[0]) for name, rows in tables.items()} == {name: list(published(name)[0]) for name in tables}
    assert [tuple(row.values()) for row in tables["fleet"]] == [
        ("truck-01", "", "", "", "", "0"),
        ("truck-02", "bearing_friction step +10 %", "7", "5", "among others", "1"),
        ("truck-03", "bearing_friction step +10 %", "7", "not found", "", "0"),
    ]


def test_rows_of_other_truths_stay_when_a_run_is_taken_over(repository, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(repository / "tools"))
    take_over = runpy.run_path(str(repository / "tools" / "proof-docs"))["take_over"]
    kept, new = tmp_path / "kept", tmp_path / "new"
    write_tables(kept, {"scores": [{"truth": truth, "value": "1"} for truth in ("own", "second")], "loop": [{"value": "1"}]})
    write_tables(new, {"scores": [{"truth": "own", "value": "2"}], "loop": [{"value": "2"}]})
    for name in ("scores", "loop"):
        take_over(new / f"{name}.csv", kept)
    assert [tuple(row.values()) for row in read_table(kept / "scores.csv")] == [("own", "2"), ("second", "1")]
    assert read_table(kept / "loop.csv") == [{"value": "2"}]

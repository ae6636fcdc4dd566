# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Answers and scores of constructed reports."""

import json

import numpy as np
import pytest

from proofs.sealed.cases import RIGHT_FORMS, Case, sensors_of
from proofs.sealed.own import OwnProof
from proofs.sealed.results import TARGETS, report_of, tables_of
from proofs.sealed.scoring import (
    OURS,
    MassError,
    OracleAnswer,
    Scored,
    comparable,
    error_left,
    mass_errors,
    of_report,
    own_shares,
    shares,
    sizes,
    true_values,
)
from proofs.tables import FOLDER, read_table

PARAMETERS = {"time": {"value": 0.3, "ci95": [0.25, 0.35]}}


def report(status, effects=(), described=None, after=100.0):
    made = {
        "verdict": {"status": status},
        "effects": [{"name": name, "class": [name], "parameters": PARAMETERS} for name in effects],
        "heldout": {"mae": {"nominal": 300.0, "refitted": 200.0, "with_effects": after}},
    }
    return made if described is None else {**made, "described": described}


def term(form, variable="", gate=None, memory=None, after=120.0):
    heldout = {"mae": [200.0, after]}
    return {"form": form, "variable": variable, "gate": gate, "memory": memory, "grade": "confirmed", "heldout": heldout}


def scored(level, hidden, made, seen=True, oracle_error=100.0, learned=None, masses=(), stated=None, alike=(), words=""):
    values = {name: {"time": 0.25} for name in hidden}
    program = {"words": words, "predictable": "chance" not in words} if level == "outside" else {}
    case = Case("0000cafe", level, values, {}, False, False, False, True, 11, "town", program)
    known = OracleAnswer(50.0 if seen else 1.0, alike, seen, False, 200.0, oracle_error)
    answer = of_report(made)
    if level == "street" and hidden:
        stated = bool(answer.described) and answer.described[0].form == RIGHT_FORMS[hidden[0]]
    learned = learned or {"base": 200.0, "trees": 150.0}
    return Scored(case, made, known, {OURS: answer}, 0.5, 0.5, None, learned, stated, true_values(case), masses)


def test_a_report_without_descriptions_is_read_as_before():
    assert of_report(report("none")).described == ()
    assert of_report(report("named", ["delay"])).first == "delay"
    assert error_left(report("named", ["delay"], after=90.0)) == 90.0


def test_the_error_left_is_of_the_hold_out_laps_of_the_base():
    fit_result, followed = term("curve", "speed", after=230.0), term("drift", after=80.0)
    assert error_left(report("described", described=[fit_result], after=90.0)) == 90.0
    assert error_left(report("described", described=[fit_result, followed], after=90.0)) == 80.0
    assert error_left(report("described", described=[{**followed, "grade": "refuted"}], after=90.0)) == 90.0


def test_a_confirmed_name_is_wrong_unless_hidden_or_fits_as_well():
    sure = report("named", ["delay"])
    sure["effects"][0]["grade"] = "confirmed"
    doubted = report("named", ["delay"])
    doubted["effects"][0]["grade"] = "suspected"
    item = [
        scored("outside", ["program"], sure),
        scored("outside", ["program"], sure, alike=("delay", "torque_gain")),
        scored("outside", ["program"], doubted),
        scored("single", ["delay"], sure),
        scored("none", [], sure),
    ]
    assert [s.answer.surely_wrong(s.allowed) for s in item] == [True, False, False, False, True]
    result = shares(item)
    assert result["outside: confirmed wrong name"] == (1, 3)
    assert result["all: confirmed wrong name"] == (2, 5)
    assert [s.wrong for s in item[:2]] == ["a name for what is not in the catalogue", ""]


def test_mistakes_of_descriptions():
    drift = [term("drift")]
    text = report("described", described=drift)
    assert scored("outside", ["program"], text, stated=True).wrong == ""
    assert scored("outside", ["program"], text, stated=False).wrong == "described, and not true"
    assert scored("outside", ["program"], report("named", ["delay"])).wrong == "a name for what is not in the catalogue"
    assert scored("outside", ["program"], report("none")).wrong == "unknown not noticed"
    assert scored("none", [], text).wrong == "false description"
    assert scored("single", ["delay"], text).wrong == "described though in the catalogue"


def test_scores_of_what_is_outside():
    item, by_chance = ["program"], "coming and going by chance"
    entry = [
        scored("outside", item, report("described", described=[term("spells")]), stated=True, words=by_chance),
        scored("outside", item, report("described", described=[term("curve")], after=140.0), stated=False, words="a bump"),
        scored("outside", item, report("named", ["delay"], after=250.0), words="a sine"),
        scored("outside", item, report("unexplained"), seen=False, words=by_chance),
        scored("none", [], report("described", described=[term("drift", after=190.0)]), oracle_error=200.0),
        scored("none", [], report("none", after=200.0), oracle_error=200.0),
    ]
    result, own, values = shares(entry), own_shares(entry), sizes(entry)
    assert result["outside: confirmed wrong name"] == (1, 4)
    assert result["outside: described or unexplained"] == (3, 4)
    assert result["outside: a name or a class of names"] == (1, 4)
    assert own["outside, seen by the oracle: described, and the statement is true"] == (1, 3)
    assert own["outside, described: the statement is true"] == (1, 2)
    assert own["none: false description"] == (1, 2)
    assert own["held-out laps: never worse than the base"] == (5, 6)
    name = "outside, predictable: held-out error removed, of what the oracle removes (median)"
    assert values[name] == pytest.approx([0.6, -0.5])
    assert values["held-out error removed, of what the oracle removes (median)"] == []
    tables = tables_of(entry, "own", 1, "seal")
    learned_valuess = {(row["method"], row["score"]): (row["cases"], row["value"]) for row in tables["learners"]}
    removed = "outside, predictable: removed, of what the oracle removes (median)"
    assert [learned_valuess[method, removed] for method in ("diagnosis", "trees")] == [("2", "0.05"), ("2", "0.50")]
    assert [learned_valuess[method, "outside: worse than the base"] for method in ("diagnosis", "trees")] == [
        ("4", "1"),
        ("4", "0"),
    ]
    assert {row["hidden"]: (row["right"], row["error_removed"], row["verdict"]) for row in tables["outside"]} == {
        by_chance: ("yes", "1.00", "unexplained"), "a bump": ("no", "0.60", "curve"), "a sine": ("no", "-0.50", "delay"),
    }  # fmt: skip


def test_a_score_has_its_interval_target_and_outcome():
    item = [scored("none", [], report("none"), oracle_error=200.0), scored("single", ["delay"], report("named", ["mullins"]))]
    rows = {row["score"]: row for row in tables_of(item, "own", 1, "seal")["scores"]}
    quiet, wrong = rows["none: false alarm"], rows["single: truth in the reported class"]
    keys = "truth", "hits", "of", "value", "low", "high", "target", "met"
    assert [quiet[key] for key in keys] == ["own", "0", "1", "0.00", "0.00", "0.79", "at most 0.03", "yes"]
    assert [wrong[key] for key in keys] == ["own", "0", "1", "0.00", "0.00", "0.79", "at least 0.95", "no"]
    untried = rows["two: both"]
    assert [untried[key] for key in keys] == ["own", "0", "0", "", "", "", "", ""]


def test_mistakes_in_a_town():
    place, payload = [term("place")], [term("payload")]
    assert scored("street", [], report("none")).wrong == ""
    assert scored("street", [], report("described", described=payload)).wrong == "false description"
    assert scored("street", [], report("named", ["grade"])).wrong == "false alarm"
    assert scored("street", ["street_slope"], report("named", ["grade"])).wrong == ""
    assert scored("street", ["street_slope"], report("described", described=place)).wrong == ""
    pair = report("named", ["grade", "delay"])
    assert scored("street", ["street_slope"], pair).wrong == "a name for what is not in the catalogue"
    assert scored("street", ["street_ground"], report("named", ["grade"])).wrong == "a name for what is not in the catalogue"
    assert scored("street", ["street_ground"], report("described", described=payload)).wrong == "described, and not true"
    assert scored("street", ["stretch_load"], report("none")).wrong == "unknown not noticed"


def test_scores_in_a_town():
    masses = [MassError(400.0, 0.05), MassError(310.0, 0.2, covered=False), MassError(300.0, 0.02), MassError(50.0, 0.5)]
    item = [
        scored("street", [], report("none", after=200.0), oracle_error=200.0),
        scored("street", [], report("one_of", ["delay"]), oracle_error=200.0),
        scored("street", ["street_slope"], report("named", ["grade"], after=120.0)),
        scored("street", ["street_slope"], report("named", ["delay"], after=250.0)),
        scored("street", ["stretch_load"], report("described", described=[term("payload")], after=150.0), masses=masses),
        scored("street", ["street_ground"], report("described", described=[term("place")], after=110.0), seen=False),
        scored("single", ["delay"], report("named", ["delay"])),
    ]
    result, own, values = shares(item), own_shares(item), sizes(item)
    assert result["street, nothing hidden: a name or a description"] == (1, 2)
    assert result["street: confirmed wrong name"] == (2, 6)
    assert own["street, seen by the oracle: rightly named or described"] == (2, 3)
    assert own["street, slope: named grade or described by place"] == (1, 2)
    assert own["street, load: described as a payload"] == (1, 1)
    assert own["street, ground: described by place"] == (1, 1)
    assert own["street, load described: masses within 8% of the load, over 300 s of driving"] == (1, 2)
    assert own["street, load described: masses within 8% of the load, all"] == (2, 4)
    assert own["street, load described: 95 % intervals of masses cover"] == (3, 4)
    assert own["street: held-out laps never worse than the base"] == (5, 6)
    assert own["held-out laps: never worse than the base"] == (6, 7)
    assert own["in the catalogue and identifiable: described instead of named"] == (0, 1)
    removed = "held-out error removed, of what the oracle removes (median)"
    assert values[removed] == pytest.approx([1.0])  # of the case that is in the catalogue
    assert values[f"street, street slope: {removed}"] == pytest.approx([0.8, -0.5])
    assert values[f"street, stretch load: {removed}"] == pytest.approx([0.5])
    assert values["street, load described: masses off, of the load, over 300 s of driving (median)"] == [0.05, 0.2]
    assert values["street, load described: masses off, of the load, all (median)"] == [0.05, 0.2, 0.02, 0.5]
    tables = tables_of(item, "own", 1, "seal")
    by_kind = [tuple(row.values()) for row in tables["outside"]]
    assert ("own", "street", "nothing", "town", "yes", "yes", "", "none") in by_kind
    assert ("own", "street", "nothing", "town", "yes", "no", "", "delay") in by_kind
    assert ("own", "street", "street_slope", "town", "yes", "yes", "0.80", "grade") in by_kind
    assert set(TARGETS) <= {*result, *own, *values}
    worse = [row for row in tables["learners"] if row["score"] == "street: worse than the base"]
    assert [(row["cases"], row["value"]) for row in worse] == [("6", "1"), ("6", "0")]


def test_a_run_writes_the_columns_of_the_published_tables(tmp_path, repository):
    item = [
        scored("street", [], report("none"), oracle_error=200.0),
        scored("street", ["street_slope"], report("named", ["grade"], after=120.0)),
        scored("two", ["delay", "mullins"], report("named", ["delay", "mullins"])),
    ]
    kept, text = report_of(tmp_path, item, "own", {"seed": 3, "cases": [{}] * 4}, "seal")
    assert "3 cases of the 4 that were sealed" in text
    assert [load["wrong"] for load in json.loads(json.dumps(kept))["cases"]] == ["", "", ""]
    written = sorted((tmp_path / FOLDER).iterdir())
    assert [path.stem for path in written] == ["cases", "learners", "outside", "runs", "scores"]
    for path in written:
        rows, published = read_table(path), read_table(repository / "docs" / "trust" / path.name)
        assert list(rows[0]) == list(published[0])
    assert read_table(tmp_path / FOLDER / "runs.csv") == [{"truth": "own", "cases": "3", "seed": "3", "seal": "seal"}]


def test_masses_are_compared_between_changes_of_the_load():
    speed = np.repeat([5.0, 0.0, 5.0, 5.0], [400, 20, 100, 80])  # stands, and is loaded meanwhile
    mass = np.repeat([1000.0, 3000.0, 0.0], [410, 110, 80])
    statements = [
        {"begin_s": 0.0, "end_s": 200.0, "mass": 900.0, "std": 60.0},
        {"begin_s": 200.0, "end_s": 420.0, "mass": 1300.0, "std": 60.0},
        {"begin_s": 420.0, "end_s": 520.0, "mass": 2800.0, "std": 100.0},
        {"begin_s": 520.0, "end_s": 550.0, "mass": 0.0, "std": 1.0},
    ]
    long, short = mass_errors(speed, mass, statements, 4000.0)  # less than half of the last is described
    assert (long.driving_s, short.driving_s) == (400.0, 100.0)
    assert long.off == pytest.approx(100.0 / 4000.0)
    assert short.off == pytest.approx(200.0 / 4000.0)
    assert (long.long, short.long) == (True, False)
    assert long.close
    assert (long.covered, short.covered) == (True, False)
    assert not MassError(400.0, 0.081).close


def test_a_delay_is_compared_with_all_that_the_torque_is_late_by():
    s = scored("single", ["delay"], report("named", ["delay"]))
    covers, (error,) = comparable([s])
    assert error == pytest.approx(abs(0.3 / (0.25 + sensors_of(s.case).torque_lag_s) - 1.0))
    assert covers == [True]


def test_the_first_cases_are_the_first_by_name_of_any_level(tmp_path):
    named = [
        Case(name, level, {}, {}, False, False, False, True, 1) for name, level in (("c", "none"), ("a", "two"), ("b", "outside"))
    ]
    proof = OwnProof(tmp_path, {})
    assert [item.name for item in proof.choice(named, 2)] == ["a", "b"]
    assert proof.choice(named, None) == named

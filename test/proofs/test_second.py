# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cases of another simulator: accepted labels, and right answers."""

import json

import pytest

from proofs import pipeline
from proofs.sealed.second import _accepted, _by_place, _comparable, _stated, read_labels
from proofs.tables import FOLDER, read_table


def label(name, kind, level="outside", d_prime=40.0):
    return {
        "case": name, "level": level, "effects": [{"name": kind, "d_prime": d_prime, "acceptable": ["vibration"]}],
        "identifiable": False, "tolerated": ["delay"], "given": ["belt_degc"], "driving": "mixed",
        "noise_mae": [{"raw": 80.0, "one_s": 60.0}],
    }  # fmt: skip


def written(folder, labels, recordings=1):
    """A folder with labels, and with recordings of each case."""
    for item in labels:
        (folder / "cases" / item["case"]).mkdir(parents=True)
        for i in range(recordings):
            (folder / "cases" / item["case"] / f"session{i + 1}.csv").touch()
    (folder / "labels.json").write_text(json.dumps({"seed": 11, "cases": labels}))
    return folder


@pytest.mark.parametrize(("kind", "level"), [("delay", "single"), ("pump", "outside"), ("speed_scale", "two")])
def test_labels_of_known_kinds_are_read(tmp_path, kind, level):
    labels = [label("case000", kind, level)]
    assert read_labels(written(tmp_path, labels))["cases"] == labels


@pytest.mark.parametrize(
    ("labels", "says"),
    [
        (None, "labels.json"), ("{", "labels.json"), ('{"seed": 11, "cases": 3}', "labels.json"), (["pump"], "no rec"),
        (["gremlins", "outside", 1], "gremlins"), (["gremlins", "single", 1], "gremlins"), (["delay", "outside", 1], "delay"),
    ],
)  # fmt: skip
def test_a_folder_that_cannot_be_scored_is_refused_at_once(refused, tmp_path, labels, says):
    if isinstance(labels, list):
        kind, level, recordings = [*labels, "outside", 0][:3]
        written(tmp_path, [label("case000", kind, level)], recordings)
    elif labels:
        (tmp_path / "labels.json").write_text(labels)
    assert says in refused("proofs", "second", tmp_path, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def answered(status, described=(), effects=()):
    mae = {"nominal": 200.0, "refitted": 160.0, "with_effects": 110.0}
    report = {"verdict": {"status": status, "grade": "confirmed"}, "effects": list(effects), "heldout": {"mae": mae}}
    return {"report": {**report, "described": list(described)}, "simple": {}, "learned": {"base": 160.0}}


def score_them(tmp_path, labels, results):
    source, output = written(tmp_path / "truth", labels), tmp_path / "out"
    pipeline.begin("second", output, {"source": str(source)})
    pipeline.draw(output)
    assert (output / "sealed" / "labels.json").read_bytes() == (source / "labels.json").read_bytes()
    (output / "results").mkdir()
    for value, result in zip(labels, results, strict=True):
        (output / "results" / f"{value['case']}.json").write_text(json.dumps(result))
    pipeline.score(output)


def test_cases_of_another_simulator_get_the_same_scores(tmp_path):
    labels = [label("case000", "pump"), label("case001", "resonance"), label("case002", "backlash", d_prime=5.0)]
    named = {"name": "vibration", "class": ["vibration"], "parameters": {}, "grade": "confirmed"}
    spells = {"form": "spells", "heldout": {"mae": [160.0, 110.0]}}
    results = [answered("described", [spells]), answered("named", effects=[named]), answered("unexplained")]
    score_them(tmp_path, labels, results)
    kept = json.loads((tmp_path / "out" / "scores.json").read_text())
    ours, own = kept["scores"]["diagnosis"], kept["own"]
    assert (ours["outside: described or unexplained"]["hits"], ours["outside: described or unexplained"]["of"]) == (2, 3)
    assert ours["outside: confirmed wrong name"]["hits"] == 0  # a resonance may be called a vibration
    true = own["outside, seen by the oracle: described, and the statement is true"]
    assert (true["hits"], true["of"]) == (1, 2)
    assert kept["sizes"]["outside, predictable: held-out error removed, of what the oracle removes (median)"] == [0.5, 0.5]
    outside = read_table(tmp_path / "out" / FOLDER / "outside.csv")
    assert list(next(row for row in outside if row["hidden"] == "pump").values()) == [
        "second", "outside", "pump", "mixed", "yes", "yes", "0.50", "spells",
    ]  # fmt: skip


def test_a_confirmed_place_counts_as_the_soft_ground_there():
    def report(grade, *names):
        return {"described": [{"form": "place", "grade": grade}], "effects": [{"name": name} for name in names]}

    assert [e["name"] for e in _by_place(["soft_ground", "rain"], report("confirmed"))] == ["soft_ground"]
    assert not _by_place(["soft_ground"], report("suspected"))
    assert not _by_place(["soft_ground"], report("confirmed", "soft_ground"))
    assert not _by_place(["rain"], report("confirmed"))


def test_a_name_that_labels_accept_counts_for_the_hidden_effect():
    def in_class(name, *hidden):
        return _accepted({"name": name, "class": [name]}, hidden)["class"]

    grade, pump = ({"name": name, "acceptable": ["grade_profile", "drift"]} for name in ("grade", "pump"))
    assert in_class("grade_profile", grade) == ["grade_profile", "grade"]
    assert in_class("grade", grade) == ["grade"]
    assert in_class("rain", grade) == ["rain"]
    assert in_class("drift", pump) == ["drift"]  # outside the catalogue: no name is right, see `Scored.allowed`


@pytest.mark.parametrize(("label", "ours"), [(0.04, -0.0385), (-0.03, 0.0309)])
def test_a_scale_of_the_speed_is_compared_the_other_way_round(label, ours):
    effect = {"name": "speed_scale", "comparable": {"pattern": "^e", "magnitude": False, "value": label}}
    report = {"effects": [{"name": "speed_scale", "parameters": {"error": {"value": ours}}}]}
    assert _comparable([effect], report)["speed_scale"] == ("error", pytest.approx(ours, abs=1e-4))


def test_a_statement_is_true_by_its_form_or_its_variable():
    def report(form, **about):
        return {"verdict": {"status": "described"}, "described": [{"form": form, **about}]}

    assert _stated([{"name": "pump"}], report("spells"), {})
    assert not _stated([{"name": "pump"}], report("curve", variable="speed"), {})
    assert _stated([{"name": "overload_rub"}], report("step", variable="load"), {})
    assert _stated([{"name": "pump"}], {"verdict": {"status": "named"}}, {}) is None

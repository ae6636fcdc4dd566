# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cases of another simulator: accepted labels, and right answers."""

import json

import pytest

from trackres_ros.errors import InputError
from trackres_ros.evaluation.sealed.second import _by_place, _comparable, _stated, read_labels


@pytest.fixture
def labels(tmp_path):
    """Writes labels of one case with one effect, and one recording of it."""

    def write(level="single", effect="delay", recordings=1, **changed):
        case = tmp_path / "cases" / "case000"
        case.mkdir(parents=True, exist_ok=True)
        for i in range(recordings):
            (case / f"session{i + 1}.csv").write_text("time_s\n0\n")
        of = {"seed": 1, "cases": [{"case": "case000", "level": level, "effects": [{"name": effect}]}], **changed}
        (tmp_path / "labels.json").write_text(json.dumps(of))
        return tmp_path

    return write


def test_labels_of_known_kinds_are_read(labels):
    assert read_labels(labels())["cases"][0]["case"] == "case000"
    assert read_labels(labels("outside", "pump"))["cases"][0]["level"] == "outside"


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"effect": "gremlins"}, "gremlins"),
        ({"level": "outside"}, "delay"),
        ({"cases": 3}, "labels.json"),
        ({"recordings": 0}, "no rec"),
    ],
)
def test_labels_that_cannot_be_scored_are_refused(labels, given, says):
    with pytest.raises(InputError, match=says):
        read_labels(labels(**given))


def test_a_confirmed_place_counts_as_the_soft_ground_there():
    def report(grade, *names):
        return {"described": [{"form": "place", "grade": grade}], "effects": [{"name": name} for name in names]}

    assert [e["name"] for e in _by_place(["soft_ground", "rain"], report("confirmed"))] == ["soft_ground"]
    assert not _by_place(["soft_ground"], report("suspected"))
    assert not _by_place(["soft_ground"], report("confirmed", "soft_ground"))
    assert not _by_place(["rain"], report("confirmed"))


@pytest.mark.parametrize(("label", "ours"), [(0.04, -0.0385), (-0.03, 0.0309)])
def test_a_scale_of_the_speed_is_compared_the_other_way_round(label, ours):
    effect = {"name": "speed_scale", "comparable": {"pattern": "^e", "magnitude": False, "value": label}}
    report = {"effects": [{"name": "speed_scale", "parameters": {"error": {"value": ours}}}]}
    assert _comparable([effect], report)["speed_scale"] == ("error", pytest.approx(ours, abs=1e-4))


def test_a_statement_is_true_by_its_form_or_its_variable():
    def report(form, **about):
        return {"verdict": {"status": "described"}, "described": [{"form": form, **about}]}

    assert _stated(["pump"], report("spells"))
    assert not _stated(["pump"], report("curve", variable="speed"))
    assert _stated(["overload_rub"], report("gated_curve", gate="when heavy"))
    assert _stated(["pump"], {"verdict": {"status": "named"}}) is None

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws for the proof of the learning: reproducible from a seed, sealed, and each disturbance has an effect."""

import json

import numpy as np
import pytest

from proofs import pipeline
from proofs.delay import LONGEST_S, _sampled, draw, page
from proofs.learning import (
    KINDS,
    LOSS_ERRORS,
    SENSORS,
    LearningCase,
    _of_hostile,
    _of_mass,
    added_torque,
    age,
    draw_cases,
    misled,
    misled_rows,
    weight_shares,
)
from proofs.sealed.drives import SealedDrive, drive
from proofs.sealed.recordings import START_S
from proofs.tables import FOLDER, read_table
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at

STEP_S = 0.1


def case_of(kind):
    return LearningCase("v1", {"loss": 1.0}, True, kind, 0.5, 7)


def test_a_seed_gives_the_same_cases_and_another_seed_others():
    cases = draw_cases(11, 6, 20)
    assert cases == draw_cases(11, 6, 20)
    assert cases != draw_cases(12, 6, 20)
    assert sum(not case.hostile for case in cases) == 6
    assert {case.hostile for case in cases} == {"", *KINDS}
    for case in cases:
        assert LOSS_ERRORS[0] - 1e-9 <= abs(1.0 / case.build["loss"] - 1.0) <= LOSS_ERRORS[1] + 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_each_thing_misleads_and_nothing_else_does(kind):
    random = np.random.default_rng(3)
    speed = 6.0 + 4.0 * np.sin(np.arange(9000) / 500.0)
    speed[4000:4100] = 0.0
    level = np.zeros(len(speed))
    item = SealedDrive(STEP_S, speed, np.gradient(speed, STEP_S), level, level, np.full(len(speed), 272e3), level)
    torque = 3000.0 + random.normal(0.0, 30.0, len(speed))
    changed = []
    for entry in (case_of(kind), case_of("")):
        added = added_torque(entry, item, 272e3, 0.36)
        shown = misled(entry, torque, STEP_S, random)
        loaded = weight_shares(entry, speed)
        changed.append([bool(np.any(added)), not np.array_equal(shown, torque), bool(np.any(loaded != 1.0))])
    assert sum(changed[0]) == 1
    assert changed[0][1] is (kind in SENSORS)
    assert not any(changed[1])


def test_an_hour_of_age_is_an_hour_whose_error_is_small():
    hours = age(11, 2.0)
    assert [hour["hour"] for hour in hours] == [1.0, 2.0]
    assert hours[1]["error"] < 0.02
    assert hours[1]["bytes"] < 1.1 * hours[0]["bytes"]


def hostile_case(kind, said):
    return {"hostile": kind, "worse": [0.0, 0.01, -0.01], "outside": False,
            "said": {str(i + 1): {"said_s": {said: 20} if said and i else {}} for i in range(3)}}  # fmt: skip


def test_the_page_tells_on_which_drives_nothing_was_said(repository):
    cases = [hostile_case("pump", "a torque that no parameter explains"), hostile_case("mud", "")]
    assert "4 of 6 drives (target: none): mud 3, pump 1." in "\n".join(_of_hostile(cases))
    rows = misled_rows(cases)
    assert list(rows[0]) == list(read_table(repository / "docs" / "trust" / "learning_misled.csv")[0])
    said = {row["misled_by"]: row["status_s_a_drive"] for row in rows}
    assert said == {"pump": "a torque that no parameter explains: 13", "mud": "nothing"}


def test_the_page_tells_by_how_much_a_right_mass_is_off():
    def case(mass, counts):
        applied = [0.0] * at.LEARNABLE
        applied[at.OF_MASS] = mass
        return {"said": {"3": {"applied": applied, "counts": counts}}}

    text = _of_mass([case(0.02, [at.OF_MASS]), case(-0.06, [at.OF_MASS]), case(0.5, [])])
    assert "of 2 vehicles and is then off by -2.0 % in the median, 6.0 % at worst" in text
    assert _of_mass([case(0.5, [])]) == "No mass counts as learned."


def test_delays_are_drawn_of_a_seed():
    drawing = draw(11, 6, 10)
    assert drawing == draw(11, 6, 10)
    assert drawing != draw(12, 6, 10)
    assert all(0.0 <= item.filter_s <= item.delay_s <= LONGEST_S for item in drawing)


def test_a_concealed_delay_is_found_and_its_seal_holds(good, trackres, tmp_path, monkeypatch, repository):
    # Its processes in this one.
    monkeypatch.setattr(pipeline, "run_step", lambda step, _: pipeline.call(*(str(word) for word in step if word is not None)))
    monkeypatch.setattr(pipeline, "each", lambda work, tasks, _word: [work(task) for task in tasks])
    asked = ("proofs", "delay", "--seed", 21, "--vehicles", 1, "--hostile", 1, "--minutes", 6, "-o", tmp_path)
    good(*asked)
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert len(scores["each"]) == 2
    assert all(score["wrong_s"] == 0 for score in scores["each"])
    assert "of 1 (target: all)" in (tmp_path / "delay.md").read_text() == page(scores)
    rows = read_table(tmp_path / FOLDER / "delay.csv")
    assert list(rows[0]) == list(read_table(repository / "docs" / "trust" / "delay.csv")[0])
    assert [row["vehicles"] for row in rows if row["group"].startswith(("all", "misled"))] == ["1", "1"]
    assert trackres(*asked[:3], 22, *asked[4:]).returncode == 2
    labels = tmp_path / "sealed" / "labels.json"
    opened = json.loads(labels.read_text())
    opened["drawn"][0]["delay_s"] = 0.1234
    labels.write_text(json.dumps(opened))
    with pytest.raises(InputError, match="sealed"):
        pipeline.score(tmp_path)


def test_the_clock_of_a_drawn_sensor_runs_as_the_drive_does():
    """One that ran slow would be a delay that grows."""
    random = np.random.default_rng(3)
    for item in draw(26, 4, 0):
        times, stamps = _sampled(item, drive(10.0, 272e3, 15.0, 16.0, random), 100.0, random)
        deviation = stamps - START_S - times
        assert np.all(np.diff(stamps) >= 0.0)
        assert np.polyfit(times, deviation, 1)[0] * 600.0 == pytest.approx(0.0, abs=1e-3)

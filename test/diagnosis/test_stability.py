# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A name stands for a mechanism with one size: where it surely changes with a condition, another one has been given its name."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import LAP_S, base, driven, explained, fit_with, judging, named, scored

from trackres_ros.diagnosis.search.stability import unstable
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, SUSPECTED
from trackres_ros.diagnosis.selection.level_errors import Levels

ERROR = 0.1
NAME = "torque_gain"


def late(session, _):
    return np.where(session.time > session.time[len(session) // 2], 1.0, -1.0)


def hot(session, _):
    (predicted,) = base().predict([session], base().nominal, ())
    return np.clip((predicted.belt - 25.0) / 8.0, -2.0, 2.0)


def fast(session, _):
    return scaled(np.abs(session.speed))


def weather(session):
    """Air that gets cold and warm in turn, in the other order in every second drive: hot belts are no sign of a late time."""
    cold = (session.time // (2.0 * LAP_S) + int(session.name[-1])) % 2 == 1
    return replace(session, ambient=np.where(cold, -15.0, 35.0))


def recording(session, number):
    return np.full(len(session), 2.0 * number - 1.0)


def scaled(x):
    return np.clip((x - x.mean()) / x.std(), -2.0, 2.0)


def shown(over=None, share=0.0, error=ERROR):
    """A fit with a wrong scale of the torque whose error is larger by such a share where a condition holds."""
    given = {"changed": weather, "count": 4} if over is hot else {}
    found = driven(1.0 + error if over is None else lambda s, i: 1.0 + error * (1.0 + share * over(s, i)), **given)
    return fit_with(found, named()[NAME])


@pytest.fixture(scope="module")
def stable():
    return shown()


@pytest.mark.parametrize("error", [ERROR, -ERROR])
def test_a_name_of_one_size_is_stable_whatever_its_sign(error):
    found = shown(error=error)
    assert unstable(found, NAME, scored(found)) == []


@pytest.mark.parametrize(
    ("over", "where"),
    [
        (late, "late in a drive than early"), (hot, "with hot belts than cold"), (fast, "fast than slow"),
        (recording, "in later recordings than earlier ones"),
    ],
)  # fmt: skip
@pytest.mark.parametrize(("share", "way"), [(0.7, "larger"), (-0.7, "smaller")])
def test_a_size_that_changes_with_a_condition_is_told_with_it(over, where, share, way):
    for error in (ERROR, -ERROR) if over is late else (ERROR,):
        found = shown(over, share, error)
        assert unstable(found, NAME, scored(found)) == [f"has no constant size: it is {way} {where}"]


@pytest.mark.parametrize(
    ("change", "std", "told"),
    [(0.21, 0.0, True), (0.19, 0.0, False), (0.7, 0.19, True), (0.7, 0.21, False), (-0.7, 0.19, True), (-0.7, 0.21, False)],
)
def test_a_change_is_sure_and_more_than_an_error_of_a_function(monkeypatch, stable, change, std, told):
    """Beyond two and a half standard deviations it is still a fifth of the size."""
    monkeypatch.setattr(Levels, "change_of", lambda *_: (change, std))
    monkeypatch.setattr(Levels, "falls", lambda *_: 1.0)
    assert bool(unstable(stable, NAME, scored(stable))) == told


@pytest.mark.parametrize(("falls", "told"), [(0.06, True), (0.04, False)])
def test_a_changing_size_must_predict_left_out_pieces_better(monkeypatch, stable, falls, told):
    monkeypatch.setattr(Levels, "change_of", lambda *_: (0.7, 0.1))
    monkeypatch.setattr(Levels, "falls", lambda *_: falls)
    assert bool(unstable(stable, NAME, scored(stable))) == told


def test_the_surest_change_is_told(monkeypatch, stable):
    changes = iter([(0.5, 0.1), (0.6, 0.1), (0.9, 0.25), (0.5, 0.09)])
    monkeypatch.setattr(Levels, "change_of", lambda *_: next(changes))
    monkeypatch.setattr(Levels, "falls", lambda *_: 1.0)
    assert unstable(stable, NAME, scored(stable)) == ["has no constant size: it is larger with hot belts than cold"]


def test_a_name_whose_size_changes_is_suspected():
    def growing(session, number):
        return 1.0 + ERROR * (1.0 + 0.7 * late(session, number))

    judges = [judging(driven(gain), {NAME: named()[NAME]}) for gain in (1.0 + ERROR, growing)]
    grades = [of.choice.graded(explained(of, named()[NAME]), NAME) for of in judges]
    assert [g.grade for g in grades] == [CONFIRMED, SUSPECTED]
    assert grades[1].improvement.grade == CONFIRMED
    assert grades[1].fault == "has no constant size: it is larger late in a drive than early"

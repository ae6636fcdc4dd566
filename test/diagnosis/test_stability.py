# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A name stands for a mechanism with one size: where it surely changes with a condition, another one has been given its name."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import LAP_S, base, driven, fit_with, machine, named, scored

from trackres_ros.diagnosis.search.stability import find_instabilities
from trackres_ros.diagnosis.selection.level_errors import Levels

ERROR = 0.1
NAME = "torque_gain"


def late(session, _):
    return np.where(session.time > session.time[len(session) // 2], 1.0, -1.0)


def hot(session, _):
    (prediction,) = base().predict([session], base().nominal, ())
    return np.clip((prediction.belt - 25.0) / 8.0, -2.0, 2.0)


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
    """A fit with a wrong scale of the torque whose error is larger by such a share where a condition holds.

    Only a track vehicle has belts that get hot.
    """
    given_values = {"changed": weather, "count": 4} if over is hot else {"of": machine()}
    result = driven(1.0 + error if over is None else lambda s, i: 1.0 + error * (1.0 + share * over(s, i)), **given_values)
    return fit_with(result, named()[NAME])


@pytest.fixture(scope="module")
def stable():
    return fit_with(driven(1.0 + ERROR), named()[NAME])


@pytest.fixture
def weights(monkeypatch):
    """Of a fit: how each condition that is known weighs in the used samples of its drives."""

    def of(found):
        heard, used = [], np.concatenate(scored(found))
        monkeypatch.setattr(Levels, "change_of", lambda _, adds, more, __: (heard.append(more[used] / adds[used]), (0.0, 1.0))[1])
        assert find_instabilities(found, NAME, scored(found)) == []
        return heard

    return of


def with_belts(found, change):
    """A fit with belt temperatures that a function of them and the used samples gives."""
    belts = zip(found.predicted, scored(found), strict=True)
    return replace(found, predicted=[replace(p, belt=change(p.belt.copy(), used)) for p, used in belts])


def test_each_condition_weighs_by_its_scatter(stable, weights):
    sessions, used = stable.problem.sessions, scored(stable)
    late, hot, fast, later = weights(stable)
    half = [s.time > 0.5 * (s.time[0] + s.time[-1] + s.step) for s in sessions]
    np.testing.assert_array_equal(late > 0.0, np.concatenate([x[m] for x, m in zip(half, used, strict=True)]))
    for result, given_values in ((hot, [p.belt for p in stable.predicted]), (fast, [np.abs(s.speed) for s in sessions])):
        np.testing.assert_allclose(result, scaled(np.concatenate([x[m] for x, m in zip(given_values, used, strict=True)])))
    np.testing.assert_allclose(later, scaled(np.concatenate([np.full(m.sum(), float(i)) for i, m in enumerate(used)])))


@pytest.mark.parametrize("extreme_degc", [-500.0, 500.0])
def test_an_extreme_weighs_as_two_standard_deviations(stable, weights, extreme_degc):
    def once(belt, used):
        belt[np.flatnonzero(used)[10]] = extreme_degc
        return belt

    hot = weights(with_belts(stable, once))[1]
    assert np.abs(hot).max() == hot[10] * np.sign(extreme_degc) == 2.0


def test_a_condition_is_asked_where_it_is_known_and_varies(stable, weights):
    """Belt temperatures of all used samples, and several recordings."""
    assert len(weights(with_belts(stable, lambda belt, used: np.where(used, belt, np.nan)))) == 4
    assert len(weights(with_belts(stable, lambda belt, used: np.where(np.cumsum(used) == 1, np.nan, belt)))) == 3
    assert len(weights(with_belts(stable, lambda belt, _: np.full_like(belt, 20.3)))) == 3
    assert len(weights(fit_with(driven(1.0 + ERROR, count=1), named()[NAME]))) == 3
    assert len(weights(shown())) == 3  # a machine without belts


@pytest.mark.parametrize(
    ("change", "std", "told"),
    [(0.21, 0.0, True), (0.19, 0.0, False), (0.7, 0.19, True), (0.7, 0.21, False), (-0.7, 0.19, True), (-0.7, 0.21, False)],
)
def test_a_change_is_sure_and_more_than_an_error_of_a_function(monkeypatch, stable, change, std, told):
    """Beyond two and a half standard deviations it is still a fifth of the size."""
    monkeypatch.setattr(Levels, "change_of", lambda *_: (change, std))
    monkeypatch.setattr(Levels, "falls", lambda *_: 1.0)
    assert bool(find_instabilities(stable, NAME, scored(stable))) == told


@pytest.mark.parametrize(("falls", "told"), [(0.06, True), (0.04, False)])
def test_a_changing_size_must_predict_left_out_pieces_better(monkeypatch, stable, falls, told):
    monkeypatch.setattr(Levels, "change_of", lambda *_: (0.7, 0.1))
    monkeypatch.setattr(Levels, "falls", lambda *_: falls)
    assert bool(find_instabilities(stable, NAME, scored(stable))) == told


def test_the_surest_change_is_told(monkeypatch, stable):
    changes = iter([(0.5, 0.1), (0.6, 0.1), (0.9, 0.25), (0.5, 0.09)])
    monkeypatch.setattr(Levels, "change_of", lambda *_: next(changes))
    monkeypatch.setattr(Levels, "falls", lambda *_: 1.0)
    assert find_instabilities(stable, NAME, scored(stable)) == ["has no constant size: it is larger with hot belts than cold"]


@pytest.mark.parametrize("error", [ERROR, -ERROR])
def test_a_name_of_one_size_is_stable_whatever_its_sign(error):
    result = shown(error=error)
    assert find_instabilities(result, NAME, scored(result)) == []


@pytest.mark.parametrize(
    ("over", "share", "where"),
    [
        (late, 0.7, "larger late in a drive than early"), (late, -0.7, "smaller late in a drive than early"),
        (hot, 0.7, "larger with hot belts than cold"), (fast, -0.7, "smaller fast than slow"),
        (recording, 0.7, "larger in later recordings than earlier ones"),
    ],
)  # fmt: skip
def test_a_size_that_changes_with_a_condition_is_told_with_it(over, share, where):
    for error in (ERROR, -ERROR) if over is late else (ERROR,):
        result = shown(over, share, error)
        assert find_instabilities(result, NAME, scored(result)) == [f"has no constant size: it is {where}"]

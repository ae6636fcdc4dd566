# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The search over whole explanations: sets of terms, each scored on the laps left out, on small drives."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from worlds import driven, fit_with, judging, named

from trackres_ros.diagnosis.search.explanations import MOST_TERMS, LinearSets
from trackres_ros.diagnosis.selection import locate

GAIN, LEVEL_NM = 1.1, 200.0


@pytest.fixture(scope="module")
def both():
    """Explanations of a torque of another scale and of more torque when belts are hot."""

    def touching(session, _):
        return LEVEL_NM * (np.abs(session.speed) > 6.0)

    item = judging(driven(GAIN, touching), {name: named()[name] for name in ("torque_gain", "torque_offset")})
    item.search.run()
    return item


def test_each_explanation_is_a_unique_set_of_its_fits_terms(both):
    assert len(both.search.known) > 10
    for key, explanation in both.search.known.items():
        names = explanation.fit.effect_names
        assert key == explanation.key == set(names)
        assert len(names) == len(key)
        assert explanation.terms.keys() <= key
        assert all(c.name == name for name, c in explanation.terms.items())


def test_sums_run_over_names_in_order_not_as_hashes_fall(both, monkeypatch):
    """Else two runs on the same drives round differently, and the one or the other set comes first."""
    asked = []
    monkeypatch.setattr(LinearSets, "gain", lambda _, names: asked.append(names) or float(len(asked) % 7))
    both.search._add_sets(both.search.rounds[frozenset()])
    assert any(len(names) > 1 for names in asked)
    assert all(isinstance(names, tuple) and list(names) == sorted(names) for names in asked)


def test_no_explanation_is_grown_beyond_three_terms(both):
    sizes = {len(key) for key in both.search.known}
    assert sizes == {0, 1, 2, 3} == set(range(MOST_TERMS + 1))
    assert all(len(key) < MOST_TERMS for key in both.search.rounds)


def test_a_worth_is_the_level_score_less_the_cost_of_a_term(both):
    search, validation = both.search, both.validation
    proposed = [frozenset({p.effect.name}) for p in search.rounds[frozenset()].best(())]
    assert len(proposed) >= 3
    for explanation in (search.known[key] for key in proposed):
        total = validation.gain(search.base_explanation.score, explanation.score)
        assert explanation.net_gain == pytest.approx(total - search.cost, abs=1e-6)


def test_what_was_hidden_is_worth_most(both):
    best = max(both.search.known.values(), key=lambda e: e.net_gain)
    assert any(name.endswith("_of_speed") for name in best.key)
    assert both.search.known[frozenset()].net_gain == 0.0


def test_a_set_that_two_ways_reach_is_one_the_better(both):
    search = both.search
    key, known = next((k, e) for k, e in search.known.items() if len(k) == 1 and not e.settled)
    (candidate,) = known.terms.values()
    count = len(search.known)
    for nm, kept in ((1e4, True), (0.0, False)):
        search.known[key] = replace(known, net_gain=known.net_gain + nm)
        search._add(search.base_explanation, candidate, None)
        assert len(search.known) == count
        assert (search.known[key].net_gain == known.net_gain + nm) == kept or search.known[key].net_gain == pytest.approx(
            known.net_gain
        )
    search.known[key] = known


def test_without_a_term_it_is_the_set_without_it(both):
    search = both.search
    for explanation in [e for e in search.known.values() if e.key]:
        for name in explanation.key:
            less = search.without(explanation, name)
            assert less.key == explanation.key - {name} == set(less.fit.effect_names)
            assert search.known[less.key] is less


def test_without_a_term_the_others_are_fitted_anew(both):
    search = both.search
    pair = max((e for e in search.known.values() if len(e.key) == 2), key=lambda e: e.net_gain)
    name = next(iter(pair.key))
    single = search.known.pop(pair.key - {name})
    try:
        fit_result = search.polish(search.without(pair, name))
        assert fit_result.terms.keys() == single.key
        repetition = fit_with(both.refitted, *(a.effect for a in fit_result.fit.effects))
        assert fit_result.fit.log_likelihood == pytest.approx(repetition.log_likelihood, abs=3.0)
        gained = both.validation.gain(search.base_explanation.score, fit_result.score)
        assert fit_result.net_gain == pytest.approx(gained - search.cost, abs=1e-6)
    finally:
        search.known[single.key] = single


def test_a_polished_explanation_has_a_settled_fit_and_its_score(both):
    search = both.search
    rough = next(e for e in search.known.values() if not e.settled)
    fine = search.polish(rough)
    assert fine.settled
    assert fine is search.known[rough.key] is search.polish(rough)
    assert fine.key == rough.key
    assert fine.fit.log_likelihood >= rough.fit.log_likelihood - 1.0
    repetition = both.validation.score(fine.fit)
    np.testing.assert_allclose(fine.score.density, repetition.density)
    gained = both.validation.gain(search.base_explanation.score, repetition)
    assert fine.net_gain == pytest.approx(gained - search.cost * len(fine.key), abs=1e-6)


def test_an_expanded_explanation_is_expanded_once(both):
    search = both.search
    result_before = dict(search.known)
    assert search.expand(search.base_explanation) is search.rounds[frozenset()]
    assert search.known == result_before


@pytest.mark.parametrize(("slow", "like"), [(0.4, False), (0.6, True)])
@pytest.mark.parametrize("offset", [0.0, 5.0])
def test_a_slope_may_be_what_varies_slowly(slow, like, offset, monkeypatch):
    """Of a variance of 1 Nm2 beside an offset; where the slope is measured, it is none."""
    residual = offset + np.tile([-1.0, 1.0], 50)
    monkeypatch.setattr(locate, "torque_residuals", lambda _: [residual])
    result = SimpleNamespace(problem=SimpleNamespace(masks=[np.ones(100, dtype=bool)]))
    for slope, expectation in ((0.01, like), (np.nan, False)):
        left = locate.SlowResidual(float(np.sqrt(slow + offset**2)), 0.1, slope)
        monkeypatch.setattr(locate, "slow_residual", lambda _, left=left: left)
        assert locate.is_like_slope(result) == expectation

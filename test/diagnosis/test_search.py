# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The search over whole explanations and the laps left out that decide, on small drives."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.inference.levels import with_levels
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT
from trackres_ros.diagnosis.search import explanations
from trackres_ros.diagnosis.search.choice import CLASS_SHARE, Choice, ScoredExplanation, _class_of, _competes
from trackres_ros.diagnosis.search.cross_validation import FOLDS, CrossValidation
from trackres_ros.diagnosis.search.explanations import MOST_TERMS, Explanation, Search
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, SUSPECTED
from trackres_ros.diagnosis.selection.naming import Pool, compared, one_round
from trackres_ros.diagnosis.selection.visibility import EffectColumns
from trackres_ros.diagnosis.stages import refit as refit_stage
from trackres_ros.diagnosis.stages.options import BY_DEFAULT
from trackres_ros.effects import catalogue
from trackres_ros.evaluation.synthetic import drives

LAP_S, LAPS = 75.0, 8  # of each of two drives
HELD_OUT_EVERY = 4  # so many laps of a drive leave one that is not fitted
NOISE_NM, NOISE_PHI = 20.0, 0.4
GAIN, LEVEL_NM, SINCE_S = 1.1, 200.0, 250.0
MOST_SPEED_MPS = 15.0


@pytest.fixture(scope="module")
def known(loaded):
    facts = loaded.base.facts
    return catalogue(None, facts.weight * facts.radius)


@pytest.fixture(scope="module")
def driven(loaded, known):
    """Makes the fit of a base to laps of two drives with a torque of another scale and more torque, of a session, against travel;
    the last laps of each drive are held out.
    """

    def make(gain=1.0, adds=None, held_out_gain=None, laps=LAPS):
        base, rng = loaded.base, np.random.default_rng(1)
        sessions = drives(base, MOST_SPEED_MPS, 2, laps * LAP_S / 60.0, rng, step=1.0)
        bare = [p.torque for p in base.predict(sessions, base.nominal, ())]
        shown, masks = [], []
        for i, (session, torque) in enumerate(zip(sessions, bare, strict=True)):
            lap = (session.time // LAP_S).astype(np.int64)
            fitted = lap < laps - laps // HELD_OUT_EVERY
            scale = np.where(fitted, gain, gain if held_out_gain is None else held_out_gain)
            noise = lfilter([1.0], [1.0, -NOISE_PHI], rng.normal(0.0, NOISE_NM, len(session)))
            more = 0.0 if adds is None else adds(session, i) * np.sign(session.speed)
            moves = np.abs(session.speed) > 0.5
            shown.append(replace(session, torque=scale * (torque + more) + noise, block=lap + i * laps, used=moves))
            masks.append(moves & fitted)
        return fit(Problem(base, tuple(shown), tuple(masks)))

    return make


def later(session, drive):
    return LEVEL_NM * ((session.time > SINCE_S) | (drive > 0))


def validation_of(found):
    held_out = [s.used & ~m for s, m in zip(found.problem.sessions, found.problem.masks, strict=True)]
    return CrossValidation(found, held_out, np.random.default_rng(1))


def fit_with(found, *effects):
    """A fit with effects, with values that predict."""
    return with_levels(fit(found.problem, effects, found.at, found.noises))


def series(found, of, ahead=None, name="series"):
    """A term that follows the clock; it is looked for on the laps that are fitted."""
    facts, problem = found.problem.base.facts, found.problem
    shape = [of(s, i) * np.sign(s.speed) for i, s in enumerate(problem.sessions)]
    known = shape if ahead is None else [ahead * x for x in shape]
    shape = [np.where(m, x, a) for m, x, a in zip(problem.masks, shape, known, strict=True)]
    return ResidualPattern(name, "of a test", shape, facts.weight * facts.radius, known)


# Laps left out


@pytest.fixture(scope="module")
def scaled(driven, known):
    """The base alone and with the hidden effect, and the laps left out of them."""
    found = driven(GAIN)
    plain = with_levels(found)
    return plain, fit_with(found, known["torque_gain"]), validation_of(plain)


def test_a_model_scored_against_itself_gains_nothing(scaled):
    plain, _, validation = scaled
    one, same = validation.score(plain), validation.score(plain)
    improvement = validation.improvement(one, same)
    assert validation.gain(one, same) == validation.least_gain(one, same) == 0.0
    assert (improvement.before - improvement.after, improvement.low, improvement.high) == (0.0, 0.0, 0.0)
    assert not improvement.confirmed
    np.testing.assert_allclose(validation.shares([one, same]), [0.5, 0.5])


def test_a_true_effect_surely_gains_and_its_removal_does_not(scaled):
    plain, true, validation = scaled
    before, after = validation.score(plain), validation.score(true)
    assert 0.0 < validation.least_gain(before, after) < validation.gain(before, after)
    assert validation.least_gain(after, before) < 0.0
    assert validation.improvement(before, after).confirmed
    assert validation.shares([before, after])[1] > 0.99


def test_what_is_expected_of_a_fold_is_that_of_a_fit_without_it(scaled):
    """One Newton step, against fits of the other laps."""
    _, true, validation = scaled
    score, problem = validation.score(true), true.problem
    whole, fold_of = validation._of([p.torque for p in true.predicted]), validation._of(validation._fold)
    for fold in range(FOLDS):
        masks = tuple(m & (of != fold) for m, of in zip(problem.masks, validation._fold, strict=True))
        effects = [a.effect for a in true.effects]
        refit = fit(replace(problem, masks=masks), effects, true.at, true.noises, largest_root=SHORT_ROOT)
        at = fold_of == fold
        moved = validation._of([p.torque for p in refit.predicted])[at] - whole[at]
        off = score.expected[at] - whole[at] - moved
        assert np.sqrt(np.mean(off**2)) < 0.3 * np.sqrt(np.mean(moved**2)) + 0.01 * NOISE_NM
    held_out = fold_of < 0
    np.testing.assert_allclose(score.expected[held_out], whole[held_out])


def test_every_fitted_sample_is_of_one_fold_and_no_other_is(scaled):
    plain, _, validation = scaled
    for session, mask, fold in zip(plain.problem.sessions, plain.problem.masks, validation._fold, strict=True):
        assert (fold[mask] >= 0).all()
        assert (fold[~mask] == -1).all()
        of_lap = {int(b): set(fold[mask & (session.block == b)].tolist()) for b in np.unique(session.block[mask])}
        assert all(len(of) == 1 for of in of_lap.values())
    assert len(validation.measured) == sum(int(s.used.sum()) for s in plain.problem.sessions)


def test_what_only_fitted_laps_show_has_no_held_out_gain(driven):
    """A torque that comes and goes evenly and that nobody knows ahead; where it is known, it surely gains."""

    def comes_and_goes(session, _):
        return LEVEL_NM * np.sign(np.sin(session.time / 6.0))

    found = driven(adds=comes_and_goes)
    plain, validation = with_levels(found), validation_of(found)
    before = validation.score(plain)
    unknown, known = (fit_with(found, series(found, comes_and_goes, ahead)) for ahead in (0.0, 1.0))
    assert unknown.log_likelihood > plain.log_likelihood + 100.0
    assert validation.least_gain(before, validation.score(known)) > 100.0
    assert validation.least_gain(before, validation.score(unknown)) <= 0.0
    assert validation.gain(before, validation.score(unknown)) < 0.02 * validation.gain(before, validation.score(known))
    assert not validation.improvement(before, validation.score(unknown)).confirmed


# The search, and the choice of an explanation


@pytest.fixture(scope="module")
def both(driven, known, explained):
    """Explanations of a torque of another scale and of a level that changed."""
    return explained(driven(GAIN, later), {name: known[name] for name in ("torque_gain", "torque_offset")})


def test_what_was_hidden_is_found_together(both):
    assert both.chosen.explanation.key == {"torque_gain", "level_change"}


def test_each_explanation_is_a_unique_set_of_its_fits_terms(both):
    for key, explanation in both.search.known.items():
        names = explanation.fit.effect_names
        assert key == explanation.key == set(names)
        assert len(names) == len(key) <= MOST_TERMS + 1
        assert explanation.terms.keys() <= key


def test_a_set_that_two_ways_reach_is_one_with_the_better_fit(both):
    search, pair = both.search, frozenset({"torque_gain", "level_change"})
    assert all(frozenset({name}) in search.rounds for name in pair)
    before = search.known[frozenset({"level_change"})]
    step = search.rounds[before.key]
    (again,) = [c for c in step.candidates if c.name == "torque_gain"]
    of_this_way = before.evidence + again.net_evidence
    assert search.known[pair].evidence >= of_this_way
    count, kept = len(search.known), search.known[pair]
    search._keep(replace(kept, evidence=of_this_way - 1e3))  # a worse way to it
    assert (len(search.known), search.known[pair]) == (count, kept)


def test_without_a_term_it_is_the_set_without_it(both):
    search = both.search
    for explanation in [e for e in search.known.values() if e.key]:
        for name in explanation.key:
            less = search.without(explanation, name)
            assert less.key == explanation.key - {name} == set(less.fit.effect_names)
            assert search.known[less.key] is less
    pair = search.known[frozenset({"torque_gain", "level_change"})]
    single = search.known.pop(frozenset({"level_change"}))
    try:
        fitted = search.without(pair, "torque_gain")  # with the other in the fit
        assert fitted.terms.keys() == fitted.candidates.keys() == {"level_change"}
        assert fitted.evidence == pytest.approx(single.evidence, abs=3.0)
    finally:
        search.known[single.key] = single


def test_a_confirmed_explanation_has_only_confirmed_terms(both):
    choice, seen = both.choice, 0
    for judged in list(choice._judged.values()):
        graded = choice._all_graded(judged)
        if not judged.key or not choice._is_confirmed(judged):
            continue
        seen += 1
        assert all(g.grade == CONFIRMED for g in graded.values())
        for g in graded.values():
            assert g.improvement.likelier > 0.0 or g.improvement.low > 0.0
            assert g.improvement.after <= g.improvement.before
        kept = both.laps.improvement_of(both.refitted, judged.final)
        assert kept.after <= kept.before
    assert seen >= 2
    assert all(g.confirmed for g in both.chosen.graded.values())
    assert both.chosen.graded.keys() == both.chosen.explanation.key


def test_an_explanation_counts_if_each_term_beats_the_noise(both, monkeypatch):
    search, pair = both.search, both.choice.judged(both.search.known[frozenset({"torque_gain", "level_change"})])
    lost = {name: pair.explanation.evidence - search.without(pair.explanation, name).evidence for name in pair.key}
    gains = [lost[name] + c.gain - c.criterion for name, c in pair.explanation.candidates.items()]
    for share, counts in ((0.9, True), (1.1, False)):
        by_noise = share * min(gains)
        monkeypatch.setattr(search, "_pool", replace(search._pool, by_noise=by_noise))
        monkeypatch.setattr(search, "rounds", {key: replace(step, by_noise=by_noise) for key, step in search.rounds.items()})
        assert both.choice._counts(pair) == counts


def test_no_term_of_an_unconfirmed_explanation_is_confirmed(both, monkeypatch):
    monkeypatch.setattr(both.choice, "_is_confirmed", lambda _: False)
    graded = both.choice.best(keep_suspected=True).graded
    assert graded
    assert not any(g.confirmed for g in graded.values())
    assert any(g.improvement.confirmed for g in graded.values())


def test_each_class_has_what_was_chosen_and_weights_of_one(both):
    assert both.chosen.steps.keys() == both.chosen.explanation.key
    for name, step in both.chosen.steps.items():
        assert step.chosen.name == name in step.members
        assert step.weights.keys() == set(step.members)
        assert sum(step.weights.values()) == pytest.approx(1.0)
        assert step.stability >= CLASS_SHARE or len(step.members) > 1


@given(st.dictionaries(st.sampled_from("abcdef"), st.floats(0.001, 1.0), min_size=1), st.data())
def test_a_class_holds_four_fifths_unless_all_are_in_it(weights, data):
    shares = {name: w / sum(weights.values()) for name, w in weights.items()}
    name = data.draw(st.sampled_from(sorted(shares)))
    alike = data.draw(st.sets(st.sampled_from(sorted(shares))))
    members = _class_of(name, shares, alike)
    assert members[0] == name
    assert len(members) == len(set(members))
    assert alike <= set(members)
    assert sum(shares[m] for m in members) >= CLASS_SHARE - 1e-9 or set(members) == set(shares)
    by_share = [m for m in members if m not in alike | {name}]
    left = [shares[m] for m in shares if m not in members]
    assert max(left, default=0.0) <= min((shares[m] for m in by_share), default=1.0)


def shares_of(chosen, *explanations):
    """Shares of explanations: each has a weight and the evidence lost without each term; forms begin with `form`."""
    known = {
        frozenset(lost) - {name}: Explanation(None, sum(lost.values()) - lost[name]) for _, lost in explanations for name in lost
    }
    for _, lost in explanations:
        candidates = {name: SimpleNamespace(is_name=not name.startswith("form")) for name in lost}
        known[frozenset(lost)] = Explanation(None, sum(lost.values()), candidates)
    judged = [ScoredExplanation(known[frozenset(lost)], None, weight) for weight, lost in explanations]
    best = judged[0].explanation if chosen else Explanation(None)
    choice = Choice.__new__(Choice)
    choice._search = SimpleNamespace(without=lambda explanation, name: known[explanation.key - {name}])
    choice._validation = SimpleNamespace(shares=lambda weights: np.array(weights) / sum(weights))
    return choice._shares([j for j in judged if not chosen or _competes(j.explanation, best)], best.key)


some = st.floats(0.1, 300.0)


@given(some, some, some, some)
def test_a_form_lends_no_weight_to_a_name_beside_it(weight, other, by_form, by_name):
    """The name has its part of the evidence, nothing else, and the form's part has no name."""
    found = shares_of(False, (other, {"a": 9.0}), (weight, {"form": by_form, "b": by_name}))
    share, part = weight / (weight + other), by_name / (by_name + by_form)
    assert found == pytest.approx({"a": 1.0 - share, "b": share * part, "none of these": share * (1.0 - part)})
    by_names = shares_of(False, (other, {"a": 9.0}), (weight, {"c": by_form, "b": by_name}))
    assert by_names == pytest.approx({"a": 1.0 - share, "b": share, "c": share})


@given(some, some)
def test_a_form_in_place_of_a_chosen_name_takes_no_share(weight, evidence):
    alone = (1.0, {"a": 50.0})
    assert shares_of(True, alone, (weight, {"form": evidence})) == {"a": 1.0}
    assert shares_of(True, alone, (weight, {"a": 50.0, "form": evidence})) == {"a": 1.0}
    both = shares_of(True, alone, (1.0, {"b": 40.0}), (weight, {"form": evidence}))
    assert both == {"a": 0.5, "b": 0.5}


def test_a_rival_name_is_listed_with_the_form_that_helps_it():
    """Unless the evidence is far below that of the chosen name alone."""
    for by_name, listed in ((28.0, True), (26.0, False)):
        found = shares_of(True, (1.0, {"a": 50.0}), (3.0, {"b": by_name, "form": 20.0}))
        assert ("b" in found) == listed
    assert shares_of(True, (1.0, {"a": 50.0}), (3.0, {"b": 30.0, "form": 20.0}))["b"] == pytest.approx(0.75 * 0.6)
    found = shares_of(True, (1.0, {"a": 50.0, "form": 9.0}), (1.0, {"b": 40.0, "form": 9.0}))
    assert found == {"a": 0.5, "b": 0.5}  # a form that both have is not in doubt


@pytest.fixture(scope="module")
def graded(judging):
    """Grades the terms that a fit adds to a base, and says whether all of it is confirmed."""

    def grade(found, *effects, by_file=np.inf):
        choice = judging(found, {}).choice
        choice._by_file = min(choice._by_file, by_file)
        whole = fit(found.problem, effects, found.at, found.noises)
        candidates = {}
        for effect in effects:
            less = fit(found.problem, [e for e in effects if e is not effect], found.at, found.noises)
            candidates[effect.name] = compared(less, whole, effect.name, 1.0, 9.0, 0.0)
        judged = choice.judged(Explanation(whole, 0.0, candidates))
        return {name: choice.graded(judged, name) for name in candidates}, choice._is_confirmed(judged)

    return grade


def test_terms_that_cancel_each_other_are_not_confirmed(driven, graded):
    """Two large series that differ little: what they add together is a tenth of either."""

    def one(session, _):
        return LEVEL_NM * np.sin(session.time / 20.0)

    def other(session, _):
        return -LEVEL_NM * np.sin(session.time / 20.0 + 0.1)

    found = driven(adds=lambda s, i: one(s, i) + other(s, i))
    terms = [series(found, of, name=name) for name, of in (("one", one), ("other", other))]
    of, confirmed = graded(found, *terms)
    assert all(g.improvement.grade == CONFIRMED for g in of.values())  # each helps the other
    assert all((g.cancels, g.grade) == (True, SUSPECTED) for g in of.values())
    assert not confirmed


def test_a_term_as_large_as_its_improvement_is_confirmed(driven, graded):
    def one(session, _):
        return LEVEL_NM * np.sin(session.time / 20.0)

    found = driven(adds=one)
    of, confirmed = graded(found, series(found, one, name="one"))
    assert (of["one"].cancels, of["one"].grade, confirmed) == (False, CONFIRMED, True)


def test_a_gain_far_above_the_size_of_a_term_is_not_confirmed(driven, graded, known, monkeypatch):
    """A fit without the term that ended in a worse optimum, and a term that is nothing."""
    found = driven(laps=12)
    worse = replace(found, predicted=tuple(replace(p, torque=0.9 * p.torque) for p in found.predicted))
    monkeypatch.setattr(Choice, "judged", with_worse_base(Choice.judged, worse))
    of, confirmed = graded(found, known["torque_gain"])
    assert of["torque_gain"].improvement.grade == CONFIRMED
    assert (of["torque_gain"].by_others, of["torque_gain"].grade, confirmed) == (True, SUSPECTED, False)


def with_worse_base(judged, worse):
    def of(choice, explanation):
        right = judged(choice, explanation)
        return right if explanation.key else replace(right, final=worse, score=choice._validation.score(worse))

    return of


@pytest.mark.parametrize(("cold_nm", "time_constant"), [(500.0, 300.0), (2400.0, 150.0)])
def test_a_slow_effect_is_named_whatever_its_size(driven, known, cold_nm, time_constant):
    found = driven(adds=lambda session, drive: cold_nm * np.exp(-session.time / time_constant))
    assert found.noise.phi.sum() > 0.95  # near a random walk
    names = {name: known[name] for name in ("warmup", "delay", "mullins")}
    step = one_round(found, Pool(names, EffectColumns(found), 10.0), 0, np.random.default_rng(1))
    best = step.candidates[0]
    assert best.name == "warmup"
    assert best.counts(step.threshold)


def test_beside_a_large_effect_noise_is_that_of_the_rest(driven, known, monkeypatch):
    monkeypatch.setattr(explanations, "find_terms", lambda *_, **__: ())
    found = driven(GAIN)
    search = Search(found, {}, None, (), 19, np.random.default_rng(1), lambda _: None)
    search._pool = Pool({name: known[name] for name in ("torque_gain", "grade", "stribeck")}, EffectColumns(found))
    alone = search.expand(search.nothing).by_noise
    named = search.known[frozenset({"torque_gain"})]
    assert search.expand(named).by_noise < 0.5 * alone  # what is drawn from the base alone has the effect in it
    assert search.expand(replace(named, candidates={"form": SimpleNamespace(is_name=False)})).by_noise == alone == search.by_noise


def test_the_search_gives_a_base_likelier_than_its_own(driven, known):
    found = driven()
    best = Explanation(fit(found.problem, [known["torque_gain"]], found.at, found.noises, rounds=1), 5.0, {"torque_gain": None})
    for lost, better in ((0.0, False), (5.0, False), (15.0, True)):
        search = Search(replace(found, log_likelihood=found.log_likelihood - lost), {}, None, (), 19, None, lambda _: None)
        assert search.likelier_base() is None  # without an explanation there is nothing to begin from
        search._pool = replace(search._pool, by_noise=10.0)
        search._keep(best)
        likelier = search.likelier_base()
        assert (likelier is not None) == better
        assert likelier is None or likelier.log_likelihood == pytest.approx(found.log_likelihood, abs=4.0)


def test_a_likelier_base_is_searched_from_once(monkeypatch):
    began = []

    def explored(_, base, *__):
        return SimpleNamespace(base=base, likelier_base=lambda: SimpleNamespace(at="better"))

    def refitted(*_):
        began.append(_[-1])
        return SimpleNamespace(refitted=None, validation=None, laps=None, use=None)

    chosen = SimpleNamespace(best=lambda _: "chosen")
    for name, value in (("_explored", explored), ("refit", refitted), ("Choice", lambda *_: chosen)):
        monkeypatch.setattr(refit_stage, name, value)
    base, of = refit_stage.search(None, None, BY_DEFAULT, None)
    assert (began, base is None, of) == (["better"], False, "chosen")


def test_a_name_on_a_bound_is_at_best_suspected(driven, graded, known):
    found = driven(GAIN)
    narrow = copy.copy(known["torque_gain"])
    narrow.parameters = tuple(replace(q, high=0.7 * (GAIN - 1.0)) for q in narrow.parameters)
    of, confirmed = graded(found, narrow)
    assert of["torque_gain"].improvement.grade == CONFIRMED
    assert (of["torque_gain"].on_bounds, of["torque_gain"].grade, confirmed) == (("error",), SUSPECTED, False)


def test_what_held_out_laps_or_the_file_refute_is_not_confirmed(driven, graded, known):
    found = driven(GAIN)
    assert graded(found, known["torque_gain"])[1]
    assert not graded(found, known["torque_gain"], by_file=1.0)[1]
    assert not graded(driven(GAIN, held_out_gain=1.0), known["torque_gain"])[1]


@pytest.mark.parametrize(("fallen", "beaten"), [(0.9, False), (1.1, True)])
def test_a_form_takes_the_place_of_a_name_beyond_a_tenth_of_it(fallen, beaten):
    """It surely predicts better; its mean square error falls by so many times the square of a tenth of what the name adds."""
    adds, samples = 300.0, 100

    def judged(names, forms, square):
        candidates = {name: SimpleNamespace(is_name=True) for name in names}
        explanation = SimpleNamespace(without_a_name=forms, candidates=candidates, terms={})
        final = SimpleNamespace(contribution=lambda _: np.full(samples, adds))
        return SimpleNamespace(
            explanation=explanation, final=final, key=set(names), score=SimpleNamespace(square=np.array([square]))
        )

    choice = SimpleNamespace(_validation=SimpleNamespace(least_gain=lambda *_: 100.0), _beyond_base=lambda series: series)
    name = judged(["scrub"], 0, 1e6)
    form = judged([], 1, 1e6 - fallen * samples * (0.1 * adds) ** 2)
    assert Choice._beats(choice, form, name) == beaten
    assert Choice._beats(choice, judged(["other"], 0, 1e6), name)  # a name needs no more than to be surely better


@pytest.mark.parametrize(("after", "evidence", "outdone"), [(99.0, 11.0, True), (99.0, 9.0, False), (90.0, 11.0, False)])
def test_a_form_with_more_evidence_replaces_a_small_name(after, evidence, outdone):
    def judged(names, forms, error, evidence):
        terms = {name: SimpleNamespace(is_name=True) for name in names} | {f: SimpleNamespace(is_name=False) for f in forms}
        explanation = SimpleNamespace(candidates=terms, evidence=evidence)
        return SimpleNamespace(explanation=explanation, key=set(terms), score=SimpleNamespace(error=np.array([error])))

    base, search = judged([], ["spells"], 100.0, 0.0), SimpleNamespace(without=lambda *_: None)
    choice = SimpleNamespace(_search=search, judged=lambda _: base)
    name, form = judged(["scrub"], ["spells"], after, 10.0), judged([], ["spells", "step"], after, evidence)
    assert Choice._outdoes(choice, form, name) == outdone
    assert not Choice._outdoes(choice, name, form)

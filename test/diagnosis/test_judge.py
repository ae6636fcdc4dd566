# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The judge: what laps and recordings left out confirm, which explanation is chosen, and what is as good as it."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import driven, explained, form, graded, judging, machine, named, series

from trackres_ros.diagnosis.base.patterns import ByPlace, ClockTerm, ResidualPattern
from trackres_ros.diagnosis.empirical.term import CLOCK, FORM, NAME, ONLY_BETWEEN, Round, Term
from trackres_ros.diagnosis.search.choice import CLASS_SHARE, Choice, _class_of, _competes
from trackres_ros.diagnosis.search.explanations import Explanation
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED
from trackres_ros.effects.learned import ABOVE, AMBIENT, SPEED, STEP, VARIABLES, Corner

GAIN, LEVEL_NM, SIZE_NM = 1.1, 200.0, 150.0


# Rules, without a drive


@given(st.dictionaries(st.sampled_from("abcdef"), st.floats(0.001, 1.0), min_size=1), st.data())
def test_a_class_holds_four_fifths_unless_all_are_in_it(weights, data):
    shares = {name: w / sum(weights.values()) for name, w in weights.items()}
    name = data.draw(st.sampled_from(sorted(shares)))
    alike = data.draw(st.sets(st.sampled_from(sorted(shares))))
    members = _class_of(name, shares, alike)
    assert members[0] == name
    assert len(members) == len(set(members))
    assert alike <= set(members)
    assert sum(shares[m] for m in members) >= 0.8 - 1e-9 or set(members) == set(shares)
    by_share = [m for m in members if m not in alike | {name}]
    remainders = [shares[m] for m in shares if m not in members]
    assert max(remainders, default=0.0) <= min((shares[m] for m in by_share), default=1.0)
    # And no more than that: without the smallest of those it would hold less.
    needed = {name, *by_share}
    if by_share:
        assert sum(shares[m] for m in needed) - min(shares[m] for m in by_share) < 0.8


def of_kinds(kinds, **given):
    return Explanation(None, None, 0.0, {name: Term(EFFECTS[kind](name), None) for name, kind in kinds.items()}, **given)


EFFECTS = {
    NAME: lambda name: SimpleNamespace(name=name),
    FORM: lambda name: Corner(SPEED, STEP),
    CLOCK: lambda name: ResidualPattern(name, "of a test", (), 1e4),
}


def test_shares_are_of_names_and_forms_have_none():
    explanations = [of_kinds({"a": 0}), of_kinds({"b": 0, "form": 1}), of_kinds({"form": 1})]
    choice = Choice.__new__(Choice)
    choice._validation = SimpleNamespace(shares=lambda _: np.array([0.5, 0.3, 0.2]))
    scored_by = [replace(e, score=SimpleNamespace()) for e in explanations]
    result = choice._shares(scored_by)
    assert result == pytest.approx({"a": 0.5, "b": 0.3, "none of these": 0.2})
    assert list(result) == ["a", "b", "none of these"]


def test_an_explanation_with_more_forms_casts_no_doubt():
    name, form_alone, on_clock = of_kinds({"a": 0}), of_kinds({"x": 1}), of_kinds({"x": 2})
    assert (_competes(name, form_alone), _competes(form_alone, name)) == (True, False)
    assert _competes(form_alone, on_clock)
    assert not _competes(on_clock, form_alone)
    assert _competes(name, of_kinds({"b": 0}))


@pytest.mark.parametrize(("fallen", "beaten"), [(0.9, False), (1.1, True)])
def test_a_form_takes_the_place_of_a_name_beyond_a_tenth_of_it(fallen, beaten):
    """It surely predicts better; its mean square error falls by so many times the square of a tenth of what the name adds."""
    adds, samples = 300.0, 100

    def judged(kinds, square):
        fit = SimpleNamespace(contribution=lambda _: np.full(samples, adds))
        return replace(of_kinds(kinds), fit=fit, score=SimpleNamespace(square=np.array([square])))

    choice = SimpleNamespace(_validation=SimpleNamespace(least_gain=lambda *_: 100.0), _beyond_base=lambda x: x)
    name = judged({"scrub": 0}, 1e6)
    by_form = judged({"form": 1}, 1e6 - fallen * samples * (0.1 * adds) ** 2)
    assert Choice._beats(choice, by_form, name) == beaten
    assert Choice._beats(choice, judged({"other": 0}, 1e6), name)  # a name needs no more than to be surely better
    by_place = replace(name, terms={"scrub": Term(ByPlace("scrub", "of a test", (), 1e4, None, 1.0), None)})
    assert Choice._beats(choice, by_form, by_place)  # what was learned for each place has no form to err in


@pytest.mark.parametrize(("gain", "by_name", "by_form"), [(2.9, False, False), (3.1, True, False), (10.1, True, True)])
def test_a_form_needs_a_larger_margin_than_a_name(gain, by_name, by_form):
    choice = SimpleNamespace(_validation=SimpleNamespace(least_gain=lambda *_: gain), _beyond_base=lambda x: x)
    fit, score = SimpleNamespace(contribution=lambda _: np.zeros(1)), [SimpleNamespace(square=np.array([x])) for x in (9.0, 1.0)]
    name = replace(of_kinds({"a": 0}), fit=fit, score=score[0])
    others = [replace(of_kinds(kinds), fit=fit, score=score[1]) for kinds in ({"b": 0}, {"x": 1})]
    assert [Choice._beats(choice, other_item, name) for other_item in others] == [by_name, by_form]


@pytest.mark.parametrize(("worth", "confirmed"), [(9.9, False), (10.1, True)])
def test_terms_that_pass_only_together_need_a_margin(worth, confirmed):
    sure = SimpleNamespace(confirmed=True, before=2.0, after=1.0)
    choice = SimpleNamespace(
        _search=SimpleNamespace(base_explanation=SimpleNamespace(score=None)),
        _validation=SimpleNamespace(improvement=lambda *_, **__: sure),
        _hold_out_improvement=lambda _: sure, _by_file=2.0, _laps=SimpleNamespace(predicts=lambda _: True),
        grade_term=lambda *_: sure,
    )  # fmt: skip
    pair = replace(of_kinds({"a": 0, "x": 1}), net_gain=worth)
    assert Choice._is_confirmed(choice, pair) == confirmed
    assert Choice._is_confirmed(choice, replace(of_kinds({"a": 0}), net_gain=0.1))


@pytest.mark.parametrize("alone", [False, True])
def test_a_name_stands_without_the_forms_beside_it(alone, monkeypatch):
    monkeypatch.setattr("trackres_ros.diagnosis.search.choice.find_instabilities", lambda *_: [])
    known = {key: of_kinds(dict.fromkeys(key, 0)) for key in ("", "a")} | {"ax": of_kinds({"a": 0, "x": 1})}
    less = {("ax", "x"): "a", ("a", "a"): ""}
    search = SimpleNamespace(without=lambda e, name: known[less["".join(sorted(e.key)), name]])
    validation = SimpleNamespace(scored=(), improvement=lambda *_: SimpleNamespace(confirmed=alone))
    choice = SimpleNamespace(_search=search, _validation=validation, _unstable_names=set())
    assert (not Choice._size_faults(choice, known["ax"], "a")) == alone
    assert not Choice._size_faults(choice, known["a"], "a")


def chosen_beside(own, candidates, cost=3.0, members=()):
    """A chosen term `own`, and the candidates of the round without it."""
    first, *others = (replace(Term(SimpleNamespace(name=""), None, share=0.1), **item) for item in (own, *candidates))
    return replace(first, rivals=Round(None, None, tuple(others), cost), members=members)


@pytest.mark.parametrize(
    ("level", "rival", "instead"),
    [
        (20.0, {"level": 9.9}, ""), (20.0, {"level": 10.1}, "b"), (4.0, {"level": 2.5}, ""), (4.0, {"level": 3.5}, "b"),
        (20.0, {"level": 15.0, "effect": Corner(SPEED, STEP)}, ""), (20.0, {"level": 15.0, "share": 0.001}, ""),
    ],
)  # fmt: skip
def test_a_name_in_place_gains_half_as_much_and_its_cost(level, rival, instead):
    a, b, c, d = (SimpleNamespace(name=name) for name in "abcd")
    others = [{"effect": c, "level": 1.0}, {"effect": b, **rival}]
    assert chosen_beside({"effect": a, "level": level}, others).instead == instead
    if instead:
        assert chosen_beside({"effect": a, "level": level}, [*others, {"effect": d, "level": 16.0}]).instead == "d"


def test_a_form_is_like_those_over_other_variables_in_its_class():
    own, *others = ({"level": 5.0, "effect": form} for form in (Corner(SPEED, STEP), Corner(AMBIENT, STEP), Corner(SPEED, ABOVE)))
    x, y, z = (item["effect"].name for item in (own, *others))
    assert chosen_beside(own, others, members=(x, y, z)).alike == (VARIABLES[AMBIENT].text,)
    assert chosen_beside(own, others, members=(x, z)).alike == ()
    name = {"level": 5.0, "effect": named()["torque_gain"]}
    assert chosen_beside(name, others, members=("torque_gain", y)).alike == ()


# On drives


@pytest.fixture(scope="module")
def by_gain():
    """A torque of another scale, and what judges its explanations."""
    return judging(driven(GAIN, of=machine()), {name: named()[name] for name in ("torque_gain", "torque_offset")})


@pytest.fixture(scope="module")
def chosen(by_gain):
    by_gain.search.expand(by_gain.search.base_explanation)
    return by_gain.choice.best()


# What is confirmed


def test_a_confirmed_explanation_has_only_confirmed_terms(by_gain, chosen):
    choice, seen = by_gain.choice, 0
    for judged in [e for e in by_gain.search.known.values() if e.key and e.settled]:
        terms = choice._graded_terms(judged)
        assert terms.keys() == judged.key
        if not choice._is_confirmed(judged):
            continue
        seen += 1
        assert all(g.grade == CONFIRMED for g in terms.values())
        for g in terms.values():
            assert g.improvement.likelihood_bound > 0.0
            assert g.improvement.after <= g.improvement.before
        kept = by_gain.laps.improvement_of(by_gain.refitted, judged.fit)
        assert kept.after <= kept.before
    assert seen >= 2
    assert all(term.confirmed for term in chosen.explanation.terms.values())


def test_the_name_is_chosen_where_a_form_predicts_alike(by_gain, chosen):
    """A curve of the driving torque is the same as another scale, where that is driven."""
    rivals = [e for e in by_gain.search.known.values() if any("driving" in name for name in e.key) and len(e.key) == 1]
    assert any(by_gain.choice._is_confirmed(by_gain.search.polish(e)) for e in rivals)
    assert chosen.explanation.key == {"torque_gain"}
    assert chosen.final.effect_names == ("torque_gain",)
    assert chosen.explanation.terms["torque_gain"].is_named


def test_a_form_with_a_higher_worth_still_yields_to_the_name(by_gain, chosen):
    name = chosen.explanation
    other = next(e for e in by_gain.search.known.values() if len(e.key) == 1 and e.without_a_name)
    better = replace(other, score=name.score, net_gain=name.net_gain + 50.0)
    assert by_gain.choice._select([better, name]) is name
    assert by_gain.choice._select([better]) is better
    assert by_gain.choice._select([]) is by_gain.search.base_explanation
    clock = replace(better, terms={"x": Term(EFFECTS[CLOCK]("x"), None)}, net_gain=name.net_gain + 99.0)
    assert by_gain.choice._select([clock, better]) is better


def test_of_two_names_the_one_that_predicts_better_is_chosen(by_gain, chosen):
    name, nothing = chosen.explanation, by_gain.search.base_explanation
    worse = replace(name, score=nothing.score, net_gain=name.net_gain + 50.0)
    assert by_gain.choice._select([worse, name]) is name
    alike = replace(name, net_gain=name.net_gain - 1.0)
    assert by_gain.choice._select([alike, name]) is name


def test_what_held_out_laps_or_the_file_refute_is_not_confirmed(by_gain):
    effect = named()["torque_gain"]
    assert graded(by_gain, effect)[1]
    item = judging(by_gain.refitted, {})
    item.choice._by_file = 1.0
    assert not graded(item, effect)[1]
    assert not graded(judging(driven(GAIN, held_out_gain=1.0, of=machine()), {}), effect)[1]


def test_a_name_on_a_bound_is_at_best_suspected(by_gain):
    narrow = copy.copy(named()["torque_gain"])
    narrow.parameters = tuple(replace(q, high=0.7 * (GAIN - 1.0)) for q in narrow.parameters)
    terms, confirmed = graded(judging(by_gain.refitted, {}), narrow)
    item = terms["torque_gain"]
    assert item.improvement.grade == CONFIRMED
    assert (item.on_bounds, item.grade, confirmed) == (("error",), SUSPECTED, False)


def test_a_name_whose_size_changes_is_suspected():
    def growing(session, _):
        late = np.where(session.time > session.time.mean(), 1.0, -1.0)
        return 1.0 + (GAIN - 1.0) * (1.0 + 0.7 * late)

    item = graded(judging(driven(growing, of=machine()), {}), named()["torque_gain"])[0]["torque_gain"]
    assert (item.improvement.grade, item.grade) == (CONFIRMED, SUSPECTED)
    assert item.fault == "has no constant size: it is larger late in a drive than early"


def wave(session, _):
    return LEVEL_NM * np.sin(session.time / 20.0)


def against(session, _):
    return -LEVEL_NM * np.sin(session.time / 20.0 + 0.1)


def test_terms_that_cancel_each_other_are_not_confirmed():
    """Two large series that differ little: what they add together is a tenth of either."""
    result = driven(of=machine(), adds=lambda s, i: wave(s, i) + against(s, i))
    terms, confirmed = graded(judging(result, {}), series(result, wave, name="one"), series(result, against, name="other"))
    assert all(g.improvement.grade == CONFIRMED for g in terms.values())  # each helps the other
    assert not confirmed


def comes_and_goes(session):
    return SIZE_NM * np.sign(np.sin(session.time / 40.0))


def helping(count, elsewhere):
    """Grade of a torque that is there in the first of four recordings, by a term that is also somewhat in the others."""
    result = driven(of=machine(), adds=lambda s, i: comes_and_goes(s) * (i < count), count=4)
    term = series(result, lambda s, i: comes_and_goes(s) * (1.0 if i < count else elsewhere))
    return graded(judging(result, {}), term)[0]["series"]


def test_a_term_helps_in_most_recordings_in_which_it_acts():
    half = helping(2, 0.6)
    assert half.improvement.grade == CONFIRMED
    assert half.grade == SUSPECTED
    assert half.fault == "helps in 2 of the 4 recordings in which it acts"
    assert helping(3, 0.6).confirmed
    assert helping(2, 0.0).confirmed  # where it does not act it need not help


@pytest.mark.parametrize(("count", "grade"), [(3, SUSPECTED), (6, CONFIRMED)])
def test_what_differs_between_few_recordings_is_suspected(count, grade):
    """Other things may differ between three drives too. Between six, of which every third has it, they hardly do."""

    def in_every_third(session, number):
        return np.full(len(session), SIZE_NM * (number % 3 == 1))

    result = driven(of=machine(), adds=in_every_third, count=count)
    item = graded(judging(result, {}), series(result, in_every_third))[0]["series"]
    assert (item.improvement.grade, item.grade) == (CONFIRMED, grade)
    assert item.fault == (f"{ONLY_BETWEEN} 3 recordings, as other things may" if count == 3 else "")


def judged_with(of, explanation, name, **changed):
    """The grade of a term of an explanation whose score has other values, by a judge that has seen nothing yet."""
    known = dict(of.search.known)
    try:
        choice = Choice(of.search, of.search.base_explanation.fit, of.laps, of.use)
        return choice.grade_term(replace(explanation, score=replace(explanation.score, **changed)), name)
    finally:
        of.search.known.clear()
        of.search.known.update(known)


@pytest.fixture(scope="module")
def hidden():
    """Three recordings with more torque above a speed, explained by that form."""
    effect = form(Corner(SPEED, STEP, 0.5, 6.0, 12.0))
    item = judging(driven(of=machine(), adds=lambda s, _: SIZE_NM * (np.abs(s.speed) > 6.0), count=3), {})
    return item, explained(item, effect), effect.name


@pytest.mark.parametrize(("worse", "grade"), [(1.005, CONFIRMED), (1.02, SUSPECTED)])
def test_a_term_may_not_predict_unseen_recordings_worse(hidden, worse, grade):
    item, explanation, name = hidden
    unseen = item.search.base_explanation.score.unseen * worse
    result = judged_with(item, explanation, name, unseen=unseen)
    assert result.grade == grade
    assert ("predicts recordings left out worse" in result.fault) == (grade == SUSPECTED)


def test_a_gain_is_more_than_the_best_of_as_many_by_chance(hidden):
    """Three more than the logarithm of their number."""
    item, explanation, name = hidden
    result_before, count = item.search.base_explanation.score, len(explanation.score.density)
    for more, grade in ((-0.5, SUSPECTED), (0.5, CONFIRMED)):
        gained = 3.0 + item.search.cost + more
        result = judged_with(item, explanation, name, density=result_before.density + gained / count)
        assert result.improvement.level_gain == pytest.approx(gained)
        assert result.grade == grade
        assert ("gains no more than the best of many" in result.fault) == (grade == SUSPECTED)
    assert item.search.cost == pytest.approx(np.log(len(item.search.rounds[frozenset()].by_name)))


@pytest.mark.parametrize(("less", "level", "grade"), [(0.97, 0.99, CONFIRMED), (0.99, 0.99, SUSPECTED), (0.99, 0.9, CONFIRMED)])
def test_an_error_falls_by_a_fiftieth_or_its_levels_by_more(hidden, less, level, grade):
    item, explanation, name = hidden
    result_before = item.search.base_explanation.score
    result = judged_with(item, explanation, name, error=less * result_before.error, level=level * result_before.level)
    assert result.grade == grade
    assert ("hardly reduces the error" in result.fault) == (grade == SUSPECTED)


def test_a_term_that_grows_the_error_is_refuted(hidden):
    item, explanation, name = hidden
    assert judged_with(item, explanation, name).grade == CONFIRMED
    assert judged_with(item, explanation, name, error=1.05 * item.search.base_explanation.score.error).grade == REFUTED


def test_next_to_nothing_is_not_confirmed(hidden):
    item, explanation, name = hidden
    little = {name: replace(explanation.terms[name], share=0.004)}
    assert judged_with(item, replace(explanation, terms=little), name).fault == "adds only 0.4 % of the torque"


# A recorded channel and the clock


def warming(session):
    """Air that warms once in each drive."""
    return replace(session, ambient=10.0 + 10.0 * session.time / session.time[-1])


def changing(session):
    """Air that warms and cools again and again."""
    return replace(session, ambient=15.0 + 5.0 * np.sin(session.time / 40.0 + 2.0))


def warm(session, _):
    return SIZE_NM * (session.ambient > 15.0)


def with_rivals(changed):
    """Explanations of a step over the ambient temperature by that and by one over the clock."""
    result = driven(of=machine(), adds=warm, count=3, changed=changed)
    item = judging(result, {})
    facts, sessions = result.problem.base.facts, result.problem.sessions
    half = sessions[0].time[-1] / 2.0
    shape = [np.sign(s.speed) * (s.time > half) for s in sessions]
    clock = ClockTerm("time since start", STEP, half, (0.0, 2.0 * half), shape, facts.weight * facts.radius)
    channel = form(Corner(AMBIENT, STEP, 10.0, 15.0, 20.0))
    return item, explained(item, channel), explained(item, clock)


def test_a_form_that_the_clock_explains_as_well_is_suspected():
    item, channel, clock = with_rivals(warming)
    for value, other in ((channel, clock), (clock, channel)):
        (name,), (rival,) = value.key, other.key
        result = item.choice.grade_term(value, name)
        assert result.improvement.grade == CONFIRMED
        assert (result.grade, result.fault) == (SUSPECTED, f"cannot be separated from {rival} in these drives")


def test_a_channel_that_moves_again_and_again_is_confirmed():
    item, channel, _ = with_rivals(changing)
    assert item.choice.grade_term(channel, "step_of_ambient").grade == CONFIRMED
    assert item.choice._is_confirmed(channel)


# Nothing confirmed


def test_only_what_is_confirmed_is_chosen_unless_asked_otherwise(hidden, monkeypatch):
    item, _, _ = hidden
    monkeypatch.setattr(Choice, "_is_confirmed", lambda *_: False)
    nothing, first = (
        Choice(item.search, item.search.base_explanation.fit, item.laps, item.use).best(keep) for keep in (False, True)
    )
    assert nothing.explanation.fit is item.search.base_explanation.fit
    assert not nothing.explanation.terms
    assert nothing.shares == {"none of these": 1.0}
    assert first.explanation.net_gain == max(e.net_gain for e in item.search.known.values() if e.settled)
    assert all(term.grade != CONFIRMED and term.rivals for term in first.explanation.terms.values())


# Classes


def test_each_class_has_what_was_chosen_and_weights_of_one(chosen):
    for name, term in chosen.explanation.terms.items():
        assert term.name == name == term.members[0]
        assert name not in {rival.name for rival in term.rivals.candidates}
        assert term.weights.keys() == set(term.members)
        assert sum(term.weights.values()) == pytest.approx(1.0)
        assert term.stability >= CLASS_SHARE or len(term.members) > 1
        assert not set(term.worse) & set(term.members) - {name}

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rounds in which effects are chosen, in constructed worlds: no vehicle is simulated and nothing is fitted."""

import math

import numpy as np
import pytest
from worlds import LAP, LAPS, QUIET, TORQUE_NM, Kind, Model, World

from trackres_ros.diagnosis.selection import naming
from trackres_ros.diagnosis.selection.visibility import Separability
from trackres_ros.effects.effect import Parameter

# Rounds


def test_what_gains_is_named_and_the_rest_is_not(play):
    done = play({"real": 40.0, "noise": 3.0})
    assert done.named == ("real",)
    first, last = done.steps
    assert (first.chosen.name, first.members, first.weights, first.stability) == ("real", ("real",), {"real": 1.0}, 1.0)
    assert (first.chosen.gain, first.chosen.criterion, first.threshold, first.by_noise) == (40.0, 38.0, 5.0, 5.0)
    assert (first.chosen.net_gain, first.chosen.net_evidence) == (40.0, 38.0)  # no effect stands beside it in another form
    assert first.before.effect_names == ()
    assert last.chosen is None
    assert last.before.effect_names == ("real",)
    assert done.said == ["naming, round 1: base alone", "naming, round 2: real"]


def test_nothing_is_named_where_nothing_gains_more_than_noise(play):
    done = play({"a": 4.0, "b": 3.0})
    assert done.named == ()
    (only,) = done.steps
    assert only.chosen is None
    assert {c.name for c in only.candidates} == {"a", "b"}
    assert only.hint == ""


def test_at_most_three_are_named_whatever_a_fourth_round_finds(play):
    done = play({"a": 60.0, "b": 50.0, "c": 40.0, "d": 30.0})
    assert done.named == ("a", "b", "c")
    assert [s.chosen.name for s in done.steps] == ["a", "b", "c"]
    assert done.said[-1] == "naming, round 4: a, b, c"


def test_a_best_below_half_of_what_noise_gains_is_not_fitted_at_all(play):
    for gain, threshold, fitted in ((2.4, 5.0, False), (2.6, 5.0, True), (0.9, 1.0, False), (1.1, 1.0, True)):
        done = play({"a": gain}, threshold=threshold)
        assert bool(done.steps[0].candidates) == fitted
        if not fitted:
            (step,) = done.steps
            assert (step.chosen, step.members, step.weights, step.stability) == (None, (), {}, 0.0)
            assert (step.by_noise, step.threshold) == (threshold, threshold)
            assert [(s, g) for s, g in step.screened] == [("a", pytest.approx(gain))]


def test_where_no_effect_can_be_seen_nothing_is_named(play):
    done = play({}, threshold=-1.0)
    assert (done.named, len(done.steps)) == ((), 1)


def test_the_models_own_error_raises_what_counts_and_leaves_a_hint(play):
    samples, std = LAPS * LAP, 2.5
    spurious = 0.5 * samples * (naming.MODEL_ERROR * TORQUE_NM / std) ** 2
    assert spurious == pytest.approx(1.28)
    for quieter, named in ((1.0, ("a",)), (5.0, ("a",)), (5.5, ("a",)), (6.0, ())):
        done = play({"a": 40.0}, std=std / quieter)
        step = done.steps[0]
        assert step.threshold == pytest.approx(max(5.0, quieter**2 * spurious))
        assert (step.by_noise, step.hint) == (5.0, "" if named else "a")
        assert done.named == named


def test_what_whitening_leaves_of_a_constant_it_leaves_of_the_models_error():
    world = World({}, std=2.0)
    whole = naming.spurious_gain(Model(world, ()))
    assert whole == pytest.approx(0.5 * LAPS * LAP * (0.004 * TORQUE_NM / 2.0) ** 2)
    world.noise.dc_gain = 0.5
    assert naming.spurious_gain(Model(world, ())) == pytest.approx(0.25 * whole)


def test_a_gain_that_costs_more_than_it_is_worth_is_none(play):
    assert play({"a": 20.0}, costs=21.0).named == ()
    assert play({"a": 20.0}, costs=19.0).named == ("a",)


def test_what_other_forms_take_counts_off_gain_and_evidence(play):
    assert play({"a": 20.0}, taken=16.0).named == ()
    done = play({"a": 20.0}, taken=14.0)
    assert done.named == ("a",)
    assert (done.steps[0].chosen.net_gain, done.steps[0].chosen.net_evidence) == (6.0, 4.0)


def test_what_adds_next_to_nothing_stands_behind_what_matters(play):
    done = play({"large": 40.0, "tiny": 60.0}, shares={"tiny": 0.001})
    assert done.steps[0].candidates[0].name == "large"
    assert done.steps[0].candidates[1].share == pytest.approx(0.001)
    assert "tiny" not in done.named


def test_one_effect_alone_is_fitted_once_and_never_compared_again(play):
    """It was compared with its rivals beside nothing, and nothing stands beside it in the end."""
    done = play({"a": 40.0, "b": 39.0}, together={("a", "b"): 40.5}, alike=[("a", "b")])
    assert done.named == ("a",)
    assert sorted(names for names, _, _ in done.world.fitted) == [("a",), ("b",)]


# Who is fitted


def fitted_first(done):
    return {names[0] for names, _, rounds in done.world.fitted if len(names) == 1 and rounds != 1}


def test_those_far_behind_to_first_order_are_not_fitted(play):
    gains = {"best": 20.0, "near": 5.1, "far": 4.9, "further": 1.2}
    assert fitted_first(play(gains)) == {"best", "near"}
    # Half of the best is allowed where that is more.
    assert fitted_first(play({"best": 60.0, "near": 31.0, "far": 29.0})) == {"best", "near"}


def test_a_quarter_of_what_noise_gains_is_the_least_worth_a_fit(play):
    assert fitted_first(play({"best": 10.0, "little": 2.6, "less": 2.4}, threshold=10.0)) == {"best", "little"}


def test_a_gain_that_a_fit_does_not_bear_out_is_no_measure_for_the_others(play):
    done = play({"bent": 1.0, "real": 20.0, "near": 6.0, "far": 4.0}, first_order={"bent": 80.0})
    assert done.named[0] == "real"
    assert {c.name for c in done.steps[0].candidates} == {"bent", "real", "near"}
    # One that is borne out keeps the others from being fitted, however many are bent.
    done = play({"bent": 1.0, "real": 40.0, "near": 6.0}, first_order={"bent": 90.0, "real": 100.0})
    assert {c.name for c in done.steps[0].candidates} == {"bent", "real"}
    edge = naming.BORNE_OUT * 80.0
    assert "near" not in {c.name for c in play({"bent": edge, "near": 6.0}, first_order={"bent": 80.0}).steps[0].candidates}


def test_where_all_but_what_is_not_borne_out_gain_less_than_noise_nothing_more_is_fitted(play):
    done = play({"bent": 1.0, "little": 2.4}, first_order={"bent": 80.0})
    assert done.named == ()
    assert {c.name for c in done.steps[0].candidates} == {"bent"}


def test_those_that_mislead_take_no_place_of_those_that_are_fitted(play):
    gains = {f"bent{i}": 1.0 for i in range(3)} | {f"e{i}": 20.0 - i for i in range(8)}
    done = play(gains, first_order={f"bent{i}": 80.0 for i in range(3)})
    assert len(done.steps[0].candidates) == 3 + naming.MOST_REFITTED


@pytest.mark.parametrize("acts_on", ["heat", "cooling"])
def test_what_acts_through_the_temperature_is_fitted_however_far_behind(play, acts_on):
    gains = {"best": 60.0, "warm": 6.0, "cold": 4.0}
    through = {name: Kind(name, acts_on) for name in ("warm", "cold")}
    assert fitted_first(play(gains, through)) == {"best", "warm"}


def test_edges_of_who_is_fitted_count_as_out(play):
    assert fitted_first(play({"best": 20.0, "edge": 5.0})) == {"best"}
    assert fitted_first(play({"best": 10.0, "edge": 2.5}, threshold=10.0)) == {"best"}
    assert fitted_first(play({"best": 60.0, "edge": 5.0}, {"edge": Kind("edge", "heat")})) == {"best"}


def test_a_best_at_half_of_what_noise_gains_is_fitted(play):
    assert fitted_first(play({"best": 2.5})) == {"best"}
    exactly_one = np.where(np.arange(LAPS) < 16, 1.0 / 16.0, 0.0)  # of a sum without rounding
    assert fitted_first(play({"best": exactly_one}, threshold=1.0)) == {"best"}


def test_one_just_at_what_noise_gains_is_of_no_class(play):
    done = play({"a": 6.0, "b": 5.0}, together={("a", "b"): 6.2}, alike=[("a", "b")])
    assert done.steps[0].members == ("a",)


def test_no_more_than_six_are_fitted(play):
    gains = {f"e{i}": 20.0 - i for i in range(9)}
    assert fitted_first(play(gains)) == {"e0", "e1", "e2", "e3", "e4", "e5"}


def test_the_best_of_several_starts_counts_with_what_shows_most_of_it(play, monkeypatch):
    shape = Parameter("width", "m/s", 0.0, 9.0, 2.0, "of it", more_starts=(6.0,))
    size = Parameter("size", "Nm", -100.0, 100.0, 10.0, "of it", off=5.0)
    world = World({"a": 30.0})
    world.effects["a"] = Kind("a", parameters=(size, shape))
    world.stds = {("a", "size"): 0.5, ("a", "width"): 3.0}
    starts = [{"size": 10.0, "width": width} for width in (2.0, 6.0)]

    def separability(effects, current):
        names = tuple(n for n in effects if n not in current.effect_names)
        seen = [world.seen("a", start, d, k) for start, d, k in zip(starts, (4.0, 6.0), (0.3, 0.6), strict=True) if names]
        return Separability(tuple(seen), (), names, np.eye(len(names)))

    def fit(problem, effects=(), start=None, noises=None, rounds=3):
        found = World.fit(world, problem, effects, start, noises, rounds)
        if effects:
            found.log_likelihood += 7.0 if start["a", "width"] == 2.0 else 0.0
        return found

    world.separability, world.fit = separability, fit
    done = play.run(world)
    chosen = done.steps[0].chosen
    assert chosen.gain == pytest.approx(37.0)
    assert (chosen.kept, chosen.d_prime) == (0.6, 6.0)
    begun = [start for names, start, rounds in world.fitted if names == ("a",) and rounds != 1]
    # A fifth of the way from no effect to the typical one; shapes as they stand.
    assert begun == [{("a", "size"): 6.0, ("a", "width"): width} for width in (2.0, 6.0)]
    effective = 1.0 - 0.25
    assert chosen.bic_gain == pytest.approx(2.0 * 37.0 - math.log(naming.effective_samples(chosen.fit)) * effective)


@pytest.mark.parametrize(
    ("slow", "likelier", "begun"),
    [(0.99, "short", ["as it is", "short"]), (0.99, "as it is", ["as it is", "short"]), (0.3, "as it is", ["as it is"])],
)
def test_beside_noise_that_looks_like_a_random_walk_a_fit_begins_with_short_noise_too(play, slow, likelier, begun):
    """Of two maxima of one likelihood the higher counts, whichever noise the search began with."""
    world = World({"a": 40.0})
    world.noise.phi, world.noise.scale, world.noise.degrees = np.array([slow]), QUIET, 5.0
    seen = []

    def fit(problem, effects=(), start=None, noises=None, rounds=3):
        found = World.fit(world, problem, effects, start, noises, rounds)
        seen.append("as it is" if noises["torque"] is world.noise else "short")
        found.log_likelihood += 5.0 if seen[-1] == likelier else 0.0
        return found

    world.fit = fit
    step = play.run(world).steps[0]
    assert seen == begun
    assert step.chosen.gain == 45.0


# Classes


def test_what_looks_alike_is_named_as_one_of_a_class(play):
    done = play({"a": 40.0, "b": 39.0}, together={("a", "b"): 40.5}, alike=[("a", "b")])
    assert done.named == ("a",)
    first = done.steps[0]
    assert first.members == ("a", "b")
    assert first.weights["b"] / first.weights["a"] == pytest.approx(math.exp(-1.0))


def test_only_those_above_noise_that_matter_are_of_a_class(play):
    done = play({"a": 6.0, "b": 4.9}, together={("a", "b"): 6.2}, alike=[("a", "b")])
    assert done.steps[0].members == ("a",)
    done = play({"a": 40.0, "b": 39.0}, together={("a", "b"): 40.5}, shares={"b": 0.001})
    assert done.steps[0].members == ("a",)


# Other laps


def test_what_is_just_stable_enough_is_named(play, monkeypatch):
    for share, named in ((0.8, ("a",)), (0.799, ())):
        monkeypatch.setattr(naming, "_wins", lambda current, candidates, rng, share=share: {"a": share})
        assert play({"a": 40.0}).named == named


def test_what_only_a_few_laps_show_is_not_named(play):
    one_lap = np.where(np.arange(LAPS) == 3, 40.0, 0.0)
    done = play({"a": one_lap})
    (step,) = done.steps
    assert step.chosen is None
    assert step.candidates[0].counts(step.threshold)
    assert step.stability == pytest.approx(1.0 - math.exp(-1.0), abs=0.02)
    assert step.hint == "a"
    three = np.where(np.arange(LAPS) < 3, 14.0, 0.0)
    assert play({"a": three}).named == ("a",)


def test_rivals_of_other_laps_join_the_class(play):
    first, last = np.repeat([4.0, 0.0], LAPS // 2), np.repeat([0.0, 3.8], LAPS // 2)
    done = play({"a": first, "b": last}, together={("a", "b"): 41.0})
    step = done.steps[0]
    assert set(step.members) == {"a", "b"}
    assert step.stability == pytest.approx(1.0)
    assert 0.05 < step.weights["b"] < step.weights["a"]


def test_what_hardly_adds_to_the_torque_is_no_rival_on_any_laps(play):
    on_some_laps = np.where(np.arange(LAPS) < 8, 9.0, -4.0)
    rivals = play({"a": np.full(LAPS, 2.0), "b": on_some_laps})
    assert set(rivals.steps[0].members) == {"a", "b"}
    alone = play({"a": np.full(LAPS, 2.0), "b": on_some_laps}, shares={"b": 0.001})
    assert (alone.steps[0].members, alone.steps[0].stability) == (("a",), 1.0)


def test_another_seed_makes_no_other_choice(play):
    first, last = np.repeat([4.0, 0.0], LAPS // 2), np.repeat([0.0, 3.8], LAPS // 2)
    made = [play({"a": first, "b": last}, together={("a", "b"): 41.0}, seed=seed) for seed in range(4)]
    assert len({(done.named, done.steps[0].members) for done in made}) == 1

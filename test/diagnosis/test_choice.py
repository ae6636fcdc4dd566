# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Proposals of a round of the search, in constructed worlds: no vehicle is simulated and nothing is fitted."""

import math

import numpy as np
import pytest
from trackres_ros.diagnosis.selection.screening import Gain, Screened
from worlds import LAP, LAPS, MOVED, QUIET, TORQUE_NM, Kind, Model, World

from trackres_ros.diagnosis.selection import naming
from trackres_ros.diagnosis.selection.visibility import Separability
from trackres_ros.effects.effect import Parameter
from trackres_ros.effects.learned import OPEN, SPEED, Curve

# Rounds


def test_fitted_candidates_come_best_first_with_gains_and_costs(play):
    step = play({"noise": 3.0, "real": 40.0, "near": 30.0}).step
    assert [c.name for c in step.candidates] == ["real", "near"]
    first = step.candidates[0]
    assert (first.gain, first.criterion, first.net_gain, first.net_evidence) == pytest.approx((40.0, 38.0, 40.0, 38.0))
    assert (step.threshold, step.by_noise) == (5.0, 5.0)
    assert step.screened == tuple((name, pytest.approx(gain)) for name, gain in (("real", 40.0), ("near", 30.0), ("noise", 3.0)))
    assert (step.before.effect_names, step.chosen, step.members) == ((), None, ())


def test_after_a_fit_only_other_terms_are_proposed_by_their_gain(play):
    done = play({"a": 40.0, "b": 39.0, "c": 20.0}, together={("a", "b"): 40.5}, chosen=["a"])
    assert done.names == ["c"]
    assert dict(done.step.screened) == pytest.approx({"b": 0.5, "c": 20.0})
    assert done.step.before.effect_names == ("a",)
    assert set(done.step.candidates[0].fit.effect_names) == {"a", "c"}


def test_a_best_gain_below_half_of_noise_is_not_fitted(play):
    exactly_one = np.where(np.arange(LAPS) < 16, 1.0 / 16.0, 0.0)  # of a sum without rounding
    for gain, threshold, fitted in ((2.4, 5.0, False), (2.5, 5.0, True), (0.9, 1.0, False), (exactly_one, 1.0, True)):
        step = play({"a": gain}, threshold=threshold).step
        assert bool(step.candidates) == fitted
        if not fitted:
            assert (step.chosen, step.members, step.weights, step.stability, step.hint) == (None, (), {}, 0.0, "")
            assert (step.by_noise, step.threshold) == (threshold, threshold)
            assert step.screened == (("a", pytest.approx(gain)),)
    assert play({}, threshold=-1.0).step.candidates == ()


def test_the_models_error_raises_the_threshold_and_leaves_a_hint(play):
    samples, std = LAPS * LAP, 2.5
    spurious = 0.5 * samples * (naming.MODEL_ERROR * TORQUE_NM / std) ** 2
    assert spurious == pytest.approx(1.28)
    for quieter, counts in ((1.0, True), (5.0, True), (5.5, True), (6.0, False)):
        step = play({"a": 40.0}, std=std / quieter).step
        assert step.threshold == pytest.approx(max(5.0, quieter**2 * spurious))
        assert (step.by_noise, step.hint) == (5.0, "a")
        assert step.candidates[0].counts(step.threshold) == counts


def test_whitening_scales_the_models_error_like_a_constant():
    world = World({}, std=2.0)
    whole = naming.spurious_gain(Model(world, ()))
    assert whole == pytest.approx(0.5 * LAPS * LAP * (0.004 * TORQUE_NM / 2.0) ** 2)
    world.noise.dc_gain = 0.5
    assert naming.spurious_gain(Model(world, ())) == pytest.approx(0.25 * whole)


@pytest.mark.parametrize(("given", "counts"), [({"costs": 21.0}, False), ({"costs": 19.0}, True),
                                               ({"taken": 16.0}, False), ({"taken": 14.0}, True)])  # fmt: skip
def test_costs_and_other_forms_gains_reduce_a_candidates_gain(play, given, counts):
    step = play({"a": 20.0}, **given).step
    assert step.candidates[0].counts(step.threshold) == counts


def test_what_adds_next_to_nothing_stands_behind_what_matters(play):
    step = play({"large": 40.0, "tiny": 60.0}, shares={"tiny": 0.001}).step
    assert [c.name for c in step.candidates] == ["large", "tiny"]
    assert step.candidates[1].share == pytest.approx(0.001)
    assert not step.candidates[1].counts(step.threshold)


# Who is fitted


def fitted(done):
    return {names[0] for names, _, _ in done.world.fitted}


def test_those_far_behind_to_first_order_are_not_fitted(play):
    gains = {"best": 20.0, "near": 5.1, "edge": 5.0, "further": 1.2}
    assert fitted(play(gains)) == {"best", "near"}
    # Half of the best is allowed where that is more.
    assert fitted(play({"best": 60.0, "near": 31.0, "far": 29.0})) == {"best", "near"}


def test_a_gain_that_its_fit_refutes_sets_no_bar_for_the_others(play):
    assert play({"bent": 1.0, "real": 20.0, "near": 6.0, "far": 4.0}, first_order={"bent": 80.0}).names == [
        "real",
        "near",
        "bent",
    ]
    # One that is borne out keeps the others from being fitted, however many are bent.
    assert play({"bent": 1.0, "real": 40.0, "near": 6.0}, first_order={"bent": 90.0, "real": 100.0}).names == ["real", "bent"]
    edge = naming.BORNE_OUT * 80.0
    assert play({"bent": edge, "near": 6.0}, first_order={"bent": 80.0}).names == ["bent"]

    # Nothing more is fitted if the others gain below noise.
    assert play({"bent": 1.0, "little": 2.4}, first_order={"bent": 80.0}).names == ["bent"]


def test_misleading_candidates_take_no_place_in_the_fitted_list(play):
    gains = {f"bent{i}": 1.0 for i in range(3)} | {f"e{i}": 20.0 - i for i in range(8)}
    done = play(gains, first_order={f"bent{i}": 80.0 for i in range(3)})
    assert len(done.names) == 3 + naming.MOST_REFITTED[False]


@pytest.mark.parametrize("acts_on", ["heat", "cooling"])
def test_candidates_acting_through_temperature_are_always_fitted(play, acts_on):
    gains = {"best": 60.0, "warm": 6.0, "cold": 5.0}
    through = {name: Kind(name, acts_on) for name in ("warm", "cold")}
    assert fitted(play(gains, through)) == {"best", "warm"}


def test_a_quarter_of_what_noise_gains_is_not_worth_a_fit(play):
    assert fitted(play({"best": 10.0, "quarter of noise": 2.6, "edge": 2.5}, threshold=10.0)) == {"best", "quarter of noise"}


def test_at_most_six_names_and_three_forms_are_fitted(play):
    names, forms = ({f"{of}{i}": 20.0 - i for i in range(9)} for of in ("name", "form"))
    curves = {}
    for i, name in enumerate(forms):
        curves[name] = Curve(SPEED, OPEN, [1.0, 2.0 + i])
        curves[name].name = name
    assert fitted(play({**names, **forms}, curves)) == {*[f"name{i}" for i in range(6)], "form0", "form1", "form2"}
    assert fitted(play(names)) == {f"name{i}" for i in range(6)}


@pytest.mark.parametrize(("behind", "widths"), [(2.0, [2.0, 6.0]), (4.0, [2.0])])
def test_the_best_fit_of_the_promising_starts_is_used(play, behind, widths):
    shape = Parameter("width", "m/s", 0.0, 9.0, 2.0, "of it", more_starts=(6.0,))
    size = Parameter("size", "Nm", -100.0, 100.0, 10.0, "of it", off=5.0)
    world = World({"a": 30.0})
    world.effects["a"] = Kind("a", parameters=(size, shape))
    world.stds = {("a", "size"): 0.5, ("a", "width"): 3.0}
    starts = [{"size": 10.0, "width": width} for width in (2.0, 6.0)]
    seen = [world.seen("a", start, d, k) for start, d, k in zip(starts, (4.0, 6.0), (0.3, 0.6), strict=True)]
    world.separability = lambda effects, current, columns: Separability(tuple(seen), (), ("a",), np.eye(1))
    gains = [Gain(30.0, np.array([MOVED]), False), Gain(30.0 - behind, np.array([MOVED]), False)]
    world.screen = lambda *_: Screened(tuple(zip(seen, gains, strict=True)), {}, 5.0, np.zeros(1))

    def fit(problem, effects=(), start=None, noises=None):
        found = World.fit(world, problem, effects, start, noises)
        found.log_likelihood += 7.0 if start["a", "width"] == 2.0 else 0.0
        return found

    world.fit = fit
    (chosen,) = play.run(world).step.candidates
    assert chosen.gain == pytest.approx(37.0)
    assert (chosen.kept, chosen.d_prime) == ((0.6, 6.0) if len(widths) == 2 else (0.3, 4.0))
    # Where it is best to first order; shapes as they stand.
    assert [start for _, start, _ in world.fitted] == [{("a", "size"): 7.5, ("a", "width"): width} for width in widths]
    effective = 1.0 - 0.25
    assert chosen.bic_gain == pytest.approx(2.0 * 37.0 - math.log(naming.effective_samples(chosen.fit)) * effective)


@pytest.mark.parametrize(("moved", "size"), [(0.02, 5.25), (-0.02, 4.75), (0.3, 6.5), (-0.8, 1.0)])
def test_a_fit_never_starts_at_zero_where_shape_has_no_effect(moved, size):
    world = World({"a": 1.0})
    world.effects["a"] = Kind("a", parameters=(Parameter("size", "Nm", -100.0, 100.0, 10.0, "of it", off=5.0),))
    assert naming._begin(world.seen("a"), np.array([moved])) == {("a", "size"): pytest.approx(size)}


@pytest.mark.parametrize(("slow", "short", "begun"), [(0.99, True, "short"), (0.99, False, "as it is"), (0.3, True, "as it is")])
def test_random_walk_noise_fits_start_with_the_better_noise(play, slow, short, begun):
    world = World({"a": 40.0})
    world.noise.phi, world.noise.scale, world.noise.degrees = np.array([slow]), QUIET, 5.0
    seen = []

    def fit(problem, effects=(), start=None, noises=None):
        seen.append("as it is" if noises["torque"] is world.noise else "short")
        return World.fit(world, problem, effects, start, noises)

    world.fit = fit
    world.screen = lambda current, visible, *_: Screened(
        ((visible[0], Gain(40.0, np.array([MOVED]), short)),), {}, 5.0, np.zeros(1)
    )
    play.run(world)
    assert seen == [begun]

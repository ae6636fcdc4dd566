# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What was chosen first is looked at again beside what came later: dropped, compared with its rivals, told apart."""

import math

import numpy as np
import pytest
from worlds import Model, World, candidate, candidate_of

from trackres_ros.diagnosis.selection import naming
from trackres_ros.diagnosis.selection.naming import Step

# Drop


def test_what_the_others_made_needless_is_dropped(play):
    done = play(
        {"mix": 40.0, "left": 30.0, "right": 29.0},
        together={("mix", "left"): 52.0, ("mix", "left", "right"): 70.0, ("left", "right"): 68.0, ("mix", "right"): 51.0},
    )
    assert set(done.named) == {"left", "right"}
    assert [s.chosen.name for s in done.steps if s.chosen] == ["left", "right"]
    assert done.steps[-1].chosen is None


def test_what_still_gains_its_threshold_stays(play):
    done = play(
        {"a": 40.0, "b": 30.0, "c": 1.0},
        together={("a", "b"): 70.0, ("a",): 64.9, ("b",): 30.0, ("a", "b", "c"): 71.0},
    )
    assert set(done.named) == {"a", "b"}


def dropped(gains, together, **given):
    """`_drop` of two that were chosen one after the other: what is left."""
    world = World(gains, together, **given)
    both = Model(world, [world.effects[n] for n in gains])
    names = list(gains)
    steps = [Step(None, None, 5.0, 5.0, (), (), candidate_of_taken(world, n), (n,), {n: 1.0}, 1.0) for n in names] + [
        Step(None, None, 5.0, 5.0, (), (), None, (), {}, 0.0)
    ]
    return world, both, steps


def candidate_of_taken(world, name):
    return candidate(name, 40.0, 38.0, taken=world.taken[name], fit=None)


@pytest.mark.parametrize(
    ("of_a", "costs", "taken", "left"),
    [
        (5.1, 2.0, 0.0, ("a", "b")),
        (5.0, 2.0, 0.0, ("a", "b")),  # just what was asked of it
        (4.9, 2.0, 0.0, ("b",)),
        (7.9, 2.0, 3.0, ("b",)),  # above the threshold, but not beyond what other forms of the others take
        (8.1, 2.0, 3.0, ("a", "b")),
        (9.0, 9.5, 0.0, ("b",)),  # dearer than what it gains
        (9.6, 9.5, 0.0, ("a", "b")),
        (10.0, 10.0, 0.0, ("a", "b")),
    ],
)
def test_an_effect_stays_as_long_as_it_gains_beside_the_others(monkeypatch, of_a, costs, taken, left):
    together = {("a", "b"): 40.0 + of_a, ("b",): 40.0}
    world, both, steps = dropped({"a": 30.0, "b": 30.0}, together, costs={"a": costs}, taken={"a": taken})
    monkeypatch.setattr(naming, "fit", world.fit)
    found, kept = naming._drop(both, steps)
    assert found.effect_names == left
    assert [s.chosen.name for s in kept if s.chosen] == list(left)
    assert kept[-1].chosen is None


def test_the_last_one_is_never_dropped(monkeypatch):
    world, both, steps = dropped({"a": 1.0, "b": 1.0}, {("a", "b"): 1.5})
    monkeypatch.setattr(naming, "fit", world.fit)
    found, _ = naming._drop(both, steps)
    assert found.effect_names == ("b",)


# Compare again


def test_the_first_is_compared_again_beside_what_came_later(play):
    """`near` explains a part of what `second` does, and so came before `real`; with `second` there `real` is the better."""
    done = play(
        {"near": 60.0, "real": 55.0, "second": 40.0},
        together={("near", "second"): 91.0, ("real", "second"): 95.0, ("near", "real"): 70.0, ("near", "real", "second"): 95.5},
    )
    assert done.steps[0].chosen.name == "real"
    assert set(done.named) == {"real", "second"}
    first = done.steps[0]
    assert first.before.effect_names == ("second",)
    assert first.chosen.gain == pytest.approx(55.0)
    assert first.members == ("real",)
    assert {c.name for c in first.candidates} >= {"near", "real"}
    assert first.stability == 1.0


def test_rivals_that_stay_alike_beside_the_others_stay_one_of_a_class(play):
    done = play(
        {"a": 60.0, "b": 59.0, "second": 40.0},
        together={("a", "b"): 61.0, ("a", "second"): 100.0, ("b", "second"): 101.0, ("a", "b", "second"): 102.0},
    )
    first = done.steps[0]
    assert first.chosen.name == "b"
    assert first.members == ("b", "a")
    assert first.weights["a"] / first.weights["b"] == pytest.approx(math.exp(-1.0))


@pytest.mark.parametrize(
    ("changed", "compared"),
    [
        ({}, True),
        ({"share": 0.001}, False),
        ({"gain": 5.0}, False),
        ({"criterion": 23.0}, False),
        ({"criterion": 23.1}, True),
        ({"name": "second"}, False),
        ({"taken": 35.0}, False),
    ],
    ids=str,
)
def test_only_rivals_that_come_near_are_compared_again(monkeypatch, changed, compared):
    world = World({"a": 40.0, "b": 39.0, "second": 30.0}, {("b", "second"): 100.0, ("a", "second"): 70.0})
    monkeypatch.setattr(naming, "fit", world.fit)
    chosen = candidate("a", 40.0, 38.0, fit=Model(world, [world.effects["a"]]))
    given = {"name": "b", "gain": 39.0, "criterion": 37.0, **changed}
    rival = candidate(fit=Model(world, [world.effects["b"]]), **given)
    current = Model(world, [world.effects["a"], world.effects["second"]])
    seen = world.separability(world.effects, Model(world, ()))
    step = Step(None, seen, 5.0, 5.0, (), (chosen, rival), chosen, ("a",), {"a": 1.0}, 1.0)
    last = Step(None, None, 5.0, 5.0, (), (rival,), None, (), {}, 0.0)
    found, steps = naming._compared_again(current, [step, last], np.random.default_rng(1))
    assert steps[1] is last
    if compared:
        assert steps[0].chosen.name == "b"
        assert set(found.effect_names) == {"b", "second"}
        assert [c.name for c in steps[0].candidates] == ["b", "a"]
    else:
        assert steps[0] is step
        assert found is current


def test_each_is_compared_with_rivals_of_its_own(monkeypatch):
    """The first has none; the second, chosen in front of another, is worse than that beside the first."""
    world = World({"first": 60.0, "near": 40.0, "real": 39.0}, {("first", "real"): 100.0, ("first", "near"): 95.0})
    monkeypatch.setattr(naming, "fit", world.fit)
    first, near, real = (candidate_of(world, name) for name in world.effects)
    seen = world.separability(world.effects, Model(world, ()))
    steps = [
        Step(None, seen, 5.0, 5.0, (), (first,), first, ("first",), {"first": 1.0}, 1.0),
        Step(None, seen, 5.0, 5.0, (), (near, real), near, ("near",), {"near": 1.0}, 1.0),
        Step(None, None, 5.0, 5.0, (), (near, real), None, (), {}, 0.0),
    ]
    kept = list(steps)
    found, compared = naming._compared_again(Model(world, [first.effect, near.effect]), steps, np.random.default_rng(1))
    assert set(found.effect_names) == {"first", "real"}
    assert compared[0] is kept[0]
    assert (compared[1].chosen.name, compared[1].before.effect_names) == ("real", ("first",))
    assert compared[2] is kept[2]


def test_a_rival_begins_where_it_lay_before(monkeypatch):
    world = World({"a": 40.0, "second": 30.0})
    monkeypatch.setattr(naming, "fit", world.fit)
    before = candidate("a", taken=1.5, fit=Model(world, [world.effects["a"]], {("a", "size"): 4.0, ("", "bearing"): 9.0}))
    without = Model(world, [world.effects["second"]], {("second", "size"): 7.0, ("", "bearing"): 2.0})
    found = naming._beside(without, [world.effects["second"]], before)
    names, start, _ = world.fitted[-1]
    assert names == ("second", "a")
    assert start == {("a", "size"): 4.0, ("second", "size"): 7.0, ("", "bearing"): 2.0}
    assert (found.name, found.gain, found.form_error_gain, found.kept, found.d_prime) == ("a", pytest.approx(40.0), 1.5, 0.5, 5.0)


# Apart


def test_members_that_another_round_chose_leave_the_class(play):
    """Both are there in the end, so they were told apart, however alike they looked at first."""
    done = play({"a": 40.0, "b": 39.5, "c": 38.5}, together={("b", "c"): 79.0}, alike=[])
    assert set(done.named) == {"a", "b", "c"}
    for step in done.steps[:3]:
        assert step.members == (step.chosen.name,)
        assert step.weights == {step.chosen.name: 1.0}


def test_the_weights_of_those_that_stay_add_up_again():
    step = Step(None, None, 5.0, 5.0, (), (), candidate("a"), ("a", "b", "c"), {"a": 0.5, "b": 0.3, "c": 0.2}, 0.9)
    apart = naming._apart(step, ("a", "c"))
    assert apart.members == ("a", "b")
    assert apart.weights == pytest.approx({"a": 0.625, "b": 0.375})
    none = Step(None, None, 5.0, 5.0, (), (), None, (), {}, 0.0)
    assert naming._apart(none, ("a",)) is none

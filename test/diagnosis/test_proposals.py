# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Proposals: what is slow comes from the level of the torque, what is fast from its whitened residual; both go to the judge."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from worlds import driven, form, machine, named, scored

from trackres_ros.diagnosis.search.proposals import BEST, TIED, Proposals, Proposer, _initial_values, _stronger, same_variable
from trackres_ros.diagnosis.selection.visibility import Proposal
from trackres_ros.effects.effect import Active, Parameter
from trackres_ros.effects.learned import ABOVE, AMBIENT, SPEED, STEP, Corner, Curve, Latch, sized_effect

COLD_NM, COLD_DEGC = 300.0, 3.0
LATE_S = 0.6


def weather(session):
    """Air that warms, cools and warms again in a drive, as on a mountain."""
    return replace(session, ambient=5.0 + 8.0 * np.sin(session.time / 95.0 + int(session.name[-1])))


def in_the_cold(session, _):
    return COLD_NM * (session.ambient < COLD_DEGC)


@pytest.fixture(scope="module")
def cold():
    """A step over the ambient temperature in a noise that is nearly a random walk, and what is proposed for it."""
    result = driven(adds=in_the_cold, changed=weather, count=4, phi=0.985)
    return result, Proposer(result, named(), scored(result)).proposals(result)


@pytest.fixture(scope="module")
def delayed():
    """A torque that is recorded late, and what is proposed for it."""
    result = driven(shows=[Active(named()["delay"], {"time": LATE_S})])
    names = {name: named()[name] for name in ("delay", "warmup", "torque_gain", "rotating_inertia", "speed_scale")}
    return result, Proposer(result, names, scored(result)).proposals(result)


def rank(proposals, name, by):
    return sorted((getattr(p, by) for p in proposals.by_name.values()), reverse=True).index(getattr(proposals.by_name[name], by))


def test_a_slow_step_in_a_random_walk_is_first_by_its_level(cold):
    result, proposals = cold
    assert result.problem.noises(result.residuals)["torque"].phi.sum() > 0.9
    first = max(proposals.by_name.values(), key=lambda p: p.level)
    assert first.effect.name == "step_of_ambient"
    assert first in proposals.best(())
    assert first.start["threshold"] == pytest.approx(COLD_DEGC, abs=0.5)
    assert first.start["y1"] == pytest.approx(-COLD_NM, rel=0.4)  # the base takes a part
    # To the whitened residual it is nearly nothing.
    assert first.fast_gain < 0.2 * first.level


def test_a_form_at_a_found_threshold_has_the_size_of_the_vehicle():
    result = driven(of=machine(), adds=lambda s, _: COLD_NM * (np.abs(s.speed) > 6.0))
    proposed = Proposer(result, {}, scored(result)).proposals(result).by_name["step_of_speed"].effect
    facts = machine().facts
    of_vehicle = sized_effect(Corner(SPEED, STEP), facts.weight * facts.radius)
    sizes = [[q for q in effect.parameters if q.off is not None] for effect in (proposed, of_vehicle, Corner(SPEED, STEP))]
    assert sizes[0] == sizes[1] != sizes[2]


def test_a_delay_is_proposed_by_the_whitened_residual(delayed):
    _, proposals = delayed
    assert rank(proposals, "delay", "fast_gain") == 0
    item = proposals.by_name["delay"]
    assert item in proposals.best(())
    assert item.level < 0.2 * item.fast_gain
    assert item.start["time"] > 0.0


def test_the_best_of_both_lists_are_proposed_if_beyond_chance(cold, delayed):
    for _, proposals in (cold, delayed):
        every, least = proposals.by_name.values(), np.log(len(proposals.by_name))
        lists = [sorted(every, key=lambda p, by=by: -getattr(p, by))[:4] for by in ("level", "fast_gain")]
        expectations = {p.effect.name for p in (*lists[0], *lists[1]) if max(p.level, p.fast_gain) > least}
        if expectations & set(TIED):
            expectations |= set(TIED) & proposals.by_name.keys()
        assert {p.effect.name for p in proposals.best(())} == expectations
        assert len(expectations) > BEST


def test_nothing_is_proposed_twice_nor_what_is_there_already(delayed):
    result, proposals = delayed
    names = [p.effect.name for p in proposals.best(())]
    assert len(names) == len(set(names))
    assert all(name == p.effect.name for name, p in proposals.by_name.items())
    with_it = replace(result, effects=(Active(named()["delay"], {"time": LATE_S}),))
    over_speed = form(Corner(SPEED, STEP))
    assert any(same_variable(p.effect, over_speed) for p in proposals.by_name.values())
    with_it = replace(with_it, effects=(*with_it.effects, Active(over_speed, {q.name: q.start for q in over_speed.parameters})))
    repetition = Proposer(result, {name: named()[name] for name in ("delay", "warmup")}, scored(result)).proposals(with_it)
    assert "delay" not in repetition.by_name
    assert "warmup" in repetition.by_name
    assert not any(same_variable(p.effect, over_speed) for p in repetition.by_name.values())
    assert any(isinstance(p.effect, Curve | Corner) for p in repetition.by_name.values())  # over another variable


def test_each_start_is_within_bounds_and_not_at_zero(cold, delayed):
    for _, proposals in (cold, delayed):
        for p in proposals.best(()):
            assert p.start.keys() == {q.name for q in p.effect.parameters}
            sizes = [q for q in p.effect.parameters if q.off is not None]
            assert all(q.low <= p.start[q.name] <= q.high for q in p.effect.parameters if q.fitted)
            assert any(p.start[q.name] != q.off for q in sizes)
            assert all(abs(p.start[q.name] - q.off) <= 20.0 * abs(q.start - q.off) + 1e-9 for q in sizes)


def test_names_that_drives_hardly_separate_come_together():
    gain = driven(1.1)
    names = {name: named()[name] for name in ("delay", "torque_gain", "speed_scale", "grade")}
    proposed = {p.effect.name for p in Proposer(gain, names, scored(gain)).proposals(gain).best(())}
    assert {"torque_gain", "speed_scale", "grade"} <= proposed
    assert "delay" not in proposed


def proposal(effect, start=None, columns=None, **gains):
    """An effect that is somewhat visible."""
    return Proposal(effect, start or {}, columns, 0.8, 5.0, 0.0, np.empty(0), **gains)


@pytest.mark.parametrize(("moved", "size"), [(0.02, 5.25), (-0.02, 4.75), (0.3, 6.5), (-0.8, 1.0), (90.0, 100.0), (-90.0, -95.0)])
def test_a_fit_never_starts_at_zero_where_shape_has_no_effect(moved, size):
    """Nor beyond twenty typical sizes."""
    effect = type("Any", (), {"parameters": (Parameter("size", "Nm", -100.0, 100.0, 10.0, "of it", off=5.0),)})()
    seen = proposal(effect, {"size": 10.0})
    assert _initial_values(seen, np.array([moved])) == {"size": pytest.approx(size)}


@pytest.mark.parametrize(
    ("low", "high", "moved", "sizes"),
    [
        (0.0, 100.0, [-0.02], [0.5]), (0.0, 100.0, [0.02], [0.5]), (-100.0, 0.0, [0.02], [-0.5]), (-0.5, 0.5, [0.02], [0.5]),
        (-0.5, 0.5, [-0.02], [-0.5]), (-100.0, 100.0, [0.02, -0.01], [0.2, -0.1]),
    ],
)  # fmt: skip
def test_a_start_is_on_the_side_that_bounds_allow(low, high, moved, sizes):
    """Of two sizes one may be near zero: the other one shows the shape."""
    names = [f"size_{i}" for i in range(len(moved))]
    effect = SimpleNamespace(parameters=tuple(Parameter(n, "Nm", low, high, 10.0, "of it", off=0.0) for n in names))
    seen = proposal(effect)
    assert _initial_values(seen, np.array(moved)) == pytest.approx(dict(zip(names, sizes, strict=True)))


@pytest.mark.parametrize("turned", [False, True])
def test_of_two_starts_the_one_that_gains_more_is_fitted(turned):
    """In either list it has the gain of the better one."""
    slow, fast = proposal(None, {"at": 1.0}, level=5.0, fast_gain=1.0), proposal(None, {"at": 2.0}, level=2.0, fast_gain=9.0)
    result = _stronger(fast, slow) if turned else _stronger(slow, fast)
    assert (result.start["at"], result.level, result.fast_gain) == (2.0, 5.0, 9.0)


def test_derivatives_are_those_of_sizes_and_not_of_a_shape():
    parameters = [
        Parameter(n, "Nm", 0.0, 9.0, 1.0, "of it", off=deviation)
        for n, deviation in (("one", 0.0), ("shape", None), ("other", 0.0))
    ]
    effect = SimpleNamespace(name="any", parameters=tuple(parameters))
    result = proposal(effect, columns=np.array([[1.0, 2.0], [3.0, 4.0]])).derivatives
    assert {key: column.tolist() for key, column in result.items()} == {("any", "one"): [1.0, 3.0], ("any", "other"): [2.0, 4.0]}


def test_where_nothing_is_visible_nothing_is_proposed():
    """A single effect that gains something has no rivals that do so by chance."""
    assert Proposals(None, {}, None).best(()) == ()
    item = proposal(SimpleNamespace(name="one"), level=0.1, fast_gain=-2.0)
    assert Proposals(None, {"one": item}, None).best(()) == (item,)
    assert Proposals(None, {"one": replace(item, level=0.0)}, None).best(()) == ()


def test_nothing_hidden_proposes_next_to_nothing():
    result = driven(count=3)
    names = {name: named()[name] for name in ("delay", "warmup", "stribeck", "mullins")}
    proposals = Proposer(result, names, scored(result)).proposals(result)
    assert len(proposals.by_name) > 20
    assert all(p.level < 12.0 for p in proposals.best(()))


def test_what_is_left_out_is_not_proposed_again():
    names = [f"effect_{i}" for i in range(BEST + 2)]
    every = {n: proposal(SimpleNamespace(name=n), level=50.0 - i, fast_gain=0.0) for i, n in enumerate(names)}
    proposals = Proposals(None, every, None)
    assert [p.effect.name for p in proposals.best(())][:BEST] == names[:BEST]
    assert [p.effect.name for p in proposals.best({names[0]})][:BEST] == names[1 : BEST + 1]


def test_one_form_describes_a_variable():
    step, hinge = Corner(AMBIENT, STEP), Corner(AMBIENT, ABOVE)
    assert same_variable(step, hinge)
    assert same_variable(step, Latch(AMBIENT))
    assert not same_variable(step, Corner(SPEED, STEP))
    assert same_variable(Corner(SPEED, STEP), Curve(SPEED, [1.0, 2.0]))
    assert not same_variable(step, named()["turning_scrub"])

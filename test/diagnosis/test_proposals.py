# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Proposals: what is slow comes from the level of the torque, what is fast from its whitened residual; both go to the judge."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from worlds import driven, named, scored

from trackres_ros.diagnosis.search.proposals import BEST, TIED, Proposal, Proposals, Proposer, _begin
from trackres_ros.diagnosis.selection.candidate import same_variable
from trackres_ros.diagnosis.selection.visibility import EffectSensitivity
from trackres_ros.effects.effect import Active, Parameter
from trackres_ros.effects.learned import ABOVE, AMBIENT, SPEED, STEP, Corner, Curve, Latch

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
    found = driven(adds=in_the_cold, changed=weather, count=4, phi=0.985)
    return found, Proposer(found, named(), scored(found)).proposals(found)


@pytest.fixture(scope="module")
def delayed():
    """A torque that is recorded late, and what is proposed for it."""
    found = driven(shows=[Active(named()["delay"], {"time": LATE_S})])
    names = {name: named()[name] for name in ("delay", "warmup", "torque_gain", "rotating_inertia", "speed_scale")}
    return found, Proposer(found, names, scored(found)).proposals(found)


def rank(proposals, name, by):
    return sorted((getattr(p, by) for p in proposals.every.values()), reverse=True).index(getattr(proposals.every[name], by))


def test_a_slow_step_in_a_random_walk_is_first_by_its_level(cold):
    found, proposals = cold
    assert found.problem.noises(found.residuals)["torque"].phi.sum() > 0.9
    first = max(proposals.every.values(), key=lambda p: p.level)
    assert first.effect.name == "step_of_ambient"
    assert first in proposals.best(())
    assert first.start["threshold"] == pytest.approx(COLD_DEGC, abs=0.5)
    assert first.start["y1"] == pytest.approx(-COLD_NM, rel=0.4)  # the base takes a part
    # To the whitened residual it is nearly nothing.
    assert first.fast < 0.2 * first.level


def test_a_delay_is_proposed_by_the_whitened_residual(delayed):
    _, proposals = delayed
    assert rank(proposals, "delay", "fast") == 0
    of = proposals.every["delay"]
    assert of in proposals.best(())
    assert of.level < 0.2 * of.fast
    assert of.start["time"] > 0.0


def test_the_best_of_both_lists_are_proposed_if_beyond_chance(cold, delayed):
    for _, proposals in (cold, delayed):
        every, least = proposals.every.values(), np.log(len(proposals.every))
        lists = [sorted(every, key=lambda p, by=by: -getattr(p, by))[:4] for by in ("level", "fast")]
        expected = {p.effect.name for p in (*lists[0], *lists[1]) if max(p.level, p.fast) > least}
        if expected & set(TIED):
            expected |= set(TIED) & proposals.every.keys()
        assert {p.effect.name for p in proposals.best(())} == expected
        assert len(expected) > BEST


def test_nothing_is_proposed_twice_nor_what_is_there_already(delayed):
    found, proposals = delayed
    names = [p.effect.name for p in proposals.best(())]
    assert len(names) == len(set(names))
    assert all(name == p.effect.name for name, p in proposals.every.items())
    with_it = replace(found, effects=(Active(named()["delay"], {"time": LATE_S}),))
    again = Proposer(found, {name: named()[name] for name in ("delay", "warmup")}, scored(found)).proposals(with_it)
    assert "delay" not in again.every
    assert "warmup" in again.every


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


@pytest.mark.parametrize(("moved", "size"), [(0.02, 5.25), (-0.02, 4.75), (0.3, 6.5), (-0.8, 1.0), (90.0, 100.0), (-90.0, -95.0)])
def test_a_fit_never_starts_at_zero_where_shape_has_no_effect(moved, size):
    """Nor beyond twenty typical sizes."""
    effect = type("Any", (), {"parameters": (Parameter("size", "Nm", -100.0, 100.0, 10.0, "of it", off=5.0),)})()
    seen = EffectSensitivity(effect, {"size": 10.0}, np.empty(0), 0.8, 5.0, 0.0, np.empty(0))
    assert _begin(seen, np.array([moved])) == {"size": pytest.approx(size)}


def test_nothing_hidden_proposes_next_to_nothing():
    found = driven(count=3)
    names = {name: named()[name] for name in ("delay", "warmup", "stribeck", "mullins")}
    proposals = Proposer(found, names, scored(found)).proposals(found)
    assert len(proposals.every) > 20
    assert all(p.level < 12.0 for p in proposals.best(()))


def test_what_is_left_out_is_not_proposed_again():
    names = [f"effect_{i}" for i in range(BEST + 2)]
    every = {n: Proposal(SimpleNamespace(name=n), {}, None, 50.0 - i, 0.0) for i, n in enumerate(names)}
    proposals = Proposals(every=every)
    assert [p.effect.name for p in proposals.best(())][:BEST] == names[:BEST]
    assert [p.effect.name for p in proposals.best({names[0]})][:BEST] == names[1 : BEST + 1]


def test_one_form_describes_a_variable():
    step, hinge = Corner(AMBIENT, STEP), Corner(AMBIENT, ABOVE)
    assert same_variable(step, hinge)
    assert same_variable(step, Latch(AMBIENT))
    assert not same_variable(step, Corner(SPEED, STEP))
    assert same_variable(Corner(SPEED, STEP), Curve(SPEED, [1.0, 2.0]))
    assert not same_variable(step, named()["turning_scrub"])

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a candidate is worth, which are of one class and on how many laps they win, on constructed candidates."""

import math
from dataclasses import FrozenInstanceError
from types import SimpleNamespace

import numpy as np
import pytest
from worlds import LAP, LAPS, Model, World, candidate, candidate_of

from trackres_ros.diagnosis.selection import naming
from trackres_ros.diagnosis.selection.naming import Step
from trackres_ros.diagnosis.selection.visibility import Separability

# What a candidate is worth


def test_a_candidate_counts_by_what_it_gains_beyond_other_forms_and_what_it_costs():
    one = candidate(gain=10.0, criterion=8.0, taken=3.0)
    assert (one.net_gain, one.net_evidence) == (7.0, 5.0)
    assert one.counts(6.9)
    assert not one.counts(7.0)
    assert not candidate(gain=10.0, criterion=3.0, taken=3.0).counts(1.0)
    assert candidate(gain=10.0, criterion=3.1, taken=3.0).counts(1.0)


def test_what_hardly_adds_to_the_torque_is_not_worth_a_name():
    assert candidate(share=0.005).counts(1.0)
    assert not candidate(share=0.00499).counts(1.0)


def test_the_hint_is_the_likeliest_of_those_above_noise_where_nothing_was_chosen():
    several = (candidate("a", 9.0, 4.0), candidate("b", 8.0, 6.0), candidate("c", 4.0, 9.0), candidate("d", 9.0, -1.0))

    def hint(candidates, chosen=None):
        return Step(None, None, 5.0, 50.0, (), candidates, chosen, (), {}, 0.0).hint

    assert hint(several) == "b"
    assert hint(several, several[0]) == ""
    assert hint(several[2:]) == ""
    assert hint((candidate("e", 5.0, 4.0),)) == ""
    assert hint((candidate("e", 9.0, 0.0),)) == ""
    assert hint((candidate("e", 9.0, 0.5),)) == "e"
    assert hint((candidate("e", 9.0, -0.5),)) == ""
    assert hint(()) == ""


def test_what_was_found_cannot_be_changed_afterwards():
    step = Step(None, None, 5.0, 5.0, (), (), candidate(), ("x",), {"x": 1.0}, 1.0)
    for found, attribute in ((candidate(), "gain"), (step, "chosen")):
        with pytest.raises(FrozenInstanceError):
            setattr(found, attribute, None)


def test_parameters_count_as_far_as_the_data_settle_them():
    found = SimpleNamespace(
        free=[SimpleNamespace(key=key, std=2.0) for key in (("a", "p"), ("a", "q"), ("a", "r"), ("b", "p"), ("", "base"))],
        std_of=lambda effect, name: {"p": 0.0, "q": 1.0, "r": 5.0}[name],
    )
    assert naming.effective_parameters(found, "a") == pytest.approx(1.75)
    assert naming.effective_parameters(found, "b") == 1.0


@pytest.mark.parametrize(
    ("gain", "std", "expected"), [(1.0, 1.0, 100.0), (0.5, 1.0, 25.0), (0.1, 1.0, 10.0), (1.0, 0.5, 100.0), (1.0, 2.0, 25.0)]
)
def test_samples_are_worth_less_where_residuals_resemble_each_other(gain, std, expected):
    rows = [np.where(np.arange(120) % 2, 1.0, -1.0), np.full(50, 1e9)]
    mask = np.arange(120) < 100
    segments = [SimpleNamespace(kind="torque", mask=mask), SimpleNamespace(kind="belt", mask=np.ones(50, dtype=bool))]
    noise = SimpleNamespace(dc_gain=gain, std=std)
    found = SimpleNamespace(residuals=rows, problem=SimpleNamespace(segments=segments), noise=noise)
    assert naming.effective_samples(found) == pytest.approx(expected)


def test_the_root_mean_square_is_of_what_counts():
    found = SimpleNamespace(problem=SimpleNamespace(masks=[np.array([True, True, False]), np.array([True, True])]))
    assert naming.rms([np.array([3.0, np.nan, 99.0]), np.array([4.0, 5.0])], found) == pytest.approx(math.sqrt(50.0 / 3.0))


@pytest.mark.parametrize(
    ("torque", "added", "share"), [(100.0, 5.0, 0.05), (1e-3, 1e-4, 0.1), (1e-3, 2e-3, 2.0), (0.0, 0.0, 0.0)]
)
def test_the_share_is_of_the_torque_that_was_measured_however_small(torque, added, share):
    world = World({"a": 40.0})
    world.problem.sessions = (SimpleNamespace(torque=np.full(LAPS * LAP, -torque)),)
    found = Model(world, [world.effects["a"]])
    found.contribution = lambda name: [np.full(LAPS * LAP, added)]
    assert naming.compared(Model(world, ()), found, "a", 1.0, 5.0, 0.0).share == pytest.approx(share)


# Classes


def class_of(first, *others, alike=()):
    seen = Separability((), (), tuple(c.name for c in (first, *others)), np.eye(1 + len(others)))
    for name in alike:
        j = seen.names.index(name)
        seen.cosines[0, j] = seen.cosines[j, 0] = 0.96
    return naming._class_of(first, [first, *others], seen)


def test_a_class_holds_those_that_are_nearly_as_likely_weighted_by_evidence():
    first, near, far = candidate("a", 20.0, 18.0), candidate("b", 20.0, 16.0), candidate("c", 20.0, 14.9)
    found = class_of(first, near, far)
    assert list(found) == ["a", "b"]
    assert found["b"] / found["a"] == pytest.approx(math.exp(-2.0))
    assert sum(found.values()) == pytest.approx(1.0)
    assert list(class_of(first, candidate("d", 20.0, 15.0))) == ["a"]


def test_a_weight_that_is_next_to_nothing_is_left_out_but_of_those_that_look_alike():
    first, unlikely = candidate("a", 20.0, 18.0), candidate("b", 20.0, 15.01)
    assert math.exp(-2.99) / (1 + math.exp(-2.99)) < 0.05
    assert list(class_of(first, unlikely)) == ["a"]
    assert class_of(first, unlikely) == {"a": 1.0}
    alike = class_of(first, unlikely, alike=["b"])
    assert list(alike) == ["a", "b"]


def test_those_that_look_alike_are_of_the_class_by_the_likelihood_alone():
    first, costly, worse = candidate("a", 20.0, 18.0), candidate("b", 17.1, 6.0), candidate("c", 17.0, 6.0)
    assert list(class_of(first, costly, worse)) == ["a"]
    assert list(class_of(first, costly, worse, alike=["b", "c"])) == ["a", "b"]


@pytest.mark.parametrize("evidence", [-2000.0, 0.0, 2000.0])
def test_weights_hang_on_differences_of_evidence_alone(evidence):
    found = class_of(candidate("a", 3000.0, evidence), candidate("b", 3000.0, evidence - 1.0))
    assert found["b"] / found["a"] == pytest.approx(math.exp(-1.0))


def test_a_first_that_was_not_looked_at_beforehand_is_a_class_of_its_own():
    seen = Separability((), (), ("other",), np.eye(1))
    assert naming._class_of(candidate("a"), [candidate("a")], seen) == {"a": 1.0}


# Other laps


def test_a_class_is_widened_by_those_that_other_laps_would_name_until_it_is_stable():
    weights, wins = {"a": 0.9, "b": 0.1}, {"a": 0.5, "b": 0.1, "c": 0.15, "d": 0.1, "e": 0.05}
    members, widened, stability = naming._widened(weights, wins)
    assert members == ("a", "b", "c", "d")
    assert stability == pytest.approx(0.85)
    total = 1.0 + 0.15 + 0.1
    assert widened == pytest.approx({"a": 0.9 / total, "b": 0.1 / total, "c": 0.15 / total, "d": 0.1 / total})


def test_a_class_that_is_stable_is_not_widened_and_those_that_hardly_ever_win_do_not_join():
    assert naming._widened({"a": 1.0}, {"a": 0.8, "b": 0.2}) == (("a",), {"a": 1.0}, 0.8)
    members, _, stability = naming._widened({"a": 1.0}, {"a": 0.5, "b": 0.06, "c": 0.04, "d": 0.04})
    assert members == ("a", "b")
    assert stability == pytest.approx(0.56)
    assert naming._widened({"a": 1.0}, {"a": 0.5, "b": 0.05})[0] == ("a", "b")


def models(**laps):
    world = World(laps)
    return world, Model(world, ()), [candidate_of(world, name) for name in laps]


def test_wins_are_shares_of_resampled_laps():
    half = np.repeat([0.0, 4.0], LAPS // 2)
    _, base, rivals = models(a=half, b=half[::-1])
    wins = naming._wins(base, rivals, np.random.default_rng(1))
    assert sum(wins.values()) == pytest.approx(1.0)
    assert wins["a"] == pytest.approx(0.5, abs=0.09)  # where both have as many laps the first is counted
    assert naming._wins(base, rivals[:1], np.random.default_rng(1)) == {"a": 1.0}


def test_where_nothing_is_better_than_nothing_nobody_wins():
    laps = np.full(LAPS, -1.0)
    _, base, (loser,) = models(a=laps)
    assert naming._wins(base, [loser], np.random.default_rng(1)) == {"a": 0.0}
    laps = np.where(np.arange(LAPS) == 0, 60.0, -1.0)  # all of it of one lap, which a third of the draws leaves out
    _, base, (lucky,) = models(a=laps)
    assert naming._wins(base, [lucky], np.random.default_rng(1))["a"] == pytest.approx(1.0 - math.exp(-1.0), abs=0.02)


def test_costs_and_priors_weigh_the_same_on_whatever_laps():
    laps = np.full(LAPS, 1.0)
    _, base, (one,) = models(a=laps)
    for gain, worth, share in ((20.0, 0.1, 1.0), (20.0, -0.1, 0.0), (20.0, 0.0, 0.0), (10.0, 0.1, 1.0), (30.0, -0.1, 0.0)):
        # The gain is that of the laps and of the priors; the evidence what is left of it.
        found = candidate("a", gain, worth, fit=one.fit)
        assert naming._wins(base, [found], np.random.default_rng(1)) == {"a": share}
    taken = candidate("a", 20.0, 18.0, taken=18.1, fit=one.fit)
    assert naming._wins(base, [taken], np.random.default_rng(1)) == {"a": 0.0}


def test_what_a_lap_gains_is_over_the_fit_before():
    """The effect that is there already explains much of one lap; what comes beside it gains a little of each."""
    world = World({"there": np.where(np.arange(LAPS) == 3, 200.0, 0.0), "a": 20.0})
    there, beside = world.effects.values()
    found = candidate("a", 20.0, 18.0, fit=Model(world, [there, beside]))
    assert naming._wins(Model(world, [there]), [found], np.random.default_rng(1)) == {"a": 1.0}

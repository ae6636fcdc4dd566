# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gain of a candidate, on constructed candidates."""

import math
from dataclasses import FrozenInstanceError
from types import SimpleNamespace

import numpy as np
import pytest
from trackres_ros.diagnosis.selection.naming import Step
from worlds import LAP, LAPS, Kind, Model, World, candidate

from trackres_ros.diagnosis.selection import naming
from trackres_ros.effects.learned import OPEN, SPEED, Curve

# Gain of a candidate


def test_a_candidate_counts_by_gain_net_of_other_forms_and_costs():
    one = candidate(gain=10.0, criterion=8.0, taken=3.0)
    assert (one.net_gain, one.net_evidence) == (7.0, 5.0)
    assert one.counts(6.9)
    assert not one.counts(7.0)
    assert not candidate(gain=10.0, criterion=3.0, taken=3.0).counts(1.0)
    assert candidate(gain=10.0, criterion=3.1, taken=3.0).counts(1.0)
    # What hardly adds to the torque is not worth a name.
    assert candidate(share=0.005).counts(1.0)
    assert not candidate(share=0.00499).counts(1.0)


def test_the_hint_is_the_likeliest_candidate_above_noise():
    def of(name, gain, criterion, effect=None):
        return candidate(name, gain, criterion, fit=Model(World({name: gain}), [effect or Kind(name)]))

    several = (of("a", 9.0, 4.0), of("b", 8.0, 6.0), of("c", 4.0, 9.0), of("d", 9.0, -1.0))

    def hint(candidates, chosen=None):
        return Step(None, None, 5.0, 50.0, (), candidates, chosen, (), {}, 0.0).hint

    assert hint(several) == "b"
    assert hint(several, several[0]) == ""
    assert hint(several[2:]) == ""
    assert hint((of("e", 5.0, 4.0),)) == ""
    assert hint((of("e", 9.0, 0.0),)) == ""
    assert hint((of("e", 9.0, 0.5),)) == "e"
    assert hint((of("e", 9.0, -0.5),)) == ""
    assert hint(()) == ""
    curve = Curve(SPEED, OPEN, [1.0, 5.0])
    assert hint((of(curve.name, 9.0, 8.0, curve),)) == ""  # a form is no name


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
def test_autocorrelated_residuals_reduce_the_effective_samples(gain, std, expected):
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
def test_the_share_is_relative_to_the_measured_torque(torque, added, share):
    world = World({"a": 40.0})
    world.problem.sessions = (SimpleNamespace(torque=np.full(LAPS * LAP, -torque)),)
    found = Model(world, [world.effects["a"]])
    found.contribution = lambda name: [np.full(LAPS * LAP, added)]
    assert naming.compared(Model(world, ()), found, "a", 1.0, 5.0, 0.0).share == pytest.approx(share)

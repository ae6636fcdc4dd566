# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a torque follows: the channel that comes closest, with the share that other laps confirm; and the load between drives."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from trackres_ros.diagnosis.empirical.closest import FOLLOWS_LEAST, closest_channel
from trackres_ros.diagnosis.selection.grade import Graded
from trackres_ros.diagnosis.selection.held_out import Improvement
from trackres_ros.diagnosis.stages.judge import _by_load


def said(found, torques):
    sentence = closest_channel(found.final, torques)
    channel, share = re.search(r"(?:the best,|channels,) (.+?),? (?:comes|explains).*?(\d+) % of it", sentence).groups()
    assert sentence.startswith("It follows no") == (int(share) < 100.0 * FOLLOWS_LEAST)
    return channel, int(share)


def test_a_torque_of_a_channel_is_explained_by_it(diagnosed):
    channel, share = said(diagnosed, [50.0 * np.abs(s.speed) for s in diagnosed.sessions])
    assert channel == "speed"
    assert share > 90


def test_a_torque_of_two_channels_names_both(diagnosed):
    torques = [100.0 * (s.speed > 3.0) * (np.sin(s.heading) > 0.0) for s in diagnosed.sessions]
    channel, share = said(diagnosed, torques)
    assert set(channel.split(" with ")) == {"speed", "heading"}
    assert share > 50


@pytest.mark.parametrize("seconds", [1.0, 60.0])
def test_a_torque_of_chance_is_explained_by_no_channel(diagnosed, seconds):
    """Nor by the many cells, as each lap is predicted from the others."""
    rng = np.random.default_rng(3)
    torques = [rng.normal(0.0, 100.0, len(s))[(s.time // seconds).astype(int)] for s in diagnosed.sessions]
    assert said(diagnosed, torques)[1] < 10


def test_no_channel_explains_what_each_lap_has_differently(diagnosed):
    torques = [np.where(s.block % 2 > 0, 100.0, -100.0) * np.sign(s.speed - 3.0) for s in diagnosed.sessions]
    assert said(diagnosed, torques)[1] < 20


@pytest.mark.parametrize(("within", "name"), [(0.0, "hinge_above_load"), (0.2, "")])
def test_load_is_told_first_where_only_recordings_differ_in_it(diagnosed, within, name):
    """And where a form that follows it is suspected, not refuted."""
    problem = diagnosed.final.problem
    weights = [(1.0 + 0.1 * i) * (1.0 + within * np.sin(s.time / 50.0)) for i, s in enumerate(problem.sessions)]
    sessions = tuple(replace(s, weight=2e5 * w) for s, w in zip(problem.sessions, weights, strict=True))
    final = replace(diagnosed.final, problem=replace(problem, sessions=sessions))
    better, worse = (Improvement(100.0, after, 0.0, 1.0) for after in (90.0, 120.0))
    for improvement, expected in ((better, name), (replace(worse, low=-30.0, high=-10.0), "")):
        chosen = SimpleNamespace(unconfirmed=(Graded("payne", better), Graded("hinge_above_load", improvement)))
        assert _by_load(chosen, final) == expected

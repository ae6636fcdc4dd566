# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a torque follows: the channel that comes closest, with the share that other laps confirm; and the load between drives."""

import re
from dataclasses import replace

import numpy as np
import pytest

from trackres_ros.diagnosis.empirical.term import ONLY_BETWEEN, Term
from trackres_ros.diagnosis.pipeline import _by_load
from trackres_ros.diagnosis.selection.held_out import Improvement
from trackres_ros.diagnosis.selection.locate import FOLLOWS_LEAST, closest_channel
from trackres_ros.effects.learned import ABOVE, LOAD, SPEED, STEP, Corner


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


def test_load_is_told_first_where_only_recordings_differ_in_it():
    better, between = Improvement(100.0, 90.0, 5.0, 15.0), (f"{ONLY_BETWEEN} 5 recordings, as other things may",)
    of_load, of_speed = (
        Term(form, None, improvement=better, faults=between) for form in (Corner(LOAD, ABOVE), Corner(SPEED, STEP))
    )
    assert _by_load((of_speed, of_load)) == "hinge_above_load"
    for silent in ((of_speed,), (replace(of_load, faults=("mostly cancels another term",)),), ()):
        assert not _by_load(silent)

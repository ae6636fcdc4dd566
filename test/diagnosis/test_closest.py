# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The recorded channel that comes closest to a torque, with the share of it that laps left out confirm."""

import re

import numpy as np
import pytest

from trackres_ros.diagnosis.empirical.closest import FOLLOWS_LEAST, closest_channel


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

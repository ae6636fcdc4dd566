# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learned values survive a restart bit by bit, and a file can contain nothing else."""

import copy
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import STEP
from trackres_ros.learning.store import learner_content, take_content
from trackres_ros.units import GRAVITY, SECOND_NS
from trackres_ros.vehicle import load_any

START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def learner(road):
    return road("watch", {layout.OF_LOSS: 0.2}).drive(5.0).learner


def _read_back(estimator, learner):
    read = Learner(estimator)
    take_content(read, json.loads(json.dumps(learner_content(learner))))
    return read


@pytest.mark.parametrize("seed", [0, 2])
def test_every_state_of_a_learner_is_read_back_bit_by_bit(seed):
    """Of blocks with any torque, on hills seen by an altitude and an IMU."""
    estimator, random, height, drive = Estimator(load_any("bmw_i3")), np.random.default_rng(seed), 500.0, 0.0
    session, learner = estimator.session(), Learner(estimator, "on")
    for i in range(300):
        stamp, slope = START_NS + i * SECOND_NS // 2, 0.05 * np.sin(i / 30.0)
        speed = 20.0 + 12.0 * np.sin(i / 80.0)
        if i % 20 == 0:
            assert learner_content(_read_back(estimator, learner)) == learner_content(learner)
            error = learner.prior.rolling_nm * (random.normal() - 1.0) * random.choice([0.1, 0.1, 30.0])
        height += 0.5 * speed * slope
        session.handle(layout.TORQUE, stamp, stamp, drive + error + random.normal(0.0, 5.0))
        session.handle(layout.ALTITUDE, stamp, stamp, height + random.normal())
        session.handle(layout.SPECIFIC_FORCE, stamp, stamp, GRAVITY * slope + random.normal(0.0, 0.1))
        estimate = session.handle(layout.SPEED, stamp, stamp, speed)
        drive = estimate["drive_torque_nm"]
        learner.take(stamp, estimate.row.tolist(), session)


def test_a_step_between_the_largest_torques_is_read_back(reference, learner):
    low, high = reference.constants.channel_limits[layout.TORQUE]
    step_learner = copy.deepcopy(learner)
    step_learner.learned.covariance[STEP, STEP] += (high - low) ** 2
    assert learner_content(_read_back(reference, step_learner)) == learner_content(step_learner)


@given(data=st.data())
def test_what_no_learning_leaves_is_refused_and_leaves_it_as_new(reference, learner, data):
    content = copy.deepcopy(learner_content(learner))
    part = data.draw(st.sampled_from(sorted(content)))
    name = data.draw(st.sampled_from(sorted(content[part])))
    content[part][name] = data.draw(st.sampled_from([None, "abc", [], {}, "-inf", 1.5, ["0x1.0p+0"]]))
    new_learner = Learner(reference)
    with pytest.raises(ValueError, match="learned parameters"):
        take_content(new_learner, content)
    assert learner_content(new_learner) == learner_content(Learner(reference))


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("learned", "mean", layout.OF_LOSS), 5.0, "range"),
        (("learned", "past", "slow"), -1.0, "an invalid size"),
        (("learned", "past", "white"), -1.0, "an invalid size"),
        (("delay", "delays", 0), 2.0, "delay"),
        (("delay", "variances", 0), -1.0, "delay"),
    ],
)
def test_a_number_that_no_learner_has_is_refused(reference, learner, place, value, said):
    content = copy.deepcopy(learner_content(learner))
    part, name, last = place
    content[part][name][last] = value.hex()
    with pytest.raises(ValueError, match=said):
        take_content(Learner(reference), content)

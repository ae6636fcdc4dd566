# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learned values survive a restart bit by bit, and a file can contain nothing else."""

import copy
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.estimator import columns as at
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.store import stored, take


@pytest.fixture(scope="module")
def learner(road):
    return road("watch", {at.OF_LOSS: 0.2}).drive(5.0).learner


def test_it_comes_back_bit_by_bit(reference, learner):
    given_back = Learner(reference)
    take(given_back, json.loads(json.dumps(stored(learner))))
    assert stored(given_back) == stored(learner)
    assert np.array_equal(given_back.learned.covariance, learner.learned.covariance)


@given(data=st.data())
def test_what_no_learning_leaves_is_refused_and_leaves_it_as_new(reference, learner, data):
    content = copy.deepcopy(stored(learner))
    part = data.draw(st.sampled_from(sorted(content)))
    name = data.draw(st.sampled_from(sorted(content[part])))
    content[part][name] = data.draw(st.sampled_from([None, "abc", [], {}, "-inf", 1.5, ["0x1.0p+0"]]))
    fresh = Learner(reference)
    with pytest.raises(ValueError, match="learned parameters"):
        take(fresh, content)
    assert stored(fresh) == stored(Learner(reference))


def test_a_departure_outside_of_the_ranges_is_refused(reference, learner):
    content = copy.deepcopy(stored(learner))
    content["learned"]["mean"][at.OF_LOSS] = (5.0).hex()
    with pytest.raises(ValueError, match="range"):
        take(Learner(reference), content)


@pytest.mark.parametrize("name", ["slow", "white"])
def test_a_variance_below_zero_is_refused(reference, learner, name):
    content = copy.deepcopy(stored(learner))
    content["learned"]["past"][name] = (-1.0).hex()
    with pytest.raises(ValueError, match="an invalid size"):
        take(Learner(reference), content)

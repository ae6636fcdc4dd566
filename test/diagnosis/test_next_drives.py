# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is advised to be driven next, by what it is expected to tell."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.diagnosis import read_recordings
from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.empirical.term import Round, term_of_fit
from trackres_ros.diagnosis.findings.next_drives import (
    SEEN_D_PRIME,
    advise,
    information,
    menu,
    recorded_distances,
    squared_distances,
)
from trackres_ros.diagnosis.inference.fitting import Problem, fit
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.session import lap_name, split_laps
from trackres_ros.errors import InputError

FASTEST_MPS = 14.0


@st.composite
def beliefs(draw):
    """How likely some hypotheses are, and squared distances between them."""
    n = draw(st.integers(2, 5))
    raw = np.array(draw(st.lists(st.floats(0.01, 1.0), min_size=n, max_size=n)))
    upper = np.zeros((n, n))
    upper[np.triu_indices(n, 1)] = draw(st.lists(st.floats(0.0, 100.0), min_size=n * (n - 1) // 2, max_size=n * (n - 1) // 2))
    return raw / raw.sum(), upper + upper.T


@given(beliefs())
def test_information_lies_between_zero_and_the_entropy(belief):
    weights, squares = belief
    assert information(weights, np.zeros_like(squares)) == pytest.approx(0.0, abs=1e-9)
    assert 0.0 <= information(weights, squares) <= -(weights @ np.log2(weights)) + 1e-9


@given(beliefs(), st.floats(0.01, 50.0), st.data())
def test_information_grows_with_every_distance(belief, more, data):
    weights, squares = belief
    i, j = data.draw(st.sampled_from([(i, j) for i in range(len(weights)) for j in range(i)]))
    further = squares.copy()
    further[i, j] = further[j, i] = squares[i, j] + more
    assert information(weights, further) >= information(weights, squares) - 1e-12


def test_a_manoeuvre_that_shows_none_of_the_tied_is_worth_less():
    weights = np.array([0.4, 0.3, 0.3])
    apart_from_each_other = np.array([[0.0, 36.0, 0.0], [36.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    and_from_nothing = 36.0 * (1.0 - np.eye(3))
    assert information(weights, apart_from_each_other) < information(weights, and_from_nothing)


@pytest.fixture(scope="module")
def tied(recorded, loaded, effects):
    """A round in which drag and offset are tied, as they are as long as one drives forwards only."""
    sessions = gate(read_recordings(recorded("drivetrain_drag"), None), loaded.known).sessions
    result_before = fit(Problem(loaded.base, sessions, tuple(s.used for s in sessions)))
    fits = {
        name: fit(result_before.problem, [effects[name]], result_before.estimates, result_before.noises)
        for name in ("drivetrain_drag", "torque_offset")
    }
    results = [term_of_fit(result_before, with_it, effects[name]) for name, with_it in fits.items()]
    drag, offset = (replace(term, level=term.gain) for term in results)
    return replace(drag, rivals=Round(result_before, None, (offset,), 5.0), members=tuple(fits), weights=dict.fromkeys(fits, 0.5))


def test_drag_and_offset_are_told_apart_in_reverse(tied):
    best = advise(tied, FASTEST_MPS)[0]
    assert "in reverse" in best.manoeuvre
    assert best.groups == (("drivetrain_drag",), ("torque_offset",))
    assert best.expected_d_prime >= SEEN_D_PRIME
    assert 0.0 < best.information_bit <= np.log2(3.0)


def test_what_is_not_tied_needs_no_advice(tied):
    alone = replace(tied, members=("drivetrain_drag",), weights={"drivetrain_drag": 1.0})
    assert advise(alone, FASTEST_MPS) == []
    assert advise(replace(tied, rivals=None), FASTEST_MPS) == []


def test_standing_adds_no_evidence_beyond_the_models_own_error(tied):
    facts, like = tied.rivals.before.problem.base.facts, tied.rivals.before.problem.sessions[0]
    drive = menu(facts.weight, FASTEST_MPS)["drive at one speed with three loads, five minutes each"](like)
    nothing_hidden = [tied.rivals.before, tied.rivals.before]
    assert squared_distances(nothing_hidden, drive)[0, 1] < 0.0
    assert recorded_distances([tied.level - tied.rivals.cost])[0, 1] == pytest.approx(2.0 * (tied.level - tied.rivals.cost))


def test_laps_can_be_held_out_by_name(tied):
    sessions = tied.rivals.before.problem.sessions
    usual = split_laps(sessions)
    laps = [lap_name(s, b) for s in sessions for b in sorted(set(s.block.tolist())) if b in usual.held_out]
    by_name = split_laps(sessions, laps)
    assert (by_name.training, by_name.held_out) == (usual.training, usual.held_out)
    with pytest.raises(InputError):
        split_laps(sessions, [lap_name(s, b) for s in sessions for b in set(s.block.tolist())])


def test_a_series_of_the_recordings_is_unknown_in_another_drive(tied):
    facts, result_before = tied.rivals.before.problem.base.facts, tied.rivals.before
    shape = [np.ones(len(s)) for s in result_before.problem.sessions]
    watched = ResidualPattern("spells", "for a while", shape, facts.weight * facts.radius)
    with_watched = fit(result_before.problem, [watched], result_before.estimates, result_before.noises)
    drive = menu(facts.weight, FASTEST_MPS)["drive at one speed with three loads, five minutes each"](
        result_before.problem.sessions[0]
    )
    assert np.isfinite(squared_distances([with_watched, result_before], drive)).all()

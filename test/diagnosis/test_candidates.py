# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gain of a candidate, and what a round of the search tells, on constructed candidates."""

import math
from dataclasses import FrozenInstanceError, replace
from types import SimpleNamespace

import numpy as np
import pytest

from trackres_ros.diagnosis.base.patterns import ByPlace, ResidualPattern
from trackres_ros.diagnosis.empirical.term import CLOCK, FORM, NAME, Round, Term, rms, spurious_gain, term_of_fit
from trackres_ros.diagnosis.report.content import why as why_of
from trackres_ros.effects.learned import SPEED, Curve

SAMPLES = 1000
COST = 3.0  # logarithm of the number of candidates


def candidate(name="x", level=10.0, share=0.1, effect=None):
    return Term(effect or SimpleNamespace(name=name), None, gain=level, evidence=level, share=share, level=level)


def fitted(torque=100.0, added=0.0, log_likelihood=0.0, log_evidence=0.0, dc_gain=0.5, std=2.0):
    mask = np.arange(SAMPLES) >= 100  # what is not used is far off, and must not count
    session = SimpleNamespace(torque=np.where(mask, torque, 1e9))
    return SimpleNamespace(
        problem=SimpleNamespace(sessions=(session,), masks=(mask,)),
        contribution=lambda name: [np.where(mask, added, 1e9)],
        log_likelihood=log_likelihood,
        log_evidence=log_evidence,
        noise=SimpleNamespace(dc_gain=dc_gain, std=std),
    )


@pytest.mark.parametrize(
    ("torque", "added", "share"), [(100.0, 5.0, 0.05), (1e-3, 1e-4, 0.1), (1e-3, 2e-3, 2.0), (0.0, 0.0, 0.0)]
)
def test_the_share_is_relative_to_the_measured_torque(torque, added, share):
    assert term_of_fit(fitted(torque), fitted(torque, added), SimpleNamespace(name="a")).share == pytest.approx(share)


def test_a_gain_is_over_the_fit_without_and_its_evidence_costs():
    result_before, result_after = (
        fitted(log_likelihood=-50.0, log_evidence=-60.0),
        fitted(log_likelihood=-40.0, log_evidence=-53.0),
    )
    item = term_of_fit(result_before, result_after, SimpleNamespace(name="a"), 3.0)
    assert (item.gain, item.evidence) == (10.0, 4.0)
    assert math.isnan(item.level)  # no lap has judged it


def test_the_root_mean_square_is_of_what_counts():
    result = SimpleNamespace(problem=SimpleNamespace(masks=[np.array([True, True, False]), np.array([True, True])]))
    assert rms([np.array([3.0, np.nan, 99.0]), np.array([4.0, 5.0])], result) == pytest.approx(math.sqrt(50.0 / 3.0))


def test_the_models_own_error_gains_more_in_long_quiet_drives():
    total = spurious_gain(fitted())
    half = fitted()
    half.problem.masks = (half.problem.masks[0] & (np.arange(SAMPLES) % 2 == 0),)
    assert spurious_gain(half) == pytest.approx(0.5 * total)
    assert spurious_gain(fitted(std=4.0)) == pytest.approx(0.25 * total)
    assert spurious_gain(fitted(dc_gain=1.0)) == pytest.approx(4.0 * total)
    assert spurious_gain(fitted(torque=200.0)) == pytest.approx(4.0 * total)


CURVE = Curve(SPEED, [1.0, 5.0])
SERIES = ResidualPattern("spells", "of a test", [np.ones(5)], 1e4)
PLACE = ByPlace("place", "of a test", [np.ones(5)], 1e4, None, 1.0)


@pytest.mark.parametrize(("effect", "kind"), [(None, NAME), (CURVE, FORM), (PLACE, FORM), (SERIES, CLOCK)])
def test_a_name_goes_before_a_form_and_a_form_before_the_clock(effect, kind):
    item = candidate("x" if effect is None else effect.name, effect=effect)
    assert (item.kind, item.is_name) == (kind, kind == NAME)
    assert NAME < FORM < CLOCK


def test_the_hint_is_the_best_name_beyond_chance():
    def hint(candidates):
        return Round(None, None, tuple(candidates), COST).hint

    several = [candidate("a", 4.0), candidate("b", 6.0), candidate("c", COST)]
    assert hint(several) == "b"
    assert hint(several[2:]) == ""
    assert hint(()) == ""
    assert hint([candidate("small", 9.0, share=0.00499), candidate("a", 4.0, share=0.005)]) == "a"
    assert hint([candidate(CURVE.name, 9.0, effect=CURVE), *several]) == "b"  # a form is no name
    assert hint([candidate("unjudged", math.nan)]) == ""


def test_each_candidate_says_why_it_was_not_chosen():
    def why(c, chosen=None, **given):
        return why_of(c, COST, chosen if chosen is None or chosen is c else replace(chosen, **given))

    best = candidate("best", 20.0)
    assert why(best, best) == "chosen"
    assert why(candidate("tied", 1.0), best, members=("best", "tied")) == "not distinguishable from best here"
    assert "by chance" in why(candidate("weak", COST), best)
    assert "by chance" not in why(candidate("weak", COST + 0.1), best)
    assert why(candidate("small", 9.0, share=0.001), best) == "adds only 0.1 % of the torque"
    assert why(candidate("far", 18.0), best) == "7 times less likely than best"
    assert "laps left out in turn decide for best" in why(candidate("near", 19.5), best, worse=("near",))
    assert "bends to the data" in why(candidate(CURVE.name, 19.5, effect=CURVE), best)


def test_what_was_found_cannot_be_changed_afterwards():
    for result, attribute in ((candidate(), "gain"), (Round(None, None, ()), "cost")):
        with pytest.raises(FrozenInstanceError):
            setattr(result, attribute, None)

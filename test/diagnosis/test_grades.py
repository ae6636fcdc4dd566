# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What laps left out say of a term, on errors that are given: nothing is simulated."""

from types import SimpleNamespace

import pytest

from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.empirical.term import Term, displaced_parameters, on_bounds
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, Improvement
from trackres_ros.effects.effect import Active, Parameter

SURE = Improvement(100.0, 90.0, 5.0, 15.0)
UNSURE = Improvement(100.0, 95.0, -5.0, 15.0)
WORSE = Improvement(100.0, 110.0, -15.0, -5.0)


def fitted(rolling=1.0):
    """A fit that rolls so, of a file whose value is 1 within 0.5."""
    rolls = BaseParameter("rolling", "1", 1.0, 0.5, 0.0, 2.0)
    problem = SimpleNamespace(base=SimpleNamespace(parameters=(rolls,)))
    return SimpleNamespace(base_values={"rolling": rolling}, problem=problem)


@pytest.mark.parametrize("why", ["", "on_bounds", "faults"])
def test_a_doubtful_term_is_at_best_suspected(why):
    doubt = {why: ("size",)} if why else {}
    graded = [Term(None, None, improvement=improvement, **doubt) for improvement in (SURE, UNSURE, WORSE)]
    assert [g.grade for g in graded] == [SUSPECTED if why else CONFIRMED, SUSPECTED, REFUTED]
    assert [g.confirmed for g in graded] == [not why, False, False]


@pytest.mark.parametrize(
    ("value", "given", "bounds"),
    [
        (5.0, {}, ()),
        (10.0, {}, ("size",)),
        (-10.0, {}, ("size",)),
        (9.98, {}, ("size",)),  # within a thousandth of the span
        (9.97, {}, ()),
        (-9.98, {}, ("size",)),
        (-9.97, {}, ()),
        (0.0, {"low": 0.0}, ()),  # no effect at all is no bound of what is plausible
        (10.0, {"low": 0.0}, ("size",)),
        (10.0, {"fitted": False}, ()),
        (1.0 + 1e-3, {"low": 1.0, "high": 2.0}, ("size",)),
        (1.0 + 3e-3, {"low": 1.0, "high": 2.0}, ()),
        (1.0, {"low": 1.0, "high": 2.0, "off": 1.0}, ()),
    ],
)
def test_a_value_within_a_thousandth_of_its_span_is_on_a_bound(value, given, bounds):
    size = Parameter("size", "Nm", **{"low": -10.0, "high": 10.0, "start": 3.0, "text": "of it", "off": 0.0, **given})
    assert on_bounds(Active(SimpleNamespace(name="a", parameters=(size,)), {"size": value})) == bounds


def test_what_displaces_is_refuted_whatever_it_improves():
    for improvement in (SURE, UNSURE, WORSE):
        graded = Term(None, None, improvement=improvement, displaces=("rolling",))
        assert (graded.grade, graded.confirmed) == (REFUTED, False)


@pytest.mark.parametrize(("with_term", "without_term", "takes"), [
    (0.0, 1.0, True), (2.0, 1.0, True), (0.001, 1.0, True), (1.999, 1.0, True),
    (0.003, 1.0, False), (1.997, 1.0, False), (0.0, 0.0, False), (0.0, 0.002, False),
])  # fmt: skip
def test_a_term_displaces_a_value_that_it_drives_to_its_bound(with_term, without_term, takes):
    little = Improvement(100.0, 92.0, 5.0, 11.0)
    assert displaced_parameters(little, fitted(with_term), fitted(without_term)) == (("rolling",) if takes else ())


@pytest.mark.parametrize(("error", "takes"), [(90.1, True), (89.9, False), (50.0, False)])
def test_a_term_that_improves_laps_much_displaces_nothing(error, takes):
    assert bool(displaced_parameters(Improvement(100.0, error, 1.0, 50.0), fitted(0.0), fitted(1.0))) == takes

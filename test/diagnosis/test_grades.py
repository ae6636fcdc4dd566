# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What held-out laps say of each effect, on fits whose errors are given: nothing is simulated."""

from types import SimpleNamespace

import numpy as np
import pytest

from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.selection import confirm as confirming
from trackres_ros.diagnosis.selection.confirm import Graded, confirm, leave_unconfirmed
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, Improvement
from trackres_ros.effects.effect import Parameter

SURE = Improvement(100.0, 90.0, 5.0, 15.0)
UNSURE = Improvement(100.0, 95.0, -5.0, 15.0)
WORSE = Improvement(100.0, 110.0, -15.0, -5.0)


def effect(name, value=5.0, **given):
    """An effect of one parameter between -10 and 10, or of such as are given, and the value it was fitted to."""
    size = Parameter("size", "Nm", **{"low": -10.0, "high": 10.0, "start": 3.0, "text": "of it", "off": 0.0, **given})
    return SimpleNamespace(effect=SimpleNamespace(name=name, parameters=(size,)), values={"size": value})


class Fitted:
    """A fit with some effects, and what it leaves of the held-out laps."""

    def __init__(self, laps, effects):
        self.laps, self.effects = laps, tuple(effects)
        bearing = float(len(self.effects))
        self.base_values = {"bearing": bearing, "rolling": self.laps.rolling.get(frozenset(a.effect.name for a in effects), 1.0)}
        self.problem = SimpleNamespace(base=SimpleNamespace(parameters=(BaseParameter("rolling", "1", 1.0, 0.5, 0.0, 2.0),)))

    @property
    def error(self):
        return self.laps.errors[frozenset(a.effect.name for a in self.effects)]


class Laps:
    """Held-out laps on which the mean error of a model is said by the effects in it [Nm], and how it rolls beside them."""

    def __init__(self, errors, spread=0.5, rolling=None):
        self.errors, self.spread = {frozenset(names): error for names, error in errors.items()}, spread
        self.rolling = {frozenset(names): value for names, value in (rolling or {}).items()}

    def improvement_of(self, before, after):
        gain = before.error - after.error
        return Improvement(before.error, after.error, gain - self.spread, gain + self.spread)


@pytest.fixture(autouse=True)
def fitted_again(monkeypatch):
    """Fits without some effects are those of the same laps."""

    def without(fit, names):
        return Fitted(fit.laps, [a for a in fit.effects if a.effect.name not in names])

    monkeypatch.setattr(confirming, "with_levels", without)


def fits(errors, *effects, **given):
    laps = Laps(errors, **given)
    return Fitted(laps, effects), Fitted(laps, ()), laps


# Grades


@pytest.mark.parametrize(
    ("after", "low", "high", "likelier", "grade"),
    [
        (90.0, 1.0, 19.0, -np.inf, CONFIRMED),
        (90.0, -1.0, 21.0, 0.1, CONFIRMED),
        (90.0, -1.0, 21.0, -0.1, SUSPECTED),
        (90.0, 0.0, 20.0, 0.0, SUSPECTED),
        (100.0, 1.0, 2.0, 1.0, CONFIRMED),
        (100.5, 1.0, 2.0, 1.0, SUSPECTED),  # likelier, but the mean error does not fall
        (101.0, -2.0, 0.0, 1.0, SUSPECTED),
        (101.1, -2.0, 1.0, 1.0, REFUTED),
        (100.5, -2.0, -0.1, 1.0, REFUTED),
    ],
)
def test_a_grade_is_what_the_mean_error_and_its_interval_say(after, low, high, likelier, grade):
    assert Improvement(100.0, after, low, high, likelier).grade == grade


def test_on_a_bound_what_is_confirmed_is_suspected_and_what_is_refuted_stays_so():
    for on_bounds in ((), ("size",)):
        graded = [Graded("x", improvement, on_bounds).grade for improvement in (SURE, UNSURE, WORSE)]
        assert graded == [SUSPECTED if on_bounds else CONFIRMED, SUSPECTED, REFUTED]


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
def test_a_parameter_lies_on_a_bound_within_a_thousandth_of_its_span(value, given, bounds):
    final, refitted, laps = fits({(): 100.0, ("a",): 80.0}, effect("a", value, **given))
    _, graded, _ = confirm(final, refitted, laps)
    assert graded["a"].on_bounds == bounds
    assert graded["a"].grade == (SUSPECTED if bounds else CONFIRMED)


# What is left out


def test_effects_that_make_laps_better_stay_each_graded_by_the_fit_without_it():
    errors = {(): 100.0, ("a",): 80.0, ("b",): 95.0, ("a", "b"): 70.0}
    final, refitted, laps = fits(errors, effect("a"), effect("b"))
    kept, graded, refuted = confirm(final, refitted, laps)
    assert kept is final
    assert refuted == ()
    assert {name: (g.name, g.improvement.before, g.improvement.after) for name, g in graded.items()} == {
        "a": ("a", 95.0, 70.0),
        "b": ("b", 80.0, 70.0),
    }


def test_one_effect_alone_is_graded_over_the_fit_that_has_none():
    final, _, laps = fits({(): 100.0, ("a",): 80.0}, effect("a"))
    _, graded, _ = confirm(final, Fitted(Laps({(): 130.0}), ()), laps)
    assert graded["a"].improvement.before == 130.0


def test_the_worst_is_left_out_first_and_the_others_are_graded_anew():
    errors = {
        (): 100.0, ("a",): 80.0, ("b",): 99.0, ("c",): 120.0,
        ("a", "b"): 70.0, ("a", "c"): 95.0, ("b", "c"): 104.0, ("a", "b", "c"): 84.0,
    }  # fmt: skip
    # `c` makes the laps worse beside `a` and `b`, and more so than anything else.
    final, refitted, laps = fits(errors, *map(effect, "abc"))
    kept, graded, refuted = confirm(final, refitted, laps)
    assert [a.effect.name for a in kept.effects] == ["a", "b"]
    assert [(g.name, g.improvement.before, g.improvement.after) for g in refuted] == [("c", 70.0, 84.0)]
    assert {name: g.improvement.before for name, g in graded.items()} == {"a": 99.0, "b": 80.0}


def test_of_two_that_are_refuted_only_the_worse_goes_if_the_other_is_sound_without_it():
    errors = {(): 100.0, ("a",): 90.0, ("b",): 95.0, ("a", "b"): 98.0}
    final, refitted, laps = fits(errors, effect("a"), effect("b"))
    kept, graded, refuted = confirm(final, refitted, laps)
    assert ([a.effect.name for a in kept.effects], list(graded), [g.name for g in refuted]) == (["a"], ["a"], ["b"])


@pytest.mark.parametrize(("beside", "without", "goes"), [
    (0.0, 1.0, True), (2.0, 1.0, True), (0.001, 1.0, True), (1.999, 1.0, True),
    (0.003, 1.0, False), (1.997, 1.0, False), (0.0, 0.0, False), (0.0, 0.002, False),
])  # fmt: skip
def test_what_takes_the_place_of_what_the_vehicle_has_goes_though_laps_are_a_little_better_with_it(beside, without, goes):
    errors = {(): 100.0, ("a",): 92.0, ("b",): 60.0, ("a", "b"): 56.0}
    rolling = {("a", "b"): beside, ("a",): beside, ("b",): without, (): without}
    final, refitted, laps = fits(errors, effect("a"), effect("b"), rolling=rolling)
    kept, graded, refuted = confirm(final, refitted, laps)
    assert [g.name for g in refuted] == (["a"] if goes else [])
    assert [a.effect.name for a in kept.effects] == (["b"] if goes else ["a", "b"])
    assert {g.grade for g in graded.values()} == {CONFIRMED}
    assert all((g.displaces, g.grade) == (("rolling",), REFUTED) for g in refuted)


@pytest.mark.parametrize(("error", "goes"), [(90.1, True), (89.9, False), (50.0, False)])
def test_what_makes_laps_much_better_stays_wherever_the_base_goes(error, goes):
    final, refitted, laps = fits({(): 100.0, ("a",): error}, effect("a"), rolling={("a",): 0.0})
    kept, _, refuted = confirm(final, refitted, laps)
    assert [g.name for g in refuted] == (["a"] if goes else [])
    assert (kept is final) == (not goes)


def test_effects_that_are_worse_together_than_none_go_though_each_helps_the_other():
    errors = {(): 100.0, ("a",): 150.0, ("b",): 140.0, ("a", "b"): 120.0}
    final, refitted, laps = fits(errors, effect("a"), effect("b"))
    kept, graded, refuted = confirm(final, refitted, laps)
    assert kept is refitted
    assert graded == {}
    assert [g.name for g in refuted] == ["a", "b"]  # `a` helps by 20 Nm where `b` helps by 30


def test_without_an_effect_there_is_nothing_to_grade():
    final, refitted, laps = fits({(): 100.0})
    assert confirm(final, refitted, laps) == (final, {}, ())


def test_what_helps_only_beside_others_is_suspected_while_all_of_it_gains_nothing():
    errors = {(): 100.0, ("a",): 150.0, ("b",): 140.0, ("a", "b"): 99.8}  # two terms that cancel each other
    final, refitted, laps = fits(errors, effect("a"), effect("b"))
    kept, graded, refuted = confirm(final, refitted, laps)
    assert (kept, refuted) == (final, ())
    assert {(g.improvement.grade, g.together.grade, g.grade) for g in graded.values()} == {(CONFIRMED, SUSPECTED, SUSPECTED)}


@pytest.mark.parametrize(
    ("errors", "stay", "left"),
    [
        ({(): 100.0, ("a",): 60.0, ("b",): 99.9, ("a", "b"): 59.9}, ["a"], ["b"]),
        ({(): 100.0, ("a",): 60.0, ("b",): 70.0, ("a", "b"): 50.0}, ["a", "b"], []),
        ({(): 100.0, ("a",): 99.9, ("b",): 99.9, ("a", "b"): 99.8}, ["a", "b"], []),  # nothing is confirmed
        ({(): 100.0, ("a",): 99.9}, ["a"], []),
    ],
)
def test_what_is_only_suspected_goes_beside_what_is_confirmed(errors, stay, left):
    final, refitted, laps = fits(errors, *map(effect, max(errors, key=len)))
    final, graded, _ = confirm(final, refitted, laps)
    kept, after, gone = leave_unconfirmed(final, graded, refitted, laps)
    assert ([a.effect.name for a in kept.effects], list(after), [g.name for g in gone]) == (stay, stay, left)
    assert len({g.grade for g in after.values()}) == 1
    assert {g.improvement.after for g in after.values()} == {errors[tuple(stay)]}  # of the fit that is left
    assert (kept is final) == (not left)


def test_of_several_that_are_suspected_the_one_that_gains_least_goes_first():
    errors = {
        (): 100.0, ("a",): 60.0, ("b",): 99.0, ("c",): 99.0, ("b", "c"): 90.0,
        ("a", "b"): 58.0, ("a", "c"): 59.9, ("a", "b", "c"): 57.9,
    }  # fmt: skip
    final, refitted, laps = fits(errors, *map(effect, "abc"))
    kept, _, gone = leave_unconfirmed(final, confirm(final, refitted, laps)[1], refitted, laps)
    assert ([a.effect.name for a in kept.effects], [g.name for g in gone]) == (["a", "b"], ["c"])

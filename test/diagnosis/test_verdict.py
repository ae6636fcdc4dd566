# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From findings to one of five verdicts, its grade, and the permitted files: on constructed findings."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.diagnosis.base.base import BaseParameter
from trackres_ros.diagnosis.base.instrument import PRIOR_STDS
from trackres_ros.diagnosis.base.patterns import ResidualPattern
from trackres_ros.diagnosis.empirical.sentences import describe_form, turning_points
from trackres_ros.diagnosis.empirical.term import FOLLOWED, FROM, Form, Round, Term, by_improvement
from trackres_ros.diagnosis.findings.verdict import LARGE_SLOW_SHARE, LEFT_SHARE, Changed, Findings, Verdict, judge
from trackres_ros.diagnosis.findings.wording import MOST_WORDS, assumed_sensor, likelier_text
from trackres_ros.diagnosis.pipeline import credible_names
from trackres_ros.diagnosis.prepare.checks import pool_notes, speed_off
from trackres_ros.diagnosis.prepare.session import SensorFinding
from trackres_ros.diagnosis.report.content import why
from trackres_ros.diagnosis.selection.as_used import moved_parameters
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, HeldOut, Improvement
from trackres_ros.diagnosis.selection.locate import Bin, Location, RegimeMap, SlowResidual, only_later
from trackres_ros.effects import catalogue
from trackres_ros.effects.effect import Active, Parameter
from trackres_ros.effects.learned import CURVATURE, DRIVING_TORQUE, LOAD, SPEED, STEP, Corner, Curve

BETTER = Improvement(100.0, 80.0, 15.0, 25.0)
LESS_LIKELY = Improvement(326.0, 310.0, 4.9, 27.0, likelihood_bound=-30.0, level_gain=-2.0)  # confirmed but for its level score
UNSURE = Improvement(100.0, 95.0, -5.0, 15.0)
WORSE = Improvement(100.0, 120.0, -30.0, -10.0)
EVERYWHERE = Location("speed", "m/s", 0.0, 10.0, 0.0, 10.0, 0.0, 100.0, 1.0)
SEEN = "the vehicle needs about 90 Nm more than the model"
SIZE = Parameter("size", "Nm", 0.0, 500.0, 100.0, "of it", off=0.0)
QUIET, NOISY = SlowResidual(1.0, LARGE_SLOW_SHARE / 2, math.nan), SlowResidual(40.0, 0.08, 0.012)


def candidate(name, worth=20.0, effect=None):
    effect = effect or SimpleNamespace(name=name)
    return Term(effect, None, gain=worth + 2.0, evidence=worth, share=0.1, level=worth)


def graded(name, improvement, faults=(), **more):
    return replace(candidate(name), improvement=improvement, faults=faults, **more)


def found(name="scrub", members=None, improvement=BETTER, on_bounds=(), adds=100.0, rivals=(), worse=()):
    members = members or (name,)
    effect = SimpleNamespace(name=name, text=f"{name} is missing", acts_on="torque", parameters=(SIZE,))
    return replace(
        candidate(name, effect=effect), rivals=Round(None, None, tuple(rivals), 5.0), members=members, worse=worse,
        weights=dict.fromkeys(members, 1.0 / len(members)), improvement=improvement, on_bounds=on_bounds, values={"size": 120.0},
        adds=[np.full(100, adds)], location=EVERYWHERE, seen=SEEN,
    )  # fmt: skip


def regimes(*means, p=0.001):
    return RegimeMap(tuple(Bin("speed", i, i + 1.0, mean, "m/s", 50, p) for i, mean in enumerate(means)), p, 500)


def worth(refit=BETTER, r2=0.9, with_effects=60.0):
    mae = {"nominal": 100.0, "refitted": 80.0, "with_effects": with_effects}
    item = {"nominal": r2, "refitted": r2 + 0.01, "with_effects": r2 + 0.02}
    return HeldOut(("a: 1",), mae, item, mae, {}, refit, BETTER)


def refitted(*moved, std=0.1):
    parameters = tuple(BaseParameter(f"q{i}", "1", 1.0, std, 0.0, 3.0) for i in range(len(moved)))
    values = {q.name: 1.0 + std * m for q, m in zip(parameters, moved, strict=True)}
    base = SimpleNamespace(parameters=parameters, noun="vehicle", file="vehicle file", rolls=True)
    return SimpleNamespace(base_values=values, problem=SimpleNamespace(base=base))


def said(found=(), terms=(), base=None, at_end=None, slow=QUIET, hint="", held=None, drift=None, changed=(), **more):
    verdict = judge(
        Findings(
            terms=[*found, *terms], unconfirmed=more.pop("unconfirmed", ()), refitted=base or refitted(),
            at_end=at_end or regimes(), left_over=slow, hint=hint, held_out=held or worth(), drift=drift, changed=changed, **more,
        )
    )  # fmt: skip
    for sentence in re.split(r"(?<=\.) ", verdict.sentence):
        assert 2 < len(sentence.split()) <= MOST_WORDS, sentence
        assert sentence.endswith(".")
        assert not re.match("an? |the ", sentence), sentence
    assert ".." not in verdict.sentence
    return verdict


# Nothing found


def test_an_error_with_an_assumed_sensor_is_said_without_it_too():
    gain = Parameter("error", "1", -0.015, 0.015, 0.005 / PRIOR_STDS, "relative", off=0.0)
    offset = Parameter("offset", "Nm", -45.0, 45.0, 15.0 / PRIOR_STDS, "", off=0.0)
    pair = "gain 0.1 %, offset 2 Nm"
    for gain_at, offset_at, assumed in (
        (0.015, 2.0, "gain 1.5 %, the most it assumes"),
        (0.001, -20.0, "offset -20 Nm"),
        (0.001, 2.0, pair),
    ):
        values = (("torque_gain", gain, gain_at), ("torque_offset", offset, offset_at))
        acting = [Active(SimpleNamespace(name=name, parameters=(q,)), {q.name: x}) for name, q, x in values]
        for fit, terms in (("with the effects", [found()]), ("of the re-fit", [])):
            sensor = assumed_sensor(acting, replace(worth(), without_sensor=95.0), fit)
            sentence = f"An assumed torque sensor error ({assumed}) lowers the mean error {fit} from 95 to 60 Nm."
            assert sentence in said(terms, sensor=sensor).sentence
        assert not assumed_sensor(acting, worth(), fit)
        only = said(held=worth(Improvement(100.0, 99.5, 0.1, 0.9)), sensor=sensor, changed=(BEARING,))
        assert only.sentence.startswith("No mismatch beyond noise and an error of the torque sensor.")
        assert (sentence in only.sentence, only.changed) == (True, ())


def test_nothing_beyond_noise():
    verdict = said(held=worth(UNSURE))
    assert (verdict.status, verdict.grade) == ("none", CONFIRMED)
    assert "No mismatch beyond noise" in verdict.sentence
    assert "100 Nm" in verdict.sentence
    assert "95 Nm" in verdict.sentence
    assert not verdict.names


@pytest.mark.parametrize(
    ("improvement", "grade", "word"),
    [(BETTER, CONFIRMED, "a re-fit of all"), (UNSURE, SUSPECTED, "do not confirm"), (WORSE, REFUTED, "reject")],
)
def test_moved_parameters_are_no_physics_and_graded_by_the_refit(improvement, grade, word):
    verdict = said(base=refitted(2.0, 1.0), held=worth(improvement))
    assert (verdict.status, verdict.grade) == ("none", grade)
    assert "No physics is missing" in verdict.sentence
    assert word in verdict.sentence
    if grade != CONFIRMED:
        assert "q0 1 -> 1.2" in verdict.sentence
        assert "q1" not in verdict.sentence


BEARING = Changed("bearing_friction", "1", 0.01, 0.0114, 0.0111, 0.0117, 80.0)
OFFSET = Changed("grade", "1", 0.0, -0.002, -0.003, -0.001, 12.0)


def test_a_refit_that_gains_names_the_changed_values():
    verdict = said(changed=(BEARING, OFFSET))
    assert (verdict.status, verdict.grade, verdict.changed) == ("none", CONFIRMED, (BEARING, OFFSET))
    assert "bearing_friction is 14 % higher, 0.01140 [0.01110, 0.01170] instead of 0.01000" in verdict.sentence
    assert "grade is 0.002 lower" in verdict.sentence
    assert "falls from 100 to 80 Nm" in verdict.sentence
    assert said().sentence.startswith("No physics is missing. No value of the vehicle file is surely off, but a re-fit")
    assert "were off" not in said().sentence
    at_end = said(changed=(replace(BEARING, at_bound=True),)).sentence
    assert "bearing_friction is at the high end of its range, 0.01140 instead of 0.01000." in at_end


@pytest.mark.parametrize("gain", [0.0, 0.5])
def test_a_refit_that_hardly_gains_changes_no_verdict(gain):
    verdict = said(held=worth(Improvement(100.0, 100.0 - gain, 0.0, 1.0, likelihood_bound=5.0)), changed=(BEARING,))
    assert verdict.changed == ()
    assert "No mismatch beyond noise" in verdict.sentence


def test_a_parameter_outside_its_range_has_moved_furthest_first():
    moved = moved_parameters(refitted(1.6, -3.0, 1.5, -1.4))
    assert [(q.name, value) for q, value in moved] == [("q1", pytest.approx(0.7)), ("q0", pytest.approx(1.16))]


def test_several_values_far_out_of_range_reject_the_vehicle_file():
    verdict = said(base=refitted(8.0, -6.0, 1.0), slow=NOISY)
    assert (verdict.status, verdict.grade) == ("unexplained", SUSPECTED)
    assert verdict.seen == "The vehicle file does not fit this vehicle"
    assert "q0 would be 1.8" in verdict.sentence
    assert "q1 would be 0.4" in verdict.sentence
    assert "q2" not in verdict.sentence
    assert said(base=refitted(8.0, 1.0)).status == "none"  # one value may be wrong
    by_load = said(base=refitted(8.0, -6.0), by_load="hinge_above_load")
    assert by_load.sentence.startswith(
        "The recordings differ in their load, and a torque that follows it would explain them (hin"
    )
    assert by_load.seen in by_load.sentence
    assert "The vehicle file does not fit this vehicle." in by_load.sentence


def test_a_value_as_far_as_is_plausible_is_far_out():
    base = refitted(8.0, -4.0)
    second = base.problem.base.parameters[1]
    for low, far in ((second.low, False), (base.base_values["q1"], True)):
        base.problem.base.parameters = (base.problem.base.parameters[0], replace(second, low=low, by_file=(0.8, 1.2)))
        assert ("q1 would be 0.6, but the file allows 0.8 to 1.2" in said(base=base).sentence) == far


def test_a_refit_no_command_accepts_does_not_fit_the_vehicle():
    base = refitted(3.0, 1.0)
    base.problem.base.parameters = tuple(replace(q, by_file=(0.8, 1.2)) for q in base.problem.base.parameters)
    verdict = said(base=base, unusable="a belt that settles at 352 degC", changed=(BEARING,))
    assert (verdict.status, verdict.seen, verdict.changed) == ("unexplained", "The vehicle file does not fit this vehicle", ())
    assert "q0 would be 1.3, but the file allows 0.8 to 1.2" in verdict.sentence
    assert "q1" not in verdict.sentence
    assert "a belt that settles at 352 degC" in verdict.sentence
    assert "The mean error" not in verdict.sentence


def test_hold_out_laps_that_differ_plainly_more_are_unexplained():
    verdict = said(later=(50.0, 200.0))
    assert (verdict.status, verdict.grade) == ("unexplained", SUSPECTED)
    assert "The hold-out laps differ from the re-fitted model by 200 Nm, the fitted laps by 50 Nm" in verdict.sentence


@pytest.mark.parametrize(("unused", "differs"), [(19.0, False), (21.0, True)])
def test_hold_out_laps_differ_from_twice_the_fitted_error(unused, differs):
    session, expectation = SimpleNamespace(torque=np.full(4, 100.0)), SimpleNamespace(torque=np.array([90.0, 110.0, 90.0, 110.0]))
    problem = SimpleNamespace(sessions=(session,), masks=(np.ones(4, dtype=bool),))
    base = SimpleNamespace(predicted=(expectation,), problem=problem)
    assert (only_later(base, unused) is not None) == differs


def test_a_parameter_without_a_prior_cannot_have_moved():
    free = refitted(9.0)
    (q,) = free.problem.base.parameters
    free.problem.base.parameters = (replace(q, std=np.inf),)
    assert moved_parameters(free) == []


def test_a_hint_is_told_where_nothing_was_named_only():
    assert "headwind would fit, but the model's own error can look the same." in said(hint="headwind").sentence
    assert "headwind" in said(hint="headwind", base=refitted(3.0)).sentence
    assert "headwind" not in said([found()], hint="headwind").sentence


def test_a_residual_without_a_name_is_unexplained_at_its_largest():
    verdict = said(at_end=regimes(30.0, -70.0))
    assert (verdict.status, verdict.grade) == ("unexplained", SUSPECTED)
    assert verdict.sentence.startswith("At speed 1 to 2 m/s the vehicle needs 70 Nm less than the model.")
    assert verdict.seen == "At speed 1 to 2 m/s the vehicle needs 70 Nm less than the model"
    assert "At speed 0 to 1 m/s the vehicle needs 30 Nm more than the model." in said(at_end=regimes(30.0, -7.0)).sentence
    assert said(at_end=regimes(30.0, p=0.011)).status == "none"
    assert said(at_end=regimes(30.0, p=0.0099)).status == "unexplained"


def test_a_slow_residual_is_unexplained_where_nothing_was_named():
    verdict = said(slow=NOISY)
    assert (verdict.status, verdict.grade) == ("unexplained", SUSPECTED)
    assert "differs from the model by 40 Nm, 8 % of the torque" in verdict.sentence
    assert "An unrecorded slope of 1.2 % would do the same." in verdict.sentence
    assert "slope" not in said(slow=SlowResidual(40.0, 0.08, math.nan)).sentence
    assert said(slow=SlowResidual(9.0, LARGE_SLOW_SHARE, 0.0)).status == "none"


@pytest.mark.parametrize("left", [{"at_end": regimes(30.0)}, {"slow": NOISY}], ids=["bins", "slow"])
def test_a_refuted_term_is_named_and_the_unexplained_is_refuted(left):
    refuted = [graded("payne", WORSE)]
    verdict = said(unconfirmed=refuted, **left)
    assert (verdict.status, verdict.grade) == ("unexplained", REFUTED)
    assert "Laps left out in turn reject payne: it raises their mean error from 100 to 120 Nm." in verdict.sentence
    assert "payne (" not in said(unconfirmed=refuted, shares={"payne": 0.6, "none of these": 0.4}, **left).sentence
    none = said(unconfirmed=refuted)
    assert (none.status, none.grade) == ("none", CONFIRMED)
    assert "payne" in none.sentence


def test_a_dropped_term_is_reported_with_the_value_it_displaces():
    sentence = said(unconfirmed=[graded("torque_offset", BETTER, displaces=("rolling_coefficient",))]).sentence
    assert "drops torque_offset: it pushes rolling_coefficient to the end of its range." in sentence
    assert "reject" not in sentence


def test_terms_that_hardly_change_the_error_share_a_sentence():
    little = [
        graded(name, Improvement(100.0, result_after, -5.0, 5.0)) for name, result_after in (("payne", 99.5), ("mullins", 100.3))
    ]
    together = "Laps left out in turn do not confirm payne or mullins: their mean error changes by 0.5 Nm at most."
    assert together in said(unconfirmed=little).sentence
    assert "do not confirm payne: their mean error goes from 100 to 99.5 Nm" in said(unconfirmed=little[:1]).sentence


@pytest.mark.parametrize(
    ("dropped", "reason"),
    [
        (graded("payne", UNSURE), "do not confirm payne: their mean error goes from 100 to 95 Nm"),
        (
            graded("payne", LESS_LIKELY),
            "payne: their mean error falls from 326 to 310 Nm, but their likelihood falls too.",
        ),
        (graded("payne", BETTER, on_bounds=("height",)), "payne is at the limit of its plausible range (height)"),
        (graded("payne", BETTER, ("hardly reduces the error",)), "payne hardly reduces the error."),
    ],
)
def test_an_unconfirmed_term_is_dropped_for_its_own_reason(dropped, reason):
    by_laps = dropped.improvement.grade != CONFIRMED
    sentence = said(unconfirmed=[dropped]).sentence
    assert reason in sentence
    assert ("do not confirm" in sentence) == by_laps
    for others in ([], [graded("mullins", WORSE)]):
        assert said(unconfirmed=[dropped, *others], at_end=regimes(30.0)).grade == SUSPECTED
    rival = candidate("payne", worth=19.5).graded_as(dropped)
    choice = found(rivals=(rival,))
    for text in (said([choice]).sentence, why(rival, 5.0, choice), why(rival, 5.0)):
        assert ("do not confirm it" in text) == by_laps
        assert dropped.fault in text


# Something found


def test_a_name_that_laps_confirm_is_named():
    verdict = said([found()])
    assert (verdict.status, verdict.grade, verdict.names) == ("named", CONFIRMED, True)
    assert verdict.sentence == (
        f"T{SEEN[1:]}. The cause is scrub. Scrub is missing. Its values with 95 % intervals: size 120 Nm. "
        "The mean error on hold-out laps falls from 80 to 60 Nm."
    )


def test_the_term_that_removes_most_error_comes_first():
    much = Improvement(400.0, 60.0, 300.0, 380.0)
    sentence = said([found("scrub"), found("grade", improvement=much)]).sentence
    assert sentence.index("The cause is grade") < sentence.index("The cause is scrub")
    assert [f.name for f in by_improvement([found("a", improvement=UNSURE), found("b", improvement=BETTER)])] == ["b", "a"]


def test_the_sentence_gives_the_size_of_the_term_itself():
    one_way = Location("speed", "m/s", 4.0, 10.0, 0.0, 10.0, 0.0, 384.0, 1.0, 300.0, 320.0)
    assert one_way.size("vehicle") == "the vehicle needs about 300 Nm more than the model"
    assert "about 300 Nm less" in replace(one_way, mean=-300.0).size("machine")
    assert "from 40 Nm less to 63 Nm more" in replace(one_way, smallest=-40.0, largest=63.0).size("vehicle")
    assert "root mean square of 320 Nm" in replace(one_way, follows=0.0).size("vehicle")


def test_a_place_that_two_variables_give_names_both():
    turning = found()
    turning = replace(turning, place="above 4 m/s of speed", location=replace(EVERYWHERE, alike=("yaw rate",)))
    assert "These recordings cannot separate speed and yaw rate." in said([turning]).sentence
    assert "cannot separate" not in said([found()]).sentence
    forms = [Corner(code, STEP) for code in (SPEED, LOAD, CURVATURE)]
    own, *others = (replace(term(), effect=form) for form in forms)
    own = replace(own, rivals=Round(None, None, tuple(others)), members=tuple(form.name for form in forms))
    assert "cannot separate speed, load and curvature." in said(terms=[own]).sentence


def test_an_edge_that_is_nothing_on_its_scale_is_zero():
    assert Location("acceleration", "m/s^2", 1.91e-7, 1.2, -1.1, 1.2, 0.0, 1.0, 1.0).text == "above 0 m/s^2 of acceleration"


def test_names_that_cannot_be_told_apart_are_one_of_a_class():
    verdict = said([found(members=("scrub", "cornering")), found("payne")])
    assert (verdict.status, verdict.grade, verdict.names) == ("one_of", CONFIRMED, True)
    assert "The cause is scrub (50 %) or cornering (50 %). These recordings cannot tell them apart." in verdict.sentence
    assert said([found(), found("payne")]).status == "named"


OFF_SPEED = speed_off({"a": -0.05, "b": -0.052, "c": -0.048})
AT_REST = SensorFinding("the torque is -161 Nm at rest; it", "The torque is -161 Nm at rest", "torque_offset", -161.0)


def test_a_second_sensor_speaks_on_a_class_with_its_error():
    class_of = found("torque_gain", members=("torque_gain", "speed_scale"))
    sentence = said([class_of], sensors=[OFF_SPEED]).sentence
    assert "The torque cannot tell them apart, but a second sensor is for speed_scale." in sentence
    others = found(members=("scrub", "cornering"))
    for silent in (said([class_of]), said([others], sensors=[OFF_SPEED])):
        assert "These recordings cannot tell them apart." in silent.sentence


@pytest.mark.parametrize("finding", [OFF_SPEED, AT_REST], ids=["speed", "offset"])
def test_no_verdict_contradicts_a_warning_on_a_sensor(finding):
    """Each verdict says what the warning says; none that nothing is wrong before it."""
    spells = unnamed("drift", "drift", "The residual drifts", "a zero", 40.0, BETTER)
    verdicts = [
        {}, {"held": worth(UNSURE)}, {"changed": (BEARING,)}, {"base": refitted(2.0, 1.0), "held": worth(WORSE)},
        {"found": [found()]}, {"found": [found("torque_offset")]}, {"terms": [term()]}, {"at_end": regimes(-70.0)},
        {"base": refitted(8.0, -6.0)}, {"slow": NOISY}, {"slow": NOISY, "drift": spells}, {"later": (50.0, 200.0)},
        {"found": [found()], "at_end": regimes(-500.0)}, {"terms": [term(improvement=UNSURE)]},
    ]  # fmt: skip
    for findings in verdicts:
        verdict, without = said(sensors=[finding], **findings), said(**findings)
        assert f"{finding.statement}." in verdict.sentence
        assert finding.startswith(f"{finding.statement[0].lower()}{finding.statement[1:]}") or finding.statement[1:] in finding
        assert (verdict.status, verdict.grade) == (without.status, without.grade)
        assert finding.statement not in without.sentence
        if verdict.status == "none":
            assert verdict.sentence.startswith(f"{finding.statement}. ")
            assert "No physics is missing" not in verdict.sentence
            assert "No mismatch" not in verdict.sentence


def test_one_warning_tells_all_recordings_with_a_wrong_speed():
    each = [speed_off({name: value}) for name, value in (("a", -0.05), ("b", -0.06), ("c", 0.04))]
    notes = pool_notes(["x: y", *each, "z"])
    assert [note for note in notes if note in ("x: y", "z")] == ["x: y", "z"]
    low, high = (note for note in notes if isinstance(note, SensorFinding))
    assert low == "a, b: the speed is 5.8 % more than the recorded distance implies: one of them is wrong"
    assert high == "c: the speed is 3.8 % less than the recorded distance implies: one of them is wrong"
    assert low.value == pytest.approx(-0.055)


def test_a_suspected_term_never_hides_a_confirmed_one():
    verdict = said([found(), found("payne", improvement=UNSURE)])
    assert (verdict.status, verdict.grade) == ("named", CONFIRMED)
    sure, _, unsure = verdict.sentence.partition("It may also be: ")
    assert "The cause is scrub" in sure
    assert "payne" not in sure
    assert unsure.startswith("payne. Laps left out in turn do not confirm payne: their mean error goes from 100 to 95 Nm")
    assert "do not confirm scrub" not in verdict.sentence
    assert verdict.may_be == (("payne", None),)


def test_a_suspected_effect_is_never_the_headline():
    """Where nothing is confirmed: where and by how much it differs, then what it may be."""
    for improvement in (UNSURE, replace(UNSURE, after=99.9)):
        alone = said([found(improvement=improvement)], at_end=regimes(-70.0))
        assert alone.sentence.startswith("At speed 0 to 1 m/s the vehicle needs 70 Nm less than the model. It may be: scrub.")
        assert (alone.status, alone.grade, alone.names) == ("unexplained", SUSPECTED, False)
    members = said([found(members=("scrub", "cornering"), improvement=UNSURE)])
    assert members.sentence.startswith(f"T{SEEN[1:]}. It may be: scrub (50 %), cornering (50 %).")
    slow = said([found(improvement=UNSURE)], slow=NOISY)
    assert slow.sentence.startswith("Averaged over 30 s, the measured torque differs")
    assert "It may be: scrub." in slow.sentence
    description = said(terms=[term(improvement=UNSURE)])
    assert description.sentence.startswith("The measured torque differs from the model by about 100 Nm, depending on")


def test_a_suspected_term_that_removes_little_is_only_listed():
    little = Improvement(100.0, 99.5, -5.0, 15.0)
    verdict = said([found(improvement=little)], changed=(BEARING,))
    assert (verdict.status, verdict.grade) == ("none", CONFIRMED)
    assert verdict.sentence.startswith("Laps left out in turn confirm no missing physics, but values of the vehicle file were")
    assert "It may also be: scrub." in verdict.sentence


def test_name_probabilities_are_listed_with_none_of_these_last():
    shares = {"payne": 0.25, "none of these": 0.35, "mullins": 0.36, "weak": 0.04}
    verdict = said([found("payne", improvement=UNSURE)], at_end=regimes(-70.0), shares=shares)
    assert "It may be: mullins (36 %), payne (25 %), none of these (35 %)." in verdict.sentence
    assert verdict.may_be == (("mullins", 0.36), ("payne", 0.25), ("none of these", 0.35))
    verdict = said([found("mullins"), found("payne", improvement=UNSURE)], shares=shares)
    assert "It may also be: payne (25 %), none of these (35 %)." in verdict.sentence
    assert said([found("mullins")], shares={"mullins": 0.97, "none of these": 0.03}).may_be == ()


def test_a_confirmed_term_that_removes_little_is_last_and_small():
    little = Improvement(80.0, 79.0, 0.5, 1.5)
    verdict = said([found("payne", improvement=little), found()])
    assert verdict.sentence.endswith("payne is confirmed but small: 1 Nm less error on laps left out in turn.")
    assert "The cause is payne" not in verdict.sentence
    unnamed = said([found()], terms=[term(improvement=little)])
    assert unnamed.sentence.endswith("A curve of the speed is confirmed but small: 1 Nm less error on laps left out in turn.")
    alone = said([found("payne", improvement=little)], held=worth(with_effects=79.0))
    assert (alone.status, alone.grade) == ("named", CONFIRMED)
    assert alone.sentence.startswith("The missing physics is small. The mean error on hold-out laps falls from 80 to 79 Nm.")
    assert "The cause is payne" in alone.sentence


def test_a_value_on_a_bound_makes_it_suspected_and_says_why():
    verdict = said([found(on_bounds=("size",))])
    assert verdict.grade == SUSPECTED
    assert "scrub is at the limit of its plausible range (size)." in verdict.sentence


def test_a_small_residual_is_reported_a_large_one_drops_names():
    limit = LEFT_SHARE * 100.0
    small, large = said([found()], at_end=regimes(-0.99 * limit)), said([found()], at_end=regimes(-1.01 * limit))
    assert (small.status, small.grade) == ("named", CONFIRMED)
    assert "A small error remains at speed 0 to 1 m/s" in small.sentence
    assert (large.status, large.grade, large.names) == ("unexplained", SUSPECTED, False)
    assert "scrub would explain a part of it, but the remaining error is too large to confirm that." in large.sentence
    assert said([found()], at_end=regimes(-500.0, p=0.02)).status == "named"


def test_what_several_explain_counts_together_where_they_act():
    pairs = [found(adds=60.0), found("payne", adds=60.0)]
    assert said(pairs, at_end=regimes(59.0)).status == "named"
    assert said([found(adds=60.0)], at_end=regimes(59.0)).status == "unexplained"
    seldom = found()
    seldom.adds[0][:] = np.where(np.arange(100) < 10, 100.0, 0.0)  # for a tenth of the time
    assert said([seldom], at_end=regimes(49.0)).status == "named"
    seldom.adds[0][:] = np.where(np.arange(100) < 3, 100.0, 0.0)
    assert said([seldom], at_end=regimes(49.0)).status == "unexplained"


def test_a_slow_residual_that_can_be_followed_is_a_drift():
    form = "drift"

    def drift(improvement):
        return unnamed("drift", form, "The residual drifts by 40 Nm", "a zero that drifts", 40.0, improvement)

    verdict = said(slow=NOISY, drift=drift(BETTER))
    assert (verdict.status, verdict.grade) == ("described", CONFIRMED)
    assert verdict.sentence.startswith("The residual drifts by 40 Nm. Look for a zero that drifts.")
    assert "from 100 to 80 Nm. The feed-forward leaves out a drift; this error includes it, taken from a live" in verdict.sentence
    for not_followed in (None, drift(UNSURE), drift(WORSE)):
        assert said(slow=NOISY, drift=not_followed).status == "unexplained"
    # The torque missing in a regime exceeds a drifting level, and a hardly visible one is none.
    assert said(slow=NOISY, drift=drift(BETTER), at_end=regimes(30.0)).status == "unexplained"
    assert said(drift=drift(BETTER)).status == "none"
    # Time and distance only grow, and show it as a level.
    at_distance = RegimeMap((Bin("distance", 0.0, 900.0, 30.0, "m", 50, 0.001),), 0.001, 500)
    assert said(slow=NOISY, drift=drift(BETTER), at_end=at_distance).status == "described"
    assert said(slow=NOISY, drift=drift(UNSURE), at_end=at_distance).status == "unexplained"
    # A level of each recording shows as whatever differs between them, and may show on hold-out laps alone.
    form = "recordings"
    for more in ({"slow": NOISY, "at_end": regimes(30.0)}, {"later": (20.0, 200.0)}):
        assert said(drift=drift(BETTER), **more).status == "described"
        assert said(drift=drift(UNSURE), **more).status == "unexplained"


def test_a_slow_residual_next_to_a_name_is_only_noted():
    verdict = said([found()], slow=NOISY)
    assert verdict.status == "named"
    assert "Averaged over 30 s, the measured torque differs" in verdict.sentence
    assert "Averaged" not in said([found()]).sentence


def test_the_next_best_is_told_with_how_much_less_likely_it_is():
    rivals = (candidate("payne", 18.0), candidate("mullins", 19.0))
    assert "The next best explanation, mullins, is 3 times less likely." in said([found(rivals=rivals)]).sentence
    assert "less likely" not in said([found()]).sentence
    members = found(members=("scrub", "mullins"), rivals=rivals)
    assert "less likely" not in said([members]).sentence


def test_a_rival_with_as_much_evidence_lost_on_the_unused_laps():
    rival = candidate("delay", worth=19.5)
    assert "Delay fits as well, but laps left out in turn do not confirm it." in said([found(rivals=(rival,))]).sentence
    beaten = found(rivals=(rival,), worse=("delay",))
    assert "Delay fits as well, but predicts laps left out in turn significantly worse." in said([beaten]).sentence


def test_a_form_with_as_much_evidence_predicts_no_worse():
    sentence = said([found(rivals=(candidate(RISING.name, 21.0, RISING),))]).sentence
    assert f"{RISING.name.capitalize()} fits as well, but is a form: it bends to the data." in sentence
    assert "worse" not in sentence


def test_a_rival_has_one_probability():
    """A listed one has that of laps left out, not that of the evidence as well."""
    rivals = (candidate("payne", 8.0), candidate("mullins", 9.0))
    for share, odds in ((0.04, True), (0.4, False)):
        sentence = said([found(rivals=rivals)], shares={"scrub": 1.0 - share, "mullins": share}).sentence
        assert ("mullins (40 %)" in sentence, "less likely" in sentence) == (not odds, odds)


def test_certainty_is_bounded():
    assert likelier_text(candidate("a", 22.0), candidate("b", 20.0)) == "7"
    assert likelier_text(candidate("a", 900.0), candidate("b", 20.0)) == "over a thousand"


# What may be written

KINDS = {"scrub": "vehicle", "payne": "vehicle", "grade": "surroundings", "torque_gain": "sensor"}
NAMED = Verdict("named", CONFIRMED, "")


def test_what_is_believed_is_confirmed_and_of_one_kind():
    assert credible_names([found()], NAMED, KINDS, False) == ["scrub"]
    assert credible_names([found(members=("scrub", "payne"))], Verdict("one_of", CONFIRMED, ""), KINDS, False) == ["scrub"]
    mixed = found(members=("scrub", "grade"))
    assert credible_names([mixed, found("payne")], Verdict("one_of", CONFIRMED, ""), KINDS, False) == ["payne"]
    assert credible_names([found(improvement=UNSURE)], NAMED, KINDS, False) == []
    assert credible_names([found(on_bounds=("size",))], NAMED, KINDS, False) == []
    assert credible_names([found()], Verdict("unexplained", SUSPECTED, ""), KINDS, False) == []


def test_who_asks_for_it_keeps_what_is_suspected_too():
    several = [found(improvement=UNSURE), found("grade", members=("grade", "torque_gain"))]
    assert credible_names(several, Verdict("unexplained", SUSPECTED, ""), KINDS, True) == ["scrub", "grade"]


# Terms without a name


def test_no_effect_explains_it_only_where_no_name_would():
    for instead in ("", "air_drag"):
        sentences = [
            said(terms=[replace(term(), rivals=Round(None, None, tuple(map(candidate, filter(None, [instead])))))]).sentence,
            said(at_end=regimes(-70.0), hint=instead).sentence,
        ]
        for sentence in sentences:
            assert ("No effect of the catalogue" in sentence) == (not instead)
            assert ("Air_drag would explain" in sentence) == bool(instead)


def term(name="curve_of_speed", improvement=BETTER, adds=100.0, predictable=True):
    text = f"The vehicle needs {abs(adds):.0f} Nm more"
    return replace(
        unnamed(name, "curve", text, "a fan", abs(adds), improvement), adds=[np.full(100, adds)], variable="speed",
        predictable=predictable,
    )  # fmt: skip


def unnamed(name, form, sentence, mechanism, size_nm, improvement):
    effect = ResidualPattern(name, "of a test", (), 1e4)
    text = {"form": form, "sentences": (sentence,), "mechanisms": (mechanism,), "size_nm": size_nm}
    return Term(effect, None, improvement=improvement, **text)


def test_what_has_no_name_is_described_with_what_to_look_for():
    verdict = said(terms=[term()])
    assert (verdict.status, verdict.grade, verdict.names) == ("described", CONFIRMED, True)
    assert verdict.sentence.startswith("The vehicle needs 100 Nm more. No effect of the catalogue explains this. Look for a fan.")
    verdict = said([found()], [term()])
    assert verdict.status == "named"
    assert "Look for a fan" in verdict.sentence


@pytest.mark.parametrize("form", get_args(Form))
def test_an_error_with_an_unpredictable_term_says_its_source(form):
    """Only what the vehicle file has as a disturbance is tracked live."""
    for predictable in (True, False):
        for by in (BETTER, Improvement(80.0, 79.0, 0.5, 1.5)):
            item = term("a_term", by, predictable=predictable)
            item = replace(item, form=form)
            sentence = said(terms=[item]).sentence
            assert ("60 Nm. The feed-forward leaves out" in sentence) == (not predictable and form in FROM)
            assert ("taken from a live estimate" in sentence) == (not predictable and form in (*FOLLOWED, "spells"))


def test_an_unconfirmed_term_is_suspected_and_a_weak_one_dropped():
    unsure = said(terms=[term(improvement=UNSURE)])
    assert (unsure.status, unsure.grade) == ("unexplained", SUSPECTED)
    little = said(terms=[term(adds=60.0)], at_end=regimes(59.0))
    assert (little.status, little.names) == ("unexplained", False)


def test_only_terms_predictable_ahead_are_written():
    description = Verdict("described", CONFIRMED, "")
    terms = [term(), term("spells", predictable=False), term("step_of_load", UNSURE)]
    assert credible_names(terms, description, KINDS, False) == ["curve_of_speed"]
    assert credible_names(terms, description, KINDS, True) == ["curve_of_speed", "step_of_load"]


FAST, RISING = Corner(SPEED, STEP, 1.0, 5.0, 10.0), Curve(DRIVING_TORQUE, [100.0, 5000.0])
PEAK, WAVY = Curve(SPEED, [1.0, 3.0, 5.0, 7.0]), Curve(SPEED, [1.0, 2.0, 3.0, 4.0, 5.0])


@pytest.mark.parametrize(
    ("effect", "values", "sentence"),
    [
        (FAST, {"y1": -380.0}, "The vehicle needs 380 Nm less with the speed above 5 m/s than below"),
        (RISING, {"x1": 100.0, "x2": 5000.0, "y1": 282.0, "y2": -278.0},
         "The extra torque falls from +282 Nm at 100 Nm of driving torque to -278 Nm at 5000 Nm"),
        (PEAK, {"y1": 10.0, "y2": 300.0, "y3": 280.0, "y4": 20.0},
         "The extra torque rises from +10 Nm at 1 m/s of speed to +300 Nm at 3 m/s. It then falls to +20 Nm at 7 m/s"),
        (WAVY, {"y1": 0.0, "y2": 300.0, "y3": -50.0, "y4": 200.0, "y5": -10.0},
         "The extra torque rises from 0 Nm at 1 m/s of speed to +300 Nm at 2 m/s. It then falls to -50 Nm at 3 m/s and rises to "
         "+200 Nm at 4 m/s and falls to -10 Nm at 5 m/s"),
    ],
    ids=["step", "curve", "peak", "wavy"],
)  # fmt: skip
def test_a_term_without_a_name_is_described_in_plain_words(effect, values, sentence):
    values = {**{q.name: q.start for q in effect.parameters}, **values}
    description = describe_form(Term(effect, None, improvement=BETTER, values=values, adds=term().adds), "vehicle")
    assert description.sentence == sentence
    verdict = said(terms=[description])
    assert verdict.sentence.startswith(f"{sentence}. No effect of the catalogue explains this. Look for ")


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=6, unique=True))
def test_turning_points_hold_all_large_swings_of_a_curve(heights):
    result = turning_points(heights)
    assert (result[0], result[-1]) == (0, len(heights) - 1)
    span = max(heights) - min(heights)
    assert max(heights[i] for i in result) > max(heights) - 0.2 * span
    assert min(heights[i] for i in result) < min(heights) + 0.2 * span
    ways = np.sign(np.diff([heights[i] for i in result]))
    assert (ways[1:] != ways[:-1]).all()


@pytest.mark.parametrize("effect", catalogue().values(), ids=lambda e: e.name)
def test_each_catalogue_effect_is_explained_in_short_sentences(effect):
    said([replace(found(), effect=effect, members=(effect.name,), values={})])


def test_a_wrong_value_of_the_file_is_named_with_its_interval(recorded, tmp_path, repository):
    """Through the command's own function: the belts of the file have another bearing than those that were driven."""
    text = (
        (repository / "config" / "xgd24d.yaml").read_text(encoding="utf-8").replace("rubber/nr", f"{repository}/config/rubber/nr")
    )
    value = re.search(r"friction: \{value: ([\d.]+)", text)
    assert value
    true = float(value[1])
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(text.replace(value[0], f"friction: {{value: {0.86 * true:.5f}"), encoding="utf-8")
    result = tr.diagnose(recorded(), wrong, quick=True).as_dict()
    assert result["verdict"]["status"] == "none"
    (changed, *_) = result["verdict"]["changed"]
    assert changed["name"] == "bearing_friction"
    assert result["base"]["refitted"]["bearing_friction"]["value"] == pytest.approx(true, rel=0.1)
    low, high = changed["ci95"]
    assert low < true < high
    assert changed["text"] in result["verdict"]["sentence"]
    assert "No mismatch beyond noise" not in result["verdict"]["sentence"]

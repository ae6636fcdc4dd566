# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether a description is true of a hidden torque."""

import numpy as np
import pytest

from proofs.sealed.cases import Case
from proofs.sealed.own import is_true
from proofs.sealed.recordings import _drives, _kept
from proofs.sealed.truth import Build, simulate_truth
from trackres_ros.files.resources import find_vehicle


@pytest.fixture(scope="module")
def kept():
    """Variables of three drives as the score sees them, and their lengths."""
    case = Case("a", "outside", {}, {}, False, False, False, True, 5)
    drives = _drives(case, 12.0, "drive")
    truth = _kept(case, drives, simulate_truth(find_vehicle("xgd24d"), Build(), {}, drives))
    return {key.removeprefix("over/"): x for key, x in truth.items() if key.startswith("over/")}, truth["lengths"]


def term(form="curve", variable=None, gate=None, period_m=None):
    return {"form": form, "variable": variable, "gate": gate, "memory": None, "period_m": period_m}


def test_the_variable_of_a_curve_is_what_the_torque_follows(kept):
    over, lengths = kept
    bump = 300.0 * np.exp(-(((over["speed"] - 7.0) / 1.5) ** 2))
    assert is_true(term(variable="speed"), over, bump, lengths)
    assert not is_true(term(variable="yaw rate"), over, bump, lengths)
    assert not is_true(term(variable="ambient temperature"), over, bump, lengths)
    assert not is_true(term(), over, bump, lengths)


@pytest.mark.parametrize("gate", ["in left turns", "yaw rate to the left above 0.02 rad/s"])
def test_a_gate_that_is_right_is_enough(kept, gate):
    over, lengths = kept
    remainder = 400.0 * (over["yaw rate to the left"] > 0.02)
    assert is_true(term("sided_gain", "", gate), over, remainder, lengths)
    assert is_true(term("sided_gain", "curvature", gate), over, remainder, lengths)
    assert not is_true(term("sided_gain", "", "when heavy"), over, remainder, lengths)


def test_what_the_base_takes_up_makes_no_statement_true(kept):
    over, lengths = kept
    rng = np.random.default_rng(1)
    drag = 4.0 * over["speed"] ** 2 + rng.normal(0.0, 1.0, len(over["speed"]))
    assert not is_true(term(variable="speed"), over, drag, lengths)


def test_spells_have_two_levels_that_last(kept):
    over, lengths = kept
    second = np.arange(int(lengths.sum()))
    on = 300.0 * (second // 97 % 3 == 1)
    assert is_true(term("spells"), over, on, lengths)
    assert not is_true(term("spells"), over, 300.0 * np.sin(second / 60.0), lengths)


def test_recording_levels_are_true_of_offsets_between_recordings(kept):
    over, lengths = kept
    rng = np.random.default_rng(2)
    each = np.repeat(rng.normal(0.0, 200.0, len(lengths)), lengths)
    assert is_true(term("recordings"), over, each + rng.normal(0.0, 50.0, len(each)), lengths)
    assert not is_true(term("recordings"), over, 300.0 * np.sin(np.arange(len(each)) / 60.0), lengths)


def test_a_drift_is_slow_and_follows_nothing(kept):
    over, lengths = kept
    rng = np.random.default_rng(3)
    walk = np.convolve(rng.normal(size=int(lengths.sum()) + 599), np.full(600, 1.0), mode="valid")
    assert is_true(term("drift"), over, walk, lengths)
    assert not is_true(term("drift"), over, rng.normal(size=len(walk)), lengths)
    assert not is_true(term("drift"), over, 50.0 * np.sin(over["belt temperature"] / 8.0), lengths)


def test_a_wave_needs_the_right_length_and_a_fade_a_stop(kept):
    over, lengths = kept
    wave = 200.0 * np.sin(2.0 * np.pi * over["distance"] / 370.0)
    assert is_true(term("wave", "driven distance", period_m=370.0), over, wave, lengths)
    assert not is_true(term("wave", "driven distance", period_m=290.0), over, wave, lengths)
    since, way = np.zeros(len(wave)), 0.0
    for i, v in enumerate(over["speed"]):
        way = 0.0 if v < 0.1 or i in np.cumsum(lengths)[:-1] else way + v
        since[i] = 300.0 * (1.0 - np.exp(-way / 400.0))
    assert is_true(term("clock", "distance since a stop"), over, since, lengths)
    assert not is_true(term("clock", "braking"), over, wave, lengths)

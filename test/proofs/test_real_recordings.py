# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Findings on real recordings outside the diagnosis: residuals tied to position, and learned streets."""

from pathlib import Path

import numpy as np
import pytest

from proofs.field import live
from proofs.field.live import all_drives, live_errors
from proofs.field.trials import (
    BUS,
    BUS_TOPICS,
    LONG_STRETCH_S,
    NOTHING,
    TWICE,
    UPHILL,
    FieldTrial,
    car,
    mass_of_joined,
    missions,
    twice,
)
from trackres_ros.diagnosis import DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.recording.bindings import Topics

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"


@pytest.mark.long
@pytest.mark.skipif(not DATA.is_dir(), reason="no real recordings on this machine")
def test_a_route_driven_twice_repeats_residuals_but_not_as_slope(tmp_path):
    paths = [car(DATA, name, tmp_path) for name in TWICE]
    result = diagnose(read_recordings(paths, None), load_base("bmw_i3"), DiagnosisOptions(hide=["grade"], quick=True))
    tried = FieldTrial("one route twice", "elevation", NOTHING, UPHILL, result)
    assert tried.outcome == "right"
    repeated = twice(tried)
    assert repeated.repeats > 0.8
    assert repeated.follows_slope < 0.5


@pytest.mark.long
@pytest.mark.skipif(not missions(DATA), reason="no recording of the bus on this machine")
def test_without_altitude_a_bus_diagnosis_names_only_the_slope():
    topics = Topics.load(BUS_TOPICS)
    recordings = read_recordings(missions(DATA), topics)
    result = diagnose(recordings, load_base(BUS).with_topics(topics), DiagnosisOptions(hide=["altitude"], quick=True))
    assert result.verdict.status == "named"
    assert [f.name for f in result.found] == ["grade"]
    assert not result.described
    held_out = result.held_out
    assert held_out.mae["with_effects"] < 0.7 * held_out.mae["refitted"]
    by_lap = held_out.by_lap["mae"]
    assert np.mean(by_lap["with_effects"] > 1.01 * by_lap["refitted"]) < 0.2  # single laps may be worse


@pytest.mark.long
@pytest.mark.skipif(not missions(DATA), reason="no recording of the bus on this machine")
def test_learned_streets_halve_the_error_in_the_rest_of_a_drive(tmp_path, good, monkeypatch):
    quick = {"diagnose": ("--quick", "--no-page"), "replay": ()}
    monkeypatch.setattr(live, "run_command", lambda command, *words: good(command, *words, *quick[command]))
    of_bus = next(all_drives(DATA, tmp_path))
    errors = {e.what: e.error_nm for e in live_errors(of_bus, tmp_path)}
    assert errors["vehicle.yaml and surroundings.yaml"] < 0.5 * errors["the shipped vehicle file"]
    assert errors["vehicle.yaml"] < 1.05 * errors["the shipped vehicle file"]


def test_short_stretches_are_joined_and_a_short_rest_is_dropped():
    driven = np.array([200.0, 150.0, 350.0, 100.0, 150.0])
    mass = np.array([0.0, 700.0, 40.0, 9.0, 9.0])
    assert LONG_STRETCH_S < 350.0
    assert mass_of_joined(mass, driven) == pytest.approx([300.0, 40.0])

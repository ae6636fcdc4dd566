# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time scale of a recording: a vehicle keeps steps of 1 s, a machine that is quick gets shorter ones."""

from pathlib import Path

import numpy as np
import pytest
from csv_tables import written

from proofs.field.emps import COULOMB, DIRECTION, force_error, only, try_slide
from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.resample import step_for
from trackres_ros.diagnosis.prepare.session import LEAST_SAMPLES, STEP_S, pace
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.samples import Series

EMPS = Path(__file__).resolve().parents[3] / "shared" / "data" / "real" / "emps" / "emps.csv.gz"


def to_and_fro(half_period, rate_hz, seconds, size=1.0, noise=0.0):
    """A speed along trapezoids: a tenth of a half period to turn round."""
    sample_times = np.arange(0.0, seconds, 1.0 / rate_hz)
    wave = 2.0 / np.pi * np.arcsin(np.sin(np.pi * sample_times / half_period))
    speed = size * np.clip(10.0 * wave, -1.0, 1.0) + np.random.default_rng(1).normal(0.0, noise, len(sample_times))
    stamps = np.round(sample_times * 1e9).astype(np.int64)
    series = {"speed": Series(stamps, stamps, speed), "torque": Series(stamps, stamps, speed)}
    return Recording("made", series, zero_is_unset=False)


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0, 100.0, 1000.0])
@pytest.mark.parametrize("half_period", [60.0, 300.0])
def test_what_turns_in_seconds_keeps_the_usual_step(rate_hz, half_period):
    assert step_for([to_and_fro(half_period, rate_hz, 4.0 * half_period)]) == STEP_S


def test_a_speed_that_shows_noise_alone_keeps_the_usual_step():
    assert step_for([to_and_fro(60.0, 100.0, 300.0, size=0.0, noise=0.1)]) == STEP_S


@pytest.mark.parametrize("faster", [2.0, 10.0])
def test_what_is_quicker_gets_a_step_as_much_shorter(faster):
    step = step_for([to_and_fro(1.0, 1000.0, 30.0)])
    quicker = step_for([to_and_fro(1.0 / faster, faster * 1000.0, 30.0)])
    assert step < 0.1 * STEP_S
    assert step / faster / 2.5 <= quicker <= step / faster * 2.5  # steps are 1, 2 or 5 of a decade


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 200.0])
def test_a_short_step_has_several_samples(rate_hz):
    assert step_for([to_and_fro(1.0, rate_hz, 60.0)]) * rate_hz >= LEAST_SAMPLES


def test_a_clock_that_was_set_does_not_ask_for_short_steps():
    made = to_and_fro(1.0, 100.0, 60.0)
    late = {
        role: Series(s.stamp_ns + (np.arange(len(s)) > 3000) * 10**18, s.arrival_ns, s.value) for role, s in made.series.items()
    }
    assert step_for([Recording("set", late, zero_is_unset=False)]) == STEP_S


def test_steps_of_a_second_or_more_have_the_pace_of_a_drive():
    assert [pace(step) for step in (0.02, 0.5, 1.0, 5.0)] == [0.02, 0.5, 1.0, 1.0]


def test_a_position_gives_its_change_as_speed(tmp_path):
    sample_times = np.arange(0.0, 30.0, 0.01)
    columns = {"time_s": sample_times, "position_m": 0.05 * np.sin(2.0 * sample_times), "force_n": np.ones(len(sample_times))}
    path = written(tmp_path / "slide.csv", columns, "%.18e")
    (read,) = read_recordings([path], Topics.load("emps"))
    assert read.series["speed"].value[1:-1] == pytest.approx(0.1 * np.cos(2.0 * sample_times[1:-1]), abs=1e-4)
    assert "the change of column position_m" in " ".join(read.notes)


@pytest.fixture(scope="module")
def tried(tmp_path_factory):
    """The positioning system without dry friction in its file, and with it."""
    if not EMPS.is_file():
        pytest.skip("no recording of the positioning system on this machine")
    return try_slide(EMPS, tmp_path_factory.mktemp("emps"))


def test_a_slide_lacks_dry_friction(tried):
    result = tried.lacking
    assert result.sessions[0].step < 0.1
    assert {f.name: f.grade for f in result.found}[COULOMB] == "confirmed"
    errors = [force_error(result, fit) for fit in (result.refitted, only(result, (COULOMB,)), only(result, (COULOMB, DIRECTION)))]
    published = (0.173, 0.034, 0.020)
    assert errors == pytest.approx(published, rel=0.25)
    assert force_error(result, result.final, held_out=True) < 0.04


def test_with_it_friction_differs_by_direction(tried):
    result = tried.with_friction
    assert {f.name: f.grade for f in result.found} == {DIRECTION: "confirmed"}
    assert result.found[0].values["forward"] == pytest.approx(0.5 * (168.0 - 242.0), rel=0.25)
    assert force_error(result, result.final) < 0.03


def test_the_sentence_counts_what_resists_against_travel(tried):
    (dry,) = (f for f in tried.lacking.found if f.name == COULOMB)
    assert dry.regime[0].mean_residual > 1.0  # over both ways alike the residual would be none


def test_the_whole_drive_of_a_slide_is_compared(tried):
    assert not any("brake" in reason for reason in tried.lacking.gated.exclusions)
    repetition = gate(read_recordings([EMPS], Topics.load("emps")), load_base("emps").known).sessions[0]
    assert repetition.used.mean() > 0.9
    assert (repetition.speed[repetition.used] < 0.0).any()

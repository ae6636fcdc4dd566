# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is named was confirmed on laps that were not fitted, and what is written is never worse than what was there."""

import json

import numpy as np
import pytest
from csv_tables import rewritten

from trackres_ros.diagnosis.findings.verdict import Verdict
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, NO_WORSE, REFUTED, SUSPECTED, HeldOutLaps
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.errors import InputError

PUMP_NM, PUMP_S = 600.0, 100.0


def test_laps_without_a_sample_are_refused(loaded):
    (session,) = drives(loaded.base, 10.0, 1, 3.0, np.random.default_rng(1))
    with pytest.raises(InputError, match="hold-out"):
        HeldOutLaps([session], [np.zeros(len(session), dtype=bool)], np.random.default_rng(1))


@pytest.fixture(scope="module")
def pumped(recorded, tmp_path_factory):
    """Three drives in the first two of which a pump cuts in and out; the last, which is held out, has none."""
    folder = tmp_path_factory.mktemp("pumped")
    rng = np.random.default_rng(9)

    def pump(columns):
        time = columns["time_s"] - columns["time_s"][0]
        on = np.any([(time >= t) & (time < t + PUMP_S) for t in np.sort(rng.uniform(0.0, time[-1], 4))], axis=0)
        columns["torque_nm"] += PUMP_NM * on

    *first, last = recorded(count=3)
    return [*(rewritten(path, folder, pump) for path in first), last]


def test_what_only_the_fitted_laps_have_is_not_written(run, pumped, tmp_path, loaded):
    output = tmp_path / "out"
    assert run(pumped, output, "--holdout", "drive_3").exit_code == 0
    result = json.loads((output / "report.json").read_text())
    mae = result["heldout"]["mae"]
    assert all(e["grade"] != CONFIRMED for e in result["effects"])
    assert result["verdict"]["grade"] != CONFIRMED or result["verdict"]["status"] in ("none", "described")
    assert not any(term["predictable"] for term in result["described"])  # at most its spells, which no file has
    assert not result["written"]["effects"]
    assert mae["with_effects"] <= NO_WORSE * mae["refitted"]
    if mae["refitted"] > mae["nominal"]:
        assert not result["written"]["base"]


@pytest.mark.parametrize("names", [(), ("turning_scrub",), ("grade_profile",)])
def test_the_kept_file_is_never_worse_on_held_out_laps(diagnoses, loaded, names):
    result = diagnoses(*names)
    masks = [result.split.held_out_mask(s) for s in result.sessions]
    laps = HeldOutLaps(result.sessions, masks, np.random.default_rng(1))
    values = result.kept.values or loaded.base.nominal
    written = result.base.predict(result.sessions, values, result.kept.effects)
    error = np.abs(laps.measured - laps.samples([p.torque for p in written])).mean()
    # The driving torque that some effects look at is that of the last fit here.
    assert error <= result.held_out.mae["nominal"] * (1.0 + 1e-3)
    assert set(result.kept.intervals) == (
        {("", name) for name in values}
        | {(a.effect.name, q.name) for a in result.kept.effects for q in a.effect.parameters if q.fitted}
        if result.kept.values
        else set()
    )


def test_every_verdict_says_whether_it_is_confirmed(diagnoses):
    for names in ((), ("turning_scrub",), ("grade_profile",)):
        verdict = diagnoses(*names).verdict
        assert isinstance(verdict, Verdict)
        assert verdict.grade in (CONFIRMED, SUSPECTED, REFUTED)
        if verdict.names:
            assert verdict.grade == CONFIRMED
            assert "The mean error on hold-out laps" in verdict.sentence


def test_a_tilted_plane_takes_more_one_way_and_less_the_other(diagnoses, loaded):
    result = diagnoses("grade_profile")
    (effect,) = result.found
    assert effect.location.variable == "heading"
    most = 0.014 * loaded.base.facts.weight * loaded.base.facts.radius  # both slopes of a hundredth
    assert 0.5 * most < effect.location.largest < 1.5 * most
    assert 0.5 * most < -effect.location.smallest < 1.5 * most
    assert "less to" in result.verdict.sentence
    assert "depending on the heading" in result.verdict.sentence


@pytest.mark.long
@pytest.mark.parametrize("names", [(), ("turning_scrub",)])
def test_the_seed_does_not_decide(diagnoses, names):
    texts = {
        (result.verdict.status, result.verdict.grade, tuple(f.members for f in result.found))
        for result in (diagnoses(*names, seed=seed) for seed in (1, 2))
    }
    assert len(texts) == 1

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An intermittent torque, watched for live: reported in the statuses, and never fed forward."""

import re
from pathlib import Path

import pytest

from trackres_ros.estimator import columns as at
from trackres_ros.estimator.disturbance import LONGEST_MEANS
from trackres_ros.node.measured_torque import Comparison, MismatchSettings
from trackres_ros.node.transport import Level
from trackres_ros.vehicle import Drift, Spells

LEVEL_NM = 1000.0
SPELLS = Spells(LEVEL_NM, 0.0, 60.0, 120.0, 100.0)
START_NS = 1_700_000_000_000_000_000


@pytest.fixture
def given(disturbed, topics):
    """Parameters of a vehicle with and without something to watch for, and of topics with a torque."""
    return {"vehicle": disturbed(LEVEL_NM), "topics": topics}, {"topics": topics}


def expected_nm(d):
    """What driving takes by the model [Nm]."""
    return d.app.overview().values["drive_torque_nm"]


def drive(d, seconds, more_nm, speed=8.0):
    """Drive with a measured torque that is so much above the expected one."""
    for _ in range(round(seconds / 0.2)):
        d.drive(0.2, speed=speed, dt=0.2, torque=expected_nm(d) + more_nm)


def of(d, entry):
    """Level and keys of an entry of the diagnostics as they are now; None where there is none."""
    d.forward(1.0)
    statuses = next(statuses for name, statuses in reversed(d.statuses) if name == "/diagnostics")
    return next(((s.level, s.message, dict(s.values)) for s in statuses if s.name.endswith(f": {entry}")), None)


@pytest.mark.parametrize("stamp", ["header", "log"])
def test_the_status_shows_a_spell_and_the_log_its_start_and_end(desk, given, topics, stamp):
    d = desk(Path(topics).read_text().replace("}", f", stamp: {stamp}}}"), vehicle=given[0]["vehicle"])
    d.drive(20.0, dt=0.2)
    drive(d, 40.0, 0.0)
    level, _, values = of(d, "disturbance")
    assert level is Level.OK
    assert values["form"] == "spells"
    assert values["present"] == "false"
    assert float(values["there"]) < 0.1
    assert "DISTURBANCE" not in d.names()
    began_s = d.time_s
    drive(d, 40.0, LEVEL_NM)
    level, message, there = of(d, "disturbance")
    assert level is Level.OK
    assert there["present"] == "true"
    assert float(there["there"]) > 0.9
    assert float(there["torque_nm"]) == pytest.approx(LEVEL_NM, rel=0.1)
    assert float(there["since"]) == pytest.approx(START_NS * 1e-9 + began_s, abs=6.0)
    assert "is present" in message
    d.clock_offset_s = 3600.0
    drive(d, 10.0, LEVEL_NM)
    _, message, later = of(d, "disturbance")
    assert "is present (" in message
    assert float(later["since"]) - float(there["since"]) == pytest.approx(3600.0, abs=0.01)
    assert "DISTURBANCE" in d.names()
    assert next(r for r in d.app.notices() if r.name == "DISTURBANCE").level is Level.OK
    drive(d, 40.0, 0.0)
    assert "DISTURBANCE" not in d.names()
    logged = [(level, text) for level, text in d.logged if "disturbance" in text]
    assert [level for level, _ in logged] == [Level.OK, Level.OK]
    assert [re.match(r"the disturbance (begins|is over)", text)[1] for _, text in logged] == ["begins", "is over"]


def test_what_is_published_as_torque_is_the_same_to_the_last_bit(desk, given):
    results = []
    for parameters in given:
        d = desk(**parameters)
        d.drive(5.0, dt=0.2)
        for i in range(60):
            d.drive(1.0, dt=0.2, torque=3000.0 + LEVEL_NM * (i // 20 % 2))
        results.append(d)
    disturbed, bare = results
    assert of(disturbed, "disturbance") is not None
    assert of(bare, "disturbance") is None
    assert any(name == "feedforward_torque" and values != [0.0] for name, _, values in disturbed.published)
    assert disturbed.published == bare.published


def test_without_a_measured_torque_nothing_is_watched_for(desk, given):
    d = desk(vehicle=given[0]["vehicle"])
    d.drive(3.0)
    assert of(d, "disturbance") is None
    assert of(d, "estimate") is not None


def test_a_reset_forgets_it(desk, given):
    d = desk(**given[0])
    d.drive(2.0, dt=0.2)
    drive(d, 40.0, LEVEL_NM)
    assert "DISTURBANCE" in d.names()
    d.app.reset()
    assert "DISTURBANCE" not in d.names()


def taken(comparison, residual_nm, seconds, start_s=0.0, drive_nm=3000.0):
    """Feed rows with a residual, a constant or of the time [s]."""
    row = [0.0] * len(at.VEHICLE_COLUMNS)
    row[at.Results.drive_torque_nm], row[at.Results.resistance_std_nm], row[at.Results.speed_mps] = drive_nm, 100.0, 8.0
    for i in range(round(seconds)):
        time_s = start_s + i
        row[at.Results.residual_nm] = residual_nm(time_s) if callable(residual_nm) else residual_nm
        comparison.take(START_NS + round(time_s * 1e9), row, START_NS + round(time_s * 1e9))


def test_a_known_spell_is_no_mismatch_but_a_larger_one_is():
    hold_s, spell_s = 60.0, 400.0
    settings = MismatchSettings(mismatch_hold_s=hold_s)
    explained, unexplained, more = Comparison(settings, SPELLS), Comparison(settings, None), Comparison(settings, SPELLS)
    for comparison in (explained, unexplained, more):
        taken(comparison, lambda t: 40.0 * (-1.0) ** int(t), 600.0)
        assert not comparison.verdict.parted
    for comparison, size in ((explained, LEVEL_NM), (unexplained, LEVEL_NM), (more, 2.0 * LEVEL_NM)):
        taken(comparison, lambda t, size=size: size + 40.0 * (-1.0) ** int(t), spell_s, start_s=600.0)
    assert not explained.verdict.parted
    assert unexplained.verdict.parted
    assert more.verdict.parted
    assert more.verdict.mean_nm == pytest.approx(LEVEL_NM, rel=0.15)
    taken(explained, lambda t: LEVEL_NM + 40.0 * (-1.0) ** int(t), LONGEST_MEANS * SPELLS.mean_there, start_s=1000.0)
    assert explained.verdict.parted  # what stays for so long is no spell


def test_an_offset_far_beyond_a_drift_is_a_mismatch():
    settings, drift = MismatchSettings(mismatch_hold_s=120.0), Drift(150.0, 300.0, 60.0)
    within, beyond = Comparison(settings, drift), Comparison(settings, drift)
    for comparison, size in ((within, 250.0), (beyond, 1500.0)):
        taken(comparison, lambda t, size=size: size * (t > 600.0) + 40.0 * (-1.0) ** int(t), 1800.0, drive_nm=1000.0)
    assert not within.verdict.parted
    assert beyond.verdict.parted

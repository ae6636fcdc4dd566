# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A judder while pulling away, through `trackres diagnose`: it has no mean, so no other term shows it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from csv_tables import rewritten

from trackres_ros.diagnosis.report.page import write_page
from trackres_ros.evaluation.synthetic import drives, write_recordings

LEG_S, JUDDER_NM, JUDDER_HZ, PULLS_MPS = 60.0, 500.0, 1.3, 2.5


@pytest.fixture
def stop_and_go(loaded, tmp_path):
    """Drives from stop to stop."""
    rng, sessions = np.random.default_rng(3), []
    for session in drives(loaded.base, loaded.known.max_speed, 2, 10.0, rng):
        knots = [5.0, 5.0 + 0.3 * LEG_S, 0.75 * LEG_S, LEG_S - 3.0]
        speed, after = (np.interp((session.time + by) % LEG_S, knots, [0.0, 6.0, 6.0, 0.0]) for by in (0.0, session.step))
        straight = {"yaw_rate": 0.0 * speed, "heading": 0.0 * speed}
        sessions.append(replace(session, speed=speed, accel=(after - speed) / session.step, **straight))
    return write_recordings(loaded.base, tmp_path, sessions, (), rng)


def judder(columns):
    """Adds a judder while the vehicle pulls away."""
    pulls = (columns["speed_mps"] > 0.1) & (columns["speed_mps"] < PULLS_MPS) & (columns["accel_mps2"] > 0.1)
    columns["torque_nm"] += JUDDER_NM * pulls * np.sin(2.0 * np.pi * JUDDER_HZ * columns["time_s"])


def test_a_judder_is_described_and_never_written(run, stop_and_go, tmp_path):
    done = run([rewritten(path, tmp_path, judder) for path in stop_and_go], tmp_path / "out")
    assert done.exit_code == 0, done.exception
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    (spread,) = (t for t in found["described"] if t["form"] == "spread")
    assert found["verdict"]["status"] == "described"
    assert found["verdict"]["grade"] == spread["grade"] == "confirmed"
    assert spread["gate"] == "while it pulls away"
    assert spread["size_nm"] == pytest.approx(JUDDER_NM / np.sqrt(2.0), rel=0.3)
    assert spread["sentence"] in found["verdict"]["sentence"]
    assert not spread["predictable"]
    assert (found["written"]["effects"], found["written"]["disturbance"]) == ([], None)
    write_page(tmp_path / "report.html", found, [], "Diagnosis")
    assert "While it pulls away" in (tmp_path / "report.html").read_text()

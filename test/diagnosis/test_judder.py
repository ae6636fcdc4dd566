# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A judder while pulling away, through `trackres diagnose`: it has no mean, so no other term shows it."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from csv_tables import rewritten

from trackres_ros.diagnosis.findings.spread import find_spread
from trackres_ros.diagnosis.prepare.session import Cumulative
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


class Drive(SimpleNamespace):
    """What is used of a `DriveSession`."""

    def __len__(self):
        return len(self.time)


@pytest.mark.parametrize("left_out", [False, True])
def test_corners_beside_steps_left_out_are_no_judder(left_out):
    """Each minute the torque falls to that of braking, along a curve that the steps of the fit do not follow."""
    rng, of_minute, lap = np.random.default_rng(2), np.arange(600.0) % 60.0, np.arange(600) // 60
    fine = np.arange(0.0, 600.0, 0.1)
    torque = 2000.0 - 6000.0 * np.interp(fine % 60.0, [0.0, 40.0, 42.0, 50.0, 52.0], [0.0, 0.0, 1.0, 1.0, 0.0])
    course = Cumulative.of(fine, torque + 600.0 * np.sin(3.0 * fine) * (torque < 2000.0) + rng.normal(0.0, 30.0, len(fine)))
    time = np.arange(600.0)
    expected = Cumulative.of(fine, torque).means(time, 1.0)
    session = Drive(
        pace=1.0, step=1.0, time=time, block=lap, torque_course=course, torque=course.means(time, 1.0),
        used=(of_minute < 41.0) | (of_minute >= 52.0) if left_out else np.full(600, True),
        speed=np.full(600, 8.0), accel=np.zeros(600), weight=np.full(600, 2e5),
    )  # fmt: skip
    predicted = SimpleNamespace(torque=expected, at_sprockets=np.where(of_minute == 40.0, -1.0, expected))
    found = find_spread(SimpleNamespace(problem=SimpleNamespace(sessions=[session]), predicted=[predicted]))
    assert found is None if left_out else found.regime == "while the motor brakes"

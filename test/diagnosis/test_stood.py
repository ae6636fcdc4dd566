# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How warm a recording begins: by the drive before it, by how long it stood since, and by a drive that is not recorded."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from csv_tables import written

from trackres_ros.diagnosis import load_base, read_recordings
from trackres_ros.diagnosis.prepare.gate import gate
from trackres_ros.diagnosis.prepare.session import GateSettings
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.effects import Active, catalogue
from trackres_ros.errors import InputError

KNOWN = GateSettings(14000.0, 40.0, 15.0, False)
CLOCK_S = 1_760_000_000


@pytest.fixture(scope="module")
def base():
    return load_base("bmw_i3").base


@pytest.fixture(scope="module")
def drive(base):
    (session,) = drives(base, 25.0, 1, 20.0, np.random.default_rng(1), step=1.0)
    return session


def begins(base, name, *sessions):
    """Torque of an effect that warms up in the first minute of driving of the last of some sessions [Nm]."""
    effect = catalogue(size=base.facts.weight * base.facts.radius, on_tyres=True)[name]
    with_it = base.predict(sessions, base.nominal, [Active(effect, effect.values())])
    without = base.predict(sessions, base.nominal, ())
    assert len(with_it) == len(sessions)
    moving = np.flatnonzero(np.abs(sessions[-1].speed) > 1.0)[:60]
    return float(np.mean((with_it[-1].torque - without[-1].torque)[moving]))


@pytest.mark.parametrize("name", ["warmup", "roadwheel_tyres", "viscous_bearing"])
def test_the_longer_it_stood_the_colder_it_begins(base, drive, name):
    stood = [begins(base, name, drive, replace(drive, gap=gap)) for gap in (0.0, 600.0, 3600.0, 6e5)]
    assert all(b > a for a, b in pairwise(stood))
    assert stood[-1] == pytest.approx(begins(base, name, drive), rel=0.01)


@pytest.mark.parametrize("name", ["warmup", "roadwheel_tyres", "viscous_bearing"])
def test_a_drive_that_is_not_recorded_is_one_like_this(base, drive, name):
    recorded = begins(base, name, drive, replace(drive, gap=900.0))
    assert begins(base, name, replace(drive, gap=900.0, after_unseen=True)) == pytest.approx(recorded, rel=1e-9)


@pytest.mark.parametrize("name", ["roadwheel_tyres", "viscous_bearing"])
def test_airflow_cooling_is_slower_at_standstill(base, drive, name):
    effect = catalogue(size=base.facts.weight * base.facts.radius, on_tyres=True)[name]
    constant = effect.values()["time_constant"]
    cold, warm, rested = (
        begins(base, name, *s) for s in ((drive,), (drive, replace(drive, gap=0.0)), (drive, replace(drive, gap=constant)))
    )
    assert (rested - warm) / (cold - warm) < 0.35  # of one constant while driving 1 - 1/e


def standing(folder, name, start_s, stood_s=None):
    time = start_s + np.arange(0.0, 300.0, 0.5)
    speed = 10.0 + 3.0 * np.sin(time / 20.0)
    columns = {"time_s": time, "speed_mps": speed, "torque_nm": 50.0 + 70.0 * np.gradient(speed, 0.5)}
    if stood_s is not None:
        columns["stood_s"] = np.full(len(time), stood_s)
    return written(folder / name, columns, fmt="%.3f")


@pytest.mark.parametrize(
    ("stood_s", "gap", "unseen"),
    [(None, 3600.0, False), (3600.0, 3600.0, False), (3580.0, 3600.0, False), (500.0, 500.0, True), (1e6, 3600.0, False)],
)
def test_standing_for_less_than_the_clock_gap_means_unseen_drive(tmp_path, stood_s, gap, unseen):
    paths = [standing(tmp_path, "a.csv", CLOCK_S), standing(tmp_path, "b.csv", CLOCK_S + 299.0 + 3600.0, stood_s)]
    first, second = gate(read_recordings(paths, None), KNOWN).sessions
    assert (first.gap, first.after_unseen) == (np.inf, False)
    assert second.gap == pytest.approx(gap, abs=5.0)
    assert second.after_unseen == unseen


def test_a_first_recording_may_begin_warm(tmp_path):
    path = standing(tmp_path, "a.csv", CLOCK_S, 30.0)
    (session,) = gate(read_recordings([path], None), KNOWN).sessions
    assert (session.gap, session.after_unseen) == (30.0, True)
    assert gate(read_recordings([path], None), KNOWN, hide=["stood"]).sessions[0].gap == np.inf


def test_a_negative_standing_time_is_refused(tmp_path):
    with pytest.raises(InputError, match="stood"):
        gate(read_recordings([standing(tmp_path, "a.csv", CLOCK_S, -5.0)], None), KNOWN)

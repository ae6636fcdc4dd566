# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Disturbances to watch for live: written as found, and only if permitted."""

from dataclasses import astuple
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.empirical.spells import Blocks, expected_level, find_drifting_level
from trackres_ros.diagnosis.empirical.term import Term
from trackres_ros.diagnosis.pipeline import may_be_kept
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED, Improvement
from trackres_ros.estimator.disturbance import BLOCK_S, MOST_DRIFT, DisturbanceWatch
from trackres_ros.vehicle import Drift, Spells, load, load_any
from trackres_ros.vehicle.writing.changes import FileChanges, LearnedDisturbance
from trackres_ros.vehicle.writing.vehicle_file import write_track_vehicle

SPELLS = LearnedDisturbance(
    Spells(312.3456789, -48.0, 81.25, 160.0, 61.0),
    {
        "level": (300.0, 325.0),
        "rest": (-60.0, -40.0),
        "mean_there": (50.0, 130.0),
        "mean_away": (90.0, 280.0),
        "noise": (50.0, 70.0),
    },
)
DRIFT = LearnedDisturbance(
    Drift(150.0, 300.0, 40.0), {"size": (100.0, 220.0), "time_constant": (150.0, 600.0), "noise": (35.0, 45.0)}
)
NOTHING = FileChanges(None, (), {}, "written: the file's own values")


def written(vehicle, folder, kept):
    folder.mkdir()
    path = folder / "vehicle.yaml"
    write_track_vehicle(vehicle, path, kept, "Written by trackres diagnose from x.")
    return path


@pytest.mark.parametrize("learned", [SPELLS, DRIFT])
def test_it_is_written_with_unit_range_and_reason_and_read_again(tmp_path, learned):
    path = written(load("xgd24d"), tmp_path / "first", NOTHING.with_disturbance(learned))
    result, section = load(path).disturbance, yaml.safe_load(path.read_text())["disturbance"]
    assert result.form == learned.disturbance.form == section.pop("form")
    for name, (low, high) in learned.ranges.items():
        assert getattr(result, name) == pytest.approx(getattr(learned.disturbance, name), rel=1e-5)
        assert section[name]["range"] == [low, high]
        assert section[name]["flag"] == "F"
        assert "trackres diagnose" in section[name]["reason"]
    assert set(section) == set(learned.ranges)
    assert learned.disturbance.form in NOTHING.with_disturbance(learned).text


def test_a_later_disturbance_replaces_the_old_and_none_keeps_it(tmp_path):
    first = load(written(load("xgd24d"), tmp_path / "first", NOTHING.with_disturbance(SPELLS)))
    later = load(written(first, tmp_path / "later", NOTHING.with_disturbance(DRIFT)))
    assert later.disturbance == DRIFT.disturbance
    path = written(later, tmp_path / "last", NOTHING)
    assert load(path).disturbance == DRIFT.disturbance
    assert path.read_text().startswith("# Written by trackres diagnose from x.")
    assert "comments could not be kept" not in path.read_text()


def test_a_vehicle_without_belts_is_watched_too(tmp_path):
    base = load_base("ztbus_hess19").base
    for name, learned_values in (("spells", SPELLS), ("drift", DRIFT)):
        base.write(tmp_path / f"{name}.yaml", NOTHING.with_disturbance(learned_values), "Written by trackres diagnose from x.")
        result = load_any(tmp_path / f"{name}.yaml").disturbance
        assert result.form == learned_values.disturbance.form
        assert astuple(result) == pytest.approx(astuple(learned_values.disturbance), rel=1e-5)


IMPROVEMENTS = {
    CONFIRMED: Improvement(100.0, 80.0, 15.0, 25.0),
    SUSPECTED: Improvement(100.0, 95.0, -5.0, 15.0),
    REFUTED: Improvement(100.0, 120.0, -30.0, -10.0),
}


@pytest.mark.parametrize(
    ("grade", "names", "keep_suspected", "expected"),
    [
        (CONFIRMED, True, False, True),
        (SUSPECTED, True, False, False),
        (CONFIRMED, False, False, False),
        (SUSPECTED, False, True, True),
        (REFUTED, False, True, False),
        (REFUTED, True, True, False),
    ],
)
def test_a_suspected_disturbance_is_kept_only_on_request(grade, names, keep_suspected, expected):
    term, verdict = Term(None, None, improvement=IMPROVEMENTS[grade]), SimpleNamespace(names=names)
    assert term.grade == grade
    assert may_be_kept(term, verdict, keep_suspected) is expected


def drifting(seed, n=720, size=150.0, seconds=300.0, noise=40.0):
    """Means over blocks of an hour of a slow disturbance [Nm]."""
    rng, level, keep = np.random.default_rng(seed), np.empty(n), np.exp(-BLOCK_S / seconds)
    level[0] = rng.normal(0.0, size)
    for i in range(1, n):
        level[i] = keep * level[i - 1] + rng.normal(0.0, size * np.sqrt(1.0 - keep**2))
    return level + rng.normal(0.0, noise, n)


@pytest.mark.parametrize("seed", range(3))
def test_the_diagnosis_and_the_watch_follow_a_drift_alike(seed):
    mean = drifting(seed)
    n = len(mean)
    index = np.arange(n)
    b = Blocks(mean, np.full(n, 5.0), index == 0, np.zeros(n, dtype=np.int64), 5 * index, 5 * (index + 1))
    level, _ = find_drifting_level(b)
    noise = level.noise / np.sqrt(5.0)
    most = MOST_DRIFT * level.size
    expectation = np.clip(expected_level(b, level)[0], -most, most)
    watch, live = DisturbanceWatch(Drift(level.size, level.seconds, noise)), np.empty(n)
    for i in range(n):
        for k in range(50):  # as many a block as blocks follow without a break
            belief = watch.take(round((BLOCK_S * i + 0.1 * k) * 1e9), mean[i], 5.0)
            live[i] = belief.torque_nm if k == 0 else live[i]
    assert np.abs(live[1:] - expectation[1:]).max() < 0.1 * noise + 0.02 * np.abs(expectation).max()
    assert np.abs(mean - expectation).mean() < 0.7 * np.abs(mean).mean()

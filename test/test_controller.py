# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The controller of examples/07_controller.py takes the feed-forward only when it may, by the limits of docs/node.md."""

import itertools
import re

import pytest


@pytest.fixture(scope="module")
def example(imported):
    return imported("examples/07_controller.py")


def test_the_page_has_the_limits_of_the_example(example, repository):
    page = (repository / "docs" / "node.md").read_text(encoding="utf-8")
    rule = page.partition("### What to do on each status")[2].partition("\n### ")[0]
    for limit_s in (example.SILENCE_S, example.OLDEST_S, example.FARTHEST_AHEAD_S):
        assert re.search(rf"(?<![\d.]){limit_s:g} s\b", rule)


def run(drive, seconds, stamp_age_s, level, start_s=1000.0, torque=3000.0):
    used = []
    for step in range(round(seconds / 0.02)):
        now = start_s + 0.02 * step
        if stamp_age_s is not None:
            drive.on_estimate(now - stamp_age_s, torque, level)
        drive.torque(now, 5.0, 5.0)
        used.append(drive.used)
    return used


@pytest.mark.parametrize("level", range(4))
@pytest.mark.parametrize("age_s", [None, -3600.0, -0.1, -0.01, 0.0, 0.3, 1.9, 2.1, 3600.0])
def test_all_that_comes_is_added_but_faults_and_other_times(example, age_s, level):
    used = run(example.Drive(), 2.0, age_s, level)
    good = age_s is not None and -0.05 <= age_s <= 2.0 and level != 2
    assert used[-1] == (3000.0 if good else 0.0)


def test_feedforward_needs_a_message_and_ends_when_none_comes(example):
    assert run(example.Drive(), 2.0, None, 0)[-1] == 0.0
    drive = example.Drive()
    assert run(drive, 2.0, 0.01, 0)[-1] == 3000.0
    used = run(drive, 3.0, None, 0, start_s=1002.0)
    assert used[round(0.16 / 0.02)] == 3000.0
    assert used[round(0.24 / 0.02)] < 3000.0
    assert used[round(0.9 / 0.02)] == 0.0


def test_it_comes_and_goes_by_its_ramp(example):
    drive = example.Drive()
    used = run(drive, 2.0, 0.01, 0) + run(drive, 2.0, 0.01, 2, start_s=1002.0)
    used += run(drive, 2.0, 0.01, 0, start_s=1004.0) + run(drive, 2.0, None, 0, start_s=1006.0)
    assert max(used) == 3000.0
    assert used[-1] == 0.0
    assert all(abs(b - a) <= 5000.0 * 0.02 + 1e-6 for a, b in itertools.pairwise(used))

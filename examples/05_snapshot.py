# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stop and go on: bit-equal to never having stopped; and begin again after an hour off, with belts that have cooled."""

from pathlib import Path

import numpy as np

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.snapshot import after_time_off, resume, save
from trackres_ros.vehicle import load

state_file = Path("state.json")
estimator = Estimator(load("xgd24d"))
count, half = 120_000, 60_000  # 20 minutes at 100 Hz
stamps = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(count)
speeds = np.full(count, 50 / 3.6)
channel = np.zeros(count, dtype=np.int16)


def drive(session, part):
    """Feed a part of the drive; the results."""
    return session.handle_block(channel[part], stamps[part], stamps[part], speeds[part]).rows


through = drive(estimator.session(), slice(None))
first = estimator.session()
drive(first, slice(0, half))
save(first, state_file, saved_at=stamps[half - 1] * 1e-9)
second = drive(resume(estimator, state_file), slice(half, None))
same = np.array_equal(second, through[half:], equal_nan=True)
print(f"Resumed after 600 s: the same bits as without a stop: {same}")
if not same:
    raise SystemExit("the resumed results differ")

warm, cooled = resume(estimator, state_file), after_time_off(estimator, state_file, stamps[half - 1] * 1e-9 + 3600.0)
session, off = cooled
print(f"Belts when stopped {warm.belts[0, 0, 0]:.1f} degC, after {off:.0f} s off {session.belts[0, 0, 0]:.1f} degC")

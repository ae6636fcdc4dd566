# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnose recordings whose torque has something in it that the model lacks: here simulated ones, with turning scrub."""

import tempfile
from pathlib import Path

import numpy as np

import trackres_ros as tr
from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.synthetic import drives, write_recordings

loaded, scrub, rng = load_base("xgd24d"), tr.effects.catalogue()["turning_scrub"], np.random.default_rng(1)
with tempfile.TemporaryDirectory() as folder:
    sessions = drives(loaded.base, loaded.known.max_speed, count=2, minutes=8.0, rng=rng)
    paths = write_recordings(loaded.base, Path(folder), sessions, [tr.effects.Active(scrub, {"friction": 0.3})], rng)
    found = tr.diagnose(paths, "xgd24d", hide=["belt"], quick=True)

print(found.status, "-", found.sentence)
for effect in found.effects:
    for name, value in effect.values.items():
        sure = effect.intervals[name]
        print(f"{effect.name}: {name} = {value:.3f}, 95 % from {sure.low:.3f} to {sure.high:.3f}")

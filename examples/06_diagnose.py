"""Diagnose recordings whose torque has something in it that the model lacks: here simulated ones, with turning scrub."""

import tempfile
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis import diagnose, load_base, read_recordings
from trackres_ros.diagnosis.trial import drives, write_recordings
from trackres_ros.effects import Active, catalogue

loaded, scrub, rng = load_base("xgd24d"), catalogue()["turning_scrub"], np.random.default_rng(1)
with tempfile.TemporaryDirectory() as folder:
    sessions = drives(loaded.base, loaded.known.max_speed, count=2, minutes=8.0, rng=rng)
    paths = write_recordings(loaded.base, Path(folder), sessions, [Active(scrub, {"friction": 0.3})], rng)
    found = diagnose(read_recordings(paths, topics=None), loaded, hide=["belt"], quick=True)

print(found.verdict.status, "-", found.verdict.sentence)
for effect in found.found:
    for name, value in effect.values.items():
        sure = effect.intervals[name]
        print(f"{effect.name}: {name} = {value:.3f}, 95 % from {sure.low:.3f} to {sure.high:.3f}")

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Summary of the recordings, as plain data of report.json."""

from __future__ import annotations

from typing import Any

import numpy as np

from trackres_ros.diagnosis.base.variables import BY_NAME, varying
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.report.series import runs

BINS, CELLS = 24, (24, 12)  # of a histogram; of speed and acceleration


def inputs(d: Diagnosis) -> dict[str, Any]:
    """Summary of the recordings as plain data: the length and gaps of each [s], the range and histogram of each variable."""
    used = np.concatenate([s.used for s in d.sessions])
    recordings = []
    for s in d.sessions:
        gaps = [end - begin for begin, end in runs(s, ~s.used)]
        recordings.append(
            {
                "name": s.name, "seconds": float(len(s) * s.step), "compared_s": float(s.used.sum() * s.step),
                "held_out_s": float(d.split.held_out_mask(s).sum() * s.step), "gaps": len(gaps),
                "longest_gap_s": float(max(gaps, default=0.0)), "laps": len(np.unique(s.block)),
                "measured": sorted(s.given),
            }
        )  # fmt: skip
    series = {"torque": np.concatenate([s.torque for s in d.sessions])[used]}
    series |= {name: of[used] for name, of in varying(d.sessions, d.refitted.predicted).items()}
    ranges = []
    for name, of in series.items():
        low, middle, high = (_short(q) for q in np.quantile(of, (0.0, 0.5, 1.0)))
        unit = "Nm" if name == "torque" else BY_NAME[name].unit
        seconds = (np.histogram(of, BINS)[0] * d.sessions[0].step).tolist()
        ranges.append({"variable": name, "unit": unit, "low": low, "median": middle, "high": high, "histogram_s": seconds})
    return {"step_s": d.sessions[0].step, "recordings": recordings, "ranges": ranges, "coverage": _coverage(d)}


def _coverage(d: Diagnosis) -> dict[str, Any]:
    """Compared seconds by speed and acceleration: one row for each range of the acceleration, the least first."""
    used = np.concatenate([s.used for s in d.sessions])
    speed = np.concatenate([s.speed for s in d.sessions])[used]
    accel = np.concatenate([s.accel_around for s in d.sessions])[used]
    counts, speeds, accels = np.histogram2d(speed, accel, CELLS)
    seconds = (counts.T * d.sessions[0].step).tolist()
    ends = {"speed": [_short(speeds[0]), _short(speeds[-1])], "acceleration": [_short(accels[0]), _short(accels[-1])]}
    return {**ends, "seconds": seconds}


def _short(value: float) -> float:
    return float(np.format_float_positional(value, 4, fractional=False))

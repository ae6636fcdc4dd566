# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows of a fleet's results without the analysis that makes them."""

from datetime import datetime

import numpy as np

NAMES = ("bearing_friction", "loss_modulus_scale")


def row(number, vehicle="truck-01", month="2026-03"):
    """A row of a recording, as an analysis makes it; numbers from 0 are days of the month."""
    start = datetime.fromisoformat(f"{month}-{number + 1:02d}T12:00+00:00")
    drawn = np.random.default_rng(number).standard_normal((40, 2)) * 5.0
    precision = drawn.T @ drawn
    upper = np.triu_indices(2)
    finite = {"duration_s": 600.0, "mismatch": 0.1, "mean_torque": 900.0, "mean_speed": 5.0, "mean_weight": 2e5,
              "mean_ambient": 15.0, "compared_s": 500.0, "residual_mean": 0.0, "residual_std": 20.0}  # fmt: skip
    return {
        "url": f"{vehicle}/{start:%Y-%m-%d}.mcap", "stamp": str(number), "inputs": "i", "content": "c", "status": "good",
        "reason": "",
        "vehicle": vehicle, "day": f"{start:%Y-%m-%d}", "start_s": start.timestamp(), "distance_m": 3000.0,
        "resistance_mj": 3.0, "drive_mj": 3.0, "held_out_file": 20.0, "held_out_refit": 15.0, "names": list(NAMES),
        "units": ["1", "1"], "findings": [], "notes": [], "nominal": [0.01, 1.0], "std": [0.002, 0.1], "point": [0.01, 1.0],
        "covariance": [1e-6, 0.0, 1e-4], "precision": precision[upper].tolist(), "linear": (precision @ [0.1, 0.2]).tolist(),
        **finite,
    }  # fmt: skip


REPORT = {
    "verdict": {"status": "none", "sentence": "No mismatch"}, "effects": [],
    "base": {"refitted": {"bearing_friction": {"value": 0.01, "unit": "1", "ci95": [0.009, 0.011]}}},
}  # fmt: skip

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Robust least squares against brakes, shocks and slopes."""

from __future__ import annotations

import numpy as np

from trackres_ros.diagnosis.prepare.session import Array
from trackres_ros.units import MAD_TO_STD

TURNS, OUTLIER = 10, 1.5  # Huber's


def robust_least_squares(columns: Array, y: Array) -> Array:
    """Least squares with less weight on outliers; columns may be collinear."""
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-12)
    weight = np.ones(len(y))
    values = np.zeros(columns.shape[1])
    for _ in range(TURNS):
        root = np.sqrt(weight)
        values = np.linalg.lstsq(columns / scale * root[:, np.newaxis], y * root, rcond=None)[0] / scale
        left = np.abs(y - columns @ values)
        weight = np.minimum(1.0, OUTLIER * MAD_TO_STD * float(np.median(left)) / np.maximum(left, 1e-12))
    return values

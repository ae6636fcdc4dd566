# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tests whether a named effect has one size: early and late, with cold and hot belts, slow and fast, first and last recording.

A name stands for a mechanism with constant values. Where its size surely changes, another mechanism has been given its name.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array, Mask
from trackres_ros.diagnosis.selection.level_errors import Levels
from trackres_ros.diagnosis.selection.visibility import FORM_ERROR, base_columns

SURELY = 2.5  # standard deviations
LEAST = 2.0 * FORM_ERROR  # of its size: a smaller change may be an error of its function
LEAST_FALL = 0.05  # of the mean error of levels left out: a changing size that predicts no better is an error of its function
CLUSTER_S = 60.0  # of blocks whose errors are alike
CONDITIONS = {"late in a drive": "early", "with hot belts": "cold", "fast": "slow", "in later recordings": "earlier ones"}


def find_instabilities(fit: Fit, name: str, used_masks: Sequence[Mask]) -> list[str]:
    """Where the size of an effect surely differs, in words after its name; at most one."""
    levels, is_known = Levels(fit, base_columns(fit), used_masks), np.concatenate(list(used_masks))
    torque = np.concatenate(fit.contribution(name))
    worst_share, faults = LEAST, []
    for (condition, opposite_condition), series in zip(CONDITIONS.items(), _conditions(fit), strict=True):
        if not np.ptp(series[is_known]) > 0.0:  # nan where a belt temperature is unknown
            continue
        changing_torque = torque * np.clip((series - series[is_known].mean()) / series[is_known].std(), -2.0, 2.0)
        change, std = levels.change_of(torque, changing_torque, CLUSTER_S)
        excess = abs(change) - SURELY * std
        if excess > worst_share and levels.falls(changing_torque) > LEAST_FALL:
            worst_share, comparison = excess, "larger" if change > 0.0 else "smaller"
            faults = [f"has no constant size: it is {comparison} {condition} than {opposite_condition}"]
    return faults


def _conditions(fit: Fit) -> list[Array]:
    """Variables of the `CONDITIONS`, all sessions concatenated."""
    sessions = fit.problem.sessions
    late_shares = [(s.time > s.time[len(s) // 2]).astype(np.float64) for s in sessions]
    recording = [np.full(len(s), float(i)) for i, s in enumerate(sessions)]
    belts = [p.belt for p in fit.predicted] if fit.problem.base.has_belt else [np.full(len(s), math.nan) for s in sessions]
    return [np.concatenate(x) for x in (late_shares, belts, [np.abs(s.speed) for s in sessions], recording)]

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds the hidden physics of a town: the slope of its streets, loads changed at stops, and soft or rough ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from proofs.sealed.drives import Array, SealedDrive
from proofs.sealed.phenomenon import Adds, Journey

LOAD = "stretch_load"
STAYS = 0.5  # share of the people who stay on at a stop


def loaded(drive: SealedDrive, p: Mapping[str, float], driven: float) -> SealedDrive:
    """The same drive with a load between one stop and the next, up to a `share` of its weight.

    People get on and off a few at a time; `bulk` is either present or not.
    """
    assert drive.street is not None
    rng = np.random.default_rng([int(p["seed"]), int(driven)])
    count = int(drive.street.stretch.max()) + 1
    load = rng.uniform(0.0, 1.0, count)
    if p["bulk"]:
        full = np.arange(count) % 2 == rng.integers(2)
        load = np.where(full, 0.8 + 0.2 * load, 0.05 * load)
    else:
        for k in range(1, count):
            load[k] = STAYS * load[k - 1] + (1.0 - STAYS) * load[k]
    return replace(drive, weight=drive.weight * (1.0 + p["share"] * load[drive.street.stretch]))


def _slope(at: Journey, _p: Mapping[str, float], _: Array) -> Array:
    """The slope of a street that was not surveyed: its steepness is that of the town."""
    assert at.drive.street is not None
    return at.climbing(at.drive.street.slope)


def _ground(at: Journey, p: Mapping[str, float], _: Array) -> Array:
    """Soft or rough ground on some streets, which takes the same either way; each pass runs on another line."""
    assert at.drive.street is not None
    rng = np.random.default_rng([int(p["seed"]), int(at.driven)])
    line = 1.0 + at.lagged(rng.normal(0.0, 0.1 * np.sqrt(2.0 * 40.0 / at.step), len(at.speed)), 40.0, 0.0)
    return p["torque"] * at.drive.street.softness * line * at.load * at.direction


PHENOMENA: dict[str, Adds] = {"street_slope": _slope, "street_ground": _ground}
"""Additional torques; `LOAD` is in the weight."""

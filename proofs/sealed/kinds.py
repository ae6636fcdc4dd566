# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Slow physics outside of any catalogue, of known kinds: a seal, a parking brake and the winding of a motor.

Each is a program with a memory that no drawn program has. No code of the effects or of the described terms is used here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from proofs.sealed.drives import Array
from proofs.sealed.phenomenon import Journey

STANDING_MPS = 0.1
LONG_STOP_S = 20.0  # standing so long, the brake is set
WINDING_S = 450.0  # time constant of a winding's temperature
HOTTEST = 2.0  # over the warmth at rated torque: there a motor's control limits the torque


@dataclass(frozen=True)
class Kind:
    """A kind of slow physics: its words, its entry point, the variables that it follows, and how they give its strength."""

    words: str
    entry: str  # of `programs.ENTRIES`
    variables: tuple[str, ...]
    ranges: tuple[tuple[float, float], ...]  # of its draws
    strength: Callable[..., Array]  # by the drive, the torque without it [Nm] and the draws; between -`HOTTEST` and 1


def _seal(at: Journey, _: Array, log_m: float) -> Array:
    return np.asarray(np.exp(-at.distance / np.exp(log_m)))


def _parking_brake(at: Journey, _: Array, log_s: float) -> Array:
    """Full after a long stop; its linings wear free while driving, and a short stop changes nothing."""
    keep = np.exp(-at.step / np.exp(log_s))
    out, now, stood = np.empty(len(at.travel)), 0.0, 0.0
    for i, stands in enumerate((at.travel < STANDING_MPS).tolist()):
        stood = stood + at.step if stands else 0.0
        now = 1.0 if stood > LONG_STOP_S else now if stands else now * keep
        out[i] = now
    return out


def _winding(at: Journey, torque: Array, rated: float) -> Array:
    return -np.minimum(at.lagged((torque / rated) ** 2, WINDING_S, 0.0), HOTTEST)


KINDS: dict[str, Kind] = {
    "seal": Kind("a seal whose drag fades with the distance run", "torque", ("distance",), ((7.6, 9.2),), _seal),
    "parking brake": Kind(
        f"a parking brake that drags after stops longer than {LONG_STOP_S:.0f} s", "torque", ("time since a stop",),
        ((3.0, 5.0),), _parking_brake,
    ),
    "winding": Kind(
        "a motor torque whose gain falls as the winding warms", "gain", ("driving torque",), ((3000.0, 6000.0),), _winding
    ),
}  # fmt: skip
"""Draws: of a seal the logarithm of 2 to 10 km, of a brake that of 20 to 150 s of driving, of a motor its rated torque [Nm]."""

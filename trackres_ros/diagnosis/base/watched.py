# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A torque that follows nothing known ahead, only the clock: a series found in what a fit leaves, fitted along in size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.effect import REFERENCE_NM, Effect, Parameter

Array = NDArray[np.float64]

TYPICAL_NM, MOST_NM = 150.0, 20_000.0  # of a vehicle of `REFERENCE_NM`
WATCHED = "watched"


class Watched(Effect):
    """A series for each session, times a size.

    Parameters
    ----------
    shape
        Of each session, in the order of the problem: shape (n,), about 1 where it acts; zero on laps that are not fitted.
    size
        Of the vehicle, weight times wheel radius [Nm].
    """

    acts_on = WATCHED
    belongs_to = "vehicle"
    needs = ()

    def __init__(self, name: str, text: str, shape: Sequence[Array], size: float) -> None:
        self.name, self.text, self.shape = name, text, tuple(shape)
        most, typical = MOST_NM * size / REFERENCE_NM, TYPICAL_NM * size / REFERENCE_NM
        self.parameters = (Parameter("level", "Nm", -most, most, typical, "where it acts", off=0.0),)

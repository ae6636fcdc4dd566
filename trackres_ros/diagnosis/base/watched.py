# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A torque that follows nothing known ahead, only the clock: a series found in what a fit leaves, fitted along in size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trackres_ros.effects.effect import REFERENCE_NM, Effect
from trackres_ros.effects.learned import height

Array = NDArray[np.float64]

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
        self.parameters = (height("level", "torque where it acts").times(size / REFERENCE_NM),)

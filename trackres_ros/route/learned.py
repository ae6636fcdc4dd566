# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What was learned of the places of a route, and what it says where a vehicle is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trackres_ros.route.matching import Places
from trackres_ros.route.track import Frame

Array = NDArray[np.float64]

SLOPE, TORQUE = "slope", "torque"


@dataclass(frozen=True, eq=False)
class RouteMap:
    """A slope or a torque by place; arrays of shape (places,), or (places, 2).

    Attributes
    ----------
    kind
        `SLOPE`: rise over run the way a place points; `TORQUE`: against travel [Nm].
    latitude, longitude
        [rad].
    course
        The way a place points, about the upward axis from east [rad].
    value, std
        Of one who travels the way a place points, and the other way; nan where that was not driven. Shape (places, 2).
    passes
        How often it was passed where it was learned.
    """

    kind: str
    latitude: Array
    longitude: Array
    course: Array
    value: Array
    std: Array
    passes: NDArray[np.int64]

    def times(self, factor: float) -> RouteMap:
        """The same with values so many times as large."""
        return replace(self, value=factor * self.value, std=abs(factor) * self.std)

    @cached_property
    def frame(self) -> Frame:
        """Local metres about the middle of it."""
        return Frame(float(np.median(self.latitude)), float(np.median(self.longitude)))

    @cached_property
    def places(self) -> Places:
        """The places, to be looked up."""
        x, y = self.frame.metres(self.latitude, self.longitude)
        return Places(*(part.tolist() for part in (x, y, np.cos(self.course), np.sin(self.course))))

    def at(self, x: float, y: float, east: float, north: float) -> tuple[float, float]:
        """Value and standard deviation for one who travels in a direction at a place [m], of a slope the rise along the travel;
        nan where nothing was learned.
        """
        places, shares, signs = self.places.between(x, y, east, north)
        total, spread, weight = 0.0, 0.0, 0.0
        for place, share, sign in zip(places, shares, signs, strict=True):
            value = self.value[place, int(sign < 0.0)] if place >= 0 else np.nan
            if share > 0.0 and np.isfinite(value):
                total, spread, weight = total + share * value, spread + share * self.std[place, int(sign < 0.0)], weight + share
        return (total / weight, spread / weight) if weight > 0.0 else (np.nan, np.nan)

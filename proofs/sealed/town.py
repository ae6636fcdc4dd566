# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Draws a town: streets on a grid, the height of the ground, streets of soft or rough ground, and one that no satellite sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.arrays import Array

Crossing = tuple[int, int]

BLOCKS_M = (150.0, 400.0)
COLUMNS, ROWS = 3, (3, 4)  # of crossings
WAVES, WAVES_M = 16, (250.0, 700.0)  # of the ground
STREET_HALF_M = 20.0  # from the middle of a street on, nothing of it is felt or covered any more
EDGE_M = 12.0  # over which soft ground begins
SOFT_STREETS = 0.3  # share of the streets
SOFT_SIZES = (0.4, 1.0)  # of the softest
COVERED_TOWNS = 0.5  # share of the towns in which trees or walls hide the satellites in one street
SOUNDED_M = 5.0  # along streets, to find the steepest place


@dataclass(frozen=True)
class Patch:
    """A part of a street between two places [m], of a size of its own."""

    begin: tuple[float, float]
    end: tuple[float, float]
    size: float = 1.0

    def along(self, x: Array, y: Array) -> tuple[Array, Array]:
        """How far places are along it from its begin, and aside of it [m]."""
        (x0, y0), (x1, y1) = self.begin, self.end
        east, north = (x1 - x0) / self.length, (y1 - y0) / self.length
        return (x - x0) * east + (y - y0) * north, (x - x0) * north - (y - y0) * east

    @property
    def length(self) -> float:
        """From its begin to its end [m]."""
        return float(np.hypot(self.end[0] - self.begin[0], self.end[1] - self.begin[1]))


@dataclass(frozen=True, eq=False)
class Town:
    """Streets on a grid, and the ground below them.

    `waves` are those of the height: wave numbers to the east and to the north [rad/m], phases [rad] and amplitudes [m], shape
    (4, waves); the steepest place of all streets has a slope of 1.
    """

    east: Array  # of the streets that run north [m], shape (columns,)
    north: Array  # of those that run east [m], shape (rows,)
    waves: Array
    soft: tuple[Patch, ...]  # parts of streets on which driving is harder
    covered: Patch | None  # part of a street where no satellite is seen
    radius: float  # of the bends at crossings, in the middle of the street [m]
    stops: dict[tuple[Crossing, Crossing], float]  # by street its place as a share, from the crossing that comes first in order

    def at(self, crossing: Crossing) -> Array:
        """Where a crossing is [m], shape (2,)."""
        return np.array([self.east[crossing[0]], self.north[crossing[1]]])

    def neighbours(self, crossing: Crossing) -> list[Crossing]:
        """Crossings a block away."""
        i, j = crossing
        near = ((i + 1, j), (i, j + 1), (i - 1, j), (i, j - 1))
        return [(k, m) for k, m in near if 0 <= k < len(self.east) and 0 <= m < len(self.north)]

    @property
    def streets(self) -> list[tuple[Crossing, Crossing]]:
        """Blocks between two crossings, the first in order first."""
        crossings = [(i, j) for i in range(len(self.east)) for j in range(len(self.north))]
        return [(one, other) for one in crossings for other in self.neighbours(one) if one < other]

    def height(self, x: Array, y: Array) -> Array:
        """Height of the ground [m] for a steepest slope of 1."""
        kx, ky, phase, size = self.waves
        return np.asarray(np.sin(np.multiply.outer(x, kx) + np.multiply.outer(y, ky) + phase) @ size)

    def slope(self, x: Array, y: Array, heading: Array) -> Array:
        """Rise over run in a direction [rad, from east to north], for a steepest slope of 1."""
        kx, ky, phase, size = self.waves
        swing = np.cos(np.multiply.outer(x, kx) + np.multiply.outer(y, ky) + phase) * size
        return np.asarray((swing @ kx) * np.cos(heading) + (swing @ ky) * np.sin(heading))

    def softness(self, x: Array, y: Array) -> Array:
        """How soft or rough the ground is: of the softest street nearly 1, else less, mostly 0."""
        out = np.zeros(len(x))
        for patch in self.soft:
            along, aside = patch.along(x, y)
            inside = np.tanh(along / EDGE_M) - np.tanh((along - patch.length) / EDGE_M)
            out += 0.5 * patch.size * inside * (np.abs(aside) < STREET_HALF_M)
        return out

    def hidden_from_above(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Where no satellite is seen."""
        if self.covered is None:
            return np.zeros(len(x), dtype=bool)
        along, aside = self.covered.along(x, y)
        return np.asarray((along > 0.0) & (along < self.covered.length) & (np.abs(aside) < STREET_HALF_M))


def draw_town(rng: np.random.Generator) -> Town:
    """A town of its own."""
    east, north = (_grid(count, rng) for count in (COLUMNS, int(rng.choice(ROWS))))
    length, towards = rng.uniform(*WAVES_M, WAVES), rng.uniform(0.0, 2.0 * np.pi, WAVES)
    number = 2.0 * np.pi / length
    phase, size = rng.uniform(0.0, 2.0 * np.pi, WAVES), rng.normal(size=WAVES) / number
    waves = np.array([number * np.cos(towards), number * np.sin(towards), phase, size])
    bare = Town(east, north, waves, (), None, float(rng.uniform(10.0, 18.0)), {})
    waves[3] /= _steepest(bare)
    streets = bare.streets
    order = rng.permutation(len(streets))
    soft_ones = max(2, round(SOFT_STREETS * len(streets)))
    sizes = rng.uniform(*SOFT_SIZES, soft_ones)
    soft = tuple(
        _part(bare, streets[k], rng, float(size)) for k, size in zip(order[:soft_ones], sizes / sizes.max(), strict=True)
    )
    covered = _part(bare, streets[order[-1]], rng) if rng.random() < COVERED_TOWNS else None
    stops = {street: float(rng.uniform(0.35, 0.65)) for street in streets if rng.random() < 0.4}
    return Town(east, north, waves, soft, covered, bare.radius, stops)


def _grid(count: int, rng: np.random.Generator) -> Array:
    return np.concatenate(([0.0], np.cumsum(rng.uniform(*BLOCKS_M, count - 1))))


def _part(town: Town, street: tuple[Crossing, Crossing], rng: np.random.Generator, size: float = 1.0) -> Patch:
    """Most of a street, without its crossings."""
    begin, end = (town.at(crossing) for crossing in street)
    first, last = rng.uniform(0.15, 0.25), rng.uniform(0.75, 0.85)
    (x0, y0), (x1, y1) = (begin + share * (end - begin) for share in (first, last))
    return Patch((float(x0), float(y0)), (float(x1), float(y1)), size)


def _steepest(town: Town) -> float:
    found = []
    for street in town.streets:
        begin, end = (town.at(crossing) for crossing in street)
        share = np.linspace(0.0, 1.0, int(np.abs(end - begin).sum() / SOUNDED_M) + 2)
        x, y = (begin[i] + share * (end[i] - begin[i]) for i in (0, 1))
        heading = np.full(len(x), np.arctan2(end[1] - begin[1], end[0] - begin[0]))
        found.append(float(np.abs(town.slope(x, y, heading)).max()))
    return max(found)

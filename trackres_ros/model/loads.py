# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Distributes the load over the road wheels through the tree of balance beams, equation (1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.vehicle import Beam, Track


def beam_shares(track: Track, own_weight: bool = False) -> Array:
    """Share of the load that each road wheel carries, shape (wheels,), sum 1.

    Parameters
    ----------
    track
        The assembly's geometry.
    own_weight
        Take the split of the assembly's own weight (alpha_2) at the top beam instead of the axle load's (alpha_1).

    Notes
    -----
    Equation (1) with its stage-1 matrix corrected to [[1-a1, 1-a2], [a1, a2]]: as printed the columns of the second row
    are swapped, and the loads do not sum to the weight. A beam of any depth and road wheels of any number follow alike.
    """
    shares = np.zeros(len(track.road_wheels.positions))

    def hang(end: Beam | int, share: float) -> None:
        if isinstance(end, Beam):
            split = end.own_weight_split if own_weight else end.split
            hang(end.front, share * (1.0 - split))
            hang(end.rear, share * split)
        else:
            shares[end] += share

    hang(track.beams, 1.0)
    return shares


def hinge_position(track: Track, own_weight: bool = False) -> float:
    """Position [m] on the ground run below which the load acts on the top beam: where moments balance."""
    return float(beam_shares(track, own_weight) @ np.array(track.road_wheels.positions))


def wheel_loads(track: Track, load: ArrayLike) -> Array:
    """Load [N] of each road wheel, shape (..., wheels).

    Parameters
    ----------
    load
        Load on the assembly with its own weight [N], any shape.
    """
    total = np.asarray(load, dtype=float)[..., np.newaxis]
    own = np.minimum(track.own_weight, total)
    return np.asarray((total - own) * beam_shares(track) + own * beam_shares(track, own_weight=True))

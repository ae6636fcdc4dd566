# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cuts a session into laps, at its stops, or into pieces of equal length if there are too few stops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.session import DriveSession
from trackres_ros.diagnosis.prepare.settings import SLOWEST_MPS

FULL_STOP_S = 5.0
PIECES, SHORTEST_PIECE_S, LONGEST_PIECE_S = 20, 60.0, 300.0
FEWEST_DRIVES = 8


def lap_numbers(session: DriveSession) -> NDArray[np.int64]:
    """Number of the drive between two stops, if there are enough stops; else of a piece of equal length.

    Returns
    -------
    ndarray of int64, shape (n,)
        From 0, rising by 1 from lap to lap.
    """
    standing = np.abs(session.speed) < SLOWEST_MPS
    begins = np.flatnonzero(np.diff(standing.astype(int), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(standing.astype(int), append=0) == -1)
    full_stop = FULL_STOP_S * session.pace
    cuts = [b for b, e in zip(begins, ends, strict=True) if (e - b + 1) * session.step >= full_stop and 0 < b < len(session)]
    if len(cuts) >= FEWEST_DRIVES - 1:
        return np.searchsorted(np.array(cuts), np.arange(len(session)), side="right").astype(np.int64)
    duration = len(session) * session.step
    length = min(max(duration / PIECES, SHORTEST_PIECE_S * session.pace), LONGEST_PIECE_S * session.pace)
    pieces = max(1, int(duration // length))
    return np.minimum((np.arange(len(session)) * pieces) // len(session), pieces - 1).astype(np.int64)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The recorded channel that comes closest to a torque of the clock, a place or a drift, and how much of it that explains.

The torque of a lap is predicted by the means of the other laps in cells of equal samples: of one channel, or of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.variables import BY_NAME, varying
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array

FOLLOWS_LEAST = 0.3  # of the mean square: a smaller share means that a torque follows no variable
CLEARLY = 1.25  # times the share of a simpler or better known variable: needed to attribute a torque to another
CELLS, CELLS_OF_PAIR = 12, 4  # of a channel, alone and with another


def closest_channel(fit: Fit, torques: Sequence[Array]) -> str:
    """Sentence on the recorded channel, or the two, that explain most of a torque of each session; nan where unknown."""
    sessions, torque = fit.problem.sessions, np.concatenate(torques)
    used = np.concatenate([s.used for s in sessions]) & np.isfinite(torque)
    _, laps = np.unique(np.concatenate([s.block for s in sessions])[used], return_inverse=True)
    known = {name: x for name, x in varying(sessions, fit.predicted).items() if not BY_NAME[name].as_clock}
    known["driving torque"] = np.concatenate([p.at_sprockets * s.ahead for p, s in zip(fit.predicted, sessions, strict=True)])
    if all("grade" in s.given for s in sessions):
        known["slope"] = np.concatenate([s.grade for s in sessions])
    channels = {name: x[used] for name, x in known.items() if np.isfinite(x[used]).all() and used.any()}
    if not channels:
        return "No channel is known throughout"
    coarse = {name: _cells(x, CELLS_OF_PAIR) for name, x in channels.items()}
    shares: dict[tuple[str, ...], float] = {}
    for name, x in channels.items():
        shares[(name,)] = _explained(torque[used], _cells(x, CELLS), laps)
    for a, b in combinations(channels, 2):
        shares[a, b] = _explained(torque[used], CELLS_OF_PAIR * coarse[a] + coarse[b], laps)
    best = max(shares, key=lambda names: shares[names] / (CLEARLY if len(names) > 1 else 1.0))
    name, share = " with ".join(best), f"{100.0 * shares[best]:.0f} %"
    if shares[best] < FOLLOWS_LEAST:
        return f"It follows no recorded or simulated channel: the best, {name}, explains {share} of it"
    return f"Of the recorded and simulated channels, {name} comes closest: it explains {share} of it"


def evenly_filled(x: Array, bins: int) -> tuple[Array, NDArray[np.int64]]:
    """Edges of at most `bins` equally filled bins, and the bin of each sample."""
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, bins + 1)))
    return edges, np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))


def _cells(x: Array, bins: int) -> NDArray[np.int64]:
    return evenly_filled(x, bins)[1]


def _explained(torque: Array, cells: NDArray[np.int64], laps: NDArray[np.int64]) -> float:
    """Share of the variance of a torque that the means of its cells over the other laps explain, at least zero."""
    number, width = int(laps.max()) + 1, int(cells.max()) + 1
    at = laps * width + cells
    size = number * width
    count, total = (np.bincount(at, w, size).reshape(number, width) for w in (None, torque))
    others, sums = (x.sum(axis=0) - x if number > 1 else x for x in (count, total))
    means = np.where(others > 0.0, sums / np.maximum(others, 1.0), torque.mean()).ravel()
    variance = float(np.var(torque))
    return max(0.0, 1.0 - float(np.mean((torque - means[at]) ** 2)) / variance) if variance > 0.0 else 0.0

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Decides whether a description is true of a hidden torque: whether its variables correlate with that torque.

A description names variables, a gate, or a temporal pattern. It is true if a function of just that explains the hidden
torque with a partial correlation of at least `BOUND`. The part that a re-fit of the vehicle file can absorb is removed first. The
correlation is that in blocks of time to which the function was not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proofs.sealed.answers import words
from proofs.sealed.kinds import LONG_STOP_S
from trackres_ros.arrays import Array

BOUND = 0.4
ALL, LEVELS = 0.7, 0.92  # correlations: with the main part of a torque; with its levels (a sine has 0.90)
BLOCK_S, BINS, SIDES = 37, 10, 3  # length of a block; bins of a variable; bins of a gate
STANDING_MPS, BRAKING_MPS2 = 0.1, -0.3
MEANT = {
    "yaw rate to the left": ("left", "right"), "yaw rate": ("turn",), "load": ("heavy", "light", "load"),
    "acceleration": ("slow", "brak", "speeds up", "accelerat"), "driving torque": ("torque",),
    "time since start": ("time of day", "since start"), "speed": ("pulls away", "to a stop", "m/s"),
}  # fmt: skip
"""Words that mean a variable without its own name."""
ALSO = {
    "distance": "distance run", "distance since a stop": "distance since a long stop",
    "time since a stop": "time since a long stop",
}  # fmt: skip
"""Second meaning of a variable: since the vehicle's first drive, and since a stop of at least `kinds.LONG_STOP_S`."""
CLOCKS = ("distance", "distance run", "time since start")


def is_true(term: Mapping[str, Any], over: Mapping[str, Array], added: Array, lengths: Array) -> bool:
    """Whether a described term of report.json is true of the hidden torque.

    Variables and torque of the hidden physics [Nm] are by seconds, one drive after the other; `lengths` are those of the drives.
    """
    form = str(term["form"])
    series = {**over, **_since_stops(over, lengths)}
    if form == "spells":
        return _two_levels(np.split(added, np.cumsum(lengths)[:-1]))
    if form == "recordings":
        return partial([np.repeat(np.arange(len(lengths)), lengths.astype(int))], over, added) >= BOUND
    if form == "drift":  # slow, and no single variable explains it
        rivals = [x for name, x in over.items() if name not in CLOCKS]
        return _correlation(_smooth(added, 60), added) >= ALL > max(partial([_bins(x, BINS)], over, added) for x in rivals)
    if form in ("wave", "place"):
        period = term.get("period_m")
        return period is not None and partial([_bins(series["distance"] % float(period), 2 * BINS)], over, added) >= BOUND
    named = [*_named(words(term.get("variable")), series)[:1], *_named(words(term.get("gate")), series)[:1]]
    meant = [[series[x] for x in (name, ALSO.get(name)) if x in series] for name in named]
    return any(
        partial([_bins(x, count) for x, count in zip(xs, (BINS, SIDES), strict=False)], over, added) >= BOUND
        for xs in product(*meant) if xs
    )  # fmt: skip


def partial(groups: list[NDArray[np.int64]], over: Mapping[str, Array], target: Array) -> float:
    """Partial correlation of a torque with a free function of binned variables, given the part that the base can absorb."""
    base = np.column_stack([np.ones(len(target)), over["load"], over["load"] * over["belt temperature"], over["speed"] ** 2])
    base = base / np.abs(base).max(axis=0)
    cells = np.stack([np.all([g == k for g, k in zip(groups, key, strict=True)], axis=0)
                      for key in product(*(range(int(g.max()) + 1) for g in groups))], axis=1)  # fmt: skip
    half = np.arange(len(target)) // BLOCK_S % 2
    errors = np.zeros(2)
    for fitted in (half == 0, half == 1):
        for i, columns in enumerate((base, np.hstack((base, cells)))):
            ridge = 1e-3 * np.sqrt(fitted.sum()) * np.eye(columns.shape[1])
            wanted = np.append(target[fitted], np.zeros(columns.shape[1]))
            found = np.linalg.lstsq(np.vstack((columns[fitted], ridge)), wanted, rcond=None)[0]
            errors[i] += float(((target - columns @ found)[~fitted] ** 2).sum())
    return float(np.sqrt(max(0.0, 1.0 - errors[1] / max(errors[0], 1e-12))))


def _named(text: str, series: Mapping[str, Array]) -> list[str]:
    """Variables that a text names, the longest name first; else those that it implies."""
    given = sorted((name for name in series if name in text), key=len, reverse=True)
    return given or [name for name, meant in MEANT.items() if any(word in text for word in meant)]


def _bins(x: Array, count: int) -> NDArray[np.int64]:
    """Numbers of bins: half of the edges divide the time evenly, half the range."""
    low, high = np.quantile(x, (0.002, 0.998))
    share = np.linspace(0.0, 1.0, count // 2 + 2)[1:-1]
    edges = np.unique(np.concatenate((np.quantile(x, share), low + share * (high - low))))
    return np.searchsorted(edges, x, side="right")


def _since_stops(over: Mapping[str, Array], lengths: Array) -> dict[str, Array]:
    """Distance [m] and time [s] since a stop and since a long one, and time since a deceleration; they restart in each drive.
    Before its first long stop a drive has the largest values.
    """
    second, way = np.arange(len(over["speed"]), dtype=float), np.cumsum(np.abs(over["speed"]))
    begins = np.isin(second, np.cumsum(lengths) - lengths)

    def since(series: Array, event: NDArray[np.bool_]) -> Array:
        return np.asarray(series - np.maximum.accumulate(np.where(event | begins, series, 0.0)))

    stops, slows = np.abs(over["speed"]) < STANDING_MPS, over["acceleration"] < BRAKING_MPS2
    long = stops & (since(second, ~stops) >= LONG_STOP_S)
    none_yet = np.concatenate([np.cumsum(one) == 0 for one in np.split(long, np.cumsum(lengths)[:-1].astype(int))])
    return {
        "distance since a stop": since(way, stops),
        "time since a stop": since(second, stops),
        "distance since a long stop": np.where(none_yet, way[-1], since(way, long)),
        "time since a long stop": np.where(none_yet, second[-1], since(second, long)),
        "braking": since(second, slows),
    }


def _two_levels(added: list[Array]) -> bool:
    """Whether a torque has two levels in each drive, and stays at each for a while."""
    fitted, lasts = [], list[Array]()
    for one in added:
        slow = _smooth(one, 5)
        high = slow > 0.5 * np.sum(np.quantile(slow, (0.05, 0.95)))
        fitted.append(np.where(high, one[high].mean() if high.any() else 0.0, one[~high].mean() if not high.all() else 0.0))
        lasts.append(np.diff(np.flatnonzero(np.diff(high.astype(int)))))
    held = np.concatenate(lasts)
    return (
        len(held) > 0 and float(np.median(held)) >= 5.0 and _correlation(np.concatenate(fitted), np.concatenate(added)) >= LEVELS
    )


def _smooth(x: Array, seconds: int) -> Array:
    window = np.full(seconds, 1.0 / seconds)
    return np.convolve(np.pad(x, seconds // 2, mode="edge"), window, mode="valid")[: len(x)]


def _correlation(one: Array, other: Array) -> float:
    if one.std() < 1e-12 or other.std() < 1e-12:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])

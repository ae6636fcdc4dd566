# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Keeps arrays that take a second to compute in the cache folder, under a key of all their inputs."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.files.cache import fetched, keep, trim, usable
from trackres_ros.files.own_files import SEAL
from trackres_ros.files.resources import cache_dir

SUFFIX = ".arrays"
MOST_KEPT = 500 << 20  # bytes of all tables: those of some 250 diagnoses, each of which fits vehicles of its own
STORED = np.dtype("<f8")


def cached_arrays(
    key: str, shapes: Mapping[str, tuple[int, ...]], compute: Callable[[], Mapping[str, Array]], cache: Path | None = None
) -> dict[str, Array]:
    """Arrays by name, from the cache if intact, else computed and stored.

    `key`: file name without suffix; must change with all inputs of the arrays. `shapes`: by name; arrays are stored one after the
    other, so the shapes define the size of the file. `cache`: the folder, by default `files.resources.cache_dir`; if it cannot be
    used the next start computes again. The oldest tables are removed where all have more than `MOST_KEPT` bytes.
    """
    folder, name = usable(cache or cache_dir()), f"{key}{SUFFIX}"
    sizes = [math.prod(shape) for shape in shapes.values()]
    stored = fetched(folder, name, sum(sizes) * STORED.itemsize + SEAL().digest_size)
    if stored is not None and len(stored) == sum(sizes) * STORED.itemsize:
        numbers = np.frombuffer(stored, dtype=STORED).astype(float)
        parts = np.split(numbers, np.cumsum(sizes)[:-1])
        return {name: part.reshape(shape) for (name, shape), part in zip(shapes.items(), parts, strict=True)}
    arrays = {name: np.asarray(value, dtype=float) for name, value in compute().items()}
    keep(folder, name, b"".join(np.ascontiguousarray(arrays[each], dtype=STORED).tobytes() for each in shapes))
    trim(folder, f"*{SUFFIX}", MOST_KEPT)
    return arrays

"""Arrays that take a second to compute, kept in the cache folder under a key that says all they depend on."""

from __future__ import annotations

import tempfile
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.resources import cache_dir

Array = NDArray[np.float64]
DAMAGED = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error)


def cached_arrays(
    key: str, shapes: Mapping[str, tuple[int, ...]], compute: Callable[[], Mapping[str, Array]], cache: Path | None = None
) -> dict[str, Array]:
    """Arrays by name, from the cache if it holds them whole, else computed and stored.

    Parameters
    ----------
    key
        File name without suffix; must change with everything the arrays depend on.
    shapes
        Names and shapes: a stored file that has others, or values that are not finite, is computed anew.
    cache
        Folder; by default `trackres_ros.resources.cache_dir`. Where it cannot be written the next start computes again.
    """
    path = (cache or cache_dir()) / f"{key}.npz"
    stored = _read(path, shapes)
    if stored is not None:
        return stored
    arrays = {name: np.asarray(value, dtype=float) for name, value in compute().items()}
    _write(path, arrays)
    return arrays


def _read(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Array] | None:
    try:
        with path.open("rb") as stored, np.load(stored) as file:
            arrays = {name: np.asarray(file[name], dtype=float) for name in shapes}
    except DAMAGED:
        return None
    whole = all(arrays[name].shape == shape and np.isfinite(arrays[name]).all() for name, shape in shapes.items())
    return arrays if whole else None


def _write(path: Path, arrays: Mapping[str, Array]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npz", delete=False) as file:
            np.savez(file, allow_pickle=False, **dict(arrays))
        Path(file.name).replace(path)
    except OSError:
        return

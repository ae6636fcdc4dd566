# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Watches the parameter file of a running node: the way to change parameters where there are no parameter services."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from trackres_ros.errors import InputError
from trackres_ros.node.parameters import PARAMETERS, Parameters, Value, known, read_parameters

LOOK_EVERY_S = 1.0
Stamp = tuple[int, int, int]
"""Inode, size and time of change: a file of another stamp is another one."""


class ParameterFile:
    """A parameter file that is looked at every `LOOK_EVERY_S`.

    It is read when it has stood unchanged from one look to the next, so that what an editor is just writing is not taken for what
    is meant. What the command line gave besides stays as it was given there. A file that is gone changes nothing.

    Parameters
    ----------
    path, node, namespace
        As `read_parameters` takes them.
    parameters
        What the node began with.
    overruled
        Names that the command line gave.
    """

    def __init__(self, path: Path, node: str, namespace: str, parameters: Parameters, overruled: Collection[str]) -> None:
        self.path, self._node, self._namespace = path, node, namespace
        self._overruled = frozenset(overruled)
        self._applied: dict[str, Value] = dict(parameters.values)
        self._read = self._seen = _stamp(path)

    def look(self) -> Mapping[str, Value]:
        """Names and values that the file has changed since the last that were applied; mostly none.

        Raises
        ------
        InputError
            For a file that cannot be read, or an entry that is unknown or bad; once for each file.
        """
        stamp = _stamp(self.path)
        settled, self._seen = stamp == self._seen, stamp
        if stamp is None or stamp == self._read or not settled:
            return {}
        self._read = stamp
        given = read_parameters(self.path, self._node, self._namespace)
        meant = {name: known(name).checked(given[name]) if name in given else p.default for name, p in PARAMETERS.items()}
        return {name: value for name, value in meant.items() if name not in self._overruled and value != self._applied[name]}

    def applied(self, changed: Mapping[str, Value]) -> str:
        """Take note that a change was made; what it was, in words."""
        said = ", ".join(f"{name} {_shown(self._applied[name])} -> {_shown(value)}" for name, value in changed.items())
        self._applied.update(changed)
        return f"{self.path}: {said}"

    def refused(self, error: InputError) -> str:
        """Why nothing was changed, in words."""
        return f"{self.path}: no parameter was changed: {error}"


def _stamp(path: Path) -> Stamp | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def _shown(value: Value) -> str:
    return f"[{', '.join(value)}]" if isinstance(value, tuple) else f"{value:g}" if isinstance(value, float) else str(value)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Watches the parameter file of a running node, to change parameters without parameter services."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from trackres_ros.errors import InputError
from trackres_ros.node.parameters import PARAMETERS, Parameters, Value, known, read_entries

LOOK_EVERY_S = 1.0
Stamp = tuple[int, int, int]
"""Inode, size and time of change: a file of another stamp is another one."""


class ParameterFile:
    """A parameter file that is checked every `LOOK_EVERY_S`.

    It is read once it is unchanged between two checks, so that a file that an editor is still writing is not read. So it is after
    the start too: someone may have changed it since the node read it. A refused line leaves its parameter unchanged, and the
    other lines apply. Values of the command line keep priority. A deleted file changes nothing. `parameters` are those at the
    start of the node, and `overruled` the names set on the command line.
    """

    def __init__(self, path: Path, node: str, namespace: str, parameters: Parameters, overruled: Collection[str]) -> None:
        self.path, self._node, self._namespace = path, node, namespace
        self._overruled = frozenset(overruled)
        self._applied: dict[str, Value] = dict(parameters.values)
        self._read: Stamp | None = None
        self._seen: Stamp | None = None

    def look(self, check: Callable[[Mapping[str, Value]], object]) -> tuple[Mapping[str, Value], list[InputError]]:
        """Names and values that differ from those applied last, and an error for each refused line; mostly neither.

        `check` raises InputError for a change that the node refuses.
        """
        stamp = _stamp(self.path)
        settled, self._seen = stamp == self._seen, stamp
        if stamp is None or stamp == self._read or not settled:
            return {}, []
        self._read = stamp
        try:
            given = read_entries(self.path, self._node, self._namespace)
        except InputError as error:
            return {}, [error]
        meant, refused = {name: parameter.default for name, parameter in PARAMETERS.items()}, []
        for name, value in given.items():
            try:
                meant[name] = known(name).checked(value)
            except InputError as error:
                meant.pop(name, None)
                refused.append(error)
        changed = {name: value for name, value in meant.items() if name not in self._overruled and value != self._applied[name]}
        accepted, errors = _accepted(changed, check)
        return accepted, refused + errors

    def applied(self, changed: Mapping[str, Value]) -> str:
        """Record a change; return it as text."""
        said = ", ".join(f"{name} {_shown(self._applied[name])} -> {_shown(value)}" for name, value in changed.items())
        self._applied.update(changed)
        return f"{self.path}: {said}"

    def refused(self, error: InputError) -> str:
        """Refused changes with reasons, as text."""
        return f"{self.path}: refused, and left as it was: {error}"


def _accepted(
    changed: Mapping[str, Value], check: Callable[[Mapping[str, Value]], object]
) -> tuple[dict[str, Value], list[InputError]]:
    """All valid changes, and the errors of the others. Two that depend on each other pass in either order."""
    accepted: dict[str, Value] = {}
    errors: dict[str, InputError] = {}
    waiting = dict(changed)
    while waiting:
        errors = {}
        for name, value in waiting.items():
            try:
                check({**accepted, name: value})
            except InputError as error:
                errors[name] = error
            else:
                accepted[name] = value
        if len(errors) == len(waiting):
            break
        waiting = {name: waiting[name] for name in errors}
    return accepted, list(errors.values())


def _stamp(path: Path) -> Stamp | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def _shown(value: Value) -> str:
    return f"[{', '.join(value)}]" if isinstance(value, tuple) else f"{value:g}" if isinstance(value, float) else str(value)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the smallest blocks in which C can declare the variables of a function, which in Python are valid in all of it."""

from __future__ import annotations

Path = tuple[int, ...]  # a block, within its parents


class Scopes:
    """Records the uses of each variable in the order of the text; the next pass knows the blocks of its declarations."""

    def __init__(self) -> None:
        self._uses: dict[str, list[tuple[Path, bool]]] = {}
        self._blocks: dict[str, list[Path]] = {}
        self._declared: set[tuple[str, Path]] = set()

    def begin(self) -> None:
        """Begin a pass, with the records of the one before."""
        self._blocks = {name: _smallest(uses) for name, uses in self._uses.items()}
        self._uses, self._declared = {}, set()

    @property
    def at_top(self) -> list[str]:
        """Variables that must be declared before all statements."""
        return sorted(name for name, blocks in self._blocks.items() if not blocks)

    def see(self, name: str, block: Path, stored: bool) -> None:
        """A variable is used in a block: it gets a value, or is looked at."""
        self._uses.setdefault(name, []).append((block, stored))

    def declares(self, name: str, block: Path) -> bool:
        """Whether a value stored now is the first in its block, where the variable is declared."""
        if block not in self._blocks.get(name, [block]) or (name, block) in self._declared:
            return False
        self._declared.add((name, block))
        return True


def _smallest(uses: list[tuple[Path, bool]]) -> list[Path]:
    """The outermost blocks that store a variable, if each begins with that and there is no use outside; else none."""
    stores = {block for block, stored in uses if stored}
    outermost = [block for block in stores if not any(block != other and block[: len(other)] == other for other in stores)]
    if any(not any(block[: len(outer)] == outer for outer in outermost) for block, _ in uses):
        return []
    for outer in outermost:
        first = next(use for use in uses if use[0][: len(outer)] == outer)
        if first != (outer, True):
            return []
    return outermost

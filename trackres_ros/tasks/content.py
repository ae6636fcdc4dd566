# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines a result that is a mapping of plain data, ready for JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


class Content(Mapping[str, Any]):
    """A frozen mapping of plain data."""

    def __init__(self, content: Mapping[str, Any]) -> None:
        self._content = dict(content)

    def __getitem__(self, name: str) -> Any:
        return self._content[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._content)

    def __len__(self) -> int:
        return len(self._content)

    def as_dict(self) -> dict[str, Any]:
        """The whole content, ready for JSON.

        Returns
        -------
        dict
            Plain data, with the units in the names.
        """
        return dict(self._content)

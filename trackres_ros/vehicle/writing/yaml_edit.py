# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Changes single values in the text of a YAML file; comments, order, layout and figures stay unchanged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

Path = Sequence[str]

LOADER = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader  # the same marks, by a tenth of the time


class Document:
    """The text of a YAML mapping, with changes to be made in it."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._root = yaml.compose(text, Loader=LOADER)
        self._goal = _unshared(yaml.load(text, LOADER))
        self._edits: dict[tuple[int, int], str] = {}

    def set(self, path: Path, value: Any) -> None:
        """Replace a value, or add a new key at the top."""
        _inside(self._goal, path[:-1])[path[-1]] = value
        node = self._find(path)
        if node is None:
            self._append(f"{path[-1]}: {flow(value)}")
        else:
            start, end = node.start_mark.index, _end(node)
            self._edits[start, end] = flow(value) + ("\n" if self._text[start:end].endswith("\n") else "")

    def add(self, key: str, entries: Mapping[str, Any]) -> None:
        """Add entries to a mapping at the top level, or create it with them."""
        if not entries:
            return
        self._goal.setdefault(key, {}).update(entries)
        lines = [f"{name}: {flow(value)}" for name, value in entries.items()]
        node = self._find((key,))
        if node is None:
            self._append("\n  ".join([f"{key}:", *lines]))
        elif node.flow_style:
            last_index = node.end_mark.index - 1
            self._edits[last_index, last_index] = (", " if node.value else "") + ", ".join(lines)
        else:
            end, indent = _end(node), " " * node.start_mark.column
            if self._text[end - 1] == "\n":
                self._edits[end, end] = "".join(f"{indent}{line}\n" for line in lines)
            else:
                position = self._text.find("\n", end)
                position = len(self._text) if position < 0 else position
                self._edits[position, position] = "".join(f"\n{indent}{line}" for line in lines)

    def put_section(self, key: str, entries: Mapping[str, Any]) -> None:
        """Write a mapping at the top level, one entry a line, replacing an existing one."""
        if self._find((key,)) is None:
            self.add(key, entries)
        else:
            self.set((key,), dict(entries))

    def text(self) -> str | None:
        """The text with all changes; None if they would change anything else."""
        text = self._text
        for (start, end), insert in sorted(self._edits.items(), reverse=True):
            text = text[:start] + insert + text[end:]
        try:
            return text if yaml.load(text, LOADER) == self._goal else None
        except yaml.YAMLError:
            return None

    def plain(self) -> str:
        """The same content without comments and layout."""
        return yaml.safe_dump(self._goal, sort_keys=False, allow_unicode=True, width=130)

    def _append(self, entry: str) -> None:
        end = len(self._text)
        text = self._edits.get((end, end), "" if self._text.endswith("\n") else "\n")
        self._edits[end, end] = f"{text}\n{entry}\n"

    def _find(self, path: Path) -> Any:
        node = self._root
        for key in path:
            node = None if node is None else _child(node, key)
        return node


def flow(value: Any) -> str:
    """A value as YAML within one line."""
    return yaml.safe_dump([value], default_flow_style=True, sort_keys=False, allow_unicode=True, width=math.inf).strip()[1:-1]


def _child(node: yaml.Node, key: str) -> yaml.Node | None:
    if not isinstance(node, yaml.MappingNode):
        return None
    mappings: list[yaml.Node] = []
    for name, value in node.value:
        if name.value == key:
            return value  # type: ignore[no-any-return]
        if name.tag == "tag:yaml.org,2002:merge":
            mappings += value.value if isinstance(value, yaml.SequenceNode) else [value]
    return next((entry for mapping in mappings if (entry := _child(mapping, key)) is not None), None)


def _end(node: yaml.Node) -> int:
    """Index behind a node; a block ends with its last leaf, not with the comments below it."""
    while isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        leaf = node.value[-1]
        node = leaf[1] if isinstance(node, yaml.MappingNode) else leaf
    return node.end_mark.index


def _unshared(content: Any) -> Any:
    """Content with every alias written out: what has an alias would otherwise change in all its places."""
    if isinstance(content, dict):
        return {key: _unshared(value) for key, value in content.items()}
    return [_unshared(value) for value in content] if isinstance(content, list) else content


def _inside(content: Any, path: Path) -> Any:
    for key in path:
        content = content[key]
    return content

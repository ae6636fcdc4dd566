# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads small files of the user, all YAML and all JSON: plain data of bounded size, or one line gives the reason.

A file is read completely or refused in one line; reading never blocks. Numbers of JSON are finite.
"""

import json
import math
import pickle
import re
from collections.abc import Hashable
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.nodes import CollectionNode, MappingNode, Node, ScalarNode
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import Resolver
from yaml.scanner import Scanner

from trackres_ros.errors import InputError
from trackres_ros.files import own_files

MOST_BYTES = 1 << 18  # the longest file that is shipped has 15 kB, the parameters of a whole robot a few times that
MOST_NODES = 20_000  # with every alias written out; the largest vehicle has under a thousand
MOST_DEPTH = 50  # the deepest vehicle file has 12

MOST_DIGITS = 300  # of an integer in JSON: a longer one fits into no float
NEW_LINE, MERGE = "\n", "tag:yaml.org,2002:merge"

if yaml.__with_libyaml__:
    from yaml._yaml import CParser as _Events
else:  # ten times slower

    class _Events(Reader, Scanner, Parser):  # type: ignore[no-redef]
        def __init__(self, text: str) -> None:
            Reader.__init__(self, text)
            Scanner.__init__(self)
            Parser.__init__(self)


class _Refused(yaml.MarkedYAMLError):
    """Valid YAML that is refused."""

    def __init__(self, problem: str, place: Any) -> None:  # a node or an event
        super().__init__(problem=problem, problem_mark=place.start_mark)


class _Loader(Composer, _Events, SafeConstructor, Resolver):
    """Safe YAML with an error for duplicate keys instead of a silent loss, and with bounded size."""

    def __init__(self, text: str) -> None:
        _Events.__init__(self, text)
        Composer.__init__(self)
        SafeConstructor.__init__(self)
        Resolver.__init__(self)
        self._depth = 0
        self._sizes: dict[int, int] = {}  # size of composed nodes, with aliases written out, by identity of the node

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """One node; the composer of the library calls this for each."""
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if node is not None and id(node) not in self._sizes:
            if node.__class__ is not ScalarNode:  # an alias to an unfinished node is inside itself
                raise _Refused("an alias to its own parent", node)
            self._sizes[id(node)] = 1
        return node

    def compose_sequence_node(self, anchor: Any) -> Any:
        """A list."""
        self._check_depth()
        node = super().compose_sequence_node(anchor)
        self._measure(node, node.value)
        return node

    def compose_mapping_node(self, anchor: Any) -> Any:
        """A mapping."""
        self._check_depth()
        node = super().compose_mapping_node(anchor)
        self._measure(node, [part for pair in node.value for part in pair])
        self._refuse_repeated_keys(node)
        return node

    def _check_depth(self) -> None:
        if self._depth > MOST_DEPTH:
            raise _Refused(f"more than {MOST_DEPTH} nested lists and mappings", self.peek_event())

    def _measure(self, node: CollectionNode, parts: list[Node]) -> None:
        size = 1 + sum(self._sizes[id(part)] for part in parts)
        if size > MOST_NODES:
            raise _Refused(f"more than {MOST_NODES} values with aliases expanded", node)
        self._sizes[id(node)] = size

    def _refuse_repeated_keys(self, node: MappingNode) -> None:
        keys: set[Hashable] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, ScalarNode) or key_node.tag == MERGE:
                continue  # lists and mappings cannot be keys: the library reports it
            key = self.construct_object(key_node, deep=True)
            if key in keys:
                raise _Refused(f"given twice: {key_node.value} (one of the values would be lost)", key_node)
            keys.add(key)


_Loader.add_implicit_resolver(  # YAML 1.1 reads 1.2e11, without the sign in the exponent, as text
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+(?:\.[0-9]*)?[eE][-+]?[0-9]+"), list("-+0123456789")
)


@lru_cache(maxsize=32)
def _parse(text: str) -> bytes:
    """Pickled, as each caller gets data of its own: a command reads a vehicle file several times, in 1 % of the time."""
    return pickle.dumps(_Loader(text).get_single_data())


def parse_yaml(text: str, place: str) -> object:
    """The one document of a YAML text as plain data.

    `place`: the file or option, for messages. Raises InputError if it is no YAML, has a duplicate key, refers to itself, or
    exceeds the limit of size.
    """
    if len(text) > MOST_BYTES:
        raise InputError(place, f"{len(text)} characters", f"YAML of at most {MOST_BYTES}")
    try:
        return pickle.loads(_parse(text))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f", line {min(mark.line, text.count(NEW_LINE)) + 1}" if mark else ""  # not the one after the last
        raise InputError(
            f"{place}{line}", " ".join((error.problem or error.context or "no YAML").split()), "a YAML file or value"
        ) from None
    except Exception as error:  # a date 2001-99-99, !!int abc, 5,000 digits: constructors raise whatever they meet
        raise InputError(
            place, " ".join(f"{error}".split()) or type(error).__name__, "a YAML file or value of plain data"
        ) from None


def read_yaml(path: Path, allowed: str = "a YAML mapping at the top", remedy: str = "") -> dict[str, Any]:
    """Read the mapping in a YAML file.

    `allowed`, `remedy`: expected content and remedy, for messages. Raises InputError if there is no such file, it cannot be read
    at once, or an error of `parse_yaml`.
    """
    content = parse_yaml(read_text(path, "YAML file", MOST_BYTES), str(path))
    if not isinstance(content, dict):
        raise InputError(str(path), "nothing" if content is None else content, allowed, remedy)
    return content


def read_text(path: Path, kind: str, most_bytes: int) -> str:
    """The text of a file in UTF-8, from any editor: without a byte order mark, each line ended by a line feed.

    `kind`: expected kind, such as "YAML file", for messages; `most_bytes`: a longer one is refused. Raises InputError if there is
    no such file, it is a folder, pipe or device, too long, or no UTF-8.
    """
    try:
        text = read_bytes(path, kind, most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} is not UTF-8", f"a {kind} in UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_bytes(path: Path, kind: str, most_bytes: int) -> bytes:
    """The bytes of a file; see `read_text`."""
    try:
        return own_files.read(path, most_bytes)
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), f"a readable {kind}") from None


def is_there(path: Path) -> bool:
    """Whether a path leads to anything; not if its name is too long for one."""
    try:
        return path.exists()
    except OSError:
        return False


def parse_json(data: bytes | str) -> Any:
    """Plain data of JSON in UTF-8. Raises ValueError if it is no JSON, has a number that is not finite, or nests too deep."""
    try:
        return json.loads(data, parse_constant=_finite_number, parse_float=_finite_number, parse_int=_integer)
    except RecursionError:
        raise ValueError("lists and mappings in each other without end") from None


def _finite_number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:20]} is not a finite number")
    return value


def _integer(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def in_a_line(content: object) -> str:
    """A list or mapping as YAML in one line."""
    return yaml.safe_dump(content, default_flow_style=True, sort_keys=False, width=math.inf, allow_unicode=True).strip()

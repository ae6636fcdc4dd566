# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates functions in the restricted Python of the kernels, and all that they call, to C99.

A function is translated once for each set of kinds of its arguments. Constants of a vehicle, such as its tables and the
shapes of its arrays, are no arguments in C: branches that they exclude and unused arguments are omitted.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, cast

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.kernels.kinds import (
    BOOL,
    FAILED,
    INT,
    LENGTH,
    REAL,
    WIDE,
    ArrayOf,
    Const,
    Kind,
    Record,
    Scalar,
    literal,
    safe_name,
    words,
)

MOST_COLUMNS = 130  # of a line of C
TEMPLATES = Path(__file__).parent / "templates"
A_LINE = 5  # numbers of a table
NAMES_OF_HELPERS = re.findall(r"\btr_\w+", "".join(path.read_text(encoding="utf-8") for path in TEMPLATES.glob("*.c")))
REMEDY = "write it with numbers, if, for, while and math, as docs/own-effect.md shows"


@dataclass(frozen=True, slots=True)
class Source:
    """Source of a function: its tree, the file and the first line of the tree in it."""

    tree: ast.FunctionDef
    file: str
    line: int
    stores: Counter[str] = field(init=False)  # how often each name is assigned
    loops: Counter[str] = field(init=False)  # how often each name is that of a loop

    def __post_init__(self) -> None:
        nodes = list(ast.walk(self.tree))
        names = [node for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
        names += [node.target for node in nodes if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name)]
        targets = [node.target for node in nodes if isinstance(node, ast.For)]
        object.__setattr__(self, "stores", Counter(name.id for name in names))
        object.__setattr__(self, "loops", Counter(target.id for target in targets if isinstance(target, ast.Name)))

    @property
    def summary(self) -> str:
        """First line of the docstring."""
        return (ast.get_docstring(self.tree) or "").split("\n")[0]


@dataclass(eq=False)
class Instance:
    """A function for given kinds of its arguments."""

    function: FunctionType
    source: Source
    name: str
    arguments: dict[str, Kind]  # by the name of each parameter, including constants
    returns: Kind | None = None  # kind of its result; None without one
    text: str = ""  # its body in C
    reads: set[str] = field(default_factory=set)  # parameters that it reads
    writes: set[str] = field(default_factory=set)  # arrays among them that it changes
    calls: list[Instance] = field(default_factory=list)  # the instances that it calls
    has_failure: bool = False  # whether it, or a function that it calls, may note a failure
    is_done: bool = False

    @property
    def given(self) -> list[tuple[str, Kind]]:
        """Its parameters in C."""
        return [(n, k) for n, k in self.arguments.items() if n in self.reads and not isinstance(k, Const)]


@cache
def _read(function: FunctionType) -> Source:
    try:
        lines, line = inspect.getsourcelines(function)
    except (OSError, TypeError) as error:
        raise InputError(f"export: {function.__qualname__}", "no source", "a function in a file", REMEDY) from error
    tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
    if not isinstance(tree, ast.FunctionDef):
        raise InputError(f"{inspect.getsourcefile(function)}:{line}", "no plain function", "a function with def", REMEDY)
    return Source(tree, str(inspect.getsourcefile(function)), line)


class Translator:
    """Keeps translated functions with their structs and tables.

    `translate` fills in an instance: `flow.translate_body`. With `single`, numbers are `float` in C instead of `double`. While
    `checked`, functions may have any places and numbers, as Python; else they are kernels, which keep within their arrays.
    """

    def __init__(self, translate: Callable[[Translator, Instance], None], single: bool = False) -> None:
        self._translate, self.single = translate, single
        self.instances: dict[Any, Instance] = {}
        self.structs: dict[Any, tuple[str, Record]] = {}
        self.arrays: set[tuple[Scalar, int]] = set()
        self.tables: dict[int, tuple[str, Any]] = {}
        self.intrinsics: dict[Any, Callable[..., Any]] = {}
        self.sources: dict[Any, Source] = {}
        self.table_names: dict[int, str] = {}
        self.is_checked = True
        self._names = set(NAMES_OF_HELPERS)
        self._running: list[Instance] = []

    # Functions

    def instance(self, function: FunctionType, kinds: Sequence[Kind]) -> Instance:
        """The translation of a function for arguments of these kinds.

        Raises
        ------
        InputError
            With file and line, if it cannot be written in C.
        """
        key = (id(function), tuple(kinds), self.is_checked)
        if key not in self.instances:
            source = self.source(function)
            names = [argument.arg for argument in source.tree.args.args]
            instance = Instance(function, source, "", dict(zip(names, kinds, strict=True)))
            instance.name = self.unused_name(f"tr_{function.__name__}")
            self.instances[key] = instance
            self._running.append(instance)
            self._translate(self, instance)
            instance.is_done = True
            self._running.pop()
        previous = self.instances[key]
        if not previous.is_done:
            raise refusal_at(previous.source, previous.source.tree, f"{function.__name__} calls itself", "a loop instead")
        return previous

    def source(self, function: FunctionType) -> Source:
        """The source of a function."""
        if function not in self.sources:
            return _read(function)
        return self.sources[function]

    def add_text(self, function: FunctionType, text: str) -> None:
        """Register the source of a function that is in no file."""
        self.sources[function] = Source(cast(ast.FunctionDef, ast.parse(text).body[0]), "<export>", 1)

    def unused_name(self, name: str) -> str:
        """A unique name in C."""
        free_name, number = name, 1
        while free_name in self._names:
            number += 1
            free_name = f"{name}_{number}"
        self._names.add(free_name)
        return free_name

    # Structs and tables

    def struct(self, kind: Record) -> str:
        """The struct of a record."""
        key = tuple(kind.stored_fields()), kind.name
        if key not in self.structs:
            letter_of = {REAL: "d", INT: "i", BOOL: "b"}
            letters = "".join(letter_of.get(part, "p") if isinstance(part, Scalar) else "p" for _, part in kind.stored_fields())
            for _, part in kind.stored_fields():
                self.declaration(part)
            self.structs[key] = (self.unused_name(f"tr_{kind.name or letters}"), kind)
        return f"struct {self.structs[key][0]}"

    def declaration(self, kind: Kind | None, changes: bool = True) -> str:
        """The type of a variable of this kind; of an array a pointer, with a blank or star at its end."""
        if kind is None:
            return "void "
        if isinstance(kind, ArrayOf) and kind.lengths:
            self.arrays.add((kind.element, kind.lengths))
            return f"{self.array(kind)} "
        if isinstance(kind, ArrayOf):
            return f"{'' if changes else 'const '}{self.number(kind.element)} *"
        if isinstance(kind, Record):
            return f"{self.struct(kind)} "
        if isinstance(kind, Scalar):
            return f"{self.number(kind)} "
        raise TypeError(f"no variable of {kind}")

    def array(self, kind: ArrayOf) -> str:
        """The struct of an array with lengths."""
        self.arrays.add((kind.element, kind.lengths))
        return f"struct tr_{words(kind.element.name)}s_{kind.lengths}"

    def number(self, kind: Scalar) -> str:
        """The type of a number."""
        return "float" if kind == REAL and self.single else REAL.name if kind == WIDE else kind.name

    def table(self, value: Any, name: str) -> str:
        """The name in C of a constant array or tuple of numbers."""
        if id(value) not in self.tables:
            known_as = self.table_names.get(id(value), name.rpartition(".")[2])
            self.tables[id(value)] = (self.unused_name(f"TR_{words(known_as).strip('_').upper()}"), value)
        return self.tables[id(value)][0]

    def literal(self, value: Any) -> str:
        """A constant number."""
        return literal(value, self.single)

    def call(self, function: str) -> str:
        """A function of math.h."""
        return f"{function}f" if self.single else function

    # Text

    def text_of_structs(self, functions: str) -> str:
        """Declarations of the structs that functions use."""
        names = {name for name, _ in self.structs.values() if re.search(rf"struct {name}\b", functions)}
        for name, kind in reversed(self.structs.values()):
            if name in names:
                names |= {
                    self.structs[tuple(p.stored_fields()), p.name][0] for _, p in kind.stored_fields() if isinstance(p, Record)
                }
        lines = []
        for scalar, count in sorted(self.arrays, key=lambda key: (key[0].name, key[1])):
            lengths = "".join(f"    int64_t n{i};\n" for i in range(count))
            array = self.array(ArrayOf(scalar, (LENGTH,) * count))
            lines.append(f"{array} {{\n    {self.number(scalar)} *at;\n{lengths}}};\n")
        for name, kind in self.structs.values():
            if name not in names:
                continue
            parts = "".join(f"    {self.declaration(part)}{safe_name(field)};\n" for field, part in kind.stored_fields())
            lines.append(f"struct {name} {{\n{parts or '    char nothing;'}}};\n")
        return "\n".join(lines)

    def text_of_tables(self) -> str:
        """All tables."""
        lines = []
        for name, value in self.tables.values():
            array = np.asarray(value)
            kind = self.number(INT if array.dtype.kind in "iu" else REAL)
            numbers = [self.literal(entry) for entry in array.ravel().tolist()]
            body = ",\n".join(f"    {', '.join(numbers[i : i + A_LINE])}" for i in range(0, len(numbers), A_LINE))
            shape = " x ".join(map(str, array.shape))
            lines.append(f"static const {kind} {name}[{array.size}] = {{ /* {shape} */\n{body}\n}};\n")
        return "\n".join(lines)

    def text_of_functions(self, roots: Sequence[Instance]) -> str:
        """The root functions and all that they call, each after those it calls."""
        by_id: dict[int, Instance] = {}

        def visit(instance: Instance) -> None:
            if id(instance) not in by_id:
                for callee in instance.calls:
                    visit(callee)
                by_id[id(instance)] = instance

        for root in roots:
            visit(root)
        return "\n".join(self._text_of(instance) for instance in by_id.values())

    def _text_of(self, instance: Instance) -> str:
        file = instance.source.file.partition("trackres_ros/")[2] or instance.source.file.rsplit("/", 1)[-1]
        comment = f"{instance.source.summary} ({file})".replace("*/", "* /").encode("ascii", "replace").decode()
        lines = [f"/* {comment} */", self.head(instance), "{", *instance.text.splitlines(), "}"]
        return "\n".join(map(_short, lines)) + "\n"

    def head(self, instance: Instance) -> str:
        """Name and parameters of a function."""
        parameters = []
        for name, kind in instance.given:
            if isinstance(kind, Record):
                parameters.append(f"const {self.struct(kind)} *{safe_name(name)}")
            else:
                parameters.append(f"{self.declaration(kind, name in instance.writes)}{safe_name(name)}")
        if instance.has_failure:
            parameters.append(f"bool *{FAILED}")
        return_kind = None if isinstance(instance.returns, Const) else instance.returns
        return f"static {self.declaration(return_kind)}{instance.name}({', '.join(parameters) or 'void'})"


def _short(line: str) -> str:
    """Break a line of C that is too long."""
    if len(line) <= MOST_COLUMNS:
        return line
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.fill(line, MOST_COLUMNS, subsequent_indent=indent + "    ", break_long_words=False, break_on_hyphens=False)


def refusal_at(source: Source, node: ast.AST, code: str, allowed: str) -> InputError:
    """The refusal of source that cannot be written in C, with its line."""
    line = source.line + int(getattr(node, "lineno", 1)) - 1
    return InputError(f"{source.file}:{line}", code, allowed, REMEDY)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rooms of the package and which needs which, read from the imports; the picture of docs/architecture.md."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "trackres_ros"
DIVIDED = ("diagnosis", "node", "tools", "vehicle")  # rooms with rooms of their own
HEAD = (Path(__file__).parent / "architecture.in.md").read_text(encoding="utf-8")
COMMON = ("arrays", "errors", "units", "checks", "files", "text", "kernels")  # used from everywhere: left out of the picture


@cache
def modules() -> dict[str, Path]:
    """Every module of the package by its name without the package's."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def room_of(module: str) -> str:
    """The room a module lies in; `front` is the front door itself."""
    parts = module.split(".")
    if parts[0] in ("", "__main__"):
        return "front" if parts[0] == "" else "tasks"
    if parts[0] in DIVIDED and len(parts) > 2:
        return ".".join(parts[:2])
    return parts[0]


def imported(path: Path, known: Mapping[str, Path]) -> Iterator[str]:
    """Modules of the package that a file imports anywhere: at its top, in a function, for types alone."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            package, _, module = node.module.partition(".")
            if package == PACKAGE.name:
                for name in node.names:
                    inner = f"{module}.{name.name}".lstrip(".")
                    yield inner if inner in known else module
        elif isinstance(node, ast.Import):
            for name in node.names:
                package, _, module = name.name.partition(".")
                if package == PACKAGE.name:
                    yield module


@cache
def module_needs() -> dict[str, set[str]]:
    """For each module the modules that it imports."""
    known = modules()
    return {module: set(imported(path, known)) - {module} for module, path in known.items()}


def reached(start: str, needed: Mapping[str, Iterable[str]]) -> set[str]:
    """All that a module or room needs, directly or through others."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        new = set(needed[waiting.pop()]) - found
        found |= new
        waiting += new
    return found


def needs(room: Callable[[str], str] = room_of) -> dict[str, dict[str, list[str]]]:
    """For each room the rooms that it needs, with the imports that say so."""
    needed = module_needs()
    found: dict[str, dict[str, list[str]]] = {room(module): {} for module in needed}
    for module, others in needed.items():
        for other in sorted(others):
            if room(module) != room(other):
                found[room(module)].setdefault(room(other), []).append(f"{module} imports {other}")
    return found


def order(needed: Mapping[str, Iterable[str]]) -> list[str]:
    """Rooms, or modules, so that each stands after all that it needs.

    Raises
    ------
    graphlib.CycleError
        If they need each other in a circle; names it.
    """
    sorter = TopologicalSorter(needed)
    sorter.prepare()
    placed: list[str] = []
    while sorter.is_active():
        free = sorted(sorter.get_ready())
        sorter.done(*free)
        placed += free
    return placed


def direct(needed: Mapping[str, Mapping[str, list[str]]]) -> list[tuple[str, str]]:
    """Which room needs which, without what follows from others."""
    placed = order(needed)
    behind: dict[str, set[str]] = {}
    for room in placed:
        behind[room] = set().union(*({other} | behind[other] for other in needed[room]))
    return [
        (other, room)
        for room in placed
        for other in sorted(needed[room])
        if not any(other in behind[between] for between in needed[room] if between != other)
    ]


def sentence(room: str) -> str:
    """What the room's `__init__`, or the file, says of itself first."""
    path = PACKAGE.joinpath(*room.split(".")) if room != "front" else PACKAGE
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def lines_of_rooms() -> dict[str, int]:
    """How many lines each room has."""
    found: dict[str, int] = {}
    for module, path in modules().items():
        room = room_of(module)
        found[room] = found.get(room, 0) + len(path.read_text(encoding="utf-8").splitlines())
    return found


def page() -> str:
    """docs/architecture.md."""
    needed = needs()
    uncommon = {r: {o: i for o, i in others.items() if o not in COMMON} for r, others in needed.items() if r not in COMMON}
    shown = direct(uncommon)
    arrows = (f"    {a.replace('.', '_')}[{a}] --> {b.replace('.', '_')}[{b}]" for a, b in shown)
    picture = ["```mermaid", "flowchart LR", *arrows, "```"]
    lines = lines_of_rooms()
    rows = ["| room | what comes in, what goes out | needs, beside these | lines |", "|---|---|---|---|"]
    beside = {room: ", ".join(sorted(set(others) - set(COMMON))) for room, others in needed.items()}
    rows += [
        f"| `{room}` | {sentence(room)} | {beside[room] or 'nothing'} | {round(lines[room], -2) or '< 100'} |"
        for room in order(needed)
    ]
    rows += [f"| all of them | | | {round(sum(lines.values()), -2)} |"]
    return HEAD.replace("{picture}", "\n".join(picture)).replace("{rooms}", "\n".join(rows))


if __name__ == "__main__":
    print(page(), end="")

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rooms of the package and which needs which, read from the imports; the picture of docs/architecture.md."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "trackres_ros"
DIVIDED = ("diagnosis", "node")  # rooms with rooms of their own
HEAD = (Path(__file__).parent / "architecture.in.md").read_text(encoding="utf-8")
COMMON = ("errors", "units", "checks", "files", "text", "jit")  # used from everywhere: left out of the picture


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
        return "front" if parts[0] == "" else "cli"
    if parts[0] in DIVIDED and len(parts) > 2:
        return ".".join(parts[:2])
    return parts[0]


def imported(path: Path, known: Mapping[str, Path]) -> Iterator[str]:
    """Modules of the package that a file imports anywhere, but for types alone."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and id(node) not in for_types:
            package, _, module = node.module.partition(".")
            if package == PACKAGE.name:
                for name in node.names:
                    inner = f"{module}.{name.name}".lstrip(".")
                    yield inner if inner in known else module


def needs() -> dict[str, dict[str, list[str]]]:
    """For each room the rooms that it needs, with the imports that say so."""
    known = modules()
    found: dict[str, dict[str, list[str]]] = {room_of(module): {} for module in known}
    for module, path in known.items():
        for other in imported(path, known):
            here, there = room_of(module), room_of(other)
            if here != there:
                found[here].setdefault(there, []).append(f"{module} imports {other}")
    return found


def order(needed: Mapping[str, Mapping[str, list[str]]]) -> list[str]:
    """Rooms so that each stands after all that it needs.

    Raises
    ------
    ValueError
        If rooms need each other in a circle; says by which imports.
    """
    left, placed = dict(needed), []
    while left:
        free = sorted(room for room, others in left.items() if not set(others) & set(left))
        if not free:
            text = "; ".join(f"{a}: {imports[0]}" for a, others in left.items() for b, imports in others.items() if b in left)
            raise ValueError(f"rooms need each other in a circle: {text}")
        placed += free
        left = {room: others for room, others in left.items() if room not in free}
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


def page() -> str:
    """docs/architecture.md."""
    needed = needs()
    uncommon = {r: {o: i for o, i in others.items() if o not in COMMON} for r, others in needed.items() if r not in COMMON}
    shown = direct(uncommon)
    arrows = (f"    {a.replace('.', '_')}[{a}] --> {b.replace('.', '_')}[{b}]" for a, b in shown)
    picture = ["```mermaid", "flowchart LR", *arrows, "```"]
    rows = ["| room | what comes in, what goes out | needs |", "|---|---|---|"]
    rows += [f"| `{room}` | {sentence(room)} | {', '.join(sorted(needed[room])) or 'nothing'} |" for room in order(needed)]
    return HEAD.replace("{picture}", "\n".join(picture)).replace("{rooms}", "\n".join(rows))


if __name__ == "__main__":
    print(page(), end="")

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rooms import only those before them, each has a purpose, their page is up to date, and test names are short."""

import ast
import re
import subprocess
import sys
from graphlib import CycleError
from itertools import pairwise

import pytest


@pytest.fixture(scope="module")
def rooms(imported):
    return imported("tools/rooms.py")


@pytest.fixture(scope="module")
def trees(repository):
    """The syntax of each file of the package and of its tests."""
    paths = [path for folder in ("trackres_ros", "proofs", "test") for path in (repository / folder).rglob("*.py")]
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def test_no_room_needs_one_that_needs_it(rooms):
    placed = rooms.order(rooms.needs())
    assert placed.index("effects") < placed.index("vehicle") < placed.index("model") < placed.index("estimator")
    assert placed.index("recording") < placed.index("estimator") < placed.index("output") < placed.index("node")


@pytest.mark.parametrize("level", ["modules", "rooms", "top-level rooms"])
def test_nothing_imports_in_a_circle(rooms, level):
    needed = {
        "modules": rooms.module_needs,
        "rooms": rooms.needs,
        "top-level rooms": lambda: rooms.needs(lambda module: rooms.room_of(module).split(".")[0]) | {"front": {}},
    }[level]()  # the front door loads a name of the tools when it is used
    assert len(rooms.order(needed)) == len(needed)


def test_a_circle_is_found_and_named(rooms):
    with pytest.raises(CycleError, match=r"'a', 'b', 'a'|'b', 'a', 'b'"):
        rooms.order({"a": {"b"}, "b": {"a"}, "c": set()})


@pytest.mark.parametrize("module", ["tasks.replay", "tasks.simulate", "tasks.vehicle", "tasks.live", "node.application"])
def test_replay_and_live_import_no_diagnosis(rooms, module):
    needed = rooms.module_needs() | {"": set()}  # the front door loads a name when it is used
    needed["tasks.both_sides"] = set()  # loaded where it is asked for
    assert not {other for other in rooms.reached(module, needed) if other.startswith("diagnosis")}


PLOTTING = {"matplotlib", "bokeh"}
DRAWING = ("output.plots", "output.style", "offline", "results", "diagnosis")


def test_the_node_imports_no_plotting(rooms):
    """Nor what replays or summarises: a finished recording is drawn by the command, after the node."""
    needed = rooms.module_needs() | {"": set()}  # as above
    nodes = {module for module in needed if module.split(".")[0] == "node"}
    assert not {other for module in nodes for other in rooms.reached(module, needed) if other.startswith(DRAWING)}
    pytest.importorskip("cyclonedds")
    without_ros = sorted(f"trackres_ros.{module}" for module in nodes if not module.startswith("node.ros"))
    program = f"import importlib, sys; [importlib.import_module(name) for name in {without_ros}]; print(*sys.modules)"
    python = subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True)
    assert not {module for module in python.stdout.split() if module.split(".")[0] in PLOTTING}
    assert "trackres_ros.output.plots" not in python.stdout.split()


def test_only_the_front_door_and_shared_modules_lie_at_the_root(repository):
    files = {path.name for path in (repository / "trackres_ros").glob("*.py")}
    shared = {"arrays.py", "errors.py", "units.py", "checks.py", "progress.py", "text.py", "version.py"}
    assert files == {"__init__.py", "__main__.py", "building.py", *shared}


def test_each_room_says_what_it_is_for(rooms):
    for room in rooms.needs():
        assert len(rooms.sentence(room)) > 20, room


def test_nothing_of_the_core_imports_the_tools(rooms):
    """Their commands are plug-ins, and the front door loads its names when they are used."""
    users = {module for module, needed in rooms.module_needs().items() if any(other.split(".")[0] == "tools" for other in needed)}
    assert not {module for module in users if module.split(".")[0] not in ("tools", "")}


def test_the_package_imports_nothing_of_the_proofs(trees, repository):
    """They are not installed with it."""
    for path, tree in trees.items():
        if path.is_relative_to(repository / "trackres_ros"):
            assert not [name for name in _imports(tree) if name.split(".")[0] == "proofs"], path


def _imports(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield node.module or ""
            yield from (f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


def test_sealed_truth_needs_none_of_the_code_it_tests(rooms, repository):
    paths = {f"proofs.{'.'.join(p.relative_to(repository / 'proofs').with_suffix('').parts)}": p for p in proof_files(repository)}
    needed = {name: set(_imports(ast.parse(path.read_text(encoding="utf-8")))) for name, path in paths.items()}
    of_package = rooms.module_needs()
    for name in ("belt", "cases", "drives", "groomer", "phenomena", "truth"):
        reached, waiting = set(), [f"proofs.sealed.{name}"]
        while waiting:
            module = waiting.pop()
            if module in reached:
                continue
            reached.add(module)
            waiting += [other for other in needed[module] if other in needed]
            for other in (other.removeprefix("trackres_ros.") for other in needed[module] if other.startswith("trackres_ros.")):
                if other in of_package:
                    used = {one.split(".")[0] for one in (other, *rooms.reached(other, of_package))}
                    assert not used & {"model", "effects", "diagnosis", "estimator", "vehicle"}, (name, module, other)


def proof_files(repository):
    return sorted((repository / "proofs").rglob("*.py"))


def test_the_page_of_the_house_is_true(rooms, repository):
    """But for how many lines there are, which every change moves."""
    pages = (repository / "docs" / "architecture.md").read_text(encoding="utf-8"), rooms.page()
    assert len({re.sub(r" [\d< ]+ \|$", " |", page, flags=re.MULTILINE) for page in pages}) == 1


def test_constants_in_compiled_code_are_part_of_its_digest(rooms, trees):
    """C keeps the constants it was compiled with: after a change of a file that they come from it must not run."""
    from trackres_ros.kernels.marks import FILES, ROOMS

    def counts(module):
        path = module.replace(".", "/")
        return any(f"{path}/".startswith(f"{room}/") for room in ROOMS) or f"{path}.py" in FILES

    compiles = re.compile(r"^from trackres_ros\.kernels\.marks import .*\b(kernel|entry)\b", re.MULTILINE)
    known, strange = rooms.modules(), set()
    for module, path in known.items():
        if not compiles.search(path.read_text()):
            continue
        if not counts(module):
            strange.add((module,))
        code = [
            node for node in trees[path].body
            if isinstance(node, ast.Assign) or (isinstance(node, ast.FunctionDef) and node.decorator_list)
        ]  # fmt: skip
        used = {node.id for part in code for node in ast.walk(part) if isinstance(node, ast.Name)}
        for node in ast.walk(trees[path]):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("trackres_ros."):
                home = node.module.removeprefix("trackres_ros.")
                numbers = [name.name for name in node.names if name.name.isupper() and name.name in used]
                if numbers and not counts(home):
                    strange.add((module, home, *numbers))
    assert not strange


def test_no_test_name_is_longer_than_60_characters(trees):
    names = [
        node.name
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_")
    ]
    assert len(names) > 1000
    assert not [name for name in names if len(name) > 60]


PLAIN = {"write_text", "write_bytes", "copyfile", "copy2", "copytree"}
PARTS = {"output/table.py", "output/mcap.py", "recording/mcap.py", "files/file_sets.py"}  # moved in place when whole
NOT_KEPT = {
    "recording/bag_files.py",
    "tools/export/fmu.py",
    "kernels/compiler.py",
    "building.py",
    "tools/fleet/run.py",
    "files/own_files.py",
}


def _writes_in_place(node):
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute | ast.Name):
        return False
    name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
    modes = [one.value for one in ast.walk(node) if isinstance(one, ast.Constant)]
    return name in PLAIN or (name == "open" and any(re.fullmatch("[wxa][bt+]*", str(one)) for one in modes))


def test_what_a_user_keeps_is_written_whole_or_not_at_all(trees, repository):
    """`files.own_files.write` replaces a file in one step: a full disk or a power cut leaves the old one."""
    package, found = repository / "trackres_ros", set()
    for path, tree in trees.items():
        if path.is_relative_to(package) and any(map(_writes_in_place, ast.walk(tree))):
            found.add(path.relative_to(package).as_posix())
    assert found == PARTS | NOT_KEPT


def _follows(node):
    """What a command line has right after this Python."""
    for of in (getattr(node, "elts", None), getattr(node, "args", None)):
        for word, after in pairwise(of if isinstance(of, list) else ()):
            if ast.unparse(word) == "sys.executable":
                yield ast.unparse(after)


def test_python_is_started_without_the_current_folder(repository):
    """`-P`; else `-m` and `-c` look there for every module first. In the package one function does it, for its children too."""
    folders = [repository / name for name in ("trackres_ros", "tools", "launch", "examples")]
    found = set()
    for path in (path for folder in folders for path in folder.rglob("*") if path.is_file()):
        head = path.read_bytes()[:200]
        if path.suffix == ".py" or (head.startswith(b"#!") and b"python" in head.splitlines()[0]):
            name = path.relative_to(repository).as_posix()
            found |= {(name, after) for node in ast.walk(ast.parse(path.read_bytes())) for after in _follows(node)}
    assert {name for name, _ in found if name.startswith("trackres_ros")} == {"trackres_ros/files/interpreter.py"}
    assert len(found) > 5
    assert {after for _, after in found} == {"'-P'"}


MOST_LINES, MOST_PARAMETERS = 60, 8
BY_NAME = "each argument is a documented keyword of a public call, given by name"
NUMBERS = "called by compiled kernels, or in their place: takes numbers, as they do"
ONE_BY_ONE = "a test names what differs, all else has a default"
REASONS = {
    "diagnose.diagnose": BY_NAME, "replay.replay": BY_NAME, "simulate.simulate": BY_NAME,
    "estimator.inputs": BY_NAME, "estimator.run": BY_NAME, "effect.conditions": BY_NAME,
    "step.take_message": NUMBERS,
    "test_routes.session_of": ONE_BY_ONE, "test_verdict.said": ONE_BY_ONE, "test_scored.scored": ONE_BY_ONE,
    "conftest.__init__": ONE_BY_ONE, "worlds.driven": ONE_BY_ONE,
}  # fmt: skip


def _says_only_a_type(test):
    if isinstance(test, ast.Call):
        return isinstance(test.func, ast.Name) and test.func.id == "isinstance"
    if isinstance(test, ast.Compare):
        return all(isinstance(op, ast.IsNot) for op in test.ops) and isinstance(test.comparators[0], ast.Constant)
    return isinstance(test, ast.Name | ast.Attribute)


def test_no_assert_of_the_package_guards_more_than_a_type(trees, repository):
    for path, tree in trees.items():
        for node in ast.walk(tree) if path.is_relative_to(repository / "trackres_ros") else ():
            if isinstance(node, ast.Assert):
                assert _says_only_a_type(node.test), f"{path}:{node.lineno} is gone under python -O"


def test_a_long_function_has_a_reason(trees):
    """Lines are counted without the docstring. A command has a parameter for each option, a kernel takes numbers."""
    large = set()
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            if re.search(r"command|group|kernel|entry", " ".join(map(ast.unparse, node.decorator_list))):
                continue
            first = node.body[0]
            text = first.end_lineno - first.lineno + 1 if ast.get_docstring(node) else 0
            names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs) if one.arg != "self"]
            if node.end_lineno - node.lineno + 1 - text > MOST_LINES or len(names) > MOST_PARAMETERS:
                large.add(f"{path.stem}.{node.name}")
    assert large == REASONS.keys()

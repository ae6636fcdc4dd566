# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""docs/errata.md: every equation of the paper has its row, and all names in the rows exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EQUATIONS = range(1, 37)
VERDICTS = (
    "OK", "form OK", "wrong", "unsafe", "signs lost", "sign wrong", "index wrong", "ambiguous", "inconsistent", "two errors",
    "unit missing", "scope", "w undefined",
)  # fmt: skip


def page(name):
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def rows(text):
    """Cells of the lines that belong to tables; an escaped bar is no border."""
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in text.splitlines() if line.startswith("|")]


def equation_rows():
    found = [row for row in rows(page("errata.md")) if re.fullmatch(r"\d+", row[0])]
    assert len({row[0] for row in found}) == len(found)
    return {int(row[0]): row for row in found}


@cache
def functions_of(path):
    """Names of the test functions in a file."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"))


def named_tests(text):
    return re.findall(r"`(test/[\w/]+\.py)::(\w+)`", text)


def anchors(text):
    """Anchors that a forge makes of the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_equation_has_one_row():
    assert sorted(equation_rows()) == list(EQUATIONS)


@pytest.mark.parametrize("number", EQUATIONS)
def test_each_row_has_printed_computed_verdict_and_its_tests(number):
    _, printed, verdict, computed, shown_by = equation_rows()[number]
    assert printed
    assert computed
    assert verdict.startswith(VERDICTS)
    assert named_tests(shown_by)


@pytest.mark.parametrize("name", ["errata.md", "model.md"])
def test_every_test_that_is_named_exists(name):
    text = page(name)
    for path, test in named_tests(text):
        assert test in functions_of(path), f"{path}::{test}"
    everywhere = {test for path in (ROOT / "test").rglob("test_*.py") for test in functions_of(str(path.relative_to(ROOT)))}
    assert set(re.findall(r"\b(test_\w+)`", text)) - {Path(p).stem for p, _ in named_tests(text)} <= everywhere
    for path in re.findall(r"`((?:test|trackres_ros)/[\w/]+(?:\.py|/))", text):
        assert (ROOT / path).exists(), path


def test_the_errata_name_each_contradicted_claim_and_its_figure():
    """Claims that the program finds false are in the errata too, and all figures of the errata exist."""
    reproduction, errata = page("reproduction.md"), page("errata.md")
    contradicted = [row[0] for row in rows(reproduction) if len(row) == 3 and row[2].startswith("[does not hold]")]
    assert len(contradicted) >= 4
    for claim in contradicted:
        assert re.sub(r" \(.*\)\.$", "", claim).rstrip(".") in errata, claim
    linked = re.findall(r"\(reproduction\.md#([\w\-]+)\)", errata)
    assert len(linked) >= 5
    assert set(linked) <= anchors(reproduction)


def test_each_symbol_names_existing_vehicle_keys_and_code_names():
    source = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "trackres_ros").rglob("*.py"))
    vehicle = (ROOT / "config" / "xgd24d.yaml").read_text(encoding="utf-8")
    symbols = [row for row in rows(page("model.md")) if len(row) == 5 and row[0].startswith("$")]
    assert len(symbols) > 50
    for row in symbols:
        for name in re.findall(r"`([\w.]+)`", row[3]):
            assert re.search(rf"\b{name.rpartition('.')[2]}\b", source), f"{row[0]}: {name} is not in the code"
        for key in re.findall(r"`([\w.]+)`", row[4]):
            assert re.search(rf"\b{key.rpartition('.')[2]}\b", vehicle), f"{row[0]}: {key} is not in the vehicle file"


def test_every_quantity_of_the_vehicle_file_has_a_symbol():
    """But those that only check others, or stand for a place in the geometry."""
    without = {
        "tread_depth", "tread_land_ratio", "max_speed", "motor_ratio", "motor_efficiency", "radius", "wrap_angle", "positions",
        "load", "ground_run", "split", "own_weight_split",
    }  # fmt: skip
    names = set(re.findall(r"(\w+): \{value:", (ROOT / "config" / "agri3t.yaml").read_text(encoding="utf-8"))) - without
    assert len(names) > 30
    keys = " ".join(row[4] for row in rows(page("model.md")) if len(row) == 5)
    for name in names:
        assert re.search(rf"\b{name}\b", keys), f"{name} has no symbol"

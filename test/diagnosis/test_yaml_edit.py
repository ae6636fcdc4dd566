# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Changes in the text of a YAML file affect only their lines."""

import pytest
import yaml

from trackres_ros.vehicle.writing.yaml_edit import Document

TEXT = """# on top
a: {value: 1.0, range: [0.5, 1.50], reason: "as said"}   # beside
b:
  # above
  c: 3.0e-7
  list:
    - one
    - two   # the second
  text: >
    folded
    words
# between
d: last"""


def test_a_value_changes_where_it_stands():
    document = Document(TEXT)
    document.set(("a", "value"), 2e-05)
    document.set(("a", "range"), [1e-05, 3.0])
    document.set(("a", "reason"), "now: so, 'quoted' \\ \\n")
    document.set(("b", "c"), 4.0)
    document.set(("d",), "first")
    lines, result_before = document.text().splitlines(), TEXT.splitlines()
    assert [i for i, (x, y) in enumerate(zip(lines, result_before, strict=True)) if x != y] == [1, 4, 12]
    assert lines[1].endswith("   # beside")
    content = yaml.safe_load(document.text())
    assert content["a"] == {"value": 2e-05, "range": [1e-05, 3.0], "reason": "now: so, 'quoted' \\ \\n"}


@pytest.mark.parametrize(("key", "value"), [("list", [1, 2]), ("text", "plain"), ("c", {"x": None})])
def test_what_stands_over_several_lines_is_replaced_whole(key, value):
    document = Document(TEXT)
    document.set(("b", key), value)
    text = document.text()
    wanted = yaml.safe_load(TEXT)
    wanted["b"][key] = value
    assert yaml.safe_load(text) == wanted
    assert {"# on top", "  # above", "# between"} <= set(text.splitlines())


@pytest.mark.parametrize(
    "there",
    ["", "e: {}", "e: {x: 1}", "e: {x: {y: 1},\n    z: 2}  # two", "e:\n  x: 1  # one\n  # end\n", "e:\n    x: >\n      words\n"],
)
@pytest.mark.parametrize("after", ["", "\n", "\n# the end\n", "\nf: 1\n"])
def test_entries_join_a_mapping_however_it_is_written(there, after):
    text = f"{TEXT}\n{there}{after}"
    document = Document(text)
    document.add("e", {"new": {"v": {"value": 1.0, "range": [0.5, 2.0]}}, "other": 2})
    document.set(("files",), ["a b.py"])
    wanted = yaml.safe_load(text)
    wanted["e"] = {**wanted.get("e", {}), "new": {"v": {"value": 1.0, "range": [0.5, 2.0]}}, "other": 2}
    wanted["files"] = ["a b.py"]
    changed = document.text()
    assert yaml.safe_load(changed) == wanted
    assert [line for line in text.splitlines() if line.lstrip().startswith("#") and line not in changed.splitlines()] == []


SHARED = """a: &x {value: 1.0, unit: m}
b: {<<: *x, unit: km}
c: *x
d: &y {belt: {film: *x, width: &w 2.0}}  # of both
e: {<<: *y, wheels: 3}
f: *w
"""


def leaves(content, path=()):
    if not isinstance(content, dict):
        return {path: content}
    return {leaf: value for key, inner in content.items() for leaf, value in leaves(inner, (*path, key)).items()}


@pytest.mark.parametrize("path", leaves(yaml.safe_load(SHARED)), ids=".".join)
def test_exactly_what_is_set_changes_however_it_is_shared(path):
    document = Document(SHARED)
    document.set(path, "new")
    changed = yaml.safe_load(document.text() or document.plain())
    assert leaves(changed) == {**leaves(yaml.safe_load(SHARED)), path: "new"}


def test_a_key_of_its_own_changes_beside_a_merged_one():
    document = Document(SHARED)
    document.set(("b", "unit"), "cm")
    assert "b: {<<: *x, unit: cm}" in document.text()

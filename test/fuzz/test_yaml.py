# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every kind of YAML that is read: any content is accepted, or one line gives the reason."""

from __future__ import annotations

import os
import re

import pytest
import yaml
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mutator import mutations
from user_files import YAMLS

from trackres_ros.errors import InputError
from trackres_ros.files.documents import MOST_BYTES, MOST_DEPTH, MOST_NODES, parse_yaml, read_yaml
from trackres_ros.files.resources import config_dir
from trackres_ros.node.parameters import make_parameters, read_parameters
from trackres_ros.tasks.main import cli

SPOILT_OF_EACH, MORE = 30, 100
LONGEST_LINE = 3000  # characters
DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

BOMB = (
    "[&a [x, x, x, x, x, x, x, x, x, x]"
    + "".join(f", &{new} [{', '.join([f'*{old}'] * 10)}]" for old, new in zip("abcdefg", "bcdefgh", strict=True))
    + "]"
)
NASTY = (
    "2001-99-99", "2001-01-01", "!!int abc", "!!float abc", "!!bool maybe", "!!timestamp x", "!!binary x",
    "!!python/object/apply:os.system [true]", "!unknown x", "9" * 5000, "0x" + "f" * 5000, "-" + "9" * 400, "1e999", ".nan",
    "[" * 1000 + "]" * 1000, "[" * 100_000, "&self [*self]", "&self {a: *self}", "{<<: &m {a: 1}, b: 2}", "*nowhere", BOMB,
    "{a: 1, a: 2}", "{[a]: 1}", "{1: a, 0x1: b}", "'" + "long " * 10_000 + "'", '"\\0"', '"\\ud800"', '"a\\nb\\e[31m"',
    "null", "true", "[]", "{}", "''",
)  # fmt: skip


@pytest.fixture(params=YAMLS)
def kind(request, tmp_path):
    """Reads a text as one kind of file: the result, or the refusal; anything else is raised."""
    read, right = YAMLS[request.param]
    path = tmp_path / "given.yaml"

    def taken(content: bytes) -> object:
        path.write_bytes(content)
        try:
            return read(path)
        except InputError as refused:
            line = str(refused)
            assert len(line) < LONGEST_LINE
            assert line.isprintable()
            assert str(path) in line
            return refused

    assert not isinstance(taken(right.encode()), InputError)
    return taken, right


def test_spoilt_bytes(kind):
    taken, right = kind
    refused = [isinstance(taken(spoilt), InputError) for spoilt in mutations(right.encode(), SPOILT_OF_EACH, seed=1)]
    assert any(refused)


@pytest.mark.long
def test_more_spoilt_bytes(kind):
    taken, right = kind
    for spoilt in mutations(right.encode(), MORE, seed=2):
        taken(spoilt)


def places(content: object, path: tuple = ()) -> list[tuple]:
    """Paths of a value in nested mappings and lists, and of a key."""
    found = [path] if path else []
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return found + [p for key, value in items for p in places(value, (*path, key))]


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_anything_in_any_place(kind, data):
    taken, right = kind
    content = parse_yaml(right, "right")
    parent, place = content, data.draw(st.sampled_from(places(content)))
    for key in place[:-1]:
        parent = parent[key]
    nasty = data.draw(st.sampled_from(NASTY) | st.text(max_size=30).map(repr) | st.floats().map(str) | st.integers().map(str))
    if isinstance(parent, dict) and data.draw(st.booleans()):
        parent["_HERE_"] = parent.pop(place[-1])  # as a key
    else:
        parent[place[-1]] = "_HERE_"
    text = yaml.dump(content, Dumper=DUMPER, default_flow_style=None, width=10**6).replace("_HERE_", nasty)
    taken(text.encode("utf-8", "surrogatepass"))


@pytest.mark.parametrize("kind", ["track vehicle"], indirect=True)
def test_a_file_name_that_is_too_long_is_refused(kind):
    taken, right = kind
    for content in (re.sub(r"\S+\.csv", "x" * 300, right), f"{right}\neffect_files: [{'x' * 300}]\n"):
        assert isinstance(taken(content.encode()), InputError)


@pytest.mark.parametrize("nasty", NASTY)
def test_anything_as_the_whole_file(kind, nasty):
    taken, _ = kind
    assert isinstance(taken(nasty.encode("utf-8", "surrogatepass")), InputError) or nasty == "{}"


def test_what_is_no_file_is_not_waited_for(tmp_path):
    path = tmp_path / "given.yaml"
    for make in (os.mkfifo, os.mkdir, lambda p: p.symlink_to("/dev/zero"), lambda p: p.symlink_to(p)):
        make(path)
        with pytest.raises(InputError, match=re.escape(str(path))):
            read_yaml(path)
        path.rmdir() if path.is_dir() else path.unlink()


def test_what_is_too_large_is_refused(kind):
    taken, right = kind
    for content in (right + "\n#" + "x" * MOST_BYTES, f"a: [{'1, ' * MOST_NODES}]", f"a: {'[' * (MOST_DEPTH + 1)}", "\xff"):
        assert isinstance(taken(content.encode("latin-1")), InputError)


@pytest.mark.parametrize("nasty", NASTY)
def test_one_parameter_on_the_command_line(nasty):
    for name in ("output_rate_hz", "vehicle", "feedforward_parts", "use_sim_time", nasty.replace(":", "")[:50]):
        if "\0" not in nasty:
            done = CliRunner().invoke(cli, ["live", "--quiet", "-p", f"{name}:={nasty}", "-p", "state_file:=3"])
            assert isinstance(done.exception, InputError)  # the second at the latest
            assert len(str(done.exception)) < LONGEST_LINE


def test_the_process_says_it_in_one_line_and_ends_with_2(tmp_path):
    path = tmp_path / "v.yaml"
    path.write_text(f"a: {BOMB}\n")
    done = CliRunner().invoke(cli, ["vehicle", "check", str(path)])
    assert isinstance(done.exception, InputError)
    assert f"more than {MOST_NODES} values" in str(done.exception)
    assert "line 1" in str(done.exception)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text() | st.integers(), lambda x: st.lists(x) | st.dictionaries(st.text(), x)
    )
)
def test_what_was_given_is_shown_as_it_is_while_it_is_short(given_):
    line = str(InputError("w", given_, "a"))
    assert line.isprintable()
    assert len(line) < 300
    if len(repr(given_)) <= 80:
        assert repr(given_) in line


def test_what_holds_itself_or_is_huge_can_be_shown():
    knot: list = []
    knot.append({"a": (knot,)})
    assert "..." in str(InputError("w", knot, "a"))
    assert len(str(InputError("w", [["x" * 10**7] * 10**6] * 10**6, "a"))) < 120
    assert "bits" in str(InputError("w", 10**5000, "a"))


def test_shipped_files_are_far_from_the_limits():
    for path in config_dir().rglob("*.yaml"):
        assert path.stat().st_size < MOST_BYTES / 10
        read_yaml(path)
    assert make_parameters(read_parameters(config_dir() / "trackres.yaml")) == make_parameters({})
    assert parse_yaml("{a: &x {b: 1.2e11}, c: {<<: *x, d: 1e3}}", "w") == {"a": {"b": 1.2e11}, "c": {"b": 1.2e11, "d": 1e3}}

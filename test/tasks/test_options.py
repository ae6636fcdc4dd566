# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every option of every command, drawn from its declared type and range and from beyond it: one line, never a traceback.

OPTION_DRAWS=200 draws so many calls of each command.
"""

import math
import os

import click
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from interrupted import interrupted

import trackres_ros as tr
from trackres_ros.tasks.main import cli

DRAWS, LONGEST_S = int(os.environ.get("OPTION_DRAWS", "2")), 0.4  # calls of each command; how long each may take
ENDS = (0, 2, 130)
HOSTILE = ("", " ", "nan", "inf", "-inf", "1e999", "1e23", "-1", "0", str(2**40), str(2**70), "9" * 400, "abc", "/dev/null/x",
           "a:b", "=", "x=nan", "x=1:nan:3", "1:2:1e9", "\u2603", "..", "/", "--", "-")  # fmt: skip
ENDED = {"live": ["-p", "output_rate_hz:=nan"], "play": ["--rate", "nan"]}
"""A last word that is refused, without which a command would open a network."""


def leaves(group=cli, path=()):
    """Each command with the words that lead to it."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        if isinstance(command, click.Group):
            if command.invoke_without_command:
                yield (*path, name), command
            yield from leaves(command, (*path, name))
        else:
            yield (*path, name), command


COMMANDS = {" ".join(path): command for path, command in leaves()}
assert sum(len(command.params) for command in COMMANDS.values()) > 100


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a drive of a minute, which commands may write into."""
    place = tmp_path_factory.mktemp("options")
    rows = "".join(f"{0.1 * i:.1f},{min(0.05 * i, 5.0):.3f},{900.0 + i % 7}\n" for i in range(600))
    (place / "drive.csv").write_text("time_s,speed_mps,torque_nm\n" + rows)
    return place


def numeric(command):
    return [p for p in command.params if isinstance(p.type, click.types.FloatParamType | click.types.IntParamType)]


@pytest.mark.parametrize("name", COMMANDS)
def test_each_number_has_a_least_and_a_greatest_value(name):
    for parameter in numeric(COMMANDS[name]):
        low, high = getattr(parameter.type, "min", None), getattr(parameter.type, "max", None)
        assert low is not None, parameter.opts
        assert high is not None, parameter.opts
        assert math.isfinite(low)
        assert math.isfinite(high)
        for value in ("nan", "inf", "-inf", "1e999", str(high * 2 + 1), str(low - 1 - abs(low))):
            with pytest.raises(click.UsageError):
                parameter.type.convert(value, parameter, None)


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_takes_an_empty_text_for_a_path(name, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("raise SystemExit('imported')\n")
    for option in COMMANDS[name].params:
        if isinstance(option, click.Option) and option.is_flag:
            continue
        given_values = [("",)] if isinstance(option, click.Argument) else [(option.opts[0], "")]
        given_values += [(f"{word}=",) for word in option.opts if word.startswith("--")]
        for item in given_values:
            shown = refused(*name.split(), *item)
            assert "not empty" in shown, item
            assert item[0].rstrip("=") in shown
            assert "imported" not in shown
    assert [path.name for path in tmp_path.iterdir()] == ["mine.py"]


def values(parameter):
    """Words for an option or an argument: within its range, at its ends, and anything."""
    kind = parameter.type
    if isinstance(kind, click.Choice):
        own = st.sampled_from([str(choice) for choice in kind.choices])
    elif isinstance(kind, click.types.IntParamType):
        own = st.integers(kind.min, kind.max).map(str) | st.sampled_from([str(kind.min), str(kind.max)])
    elif isinstance(kind, click.types.FloatParamType):
        own = st.floats(kind.min, kind.max).map(repr) | st.sampled_from([repr(kind.min), repr(kind.max)])
    elif parameter.name in ("vehicle", "one", "other", "file", "like"):
        own = st.sampled_from(["xgd24d", "agri3t", "ztbus_hess19"])
    else:
        own = st.sampled_from(["drive.csv", "out.csv", "out", "new/out.mcap", "speed=1", "a"])
    return own | st.sampled_from(HOSTILE)


@st.composite
def words(draw, command):
    """The words of a call: required ones, and some of the others."""
    drawings = []
    for parameter in command.params:
        if isinstance(parameter, click.Argument):
            drawings += [draw(st.sampled_from(["drive.csv", "xgd24d"]) | values(parameter))]
        elif parameter.required or draw(st.integers(0, 3)) == 0:
            switch = isinstance(parameter, click.Option) and parameter.is_flag
            drawings += [parameter.opts[0], *([] if switch else [draw(values(parameter))])]
    return drawings


@pytest.mark.parametrize("name", COMMANDS)
def test_whatever_is_typed_ends_in_one_line(name, trackres, folder):
    @settings(max_examples=DRAWS, phases=[Phase.generate])
    @given(words(COMMANDS[name]))
    def check(call):
        call = [*name.split(), *call, *ENDED.get(name, [])]
        code, text = interrupted(trackres, call, folder, LONGEST_S)
        assert code in ENDS, (call, text)
        if code == 2 and "--json" not in call:
            assert sum(line.startswith("trackres: error: ") for line in text.splitlines()) == 1 or not call[1:], (call, text)

    check()


@pytest.mark.parametrize(("call", "named"), [
    ("sweep xgd24d --vary belt.thickness=0.03,0.04 --ambient-degc nan", "--ambient-degc"),
    ("sensitivity xgd24d --samples 100", "--samples"),
    ("fleet drive.csv --vehicle xgd24d --workers 1e23 -o out", "--workers"),
])  # fmt: skip
def test_an_option_that_cannot_be_used_is_refused_by_name(call, named, refused, folder):
    assert named in refused(*call.split(), cwd=folder)


@pytest.mark.parametrize("seed", [-1, 2**32, 1.5, None, True, "1"])
def test_a_seed_is_a_whole_number_from_zero(seed, folder):
    for run in (tr.diagnose, tr.coastdown):
        with pytest.raises(tr.InputError, match="seed"):
            run(folder / "drive.csv", "xgd24d", seed=seed)

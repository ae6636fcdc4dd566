# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A watched parameter file: what it changes is what stands in it, all or nothing, and never what is half written."""

import json
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.errors import InputError
from trackres_ros.node.parameter_file import ParameterFile
from trackres_ros.node.parameters import PARAMETERS, make_parameters, read_parameters

RUNS = {name: p for name, p in PARAMETERS.items() if not p.fixed_because}
NUMBERS = {name: p for name, p in RUNS.items() if isinstance(p.default, float) and not name.startswith("output")}


def values(parameter):
    return st.floats(parameter.low, parameter.high)


CONTENT = st.lists(st.sampled_from(sorted(NUMBERS)), unique=True, max_size=4).flatmap(
    lambda names: st.fixed_dictionaries({name: values(NUMBERS[name]) for name in names})
)


def write(path, content, count=[0]):  # noqa: B006 - so that no two files are of one time
    count[0] += 1
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    os.utime(path, ns=(count[0] * 10**9, count[0] * 10**9))


def watched(path, content, overruled=()):
    write(path, content)
    given_ = read_parameters(path) | dict(overruled)
    parameters = make_parameters(given_)
    return ParameterFile(path, "trackres", "/", parameters, dict(overruled)), parameters


def looked(file, parameters):
    """The parameters after two looks, applied as the node does."""
    for _ in range(2):
        changed = file.look()
        if changed:
            parameters = parameters.changed(changed)
            file.applied(changed)
    return parameters


@settings(max_examples=60)
@given(st.lists(CONTENT, min_size=1, max_size=4), st.sampled_from(sorted(NUMBERS)))
def test_after_any_edits_the_parameters_are_those_of_a_start_with_the_last_file(tmp_path_factory, contents, own):
    path = tmp_path_factory.mktemp("p") / "p.yaml"
    overruled = {own: NUMBERS[own].low}
    file, parameters = watched(path, contents[0], overruled)
    for content in contents[1:]:
        write(path, content)
        parameters = looked(file, parameters)
    assert parameters == make_parameters(read_parameters(path) | overruled)
    assert not file.look()


def test_what_is_just_being_written_is_not_read(tmp_path):
    file, _ = watched(tmp_path / "p.yaml", {"gap_s": 2.0})
    for half in ("", "gap", "gap_s: ", "gap_s: 3"):
        write(tmp_path / "p.yaml", half)
        assert file.look() == {}
    assert file.look() == {"gap_s": 3.0}


@pytest.mark.parametrize("content", [{"gap_s": -1.0, "stuck_s": 100.0}, {"gap": 1.0}, "gap_s: [", "just text"])
def test_a_bad_file_is_refused_whole_and_once(tmp_path, content):
    file, parameters = watched(tmp_path / "p.yaml", {"gap_s": 2.0})
    write(tmp_path / "p.yaml", content)
    assert file.look() == {}
    with pytest.raises(InputError):
        file.look()
    assert file.look() == {}
    write(tmp_path / "p.yaml", {"gap_s": 4.0})
    assert looked(file, parameters).number("gap_s") == 4.0


def test_a_file_that_is_gone_changes_nothing_and_counts_again_when_it_is_back(tmp_path):
    file, parameters = watched(tmp_path / "p.yaml", {"gap_s": 2.0})
    (tmp_path / "p.yaml").unlink()
    assert looked(file, parameters) == parameters
    write(tmp_path / "p.yaml", {"gap_s": 5.0})
    assert looked(file, parameters).number("gap_s") == 5.0


def test_what_was_refused_is_asked_again_with_the_next_file(tmp_path):
    file, parameters = watched(tmp_path / "p.yaml", {"vehicle": "xgd24d"})
    write(tmp_path / "p.yaml", {"vehicle": "agri3t", "gap_s": 3.0})
    file.look()
    changed = file.look()
    with pytest.raises(InputError, match="read once"):
        parameters.changed(changed)
    write(tmp_path / "p.yaml", {"vehicle": "xgd24d", "gap_s": 3.0})
    assert looked(file, parameters).number("gap_s") == 3.0

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A watched parameter file: each line that is not refused is applied, and never one that is half written."""

import json
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackres_ros.node.parameters import PARAMETERS, ParameterFile, make_parameters, read_parameters

RUNS = {name: p for name, p in PARAMETERS.items() if not p.fixed_because}
NUMBERS = {name: p for name, p in RUNS.items() if p.is_number and not name.startswith("output")}
BAD = {"gap_s": -1.0, "learning": "perhaps", "vehicle": "agri3t", "gap": 2.0, "jumps_to_accept": 2.5, "belt_sensor": True, "3": 1}


def values(parameter):
    return (st.integers if isinstance(parameter.default, int) else st.floats)(parameter.low, parameter.high)


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
        changed, _ = file.look(parameters.with_changes)
        if changed:
            parameters = parameters.with_changes(changed)
            file.note_changes(changed)
    return parameters


@settings(max_examples=60)
@given(st.lists(CONTENT, min_size=1, max_size=4), st.sampled_from(sorted(NUMBERS)))
def test_edits_give_the_parameters_of_a_start_with_the_last_file(tmp_path_factory, contents, own):
    path = tmp_path_factory.mktemp("p") / "p.yaml"
    overruled = {own: NUMBERS[own].low}
    file, parameters = watched(path, contents[0], overruled)
    for content in contents[1:]:
        write(path, content)
        parameters = looked(file, parameters)
    assert parameters == make_parameters(read_parameters(path) | overruled)
    assert file.look(parameters.with_changes) == ({}, [])


def test_an_edit_during_the_start_is_applied(tmp_path):
    path = tmp_path / "p.yaml"
    write(path, {"gap_s": 2.0})
    parameters = make_parameters(read_parameters(path))
    write(path, {"gap_s": 3.0})
    assert looked(ParameterFile(path, "trackres", "/", parameters, ()), parameters).number("gap_s") == 3.0


def test_what_is_just_being_written_is_not_read(tmp_path):
    file, parameters = watched(tmp_path / "p.yaml", {"gap_s": 2.0})
    for half in ("", "gap", "gap_s: ", "gap_s: 3"):
        write(tmp_path / "p.yaml", half)
        assert file.look(parameters.with_changes) == ({}, [])
    assert file.look(parameters.with_changes) == ({"gap_s": 3.0}, [])


@pytest.mark.parametrize("content", ["gap_s: [", "just text", "/other: {ros__parameters: {gap_s: 3.0}}"])
def test_a_file_that_cannot_be_read_is_refused_once(tmp_path, content):
    file, parameters = watched(tmp_path / "p.yaml", {"gap_s": 2.0})
    write(tmp_path / "p.yaml", content)
    looks = [file.look(parameters.with_changes) for _ in range(3)]
    assert [changed for changed, _ in looks] == [{}, {}, {}]
    assert [len(refusal) for _, refusal in looks] == [0, 1, 0]
    write(tmp_path / "p.yaml", {"gap_s": 4.0})
    assert looked(file, parameters).number("gap_s") == 4.0


@settings(max_examples=60)
@given(CONTENT, st.sets(st.sampled_from(sorted(BAD)), min_size=1), st.sampled_from([None, "on", True, False]))
def test_a_refused_line_stops_no_other_line(tmp_path_factory, content, bad, learning):
    path = tmp_path_factory.mktemp("p") / "p.yaml"
    file, parameters = watched(path, {"vehicle": "xgd24d"})
    good = {"vehicle": "xgd24d"} | {name: value for name, value in content.items() if name not in bad}
    good |= {"learning": learning} if learning is not None and "learning" not in bad else {}
    write(path, good | {name: BAD[name] for name in bad})
    file.look(parameters.with_changes)
    changed, refusal = file.look(parameters.with_changes)
    assert parameters.with_changes(changed) == make_parameters(good)
    assert {error.where for error in refusal} == {f"parameter {name}" if name in PARAMETERS else "parameter" for name in bad}
    assert file.look(parameters.with_changes) == ({}, [])


def test_two_changes_that_need_each_other_are_made_in_any_order(tmp_path):
    for content in ("output_rate_hz: 2.0\noutput_deadline_s: 1.0\n", "output_rate_hz: 200.0\ngap_s: -1\n"):
        file, parameters = watched(tmp_path / "p.yaml", {"output_deadline_s": 1.0 if "2.0" in content else 0.2})
        write(tmp_path / "p.yaml", content)
        assert looked(file, parameters).number("output_rate_hz") == float(content.split()[1])


def test_a_missing_file_changes_nothing_and_is_read_once_back(tmp_path):
    file, parameters = watched(tmp_path / "p.yaml", {"gap_s": 2.0})
    (tmp_path / "p.yaml").unlink()
    assert looked(file, parameters) == parameters
    write(tmp_path / "p.yaml", {"gap_s": 5.0})
    assert looked(file, parameters).number("gap_s") == 5.0


def test_what_was_refused_is_asked_again_with_the_next_file(tmp_path):
    file, parameters = watched(tmp_path / "p.yaml", {"vehicle": "xgd24d"})
    for share in (0.01, 0.02):
        write(tmp_path / "p.yaml", {"vehicle": "agri3t", "feedforward_share": share})
        file.look(parameters.with_changes)
        changed, (refusal,) = file.look(parameters.with_changes)
        assert changed == {"feedforward_share": share}
        assert "reads it once" in str(refusal)
        assert str(tmp_path / "p.yaml") in file.refusal_text(refusal)
    write(tmp_path / "p.yaml", {"vehicle": "xgd24d", "gap_s": 3.0})
    assert looked(file, parameters).number("gap_s") == 3.0

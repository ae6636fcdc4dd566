# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameter table: every value is checked, files of both forms are read, and nothing unknown passes."""

import dataclasses
import math

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.errors import InputError
from trackres_ros.estimator.settings import AGE_LIMITS, Settings, settings_for
from trackres_ros.node.parameters import PARAMETERS, Parameters, make_parameters, read_parameters, read_with_overrides
from trackres_ros.recording.bindings import Topics

NUMBERS = [p for p in PARAMETERS.values() if p.is_number]


def test_defaults_are_within_their_own_limits():
    for parameter in PARAMETERS.values():
        assert parameter.check(parameter.default) == parameter.default
        assert parameter.meaning


def test_every_setting_of_the_estimator_is_a_parameter():
    assert {item.name for item in dataclasses.fields(Settings)} <= set(PARAMETERS)
    assert make_parameters({}).settings() == Settings()


@pytest.mark.parametrize("parameter", NUMBERS, ids=lambda p: p.name)
def test_a_number_and_its_limits_are_of_one_type(parameter):
    kind = type(parameter.default)
    assert kind in (int, float)
    for value in (parameter.low, parameter.high):
        assert type(value) is kind
        for given_ in {value, float(value), int(value) if float(value).is_integer() else value}:
            assert type(parameter.check(given_)) is kind
    assert kind is int or parameter.unit, "a count is a whole number"
    assert make_parameters({}).values[parameter.name] == parameter.default


def test_counts_are_whole_numbers():
    assert {p.name for p in NUMBERS if isinstance(p.default, int)} >= {"jumps_to_accept", "input_depth", "output_depth"}
    assert isinstance(make_parameters({"input_depth": 20.0}).count("input_depth"), int)
    with pytest.raises(InputError, match="a whole number from 2 to 100"):
        make_parameters({"jumps_to_accept": 2.5})
    with pytest.raises(InputError, match="a whole number from 2 to 100"):
        Settings(jumps_to_accept=2.5)


@pytest.mark.parametrize(
    ("text", "mode"), [("on", "on"), ("off", "off"), ("true", "on"), ("'on'", "on"), ("watch", "watch"), ("No", "off")]
)
def test_learning_takes_what_yaml_makes_of_on_and_off(tmp_path, text, mode):
    path = tmp_path / "p.yaml"
    for form in (f"learning: {text}\n", f"/**:\n  ros__parameters:\n    learning: {text}\n"):
        path.write_text(form)
        assert make_parameters(read_parameters(path)).text("learning") == mode
    with pytest.raises(InputError, match="belt_sensor: given True"):
        make_parameters({"belt_sensor": True})


@given(st.sampled_from(NUMBERS), st.floats() | st.integers(-(10**6), 10**6))
def test_a_number_passes_just_when_it_is_in_range(parameter, value):
    fits = isinstance(parameter.default, float) or float(value).is_integer()
    if math.isfinite(value) and parameter.low <= value <= parameter.high and fits:
        assert parameter.check(value) == value
    else:
        with pytest.raises(InputError, match=f"{parameter.name}.*given.*allowed"):
            parameter.check(value)


@pytest.mark.parametrize("value", [True, "3", None, [1.0]])
def test_other_kinds_are_no_numbers(value):
    with pytest.raises(InputError, match="gap_s"):
        make_parameters({"gap_s": value})


def test_a_change_is_all_or_nothing():
    parameters = make_parameters({"vehicle": "xgd24d"})
    with pytest.raises(InputError, match="gap_s"):
        parameters.with_changes({"output_rate_hz": 10, "gap_s": -1})
    assert parameters.number("output_rate_hz") == 50.0


def test_a_deadline_that_the_rate_cannot_keep_is_refused():
    assert make_parameters({"output_rate_hz": 2.0, "output_deadline_s": 1.0})
    for values in ({"output_rate_hz": 2.0}, {"output_deadline_s": 0.01}):
        with pytest.raises(InputError, match="output_deadline_s"):
            make_parameters(values)


def test_what_is_fixed_may_be_set_to_what_it_is():
    parameters = make_parameters({"vehicle": "xgd24d"})
    assert isinstance(parameters.with_changes({"vehicle": "xgd24d"}), Parameters)
    with pytest.raises(InputError, match="reconfigure the node"):
        parameters.with_changes({"vehicle": "agri3t"})


@pytest.mark.parametrize(
    ("text", "node", "namespace", "expected"),
    [
        ("gap_s: 2.0\n", "trackres", "/", {"gap_s": 2.0}),
        ("/**:\n  ros__parameters:\n    gap_s: 2\n", "other", "/a/b", {"gap_s": 2}),
        ("trackres:\n  ros__parameters:\n    gap_s: 2.0\n", "trackres", "/", {"gap_s": 2.0}),
        ("/a/trackres:\n  ros__parameters:\n    gap_s: 2.0\n", "trackres", "/a", {"gap_s": 2.0}),
        ("/a:\n  trackres:\n    ros__parameters:\n      gap_s: 2.0\n", "trackres", "/a", {"gap_s": 2.0}),
        ("/**/trackres: {ros__parameters: {gap_s: 2}}\n", "trackres", "/", {"gap_s": 2}),
        ("/**: {ros__parameters: {gap_s: 2}}\n/*/a: {ros__parameters: {gap_s: 3}}\n", "a", "/b/c", {"gap_s": 2}),
        ("/a.: {ros__parameters: {gap_s: 2}}\n/a(: {ros__parameters: {}}\n/**: {ros__parameters: {}}\n", "ab", "/", {}),
        ("other:\n  ros__parameters: {x: 1}\n/**:\n  ros__parameters:\n", "trackres", "/b", {}),
        ("/**:\n  ros__parameters: {gap_s: 2.0}\ntrackres:\n  ros__parameters: {gap_s: 3.0}\n", "trackres", "/", {"gap_s": 3.0}),
    ],
)
def test_files_of_both_forms_are_read(tmp_path, text, node, namespace, expected):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    assert read_parameters(path, node, namespace) == expected


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("/a/trackres:\n  ros__parameters: {gap_s: 2.0}\n", ["/a/trackres", "/b/trackres", "/**"]),
        ("left: {x: {ros__parameters: {gap_s: 2.0}}, y: {ros__parameters: {}}}\n", ["/left/x, /left/y", "/b/trackres"]),
        ("/b/trackres: {ros_parameters: {gap_s: 2.0}}\n", ["b/trackres/ros_parameters", "did you mean ros__parameters?"]),
        ("gap_s: 1.0\n/**: {ros__parameters: {gap_s: 2.0}}\n", ["gap_s", "1.0", "name of a node"]),
        ("/**: {ros__parameters: 3}\n", ["ros__parameters", "3"]),
    ],
)
def test_no_section_is_ignored_for_its_name(tmp_path, text, said):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as error_info:
        read_parameters(path, "trackres", "/b")
    for part in (str(path), *said):
        assert part in str(error_info.value)


@pytest.mark.parametrize("text", ["gap: 2.0\n", "gap_s: -1\n", "/**:\n  ros__parameters:\n    gap_s: .nan\n", "- 1\n", "a: {"])
def test_a_bad_file_is_named(tmp_path, text):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"p\.yaml"):
        read_parameters(path)


def test_the_shipped_file_holds_the_defaults(repository):
    assert make_parameters(read_parameters(repository / "config" / "trackres.yaml")) == make_parameters({})


def test_age_limits_of_a_topics_file_become_settings():
    line = {"topic": "t", "type": "std_msgs/Float64", "field": "data"}
    for role, name in AGE_LIMITS.items():
        topics = Topics.parse({"speed": line, role: {**line, "max_age_s": 3.0}})
        assert getattr(settings_for(Settings(), topics), name) == 3.0
    with pytest.raises(InputError, match="yaw_rate"):
        settings_for(Settings(), Topics.parse({"yaw_rate": {**line, "max_age_s": 3.0}}))
    with pytest.raises(InputError, match="max_age_s"):
        settings_for(Settings(), Topics.parse({"speed": {**line, "max_age_s": 3000.0}}))


BELT = "belt: {topic: belt, type: sensor_msgs/msg/Temperature, field: temperature"
ENABLE = "enable: {topic: enable, type: std_msgs/msg/Float64, field: data"


@pytest.mark.parametrize(
    ("line", "name", "value", "fixed"),
    [
        (f"{BELT}}}", "belt_sensor", "mean", False),
        (f"{BELT}, sensor: surface}}", "belt_sensor", "mean", True),
        (f"{BELT}}}", "belt_measured_std_k", 0.5, False),
        (f"{BELT}, std_k: 2.0}}", "belt_measured_std_k", 0.5, True),
        (f"{ENABLE}}}", "enable_hold_s", 0.2, False),
        (f"{ENABLE}, max_age_s: 0.3}}", "enable_hold_s", 0.2, True),
    ],
)
def test_a_parameter_acts_where_the_topics_file_gives_no_other(desk, line, name, value, fixed):
    speed = "speed: {topic: speed, type: geometry_msgs/msg/TwistStamped, field: twist.linear.x}"
    lines = f"{speed}\n{line}\n"
    at_start, changed = desk(lines, **{name: value}), desk(lines)
    result_before = getattr(changed.app.estimator.settings, name)
    assert (getattr(at_start.app.estimator.settings, name) == value) is not fixed
    if fixed:
        field = line.rpartition(", ")[2].partition(":")[0]
        with pytest.raises(InputError, match=f"set by the topics file; change {field} in"):
            changed.app.change({name: value})
    else:
        changed.app.change({name: value})
        changed.app.change({name: make_parameters({}).values[name]})
        assert getattr(changed.app.estimator.settings, name) == result_before


def test_a_change_that_the_vehicle_refuses_changes_nothing(desk):
    app = desk().app
    before = app.parameters
    for change in (app.checked_change, app.change):
        with pytest.raises(InputError, match="motor_ratio"):
            change({"torque_at": "motor", "learning": "on"})
    assert app.parameters == before
    assert app.estimator.settings.torque_at == "sprockets"


def test_overrides_of_qos_are_apart_with_full_names(tmp_path):
    path, words = tmp_path / "p.yaml", {"/left/speed": {"subscription": {"reliability": "reliable", "depth": 7}}}
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"gap_s": 2.0, "qos_overrides": words}}}))
    named = {
        f"qos_overrides./left/speed.subscription.{name}": value for name, value in (("reliability", "reliable"), ("depth", 7))
    }
    assert read_with_overrides(path, "trackres", "/") == (read_parameters(path), named) == ({"gap_s": 2.0}, named)
    path.write_text("/**: {ros__parameters: {qos_overrides: {/speed: {subscription: {depth: [7]}}}}}\n")
    with pytest.raises(InputError, match=r"speed\.subscription\.depth: given"):
        read_parameters(path)


@pytest.mark.parametrize("name", ["speed kmh", "/a//b", "~/speed", "{node}/speed", "/2nd", "a/", "/", "/räder"])
def test_a_topic_name_that_ros_does_not_allow_is_refused(desk, name):
    line = "{{topic: {}, type: std_msgs/msg/Float64, field: data}}"
    good, bad = line.format("/a_1/b"), line.format(f'"{name}"')
    desk(f"speed: {good}\n")
    for lines in (f"speed: {good}\nbrake: {bad}\n", f"speed: {{sum: [{good}, {bad}]}}\n"):
        with pytest.raises(InputError, match=r"topics\.yaml: (brake|speed): topic: given .*allowed: a path such as /left/speed"):
            desk(lines)

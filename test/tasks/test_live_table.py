# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live table in a terminal of 80 columns: everything is there, nothing is cut."""

import json
import math
import re
from dataclasses import replace

import pytest
from rich.console import Console

from trackres_ros.estimator.disturbance import Belief
from trackres_ros.node.measured_torque import Mismatch
from trackres_ros.node.notices import KINDS, Notice
from trackres_ros.node.status import InputState, Overview
from trackres_ros.node.transport import Level
from trackres_ros.tasks.live_display import LiveJson, LiveTable, as_dict, line, table

ASSEMBLIES = ("front_left", "front_right", "rear_left", "rear_right")
TOPICS = ("speed", "/vehicle/status/velocity_status", "/a/very/long/name/of/a/topic/that/somebody/has/chosen/for/his/load/cells")


def overview(assemblies=ASSEMBLIES, remarks=()):
    values = {
        "resistance_torque_nm": 1038.0, "hysteresis_nm": 1934.0, "bearing_nm": 910.0, "wind_nm": 40.0, "effects_nm": -1846.0,
        "grade_nm": -12345.0, "inertia_nm": 123456.0, "resistance_std_nm": 10438.0, "speed_mps": 15.0,
    }  # fmt: skip
    for name in assemblies:
        item = {"belt_degc": 104.2, "belt_std_k": 12.3, "load_n": 123456.0, "resistance_torque_nm": 12345.0}
        values |= {f"{column}/{name}": value for column, value in item.items()}
    counts = (("accepted", 123456789), ("non_finite", 12345), ("out_of_range", 12345), ("bad_stamp", 99), ("dropped", 1234567))
    inputs = [
        InputState("load/rear_right", topic, 1000.0, age, value, counts)
        for topic, age, value in zip(TOPICS, (0.0, 3.21, 86400.0), (8.0, -0.25, 272000.0), strict=True)
    ]
    inputs.append(InputState("torque", "torque", math.nan, math.nan, math.nan, ()))
    compared = Mismatch(True, 12.0, 500.0, 0.5, True, "measured torque is 500 Nm above the expected one")
    statement = tuple(Notice(name, kind.meaning) for name, kind in KINDS.items() if name in remarks)
    state = "/home/somebody/.local/state/trackres/x.json"
    return Overview(
        Level.WARN, statement, 1_700_000_000 * 10**9, 0.02, 1000.0, 5, 1.0, -98765.0, values, tuple(assemblies), tuple(inputs),
        compared, None, "", state, 3.0, "", "",
    )  # fmt: skip


def drawn(seen, width):
    console = Console(width=width, force_terminal=False)
    with console.capture() as capture:
        console.print(table("trackres: 24 t chassis on four triangular rubber-track assemblies", seen))
    return capture.get()


@pytest.mark.parametrize("width", [80, 100, 200])
def test_nothing_is_cut_and_numbers_stay_on_their_line(width):
    seen = overview(remarks=("SPEED_OLD", "OVERRUN", "WRONG_TYPE"))
    shown = drawn(seen, width)
    assert "…" not in shown
    assert all(len(text) <= width for text in shown.splitlines())
    for number in ("1038 +- 10438", "104.2 +- 12.3", "123.5", "12345", "-1846", "123456789", "272000 N", "86400", "-98765"):
        assert any(number in text for text in shown.splitlines()), number
    words = re.sub(r"[\s│]+", "", shown)
    for topic in TOPICS:  # a long one continues below
        assert topic[:20] in words
        assert topic[-4:] in words
    for name in ("bad_stamp99", "dropped1234567", *ASSEMBLIES):
        assert name in words
    assert all(re.sub(r"\s+", "", remark.text) in words for remark in seen.notices)


def test_the_parts_that_are_shown_add_up():
    rows = dict(re.findall(r"│\s+(hysteresis|bearing|wind|effects|resistance \(sum\))\s+(-?\d+)", drawn(overview(), 80)))
    total = int(rows.pop("resistance (sum)"))
    assert len(rows) == 4
    assert sum(map(int, rows.values())) == total


def test_what_is_watched_for_is_shown_and_said():
    belief = Belief("spells", 0.97, 291.0, 60.0, 1_700_000_000 * 10**9, True, False)
    watching = replace(overview(), disturbance=belief)
    words, bare = (re.sub(r"[\s│]+", "", drawn(seen, 80)) for seen in (watching, overview()))
    assert re.sub(r"\s+", "", f"disturbance: {belief.text}") in words
    assert "disturbance:" not in bare
    assert as_dict(overview(), False)["disturbance"] is None
    text = as_dict(watching, False)["disturbance"]
    assert (text["there"], text["present"], text["torque_nm"]) == (0.97, True, 291.0)
    drift = as_dict(replace(watching, disturbance=replace(belief, form="drift", there=math.nan)), False)
    assert json.loads(json.dumps(drift, allow_nan=False))["disturbance"]["there"] is None


def test_what_is_learned_is_shown_and_said():
    learning = replace(overview(), learning="learned 2 of 6, 46 Nm better than the vehicle file; used")
    words, bare = (re.sub(r"[\s│]+", "", drawn(seen, 80)) for seen in (learning, overview()))
    assert re.sub(r"\s+", "", f"learning: {learning.learning}") in words
    assert "learning:" not in bare
    assert as_dict(learning, False)["learning"] == learning.learning
    assert as_dict(overview(), False)["learning"] is None


def test_the_line_and_the_json_say_the_same():
    seen = overview()
    assert "feed-forward -98765 Nm" in line(seen)
    statement = json.loads(json.dumps(as_dict(seen, True), allow_nan=False))
    assert statement["final"] is True
    assert statement["feedforward_published_nm"] == -98765.0
    assert statement["inputs"][-1]["age_s"] is None
    assert statement["inputs"][0]["counts"]["dropped"] == 1234567


@pytest.mark.parametrize("display", [LiveJson, lambda seen: LiveTable(lambda: "a vehicle", seen)])
def test_a_display_whose_output_is_read_ends_with_its_last_state(display, capsys):
    shown = display(overview)
    shown.start()
    assert shown.stop()
    assert "-98765" in capsys.readouterr().out

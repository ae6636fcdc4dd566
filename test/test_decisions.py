# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The measurements behind docs/decisions can be repeated, and each page is listed; no time is judged here."""

import importlib
import math
import re
import shutil
import sys

import pytest

for needed in ("rosbags", "mcap", "attrs"):
    pytest.importorskip(needed)


@pytest.fixture
def decisions(repository, monkeypatch):
    monkeypatch.syspath_prepend(str(repository / "benchmarks"))
    yield importlib.import_module("decisions")
    for name in ("decisions", "measuring", "bench_step"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(("name", "sizes"), [("cdr", {"messages": 500, "repeats": 1}), ("mcap", {"messages": 500, "repeats": 1})])
def test_ours_and_the_library_are_measured(decisions, name, sizes):
    assert all(math.isfinite(value) and value > 0.0 for value in decisions.DECISIONS[name](**sizes).values())


def test_the_noise_with_spikes_is_found_better_than_as_normal(decisions):
    pytest.importorskip("statsmodels", reason="statsmodels, which only this comparison needs, is not installed")
    found = decisions.noise(samples=2000, draws=5)
    assert found["log-density of a fresh draw, ours less statsmodels [a sample]"] > 0.1


def test_every_wrong_line_is_refused_with_all_a_user_must_know(decisions):
    found = decisions.checks()
    assert found["ours: refused with all of it named"] == len(decisions.WRONG)
    assert found["ours: refused with all of it named"] > found["attrs: refused with all of it named"]


def test_no_torque_is_rounded_on_its_way_to_a_controller(decisions):
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")
    found = decisions.estimate(messages=50, repeats=1)
    assert found["DynamicInterfaceGroupValues: a torque is off by [Nm]"] == 0.0
    assert found["DiagnosticArray: a torque is off by [Nm]"] > 0.0


def test_the_library_of_the_page_is_smaller_packed(decisions):
    pytest.importorskip("bokeh")
    found = decisions.page()
    assert found["Bokeh, without widgets, packed [kB]"] < 0.5 * found["Bokeh, without widgets [kB]"] < 1000.0


def test_the_translation_has_all_functions_and_casadi_runs_fewer(decisions):
    if not shutil.which("cc"):
        pytest.skip("no C compiler is installed")
    found = decisions.export(steps=100)
    assert found["translated: functions"] > 50.0
    assert found.get("CasADi: functions that run on its symbols as they are", 0.0) < found["translated: functions"]


def test_names_and_indices_of_a_state_give_the_same(decisions):
    assert all(value > 0.0 for value in decisions.rows(steps=500, repeats=1).values())


def test_each_decision_is_listed_and_names_its_measurement(repository, decisions):
    folder = repository / "docs" / "decisions"
    pages = {path.name for path in folder.glob("*.md")} - {"README.md"}
    assert set(re.findall(r"\]\((.+?\.md)\)", (folder / "README.md").read_text())) == pages
    command = r"`(?:python benchmarks/decisions.py (\w+)`|python -m proofs )"
    measured = [re.search(command, (folder / page).read_text()) for page in pages - {"words.md", "size.md"}]
    assert {match.group(1) for match in measured} - {None} == set(decisions.DECISIONS)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node of a vehicle without belts: the same topics but for those of belts, and nothing that pushes a standing vehicle."""

import math

import pytest
from rich.console import Console

from trackres_ros.estimator import columns as at
from trackres_ros.tasks.live_display import line, table

BUS = "ztbus_hess19"


def driven(desk, speeds):
    for speed in speeds:
        desk.forward(0.1)
        desk.send("speed", speed)


def test_its_topics_are_those_without_belts(desk, topics):
    d = desk(vehicle=BUS, topics=topics)
    names = [output.name for output in d.app.outputs]
    assert not [name for name in names if "temperature" in name]
    assert {"feedforward_torque", "estimate", "resistance_torque", "torque_residual", "status"} <= set(names)
    driven(d, [8.0 + 0.01 * (i % 7) for i in range(100)])
    assert all(math.isfinite(value) for name, _, values in d.published for value in values if name != "torque_residual")
    (resistance,) = [o for o in d.app.outputs if o.name == "resistance_torque"]
    efforts = dict(zip(resistance.names, next(v for n, _, v in reversed(d.published) if n == "resistance_torque"), strict=True))
    assert efforts["bearing"] < -500.0
    assert efforts["total"] == pytest.approx(sum(efforts[part] for part in ("hysteresis", "bearing", "wind", "effects")))


def test_nothing_is_fed_forward_once_it_stands(desk):
    d = desk(vehicle=BUS)
    driven(d, [8.0 - 0.04 * i for i in range(200)] + [0.0] * 50)
    torques = [values[0] for name, _, values in d.published if name == "feedforward_torque_nm"]
    assert max(torques) > 500.0
    assert torques[-1] == 0.0


def test_a_measured_torque_is_compared_and_learned_from(desk, topics):
    d = desk(vehicle=BUS, topics=topics, learning="on")
    for i in range(900):
        d.send("torque", 1800.0 + 20.0 * (i % 3))
        driven(d, [8.0 + 0.01 * (i % 7)])
    d.app._publish_status(d.app.clock.steady_ns(), diagnostics=True)
    residual = [values for name, _, values in d.published if name == "torque_residual"][-1]
    assert residual[2] == pytest.approx(residual[0] - residual[1])
    learner = d.app.learning.learner
    assert [learnable.name for learnable in learner.learnables][:3] == [
        "rolling_coefficient",
        "drag_area",
        "rotating_mass_factor",
    ]
    assert learner.learned.mean[at.OF_BEARING] > 0.1
    assert "parameters" in [output.name for output in d.app.outputs]


def test_the_terminal_shows_what_rolls_and_no_belt(desk):
    d = desk(vehicle=BUS)
    driven(d, [8.0, 8.1, 8.2])
    seen = d.app.overview()
    console = Console(record=True, width=120)
    console.print(table("bus", seen))
    shown_text = console.export_text() + line(seen)
    assert "rolling" in shown_text
    assert "at wheels" in shown_text
    assert "belt" not in shown_text
    assert "hysteresis" not in shown_text


def test_its_state_is_kept_over_a_restart(desk, tmp_path):
    kept = {"vehicle": BUS, "state_file": str(tmp_path / "state.json")}
    first = desk(**kept)
    driven(first, [8.0] * 20)
    first.save()
    repetition = desk(**kept)
    assert "restored from" in repetition.app.began_with
    assert "belts" not in repetition.app.began_with

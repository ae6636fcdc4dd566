# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parts of the torque in every command add up, with effects in the vehicle file and without."""

import json
import re
from itertools import takewhile

import numpy as np
import pytest

from trackres_ros.model.resistance import RESISTANCE_PARTS

EFFECTS = """
effects:
  warmup: {torque: 600.0, time_constant: 300.0, cooling: 900.0}
  drivetrain_efficiency: {efficiency: 0.92}
  lug_friction: {of_tension: 0.005, of_torque: 0.015}
  turning_scrub: {friction: 0.3}
"""


@pytest.fixture(scope="module")
def vehicles(tmp_path_factory, repository):
    folder = tmp_path_factory.mktemp("vehicles")
    text = (repository / "config" / "xgd24d.yaml").read_text().replace("rubber/nr", f"{repository}/config/rubber/nr")
    with_effects = folder / "with_effects.yaml"
    with_effects.write_text(text + EFFECTS)
    return {"plain": "xgd24d", "with effects": with_effects}


@pytest.fixture(scope="module", params=["plain", "with effects"])
def vehicle(request, vehicles):
    return vehicles[request.param]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "drive.csv"
    time = np.arange(0.0, 60.0, 0.1)
    speed = 8.0 * np.sin(time / 8.0)
    path.write_text("time_s,speed_mps\n" + "\n".join(f"{t:.3f},{v:.5f}" for t, v in zip(time, speed, strict=True)))
    return path


def columns(path):
    return np.genfromtxt(path, delimiter=",", names=True, deletechars="")


def adds_up(table):
    resistance = table["resistance_torque_nm"]
    np.testing.assert_allclose(sum(table[column] for column in RESISTANCE_PARTS.values()), resistance, atol=1e-9, rtol=0)
    with_grade = table["grade_nm"] if "grade_nm" in table.dtype.names else 0.0
    np.testing.assert_allclose(resistance + with_grade + table["inertia_nm"], table["drive_torque_nm"], atol=1e-9, rtol=0)


def printed(text, total, parts):
    """Numbers of a sentence, each rounded on its own."""
    numbers = {name: float(re.search(rf"\b{name} (-?\d+)", text)[1]) for name in (total, *parts)}
    assert abs(sum(numbers[part] for part in parts) - numbers[total]) <= 0.5 * (len(parts) + 1)


@pytest.mark.usefixtures("undrawn")
def test_replay(vehicle, drive, tmp_path, good):
    text = good("replay", drive, "--vehicle", vehicle, "-o", tmp_path / "out.csv")
    table = columns(tmp_path / "out.csv")
    adds_up(table)
    for column in ("resistance_torque_nm", "hysteresis_nm"):
        each = sum(table[name] for name in table.dtype.names if name.startswith(f"{column}/"))
        np.testing.assert_allclose(each, table[column], atol=1e-9, rtol=0)
    assert np.any(table["effects_nm"]) == (vehicle != "xgd24d")
    printed(next(line for line in text.splitlines() if line.startswith("At the end")), "resistance", RESISTANCE_PARTS)
    statement = json.loads(good("replay", drive, "--vehicle", vehicle, "-o", tmp_path / "out.csv", "--json"))["last"]
    assert sum(statement[column] for column in RESISTANCE_PARTS.values()) == pytest.approx(
        statement["resistance_torque_nm"], abs=1e-9
    )


def test_simulate(vehicle, tmp_path, good):
    text = good("simulate", "--vehicle", vehicle, "--speed-kmh", 30, "--duration-s", 60, "-o", tmp_path / "out.csv")
    adds_up(columns(tmp_path / "out.csv"))
    head, _, *rows = text.splitlines()
    numbers = takewhile(lambda row: not row.lstrip().startswith(("The ", "!")), rows)
    shown_texts = [dict(zip(head.split(), map(float, row.split()), strict=True)) for row in numbers]
    assert shown_texts
    for row in shown_texts:
        assert abs(sum(row[part] for part in RESISTANCE_PARTS) - row["resistance"]) <= 2.5


@pytest.mark.parametrize("speed_kmh", [-30, 20])
def test_explain(vehicle, speed_kmh, good):
    given_valuess = ("explain", "--vehicle", vehicle, "--speed-kmh", speed_kmh, "--belt-degc", 20)
    torque = json.loads(good(*given_valuess, "--json"))["torque_nm"]
    assert sum(torque[part] for part in RESISTANCE_PARTS) == pytest.approx(torque["resistance"], abs=1e-9)
    assert (torque["effects"] != 0.0) == (vehicle != "xgd24d")
    printed(next(line for line in good(*given_valuess).splitlines() if line.startswith("Torque")), "resistance", RESISTANCE_PARTS)


def test_errors_are_json_where_json_is_asked_for(tmp_path, trackres):
    for words in (
        ("replay", "nowhere.mcap", "--vehicle", "xgd24d", "-o", tmp_path / "out.csv"),
        ("explain", "--vehicle", "nonsense", "--speed-kmh", 10, "--belt-degc", 20),
        ("explain", "--vehicle", "xgd24d", "--speed-kmh", "fast", "--belt-degc", 20),
        ("live", "--vehicle", "nonsense"),
        ("play", "nowhere.mcap"),
        ("vehicle", "check", "nonsense"),
        ("diagnose", "nowhere.csv", "--vehicle", "xgd24d", "-o", tmp_path / "report"),
    ):
        outcome = trackres(*words, "--json", cwd=tmp_path)
        assert outcome.returncode == 2, outcome.stderr
        error = json.loads(outcome.stdout)["error"]
        assert set(error) == {"where", "given", "allowed", "remedy"}
        assert error["where"]
        assert error["allowed"]
        assert outcome.stderr == ""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two designs side by side."""

import json

import numpy as np
import pytest
import yaml

GRID = ("--speed-kmh", "5:12", "--belt-degc", "0:60")


@pytest.fixture(scope="module")
def softer(tmp_path_factory, good):
    """The reference vehicle with half of the loss, and twice the bearing friction."""
    folder = tmp_path_factory.mktemp("designs")
    good("vehicle", "new", "softer", "-o", folder)
    file = folder / "softer.yaml"
    content = yaml.safe_load(file.read_text())
    content["rubber"]["loss_modulus_scale"].update(value=0.5, range=[0.4, 0.6])
    file.write_text(yaml.safe_dump(content))
    return file


def test_half_of_the_loss_is_half_of_the_hysteresis_at_every_point(good, softer):
    found = json.loads(good("compare", "xgd24d", softer, *GRID, "--json"))["designs"]
    assert found["speeds_kmh"][0] == 5.0
    assert found["belts_degc"][-1] == 60.0
    full, half = (np.array(design["torque_nm"]) for design in found["designs"])
    assert np.all(half < full)
    rest = (
        2.0 * half - full
    )  # bearings and air, alike in both and at every temperature; the torque it drives with strains the belt
    assert rest.std(axis=0).max() < 0.01 * full.mean()
    assert np.all(np.diff(full, axis=0) < 0.0)  # warmer rubber loses less
    drives = [design["drive"] for design in found["designs"]]
    assert drives[0]["km"] == drives[1]["km"]
    assert drives[1]["kwh_per_km"] < drives[0]["kwh_per_km"]


def test_the_table_and_the_picture(good, softer, tmp_path):
    text = good("compare", "xgd24d", softer, *GRID, "-o", tmp_path / "out")
    assert "Resistance [Nm] of softer" in text
    assert "kWh/km" in text
    assert (tmp_path / "out" / "designs.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_two_versions_of_one_name_go_by_their_files(good, softer):
    other = softer.with_name("wider.yaml")
    other.write_text(softer.read_text())
    text = good("compare", softer, other, *GRID)
    assert "Resistance [Nm] of softer" in text
    assert "Resistance [Nm] of wider" in text


def test_the_same_design_twice_is_the_same(good):
    one, other = json.loads(good("compare", "agri3t", "agri3t", "--json"))["designs"]["designs"]
    assert one == other


@pytest.mark.parametrize(
    ("given", "part"),
    [
        (("xgd24d", "agri3t", "--speed-kmh", "20:10"), "A:B"),
        (("xgd24d", "agri3t", "--speed-kmh", "5:50"), "--speed-kmh"),
        (("xgd24d", "agri3t", "--belt-degc", "warm"), "A:B"),
        (("husky", "husky", "--belt-degc", "0:20"), "only with two vehicle files with tracks"),
        (("xgd24d", "agri3t", "--cycle", "nothing.csv"), "nothing.csv"),
    ],
)
def test_what_cannot_be_is_one_line(trackres, given, part):
    refused = trackres("compare", *given)
    assert refused.returncode == 2
    assert part in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1

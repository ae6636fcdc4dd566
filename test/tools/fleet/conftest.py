# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

import shutil

import pytest

from proofs.fleet import write_recording
from trackres_ros.tools.fleet.sample import draw_fleet


@pytest.fixture(scope="session")
def driven(tmp_path_factory):
    """A folder with three recordings of five minutes of each of two vehicles, and the file of the fleet."""
    folder = tmp_path_factory.mktemp("fleet")
    for vehicle in draw_fleet(2, 9, 3.0, 5.0, (), seed=5):
        for number in range(len(vehicle.days)):
            write_recording(folder / "recordings", vehicle, number, 5.0)
    (folder / "fleet.yaml").write_text(
        "vehicles: {truck-01: xgd24d, truck-02: {file: xgd24d, limits: {bearing_friction: 0.012}}}\n"
    )
    return folder


@pytest.fixture
def recordings(driven, tmp_path):
    """A copy of them that a test may change."""
    shutil.copytree(driven, tmp_path / "fleet")
    return tmp_path / "fleet"

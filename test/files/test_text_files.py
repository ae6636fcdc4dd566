# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Text files that users write: the program that saved them, and its line ends, change nothing."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from trackres_ros.compound.reading import read_sweep
from trackres_ros.diagnosis import load_base
from trackres_ros.effects.effect import VehicleKind
from trackres_ros.errors import InputError
from trackres_ros.files.resources import config_dir
from trackres_ros.files.yamls import read_yaml
from trackres_ros.fleet.vehicles import read_fleet
from trackres_ros.node.parameters import read_parameters
from trackres_ros.recording.bindings import Topics
from trackres_ros.route.table import read_route
from trackres_ros.vehicle.loading import read_rubber_sweep
from trackres_ros.vehicle.surroundings import load_surroundings

ENDS = ("\n", "\r\n", "\r")
ROUTE = "latitude_deg,longitude_deg,course_deg,slope,std,passes\n47.0,8.0,90.0,0.01,0.002,3\n47.0001,8.0,90.0,0.02,0.002,3\n"
SURROUNDINGS = "schema: 1\nvehicle: xgd24d\neffects:\n  grade: {grade: {value: 0.01, range: [0.0, 0.02]}}\n"
FLEET = "vehicles:\n  one: xgd24d\n  other: {file: agri3t, topics: sample}\n"
RUBBER = (config_dir() / "rubber" / "nr_sbr_10hz.csv").read_text()


def of_route(path: Path) -> object:
    (route,) = read_route(path)
    return np.concatenate([route.latitude, route.value.ravel(), route.std.ravel()]).tolist()


def of_sweep(path: Path) -> object:
    sweep = read_sweep(path)
    return [sweep.temp_degc.tolist(), sweep.storage.tolist(), sweep.loss.tolist()]


def of_vehicle(path: Path) -> object:
    loaded = load_base(path)
    return loaded.title, loaded.known


def of_surroundings(path: Path) -> object:
    return read_yaml(path), [one.effect.name for one in load_surroundings(path, "xgd24d", 97920.0, VehicleKind())]


KINDS: dict[str, tuple[Callable[[Path], object], str]] = {
    "track vehicle": (of_vehicle, (config_dir() / "xgd24d.yaml").read_text()),
    "road vehicle": (of_vehicle, (config_dir() / "husky.yaml").read_text()),
    "surroundings": (of_surroundings, SURROUNDINGS),
    "topics": (lambda path: dict(Topics.load(path).bindings), (config_dir() / "topics" / "ztbus.yaml").read_text()),
    "parameters": (read_parameters, (config_dir() / "trackres.yaml").read_text()),
    "fleet": (lambda path: [(one.name, one.file, one.topics) for one in read_fleet(path).vehicles.values()], FLEET),
    "route": (of_route, ROUTE),
    "rubber": (lambda path: np.stack(read_rubber_sweep(path)).tolist(), RUBBER),
    "DMA sweep": (of_sweep, RUBBER),
}


@pytest.mark.parametrize("kind", KINDS)
def test_line_ends_and_a_byte_order_mark_change_nothing(tmp_path, kind):
    read, text = KINDS[kind]
    text = text.replace("rubber/nr_sbr", f"{config_dir()}/rubber/nr_sbr") if "vehicle" in kind else text
    path = tmp_path / ("given.yaml" if read_yaml_fits(text) else "given.csv")
    path.write_text(text)
    right = read(path)
    for end, mark, last in itertools.product(ENDS, ("", "\ufeff"), (True, False)):
        path.write_bytes((mark + (text if last else text.rstrip("\n")).replace("\n", end)).encode())
        assert read(path) == right, (end, mark, last)


def read_yaml_fits(text: str) -> bool:
    return ": " in text.splitlines()[-1]


def test_a_diagnosis_can_change_a_vehicle_file_of_any_editor(tmp_path):
    from trackres_ros.vehicle.writing.vehicle_file import opened

    text = (config_dir() / "husky.yaml").read_text()
    for end in ENDS:
        (tmp_path / "v.yaml").write_bytes(("\ufeff" + text.replace("\n", end)).encode())
        document = opened(tmp_path / "v.yaml")
        document.set(("title",), "other")
        (tmp_path / "w.yaml").write_text(document.text() or "")
        assert read_yaml(tmp_path / "w.yaml") == {**read_yaml(tmp_path / "v.yaml"), "title": "other"}


@pytest.mark.parametrize("row", ['"' + "9" * 200_000 + '"', "47,8,90\0,0.01,0.002,3", "47;8;90;1;1;1"])
def test_a_damaged_row_of_a_route_is_one_line(tmp_path, row):
    path = tmp_path / "route.csv"
    path.write_text(ROUTE + row)
    with pytest.raises(InputError) as refused:
        read_route(path)
    assert f"{path}, line" in str(refused.value)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every kind of text file that users write: one that is right, and what reads it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis import load_base
from trackres_ros.effects.effect import VehicleKind
from trackres_ros.files.resources import config_dir
from trackres_ros.node.parameters import read_parameters
from trackres_ros.recording.bindings import Topics
from trackres_ros.route.table import read_route
from trackres_ros.tasks.simulate import read_profile
from trackres_ros.tools.compound.reading import read_sweep
from trackres_ros.tools.fleet.vehicles import read_fleet
from trackres_ros.vehicle.loading import read_rubber_sweep
from trackres_ros.vehicle.surroundings import load_surroundings


def shipped(name: str) -> str:
    """A shipped file, with the place of its rubber."""
    return (config_dir() / name).read_text().replace("rubber/nr_sbr", f"{config_dir()}/rubber/nr_sbr")


EFFECTS = "\neffects: {turning_scrub: {friction: 0.3}, still_air: {share: {value: 0.5, range: [0.4, 0.6]}}}\n"
DISTURBANCE = """
disturbance:
  form: spells
  level: {value: 300.0, unit: Nm, flag: F, range: [280.0, 320.0], reason: found by trackres diagnose}
  rest: {value: -50.0, unit: Nm, flag: F, range: [-60.0, -40.0], reason: found by trackres diagnose}
  mean_there: {value: 80.0, unit: s, flag: F, range: [50.0, 130.0], reason: found by trackres diagnose}
  mean_away: {value: 160.0, unit: s, flag: F, range: [90.0, 280.0], reason: found by trackres diagnose}
  noise: {value: 60.0, unit: Nm, flag: F, range: [50.0, 70.0], reason: found by trackres diagnose}
"""
SURROUNDINGS = "schema: 1\nvehicle: xgd24d\neffects: {grade: {grade: {value: 0.01, range: [0.0, 0.02]}}, rain: {factor: 3.0}}\n"
ROS_PARAMETERS = (
    "/**:\n  ros__parameters: {output_rate_hz: 20.0, vehicle: xgd24d, feedforward_parts: [wind]}\nother: {ros__parameters: {}}\n"
)
ROUTE = "latitude_deg,longitude_deg,course_deg,slope,std,passes\n" + "".join(
    f"{47.0 + 1e-4 * i:.7f},8.0000000,0.0,0.01,0.002,3\n" for i in range(20)
)
FLEET = """vehicles:
  truck-01: {file: xgd24d, limits: {bearing_friction: 0.012}, recordings: ['*01*']}
  other: {file: agri3t, topics: sample}
"""
PROFILE = "time_s,speed_kmh,weight_n,ambient_degc\n" + "".join(f"{i},{min(i, 30)},240000,15\n" for i in range(60))
RUBBER = shipped("rubber/nr_sbr_10hz.csv")


def of_vehicle(path: Path) -> object:
    loaded = load_base(path)
    return loaded.title, loaded.known


def of_surroundings(path: Path) -> object:
    return [one.effect.name for one in load_surroundings(path, "xgd24d", 97920.0, VehicleKind())]


def of_route(path: Path) -> object:
    (route,) = read_route(path)
    return np.concatenate([route.latitude, route.value.ravel(), route.std.ravel()]).tolist()


def of_sweep(path: Path) -> object:
    sweep = read_sweep(path)
    return [sweep.temp_degc.tolist(), sweep.storage.tolist(), sweep.loss.tolist()]


YAMLS: dict[str, tuple[Callable[[Path], object], str]] = {
    "track vehicle": (of_vehicle, shipped("xgd24d.yaml") + EFFECTS + DISTURBANCE),
    "road vehicle": (of_vehicle, shipped("husky.yaml")),
    "surroundings": (of_surroundings, SURROUNDINGS),
    "topics": (lambda path: dict(Topics.load(path).bindings), shipped("topics/ztbus.yaml")),
    "parameters": (read_parameters, shipped("trackres.yaml")),
    "parameters as ROS has them": (read_parameters, ROS_PARAMETERS),
}
"""A refusal of these names the file."""
OTHERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "fleet": (lambda path: [(one.name, one.file, one.topics) for one in read_fleet(path).vehicles.values()], FLEET),
    "route": (of_route, ROUTE),
    "rubber": (lambda path: np.stack(read_rubber_sweep(path)).tolist(), RUBBER),
    "DMA sweep": (of_sweep, RUBBER),
    "profile": (lambda path: {role: one.value.tolist() for role, one in read_profile(path).series.items()}, PROFILE),
}

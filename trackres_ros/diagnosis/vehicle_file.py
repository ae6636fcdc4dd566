"""A vehicle file with re-fitted values and with the effects that were left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from trackres_ros.effects.effect import Active
from trackres_ros.model.belt import heat_capacity
from trackres_ros.vehicle import Vehicle
from trackres_ros.vehicle.schema import RUBBER
from trackres_ros.yamls import read_yaml

REASON = "re-fitted by trackres diagnose"


def write_track_vehicle(vehicle: Vehicle, path: Path, values: Mapping[str, float], effects: Sequence[Active], text: str) -> None:
    """Write a track vehicle with the values of `TrackBase.parameters`; `text` says in comments where they are from."""
    content = read_yaml(vehicle.source)
    rubber = Path(content["rubber"]["file"])
    content["rubber"]["file"] = str(rubber if rubber.is_absolute() else (vehicle.source.parent / rubber).resolve())
    content["model"] = {"hysteresis": vehicle.hysteresis, "thermal": vehicle.thermal}
    _set(content["rubber"]["loss_modulus_scale"], values["loss_modulus_scale"])
    for name in ("bearing_friction", "drag_coefficient"):
        _set(content["chassis"][name], values[name])
    if "conductivity" in values:
        _set(content["rubber"]["conductivity"], values["conductivity"])
    _set(content["rubber"]["heat_capacity"], _heat_capacity(vehicle, values["capacity_scale"]))
    for track in content["tracks"].values():
        for name in ("film_offset", "film_slope"):
            _scale(track["belt"][name], values["film_scale"])
        if "surface_share" in values:
            _set(track["belt"]["surface_share"], values["surface_share"])
    if effects:
        content["effects"] = {active.effect.name: dict(active.values) for active in effects}
    else:
        content.pop("effects", None)
    write_yaml(path, content, text)


def _heat_capacity(vehicle: Vehicle, scale: float) -> float:
    """Specific heat capacity of the rubber [J/kg/K] with which the whole belt, cords and all, holds so many times the heat."""
    belt, rubber = vehicle.track_of(vehicle.assemblies[0]).belt, vehicle.rubber
    whole, cords = heat_capacity(belt, rubber), heat_capacity(belt, replace(rubber, heat_capacity=0.0))
    wanted = rubber.heat_capacity * (scale * whole - cords) / (whole - cords)
    limits = RUBBER["heat_capacity"]
    return min(max(wanted, limits.low), limits.high)


def write_yaml(path: Path, content: Mapping[str, Any], text: str) -> None:
    """Write YAML below a comment."""
    comment = "".join(f"# {line}\n" for line in text.splitlines())
    path.write_text(comment + yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=130), encoding="utf-8")


def _set(quantity: dict[str, Any], value: float) -> None:
    if value != quantity["value"]:
        low, high = quantity["range"]
        quantity.update(value=value, range=[min(low, value), max(high, value)], flag="A", reason=REASON)


def _scale(quantity: dict[str, Any], factor: float) -> None:
    _set(quantity, quantity["value"] * factor)

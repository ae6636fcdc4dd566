"""`trackres vehicle check`: is the file right, and what follows from it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from trackres_ros.cli.common import emit, json_option
from trackres_ros.errors import InputError

if TYPE_CHECKING:
    from trackres_ros.model.loss_table import LossTable
    from trackres_ros.model.track import TrackModel
    from trackres_ros.vehicle import Vehicle

SHOWN_SPEED_SHARES = (0.05, 0.25, 1.0)  # of the greatest speed
SLOWEST = 0.05  # m/s: the softest belt is a hot one that creeps
DEEP_STRAIN = 0.5  # of the thickness below a wheel: beyond it a layer is no longer an elastic foundation


@click.group("vehicle")
def vehicle_group() -> None:
    """Vehicle files."""


@vehicle_group.command("check")
@click.argument("file", metavar="FILE|NAME")
@click.option(
    "--points",
    type=click.IntRange(10, 100_000),
    default=400,
    show_default=True,
    help="Random points at which the loss table is held against the exact method.",
)
@json_option
def check_command(file: str, points: int, as_json: bool) -> None:
    """Check a vehicle file and print what follows from it, with units.

    \b
    trackres vehicle check xgd24d
    trackres vehicle check my_vehicle.yaml --json
    """
    from trackres_ros.estimator.spread import spread
    from trackres_ros.model import belt as belt_model
    from trackres_ros.model.loads import hinge_position, wheel_loads
    from trackres_ros.model.loss_table import drive_share, interpolation_error, loss_table, reverse_share
    from trackres_ros.model.track import load_range, steady_tension, track_model
    from trackres_ros.vehicle import load
    from trackres_ros.vehicle.reading import FLAGS

    vehicle = load(file)
    rubber = vehicle.rubber
    tracks, remarks = {}, []
    for name, track in vehicle.tracks.items():
        model, loads = track_model(vehicle, name), load_range(vehicle, name)
        began = time.perf_counter()
        table = loss_table(vehicle, name)
        took = time.perf_counter() - began
        errors = np.abs(interpolation_error(model, table, loads, vehicle.chassis.max_speed, points))
        physics, found = _physics(vehicle, name, model, table)
        remarks += found
        modulus = float(model.rubber.dynamic_modulus(10.0, vehicle.chassis.ambient))
        tracks[name] = {
            "wheel_loads_n": wheel_loads(track, loads.nominal).tolist(),
            "hinge_position_m": hinge_position(track),
            "belt_mass_kg": belt_model.mass_per_length(track.belt, rubber) * track.belt.loop_length,
            "mass_per_length_kg_m": belt_model.mass_per_length(track.belt, rubber),
            "heat_capacity_j_k": belt_model.heat_capacity(track.belt, rubber),
            "cooled_area_m2": belt_model.cooled_area(track.belt),
            "axial_stiffness_n": float(belt_model.axial_stiffness(track.belt, modulus)),
            "tension_n": steady_tension(model, vehicle.chassis.ambient),
            "sag_m": float(
                belt_model.catenary_sag(
                    steady_tension(model, vehicle.chassis.ambient),
                    belt_model.mass_per_length(track.belt, rubber),
                    track.belt.sag_half_span,
                    float(belt_model.axial_stiffness(track.belt, modulus)),
                )
            ),
            "uncertainty": dict(
                zip(
                    ("loss", "cooling", "heat_capacity", "sprocket_radius"),
                    (float(v) for v in spread(vehicle, name).relative),
                    strict=True,
                )
            ),
            "table": {
                "seconds": took,
                "load_range_n": [loads.low, loads.high],
                "largest_error": float(errors.max()),
                "rms_error": float(np.sqrt((errors**2).mean())),
                "points": points,
                "drive_torque_share": drive_share(table, loads, track.sprocket_radius),
                "reverse_share": reverse_share(table, loads, track.sprocket_radius),
            },
            **physics,
        }
    flags = [quantity.flag for quantity in vehicle.parameters.values()]
    result: dict[str, Any] = {
        "vehicle": vehicle.name,
        "title": vehicle.title,
        "file": str(vehicle.source),
        "hysteresis": vehicle.hysteresis,
        "thermal": vehicle.thermal,
        "weight_n": vehicle.weight,
        "assemblies": {a.name: float(n) for a, n in zip(vehicle.assemblies, vehicle.nominal_loads(), strict=True)},
        "quantities": {flag: flags.count(flag) for flag in FLAGS},
        "effects": {a.effect.name: dict(a.values) for a in vehicle.effects},
        "rubber_file": str(vehicle.rubber_source),
        "tracks": tracks,
        "remarks": remarks,
    }
    emit(result, as_json, lambda: _text(result))


def _physics(vehicle: Vehicle, name: str, model: TrackModel, table: LossTable) -> tuple[dict[str, Any], list[str]]:
    """What the rubber data cover of one kind of track, where its belt settles, and remarks on both."""
    from trackres_ros.model.coverage import check_heat, coverage
    from trackres_ros.model.track import load_range

    chassis, covered = vehicle.chassis, coverage(vehicle, name)
    settles = check_heat(vehicle, name, table)
    strain = float(model.loss.contacts(SLOWEST, covered.hottest, load_range(vehicle, name).nominal).largest_strain.max())
    if strain >= 1.0:
        raise InputError(
            f"{vehicle.source}: tracks.{name}",
            f"a road wheel that presses {strain:.0%} of the belt's thickness in",
            "less than all of it",
            "check the unit of the moduli, the thickness, and radius, number and contact length of the road wheels",
        )
    speeds = [share * chassis.max_speed for share in SHOWN_SPEED_SHARES]
    coldest = [covered.coldest(model.rubber, speed) for speed in speeds]
    remarks = []
    ambient = vehicle.parameters["chassis.ambient"].low
    if coldest[-1] > ambient:
        remarks.append(
            f"track {name}: the rubber data end at {coldest[-1]:.0f} degC at {chassis.max_speed * 3.6:.0f} km/h, and the file's "
            f"ambient temperature begins at {ambient:g} degC: colder the moduli are held, and the status says OUTSIDE_TABLE"
        )
    if settles > covered.hottest:
        remarks.append(
            f"track {name}: at {chassis.max_speed * 3.6:.0f} km/h the belt settles at {settles:.0f} degC, and the data or the "
            f"life of its rubber end at {covered.hottest:.0f} degC: hotter the status says OUTSIDE_TABLE"
        )
    if strain > DEEP_STRAIN:
        remarks.append(
            f"track {name}: a road wheel presses {strain:.0%} of the thickness of a hot belt in: too deep for the contact model"
        )
    physics = {
        "balance_degc": settles,
        "largest_strain": strain,
        "rubber_data": {"speed_mps": speeds, "coldest_degc": coldest, "hottest_degc": covered.hottest},
    }
    return physics, remarks


def _text(result: dict[str, Any]) -> str:
    quantities = result["quantities"]
    lines = [
        f"{result['title']} ({result['file']}): all values are as allowed" + (", but:" if result["remarks"] else ""),
        *(f"  ! {remark}" for remark in result["remarks"]),
        f"  {quantities['P']} values from the paper, {quantities['L']} from literature, {quantities['A']} assumed, "
        f"{quantities['F']} fitted; "
        f"hysteresis {result['hysteresis']}, thermal {result['thermal']}",
        f"  rubber of {result['rubber_file']}",
        f"  weight {result['weight_n'] / 1e3:.1f} kN on "
        + ", ".join(f"{k} {v / 1e3:.1f} kN" for k, v in result["assemblies"].items()),
    ]
    if result["effects"]:
        lines.append(f"  with {', '.join(result['effects'])}")
    for name, t in result["tracks"].items():
        table, doubt, data = t["table"], t["uncertainty"], t["rubber_data"]
        ends = zip(data["speed_mps"], data["coldest_degc"], strict=True)
        lines += [
            f"Track {name}",
            "  wheel loads        " + ", ".join(f"{load:.0f}" for load in t["wheel_loads_n"]) + " N",
            f"  hinge              {t['hinge_position_m']:.3f} m behind the front end of the ground run",
            f"  belt mass          {t['belt_mass_kg']:.1f} kg ({t['mass_per_length_kg_m']:.2f} kg/m)",
            f"  heat capacity      {t['heat_capacity_j_k'] / 1e3:.1f} kJ/K",
            f"  cooled area        {t['cooled_area_m2']:.2f} m2",
            f"  axial stiffness    {t['axial_stiffness_n'] / 1e6:.1f} MN",
            f"  tension            {t['tension_n']:.0f} N, sag {t['sag_m'] * 1e3:.1f} mm",
            "  one sigma of       " + ", ".join(f"{k} {v:.0%}" for k, v in doubt.items()) + " (from the ranges in the file)",
            f"  loss table         error at most {table['largest_error']:.3%}, rms {table['rms_error']:.3%} at "
            f"{table['points']} points, "
            f"loads {table['load_range_n'][0] / 1e3:.1f} to {table['load_range_n'][1] / 1e3:.1f} kN, "
            f"ready in {table['seconds']:.2f} s",
            f"  drive torque       moves the loss by at most {table['drive_torque_share']:.4%}; "
            f"forward and reverse differ by at most {table['reverse_share']:.4%}",
            "  rubber data        cover belts of "
            + ", ".join(f"{low:.0f} degC at {v * 3.6:.0f} km/h" for v, low in ends)
            + f" and warmer, to {data['hottest_degc']:.0f} degC",
            f"  heat               in balance at {t['balance_degc']:.0f} degC at the greatest speed and nominal load",
        ]
    return "\n".join(lines)

"""`trackres simulate`: a drive that was never driven."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from trackres_ros.cli.common import emit, json_option, method_options, number, output_path, surroundings_option, vehicle_option
from trackres_ros.errors import InputError
from trackres_ros.outputs import RESISTANCE_PARTS
from trackres_ros.recording import ROLES, Recording
from trackres_ros.shown import decimals

Array = NDArray[np.float64]

KMH = 1 / 3.6
OPTION_OF = {"load": "--weight-kn", "ambient": "--ambient-degc", "grade": ""}
"""What a profile may say beside the speed, and the option that says the same."""
SUMMARY_TIMES_S = (50.0, 250.0, 600.0, 1000.0, 2500.0)


@click.command("simulate")
@vehicle_option
@surroundings_option
@click.option("--speed-kmh", type=number(-100, 100), help="Speed after the ramp [km/h].")
@click.option("--ramp-s", type=number(0, 1e5), default=50.0, show_default=True, help="Time from rest to that speed [s].")
@click.option("--duration-s", type=number(1e-3, 1e7), help="How long to simulate [s]; 2500 with --speed-kmh.")
@click.option(
    "--profile",
    type=click.Path(path_type=Path),
    metavar="P.csv",
    help="CSV or Parquet with time_s and speed_mps or speed_kmh instead, and weight_n, ambient_degc and grade if need be; "
    "straight lines between its rows.",
)
@click.option("--ambient-degc", type=number(-60, 60), help="Ambient temperature [degC]; default the vehicle file's.")
@click.option("--initial-degc", type=number(-60, 150), help="Belt temperature at the start [degC]; default the ambient one.")
@click.option("--weight-kn", type=number(0.1, 1e5), help="Weight of the whole vehicle [kN]; default the vehicle file's.")
@method_options
@click.option("--dt", type=number(1e-4, 10), default=0.1, show_default=True, help="Time step [s].")
@click.option(
    "-o", "--output", "output", type=click.Path(path_type=Path), required=True, help="Result: .csv, .csv.gz, .parquet or .mcap."
)
@json_option
def simulate_command(
    vehicle: str,
    surroundings_file: Path | None,
    speed_kmh: float | None,
    ramp_s: float,
    duration_s: float | None,
    profile: Path | None,
    ambient_degc: float | None,
    initial_degc: float | None,
    weight_kn: float | None,
    method: str | None,
    thermal: str | None,
    dt: float,
    output: Path,
    as_json: bool,
) -> None:
    """Torque and belt temperature along a speed profile.

    \b
    trackres simulate --vehicle xgd24d --speed-kmh 50 -o out.csv
    trackres simulate --vehicle xgd24d --profile laps.csv --ambient-degc -15 -o out.mcap

    Columns: time_s, speed_mps, weight_n, ambient_degc, belt_degc (mean over the assemblies), resistance_torque_nm, which is the
    sum of hysteresis_nm, bearing_nm, wind_nm and effects_nm (of the vehicle file's effects), inertia_nm, drive_torque_nm
    (resistance and inertia); whole vehicle.
    With a grade in the profile grade_nm too, which the drive torque holds as well.
    """
    from trackres_ros.csvs import write_table
    from trackres_ros.estimator.estimator import Estimator, Steps
    from trackres_ros.model.track import with_methods
    from trackres_ros.output_bag import OutputBag
    from trackres_ros.simulate import ramp_and_hold, run_drive, series_of, through_points
    from trackres_ros.vehicle import load, with_surroundings

    if (speed_kmh is None) == (profile is None):
        raise InputError("--speed-kmh, --profile", "both" if profile else "neither", "one of the two")
    if profile is not None and duration_s is not None:
        raise InputError("--duration-s", duration_s, "only with --speed-kmh: a profile says itself how long it is")
    path = output_path(output)
    description = with_surroundings(with_methods(load(vehicle), method, thermal), surroundings_file)
    estimator = Estimator(description)
    given: dict[str, Any] = {
        role: value
        for role, value in (("load", None if weight_kn is None else weight_kn * 1e3), ("ambient", ambient_degc))
        if value is not None
    }
    if speed_kmh is not None:
        _check_speed(speed_kmh * KMH, description.chassis.max_speed)
        drive = ramp_and_hold(speed_kmh * KMH, ramp_s, 2500.0 if duration_s is None else duration_s, dt)
    else:
        assert profile is not None
        recording = _read_profile(profile)
        drive = through_points(recording.time_s("speed"), recording.series["speed"].value, dt)
        _check_speed(float(np.abs(drive.speed).max()), description.chassis.max_speed)
        given |= _conditions(recording, drive.time_s, given, description.weight)
    rows = run_drive(estimator, drive, given.get("load"), given.get("ambient"), initial_degc, given.get("grade", np.nan))
    series = series_of(estimator, drive, rows)
    if "grade" in given:
        series["grade_nm"] = rows[:, estimator.column_index["grade_nm"]]
    if path.suffix.lower() == ".mcap":
        stamps = np.round((drive.time_s - drive.time_s[0]) * 1e9).astype(np.int64)
        with OutputBag(path, estimator) as bag:
            bag.write(Steps(stamps, stamps, rows))
    else:
        write_table(path, series)
    at_times = [t for t in SUMMARY_TIMES_S if t <= drive.time_s[-1]] or [float(drive.time_s[-1])]
    points = [
        {name: float(series[name][min(int(np.searchsorted(drive.time_s, t - 1e-9)), len(rows) - 1)]) for name in series}
        for t in at_times
    ]
    result = {
        "vehicle": description.name,
        "method": description.hysteresis,
        "thermal": description.thermal,
        "output": str(path),
        "rows": len(rows),
        "points": points,
    }
    emit(result, as_json, lambda: _text(result))


def _check_speed(speed: float, most: float) -> None:
    if abs(speed) > 1.2 * most:
        raise InputError(
            "speed", f"{abs(speed) * 3.6:g} km/h", f"up to 1.2 times the vehicle file's max_speed, {1.2 * most * 3.6:.0f} km/h"
        )


def _read_profile(path: Path) -> Recording:
    """The profile; a column that would do nothing is refused, and one of an unknown name is told."""
    from trackres_ros.csvs import TableSource
    from trackres_ros.sources import open_source

    source = open_source([path])
    if not isinstance(source, TableSource):
        raise InputError("--profile", str(path), "a CSV or Parquet table; trackres replay reads bags")
    unused = [role for role in source.roles if role not in ("speed", *OPTION_OF)]
    if unused:
        allowed = f"speed, {', '.join(OPTION_OF)}"
        raise InputError(f"{path}: columns of", ", ".join(unused), allowed, "leave out what a simulation does not take")
    for note in source.notes:
        if note.startswith("ignored"):
            click.echo(f"trackres: {path}: {note}", err=True)
    return Recording.from_source(source)


def _conditions(recording: Recording, time_s: Array, given: Collection[str], weight: float) -> dict[str, Array]:
    """What a profile says of its conditions at some times [s], along straight lines, by role."""
    from trackres_ros.estimator.constants import LARGEST_LOAD_SHARE, LEAST_LOAD_SHARE, PLAUSIBLE

    limits = {**PLAUSIBLE, "load": (LEAST_LOAD_SHARE * weight, LARGEST_LOAD_SHARE * weight)}
    found = {}
    for role, option in OPTION_OF.items():
        samples = recording.series.get(role)
        if samples is None or not len(samples):
            continue
        if role in given:
            raise InputError(f"{recording.name}, {option}", f"{role} in both", "one of the two")
        low, high = limits[role]
        bad = samples.value[~((samples.value >= low) & (samples.value <= high))]
        if bad.size:
            raise InputError(f"{recording.name}: {role}", float(bad[0]), f"{low:g} to {high:g} {ROLES[role].unit}")
        found[role] = np.interp(time_s, recording.time_s(role), samples.value)
    return found


def _text(result: dict[str, Any]) -> str:
    parts = {"resistance": "resistance_torque_nm", **RESISTANCE_PARTS}
    lines = [
        f"{'time':>8} {'speed':>7} " + " ".join(f"{part:>10}" for part in parts) + f" {'belt':>6}",
        f"{'s':>8} {'km/h':>7} " + " ".join(f"{'Nm':>10}" for _ in parts) + f" {'degC':>6}",
    ]
    lines += [
        f"{decimals(p['time_s']):>8} {decimals(p['speed_mps'] * 3.6, 1):>7} "
        + " ".join(f"{decimals(p[column]):>10}" for column in parts.values())
        + f" {decimals(p['belt_degc'], 1):>6}"
        for p in result["points"]
    ]
    return "\n".join([*lines, f"{result['rows']} rows in {result['output']}"])

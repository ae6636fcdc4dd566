# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates a drive along a speed profile: torques and belt temperature."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import click
import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.constants import LARGEST_LOAD_SHARE, LEAST_LOAD_SHARE
from trackres_ros.estimator.drives import SimulatedDrive, by_column, ramp_and_hold, run_drive, series_of, through_points
from trackres_ros.estimator.energy import drive_text, sum_drive
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.records import Steps
from trackres_ros.files.output_files import BAG_SUFFIX, not_an_input, output_file
from trackres_ros.model.coverage import beyond, check_speed
from trackres_ros.model.resistance import resistance_parts
from trackres_ros.output.bag import OutputBag
from trackres_ros.output.table import write_table
from trackres_ros.recording.channel_source import ChannelSource
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import PLAUSIBLE, POSITION, ROLES
from trackres_ros.tasks import options
from trackres_ros.tasks.arguments import (
    AMBIENT,
    BELT,
    SPEED,
    WEIGHT,
    StrPath,
    VehicleGiven,
    as_path,
    as_vehicle,
    check_weight,
    input_files,
    limited,
    load_vehicle,
)
from trackres_ros.tasks.results import Array, SeriesResult
from trackres_ros.tasks.terminal import Command, emit, progress, watch
from trackres_ros.text import decimals, figures, listed, number_of, panel, table
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import AnyVehicle, files_of

USUAL_RAMP_S, USUAL_DURATION_S = 50.0, 2500.0
ARGUMENT_OF = {"load": "weight_kn", "ambient": "ambient_degc", "grade": "", **dict.fromkeys(POSITION, "")}
"""Possible columns of a profile in addition to the speed, and the argument of the same meaning."""
# The first is in the other remarks; the rest is of the feed-forward and of the length of a step.
UNSHOWN = at.Reason.OUTSIDE_TABLE | at.Reason.FEEDFORWARD_CLAMPED | at.HARMLESS
SUMMARY_TIMES_S = (50.0, 250.0, 600.0, 1000.0, 2500.0)


@limited(
    speed_kmh=SPEED,
    ramp_s=(0.0, 1e5, "s"),
    duration_s=(1e-3, 1e7, "s"),
    ambient_degc=AMBIENT,
    initial_degc=BELT,
    weight_kn=WEIGHT,
    dt=(1e-4, 10.0, "s"),
)
def simulate(
    vehicle: VehicleGiven,
    *,
    speed_kmh: float | None = None,
    ramp_s: float | None = None,
    duration_s: float | None = None,
    profile: StrPath | Recording | None = None,
    ambient_degc: float | None = None,
    initial_degc: float | None = None,
    weight_kn: float | None = None,
    dt: float = 0.1,
    output: StrPath | None = None,
) -> SimulationResult:
    """Compute torque [Nm] and belt temperature [degC] along a speed profile.

    Parameters
    ----------
    vehicle
        A vehicle, the path of its file, or the name of a shipped one.
    speed_kmh, ramp_s, duration_s
        Speed after a linear ramp from rest [km/h], ramp time [s], by default 50 s, and simulated time [s], by default 2500 s.
    profile
        Instead a CSV or Parquet table with ``time_s`` and ``speed_mps`` or ``speed_kmh``, and ``weight_n``,
        ``ambient_degc`` and ``grade`` if need be. Positions (``latitude_deg``, ``longitude_deg``) are for surroundings with
        a route. Values between rows are linear.
    ambient_degc, initial_degc
        Ambient temperature [degC], by default the vehicle file's, and initial belt temperature [degC], by default the ambient
        one; none for a vehicle without belts.
    weight_kn
        Weight of the whole vehicle [kN]; by default the vehicle file's.
    dt
        Time step [s].
    output
        File to write as well, in the format of `SimulationResult.save`.

    Returns
    -------
    SimulationResult
        One row per time step: a mapping of column name to array, with `to_pandas`, `to_xarray`, `plot` and `save`.

    Raises
    ------
    InputError
        A speed above the vehicle's maximum, a number out of its range, an unusable profile, or both profile and speed.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> drive = tr.simulate("xgd24d", speed_kmh=50, duration_s=600, dt=0.5)
    >>> drive
    time  speed  resistance  hysteresis  bearing  wind  effects  belt
       s   km/h          Nm          Nm       Nm    Nm       Nm  degC
      50   50.0        3502        2512      734   255        0  18.0
     250   50.0        3117        2128      734   255        0  36.5
     600   50.0        2893        1904      734   255        0  54.1
    >>> print(f"{drive['resistance_torque_nm'].max():.0f} Nm")
    3502 Nm
    """
    if (speed_kmh is None) == (profile is None):
        raise InputError("speed_kmh, profile", "neither" if profile is None else "both", "one of the two")
    profile = profile if profile is None or isinstance(profile, Recording) else as_path(profile, "profile")
    for name, seconds in (("duration_s", duration_s), ("ramp_s", ramp_s)):
        if profile is not None and seconds is not None:
            raise InputError(name, seconds, "only with a speed; a profile has its own duration and ramps")
    file = None if output is None else output_file(output)
    machine = as_vehicle(vehicle)
    check_weight(machine, weight_kn, LEAST_LOAD_SHARE, LARGEST_LOAD_SHARE)
    paths = profile.paths if isinstance(profile, Recording) else [profile]
    inputs = input_files(None, *paths, *files_of(machine))
    not_an_input(file, inputs, "output")
    pairs = (("load", None if weight_kn is None else weight_kn * 1e3), ("ambient", ambient_degc))
    inputs_by_role: dict[str, Any] = {role: value for role, value in pairs if value is not None}
    if initial_degc is not None and not machine.assemblies:
        raise InputError("initial_degc", initial_degc, f"none for {machine.name}: the base model road_load has no belts")
    notes: tuple[str, ...] = ()
    if speed_kmh is not None:
        check_speed(machine, speed_kmh / KMH_PER_MPS)
        ramp_s = USUAL_RAMP_S if ramp_s is None else ramp_s
        duration_s = USUAL_DURATION_S if duration_s is None else duration_s
        drive = ramp_and_hold(speed_kmh / KMH_PER_MPS, ramp_s, duration_s, dt)
    else:
        assert profile is not None
        recording = read_profile(profile, bool(machine.route))
        notes = tuple(f"{recording.name}: {note}" for note in recording.notes if note.startswith("ignored"))
        drive = through_points(recording.time_s("speed"), recording.series["speed"].value, dt)
        check_speed(machine, float(np.abs(drive.speed).max()))
        inputs_by_role |= conditions(recording, drive.time_s, inputs_by_role, machine.weight)
    position = [inputs_by_role[role] for role in POSITION if role in inputs_by_role]
    grade = inputs_by_role.get("grade", np.nan)
    estimator = Estimator(machine)
    ground = estimator.along_route(drive.time_s, drive.speed, *position) if len(position) == len(POSITION) else None
    rows = run_drive(estimator, drive, inputs_by_role.get("load"), inputs_by_role.get("ambient"), initial_degc, grade, ground)
    result = SimulationResult(estimator, drive, rows, "grade" in inputs_by_role or ground is not None, notes, inputs)
    if file is not None:
        result.save(file)
    return result


def read_profile(profile: str | PathLike[str] | Recording, on_route: bool = False) -> Recording:
    """The profile of a table; a column without effect is refused, such as a position without a route.

    Raises InputError for no table, or a column that a simulation does not use.
    """
    if isinstance(profile, Recording):
        recording = profile
    else:
        source = open_source([Path(profile)])
        if not isinstance(source, ChannelSource):
            raise InputError("profile", str(profile), "a CSV or Parquet table; trackres replay reads bags")
        recording = Recording.from_source(source)
    roles = [role for role in ("speed", *ARGUMENT_OF) if on_route or role not in POSITION]
    foreign_roles = [role for role in recording.roles if role not in roles]
    if foreign_roles:
        allowed = ", ".join(roles)
        remedy = "remove the columns that a simulation does not use"
        if set(foreign_roles) <= set(POSITION):
            remedy = "a position needs a route in the surroundings: --surroundings FILE"
        raise InputError(f"{recording.name}: columns of", ", ".join(foreign_roles), allowed, remedy)
    return recording


def conditions(recording: Recording, time_s: Array, roles: Collection[str], weight: float) -> dict[str, Array]:
    """Conditions of a profile at some times [s], see `along`, by role.

    Raises InputError for a role that is also in `roles`, and for unknown or implausible values for a vehicle of a weight [N].
    """
    series = {}
    for role, argument in ARGUMENT_OF.items():
        if role not in recording.series or not len(recording.series[role]):
            continue
        if role in roles:
            raise InputError(argument, f"{role} in {recording.name} too", "one of the two")
        value = recording.series[role].value
        if not np.isfinite(value).all():
            raise InputError(f"{recording.name}: {role}", float(value[~np.isfinite(value)][0]), "finite numbers")
        series[role] = along(recording, role, time_s, weight)
    return series


def along(recording: Recording, role: str, time_s: Array, weight: float, option: str = "") -> Array:
    """The known values of a role at some times [s], interpolated.

    Before its first and after its last value a position is nan, as in a replay; others keep that value. Raises InputError for
    values that are implausible for a vehicle of a weight [N]; `option`: the one that gave the recording.
    """
    low, high = {**PLAUSIBLE, "load": (LEAST_LOAD_SHARE * weight, LARGEST_LOAD_SHARE * weight)}[role]
    times, value = recording.time_s(role), recording.series[role].value
    order = np.argsort(times, kind="stable")
    order = order[np.isfinite(value[order])]
    bad_values = value[order][(value[order] < low) | (value[order] > high)]
    if bad_values.size:
        allowed = f"{low:g} to {high:g} {ROLES[role].unit}{f' for a vehicle of {figures(weight)} N' if role == 'load' else ''}"
        raise InputError(f"{option} {recording.name}: {role}".lstrip(), float(bad_values[0]), allowed)
    value = np.unwrap(value[order]) if role == "longitude" else value[order]  # it goes on over the date line
    edge = np.nan if role in POSITION else None
    return np.interp(time_s, times[order], value, left=edge, right=edge)


class SimulationResult(SeriesResult):
    """Torques [Nm] and belt temperature [degC] along a drive, one row per time step; see `trackres_ros.simulate`.

    Columns are ``time_s``, ``speed_mps``, ``weight_n``, ``ambient_degc``, ``belt_degc`` (mean over the assemblies) and
    ``resistance_torque_nm``, the sum of ``hysteresis_nm``, ``bearing_nm``, ``wind_nm`` and ``effects_nm``. Then follow
    ``inertia_nm``, ``drive_torque_nm`` (resistance and inertia), and ``grade_nm`` if the profile has a grade, which then is
    part of the drive torque. Without belts there are no ``belt_degc`` and ``hysteresis_nm``, and ``bearing_nm`` has all rolling
    resistance.

    Attributes
    ----------
    notes
        Unused columns of the profile.
    """

    def __init__(
        self,
        estimator: Estimator,
        drive: SimulatedDrive,
        rows: Array,
        with_grade: bool,
        notes: tuple[str, ...],
        inputs: Sequence[str | PathLike[str] | None] = (),
    ) -> None:
        self.estimator, self.notes = estimator, notes
        self.title = f"Simulated: {estimator.vehicle.title}"
        self._rows, self._drive, self._inputs = rows, drive, inputs
        self._series: dict[str, Array] = dict(series_of(estimator, drive, rows))
        if with_grade:
            self._series["grade_nm"] = rows[:, estimator.column_index["grade_nm"]]

    @property
    def vehicle(self) -> AnyVehicle:
        """The vehicle of the simulation."""
        return self.estimator.vehicle

    @property
    def remarks(self) -> list[str]:
        """Belt temperatures outside the rubber data, loads outside the table of losses, and other reasons of the estimator."""
        index = self.estimator.column_index
        reasons = self._rows[:, index["reasons"]].astype(np.int64)
        counts = {reason: int(np.count_nonzero(reasons & int(reason))) for reason in at.REASON_TEXT if not reason & UNSHOWN}
        texts = [f"{at.REASON_TEXT[reason]} ({number_of(count, 'step')})" for reason, count in counts.items() if count]
        return [*beyond(self.vehicle, by_column(self.estimator, self._rows)), *texts]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns, as in the table that `save` writes."""
        return tuple(self._series)

    def __getitem__(self, name: str) -> Array:
        return self._series[name].copy()

    def _picture_series(self) -> Mapping[str, Array]:
        return self._series

    def _attributes(self) -> dict[str, str]:
        return {"vehicle": self.vehicle.name, "hysteresis": self.vehicle.hysteresis, "thermal": self.vehicle.thermal}

    def save(self, path: str | PathLike[str]) -> Path:
        """Write to a file, with the same bytes as `trackres simulate -o`.

        Parameters
        ----------
        path
            `.csv`, `.csv.gz`, `.parquet` or `.mf4` for a table of `columns`; `.mcap` for topics of the live node, without the
            standard deviation of the resistance.

        Returns
        -------
        Path
            Of the file.

        Raises
        ------
        InputError
            Another suffix, no such folder, or an input of the simulation.
        """
        file = output_file(path, argument="path")
        not_an_input(file, self._inputs, "path")
        if file.suffix.lower() == BAG_SUFFIX:
            stamps = np.round((self._drive.time_s - self._drive.time_s[0]) * 1e9).astype(np.int64)
            with OutputBag(file, self.estimator) as bag:
                bag.write(Steps(stamps, stamps, self._rows))
        else:
            write_table(file, self._series, estimates=True)
        return file

    def points(self) -> list[dict[str, float]]:
        """All columns at a few times, for a summary.

        Returns
        -------
        list of dict of str to float
            One row for each time, by column.
        """
        time = self.time_s
        at_times = [t for t in SUMMARY_TIMES_S if t <= time[-1]] or [float(time[-1])]
        rows = [min(int(np.searchsorted(time, t - 1e-9)), len(time) - 1) for t in at_times]
        return [{name: float(values[row]) for name, values in self.items()} for row in rows]

    @property
    def drive(self) -> dict[str, float]:
        """Summary of the drive: distance, driving time, resistance [Nm], energy, kWh/km, belts."""
        return sum_drive(self.vehicle, self.time_s, by_column(self.estimator, self._rows))

    def as_dict(self) -> dict[str, Any]:
        """The summary, ready for JSON.

        Returns
        -------
        dict
            Names of vehicle and methods, the number of rows, `points`, and `drive`.
        """
        return {
            "vehicle": self.vehicle.name,
            "method": self.vehicle.hysteresis,
            "thermal": self.vehicle.thermal,
            "rows": len(self.time_s),
            "points": self.points(),
            "remarks": self.remarks,
            "drive": self.drive,
        }

    def __repr__(self) -> str:
        belts = ["belt_degc"] if "belt_degc" in self else []
        parts = {"resistance": "resistance_torque_nm", **resistance_parts(bool(belts))}
        head = ["time\ns", "speed\nkm/h", *(f"{part}\nNm" for part in parts), *("belt\ndegC" for _ in belts)]
        rows = [
            [
                decimals(p["time_s"]),
                decimals(p["speed_mps"] * KMH_PER_MPS, 1),
                *(decimals(p[column]) for column in parts.values()),
                *(decimals(p[column], 1) for column in belts),
            ]
            for p in self.points()
        ]
        return "\n".join([table(rows, head), *(f"  ! {remark}" for remark in self.remarks)])

    def _repr_html_(self) -> str:
        return panel(f"{self.title}, {len(self.time_s)} rows", self._table(), listed("Remarks", self.remarks))


@click.command("simulate", cls=Command)
@options.vehicle
@options.surroundings
@options.argument_option(simulate, "speed_kmh", "Speed after the ramp [km/h].")
@options.argument_option(simulate, "ramp_s", "Time from rest to that speed [s]; 50 with --speed-kmh.")
@options.argument_option(simulate, "duration_s", "How long to simulate [s]; 2500 with --speed-kmh.")
@click.option(
    "--profile",
    type=options.PATH,
    metavar="P.csv",
    help="CSV or Parquet with time_s and speed_mps or speed_kmh instead of --speed-kmh, optionally with weight_n, "
    "ambient_degc and grade; linear interpolation between rows.",
)
@options.argument_option(simulate, "ambient_degc", options.AMBIENT)
@options.argument_option(simulate, "initial_degc", "Belt temperature at the start [degC]; default the ambient temperature.")
@options.argument_option(simulate, "weight_kn", options.WEIGHT)
@options.methods
@options.argument_option(simulate, "dt", "Time step [s].")
@click.option("-o", "--output", type=options.PATH, required=True, help="Result: .csv, .csv.gz, .parquet, .mf4 or .mcap.")
@options.json
def simulate_command(
    vehicle: str,
    surroundings: Path | None,
    method: str | None,
    thermal: str | None,
    output: Path,
    as_json: bool,
    **arguments: Any,
) -> None:
    """Compute torque and belt temperature along a speed profile.

    \b
    trackres simulate --vehicle xgd24d --speed-kmh 50 -o out.csv
    trackres simulate --vehicle xgd24d --profile laps.csv --ambient-degc -15 -o out.mcap

    Columns: time_s, speed_mps, weight_n, ambient_degc, belt_degc (mean over the assemblies), resistance_torque_nm, which is the
    sum of hysteresis_nm, bearing_nm, wind_nm and effects_nm (of the vehicle file's effects), inertia_nm, drive_torque_nm
    (resistance and inertia); whole vehicle.
    With a grade in the profile also grade_nm, which the drive torque includes.
    """
    watch(output)
    machine = load_vehicle(vehicle, method=method, thermal=thermal, surroundings=surroundings)
    with progress("simulating", None):
        result = simulate(machine, output=output, **arguments)
    for note in result.notes:
        click.echo(f"trackres: {note}", err=True)
    report = {**result.as_dict(), "output": str(output)}
    emit(report, as_json, lambda: f"{result!r}\n{drive_text(report['drive'])}\n{report['rows']} rows in {output}")

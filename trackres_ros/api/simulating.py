# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates drives and explains operating points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trackres_ros.api.arguments import StrPath, VehicleGiven, as_paths, as_vehicle, input_files
from trackres_ros.errors import InputError
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    from trackres_ros.recording.recording import Recording
    from trackres_ros.results.operating_point import OperatingPoint
    from trackres_ros.results.simulation import SimulationResult


def simulate(
    vehicle: VehicleGiven,
    *,
    speed_kmh: float | None = None,
    ramp_s: float = 50.0,
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
        Speed after a linear ramp from rest [km/h], ramp time [s], and simulated time [s]; 2500 s by default.
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
        A speed above the vehicle's maximum, an unusable profile, or both profile and speed.

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
    import numpy as np

    from trackres_ros.estimator.estimator import Estimator
    from trackres_ros.estimator.warm_up import SERIES, first_run
    from trackres_ros.files.output_files import not_an_input, output_file
    from trackres_ros.model.coverage import check_speed
    from trackres_ros.offline.profile import conditions, read_profile
    from trackres_ros.offline.simulate import ramp_and_hold, run_drive, through_points
    from trackres_ros.recording.recording import Recording
    from trackres_ros.recording.roles import POSITION
    from trackres_ros.results.simulation import SimulationResult
    from trackres_ros.vehicle import files_of

    if (speed_kmh is None) == (profile is None):
        raise InputError("speed_kmh, profile", "neither" if profile is None else "both", "one of the two")
    if profile is not None and duration_s is not None:
        raise InputError("duration_s", duration_s, "only with speed_kmh; a profile has its own duration")
    file = None if output is None else output_file(output)
    described = as_vehicle(vehicle)
    paths = profile.paths if isinstance(profile, Recording) else () if profile is None else as_paths(profile)
    inputs = input_files(None, *paths, *files_of(described))
    not_an_input(file, inputs, "output")
    known = (("load", None if weight_kn is None else weight_kn * 1e3), ("ambient", ambient_degc))
    given: dict[str, Any] = {role: value for role, value in known if value is not None}
    if initial_degc is not None and not described.assemblies:
        raise InputError("initial_degc", initial_degc, f"none for {described.name}: the base model road_load has no belts")
    notes: tuple[str, ...] = ()
    if speed_kmh is not None:
        check_speed(described, speed_kmh / KMH_PER_MPS)
        drive = ramp_and_hold(speed_kmh / KMH_PER_MPS, ramp_s, 2500.0 if duration_s is None else duration_s, dt)
    else:
        assert profile is not None
        recording = read_profile(profile, bool(described.route))
        notes = tuple(f"{recording.name}: {note}" for note in recording.notes if note.startswith("ignored"))
        drive = through_points(recording.time_s("speed"), recording.series["speed"].value, dt)
        check_speed(described, float(np.abs(drive.speed).max()))
        given |= conditions(recording, drive.time_s, given, described.weight)
    position = [given[role] for role in POSITION if role in given]
    grade = given.get("grade", np.nan)
    with first_run(SERIES, described, len(drive.time_s)) as warm_up:
        estimator = Estimator(described, entries=warm_up.first)
        ground = estimator.along_route(drive.time_s, drive.speed, *position) if len(position) == len(POSITION) else None
        rows = run_drive(estimator, drive, given.get("load"), given.get("ambient"), initial_degc, grade, ground)
    result = SimulationResult(estimator, drive, rows, "grade" in given or ground is not None, notes, inputs)
    if file is not None:
        result.save(file)
    return result


def explain(
    vehicle: VehicleGiven,
    *,
    speed_kmh: float,
    belt_degc: float | None = None,
    ambient_degc: float | None = None,
    weight_kn: float | None = None,
) -> OperatingPoint:
    """Compute the parts of the torque [Nm] at one operating point, by the exact methods.

    Parameters
    ----------
    vehicle
        A vehicle, the path of its file, or the name of a shipped one.
    speed_kmh
        [km/h]; negative in reverse.
    belt_degc
        Mean belt temperature [degC]; none for a vehicle without belts.
    ambient_degc, weight_kn
        Ambient temperature [degC] and weight of the whole vehicle [kN]; by default the vehicle file's.

    Returns
    -------
    OperatingPoint
        A mapping of wheel loads, contacts, tension, losses, heat, torque by part and the rainflow matrix; without belts only
        torque by part.

    Raises
    ------
    InputError
        For a weight or a speed that the vehicle cannot have.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> point = tr.explain("xgd24d", speed_kmh=50, belt_degc=15)
    >>> {part: round(torque) for part, torque in point["torque_nm"].items()}
    {'hysteresis': 2604, 'bearing': 734, 'wind': 255, 'effects': 0, 'inertia': 0, 'resistance': 3593}
    """
    from trackres_ros.model.operating_point import explain, explain_road
    from trackres_ros.results.operating_point import OperatingPoint
    from trackres_ros.text.numbers import figures
    from trackres_ros.vehicle import RoadVehicle

    described = as_vehicle(vehicle)
    if weight_kn is not None and not 0.05 * described.weight <= weight_kn * 1e3 <= 20 * described.weight:
        raise InputError(
            "weight_kn",
            weight_kn,
            f"{figures(0.05 * described.weight / 1e3)} to {figures(20 * described.weight / 1e3)} kN for "
            f"a vehicle of {figures(described.weight / 1e3)} kN",
        )
    weight = None if weight_kn is None else weight_kn * 1e3
    speed = speed_kmh / KMH_PER_MPS
    if isinstance(described, RoadVehicle):
        if belt_degc is not None:
            raise InputError("belt_degc", belt_degc, f"none for {described.name}: the base model road_load has no belts")
        return OperatingPoint(explain_road(described, speed, ambient_degc, weight))
    if belt_degc is None:
        raise InputError("belt_degc", "nothing", "the mean temperature of the belts [degC]")
    return OperatingPoint(explain(described, speed, belt_degc, ambient_degc, weight))

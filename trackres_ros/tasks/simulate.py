# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates drives and explains operating points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trackres_ros.errors import InputError
from trackres_ros.tasks.arguments import StrPath, VehicleGiven, as_path, as_vehicle, check_numbers, if_given, input_files
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    from trackres_ros.recording.recording import Recording
    from trackres_ros.tasks.explain import OperatingPoint
    from trackres_ros.tasks.simulation import SimulationResult
    from trackres_ros.vehicle import AnyVehicle

USUAL_RAMP_S, USUAL_DURATION_S = 50.0, 2500.0
LEAST_EXPLAINED_SHARE, LARGEST_EXPLAINED_SHARE = 0.05, 20.0  # of the nominal weight; a single point may be an unusual one


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
    import numpy as np

    from trackres_ros.estimator.constants import LARGEST_LOAD_SHARE, LEAST_LOAD_SHARE
    from trackres_ros.estimator.drives import ramp_and_hold, run_drive, through_points
    from trackres_ros.estimator.estimator import Estimator
    from trackres_ros.files.output_files import not_an_input, output_file
    from trackres_ros.model.coverage import check_speed
    from trackres_ros.recording.recording import Recording
    from trackres_ros.recording.roles import POSITION
    from trackres_ros.tasks.profile import conditions, read_profile
    from trackres_ros.tasks.simulation import SimulationResult
    from trackres_ros.vehicle import files_of

    optional = if_given(
        speed_kmh=speed_kmh, ramp_s=ramp_s, duration_s=duration_s, ambient_degc=ambient_degc, initial_degc=initial_degc,
        weight_kn=weight_kn,
    )  # fmt: skip
    check_numbers("simulate", dt=dt, **optional)
    if (speed_kmh is None) == (profile is None):
        raise InputError("speed_kmh, profile", "neither" if profile is None else "both", "one of the two")
    profile = profile if profile is None or isinstance(profile, Recording) else as_path(profile, "profile")
    for name, seconds in (("duration_s", duration_s), ("ramp_s", ramp_s)):
        if profile is not None and seconds is not None:
            raise InputError(name, seconds, "only with a speed; a profile has its own duration and ramps")
    file = None if output is None else output_file(output)
    described = as_vehicle(vehicle)
    _check_weight(described, weight_kn, LEAST_LOAD_SHARE, LARGEST_LOAD_SHARE)
    paths = profile.paths if isinstance(profile, Recording) else [profile]
    inputs = input_files(None, *paths, *files_of(described))
    not_an_input(file, inputs, "output")
    known = (("load", None if weight_kn is None else weight_kn * 1e3), ("ambient", ambient_degc))
    given: dict[str, Any] = {role: value for role, value in known if value is not None}
    if initial_degc is not None and not described.assemblies:
        raise InputError("initial_degc", initial_degc, f"none for {described.name}: the base model road_load has no belts")
    notes: tuple[str, ...] = ()
    if speed_kmh is not None:
        check_speed(described, speed_kmh / KMH_PER_MPS)
        ramp_s = USUAL_RAMP_S if ramp_s is None else ramp_s
        duration_s = USUAL_DURATION_S if duration_s is None else duration_s
        drive = ramp_and_hold(speed_kmh / KMH_PER_MPS, ramp_s, duration_s, dt)
    else:
        assert profile is not None
        recording = read_profile(profile, bool(described.route))
        notes = tuple(f"{recording.name}: {note}" for note in recording.notes if note.startswith("ignored"))
        drive = through_points(recording.time_s("speed"), recording.series["speed"].value, dt)
        check_speed(described, float(np.abs(drive.speed).max()))
        given |= conditions(recording, drive.time_s, given, described.weight)
    position = [given[role] for role in POSITION if role in given]
    grade = given.get("grade", np.nan)
    estimator = Estimator(described)
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
    from trackres_ros.tasks.explain import OperatingPoint
    from trackres_ros.vehicle import RoadVehicle

    optional = if_given(belt_degc=belt_degc, ambient_degc=ambient_degc, weight_kn=weight_kn)
    check_numbers("explain", speed_kmh=speed_kmh, **optional)
    described = as_vehicle(vehicle)
    _check_weight(described, weight_kn, LEAST_EXPLAINED_SHARE, LARGEST_EXPLAINED_SHARE)
    weight = None if weight_kn is None else weight_kn * 1e3
    speed = speed_kmh / KMH_PER_MPS
    if isinstance(described, RoadVehicle):
        if belt_degc is not None:
            raise InputError("belt_degc", belt_degc, f"none for {described.name}: the base model road_load has no belts")
        return OperatingPoint(explain_road(described, speed, ambient_degc, weight))
    if belt_degc is None:
        raise InputError("belt_degc", "nothing", "the mean temperature of the belts [degC]")
    return OperatingPoint(explain(described, speed, belt_degc, ambient_degc, weight))


def _check_weight(vehicle: AnyVehicle, weight_kn: float | None, least: float, largest: float) -> None:
    """Check a weight [kN] by shares of the vehicle's own."""
    from trackres_ros.text import figures

    low, own, high = (share * vehicle.weight / 1e3 for share in (least, 1.0, largest))
    if weight_kn is not None and not low <= weight_kn <= high:
        raise InputError("weight_kn", weight_kn, f"{figures(low)} to {figures(high)} kN for a vehicle of {figures(own)} kN")

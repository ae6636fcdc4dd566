# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Drive cycles for designs: built-in cycles, speed profiles and recordings, and the energy of a design on one."""

from collections.abc import Collection, Mapping
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trackres_ros.errors import InputError, nearest
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.constants import LARGEST_LOAD_SHARE, LEAST_LOAD_SHARE, make_constants
from trackres_ros.estimator.drives import SimulatedDrive, by_column, lap_drive, run_drive, through_points
from trackres_ros.estimator.energy import sum_drive
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.model.coverage import check_speed
from trackres_ros.model.loss_table import quick_table
from trackres_ros.model.track import vehicle_constants
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.tasks.simulate import along
from trackres_ros.text import figures
from trackres_ros.tools.design.steady import Array
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import Vehicle

SHARES, HOLD_S, RAMP_S, STEP_S = (1 / 3, 2 / 3, 1.0), 600.0, 30.0, 0.5
STAGES, LAPS = "stages", "laps"
LAPS_DRIVEN, FASTEST_LAP_KMH = 10, 20.0
BUILT_IN = STAGES, LAPS
OF_PROFILE = "load", "ambient"


@dataclass(frozen=True, eq=False)
class DriveCycle:
    """A drive by its name, and the conditions that were recorded with it.

    Attributes
    ----------
    recorded
        Load [N] and air [degC] by role, if recorded, each of shape (times,).
    notes
        Unused content of a recording.
    """

    name: str
    drive: SimulatedDrive
    recording: Recording | None = None
    notes: tuple[str, ...] = field(default=())

    def conditions(self, chosen: Collection[str]) -> list[str]:
        """Recorded ones of load and air, unless given otherwise."""
        series = {} if self.recording is None else self.recording.series
        return [r for r in OF_PROFILE if r in series and r not in chosen and np.isfinite(series[r].value).any()]

    def recorded(self, vehicle: Vehicle, chosen: Collection[str]) -> dict[str, Array]:
        """Load [N] and air [degC] along the drive, if recorded and not given otherwise. Raises InputError as `along`."""
        roles, recording = self.conditions(chosen), self.recording
        if recording is None:
            return {}
        return {role: along(recording, role, self.drive.time_s, vehicle.weight, "--cycle") for role in roles}


def read_cycle(text: str, fastest_mps: float) -> DriveCycle:
    """A built-in cycle by its name, a speed profile, or a recording with a speed.

    `stages` is ten minutes each at a third, two thirds and all of a speed; `laps` is ten laps of 628 m with a stop after each.
    `fastest_mps`: the greatest speed that a built-in cycle may have. Raises InputError for what is none of them.
    """
    if text == STAGES:
        times, speeds = [0.0], [0.0]
        for share in SHARES:
            times += [times[-1] + RAMP_S, times[-1] + RAMP_S + HOLD_S]
            speeds += [share * fastest_mps] * 2
        return DriveCycle(text, through_points(np.array(times), np.array(speeds), STEP_S))
    if text == LAPS:
        return DriveCycle(text, lap_drive(min(FASTEST_LAP_KMH, KMH_PER_MPS * fastest_mps), LAPS_DRIVEN))
    path = Path(text)
    if not path.exists():
        raise InputError("--cycle", text, f"a recording, a speed profile, {' or '.join(BUILT_IN)}", nearest(text, BUILT_IN))
    recording = Recording.from_source(open_source([path]))
    if "speed" not in recording.series:
        raise InputError(f"--cycle {text}", f"roles {', '.join(recording.roles) or 'none'}", "a recording with a speed")
    time, speed = recording.time_s("speed"), recording.series["speed"].value
    usable = np.isfinite(speed)
    at_time, first = np.unique(time[usable], return_index=True)
    drive = through_points(at_time, speed[usable][first], STEP_S)
    ignored = [role for role in recording.roles if role not in ("speed", *OF_PROFILE)]
    notes = (f"{text}: only speed, load and air of the recording are used, not {', '.join(ignored)}",) if ignored else ()
    return DriveCycle(path.name, drive, recording, notes)


def check_weight(vehicle: Vehicle, weight: float) -> None:
    """Check the weight of a vehicle [N]. Raises InputError beyond the limits of a live estimate."""
    low, high = LEAST_LOAD_SHARE * vehicle.weight / 1e3, LARGEST_LOAD_SHARE * vehicle.weight / 1e3
    if not low <= weight / 1e3 <= high:
        allowed = f"{figures(low, 4)} to {figures(high, 4)} kN for {vehicle.name} of {figures(vehicle.weight / 1e3, 4)} kN"
        raise InputError("--weight-kn", weight / 1e3, allowed)


def run_cycle(
    estimator: Estimator, cycle: DriveCycle, weight: float | None, ambient: float | None
) -> tuple[dict[str, float], dict[str, Array]]:
    """A vehicle on a cycle from cold: totals, see `estimator.energy.taken`, and columns of the estimator, each of shape (times,).

    `weight`, `ambient`: whole weight [N] and air [degC]; by default as recorded, else those of the vehicle file. Raises
    InputError on a drive that is too fast, or a load that is implausible for the vehicle.
    """
    vehicle = estimator.vehicle
    assert isinstance(vehicle, Vehicle)  # designs have tracks
    check_speed(vehicle, float(np.abs(cycle.drive.speed).max()))
    choices: Mapping[str, float | None] = {"load": weight, "ambient": ambient}
    series = cycle.recorded(vehicle, [role for role, value in choices.items() if value is not None])
    load, air = (value if value is not None else series.get(role) for role, value in choices.items())
    columns = by_column(estimator, run_drive(estimator, cycle.drive, load, air))
    return sum_drive(vehicle, cycle.drive.time_s, columns), columns


def left_out(columns: Mapping[str, Array]) -> list[str]:
    """A sentence, if a drive leaves out an effect, of an estimator's columns by name."""
    has_gaps = np.any(columns["reasons"].astype(np.int64) & int(at.Reason.EFFECT_LEFT_OUT))
    return [at.Reason.EFFECT_LEFT_OUT.text] if has_gaps else []


def estimator_of(vehicle: Vehicle, like: Estimator) -> Estimator:
    """An estimator of a vehicle that differs in its values alone, for a few drives: without standard deviations."""
    estimator = copy(like)
    estimator.vehicle, estimator.facts = vehicle, vehicle_constants(vehicle)
    estimator.constants = make_constants(vehicle, like.settings, with_uncertainty=False, maker=quick_table)
    return estimator

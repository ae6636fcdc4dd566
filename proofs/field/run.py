# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs the diagnosis on real recordings with a measured channel concealed, and again with it given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proofs.field.data import Array, car, robot, trips
from trackres_ros.diagnosis import Diagnosis, DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.errors import InputError

WARM = frozenset({"warmup", "roadwheel_tyres", "viscous_bearing"})
UPHILL = frozenset({"grade", "grade_profile"})
TURNING = frozenset({"turning_scrub", "cornering"})
AIR = "ambient temperature"
NOTHING: frozenset[str] = frozenset()
HILLY = ("TripA06", "TripA07", "TripA11", "TripA12")
TWICE = ("TripB16", "TripB17")
BUT_WHEELS = ("yaw_rate", "heading", "latitude", "longitude")
SHOWS_TURNING = (*BUT_WHEELS, "wheel_speed")
COLD_S = 180.0
COLD_AFTER_H = 5.0
EVERY_M, SMOOTHED = 50.0, 5


@dataclass(frozen=True, eq=False)
class FieldTrial:
    """One trial."""

    what: str  # the recordings, as text
    hidden: str  # the concealed channel, as text
    wanted: frozenset[str]  # effects one of which should be named; empty if none should
    never: frozenset[str]  # effects that must not be named: given or impossible ones
    found: Diagnosis
    also_present: frozenset[str] = NOTHING  # effects that may be named too: they are present and no given channel shows them

    @property
    def named(self) -> tuple[tuple[str, ...], ...]:
        """Classes of named effects; empty if the verdict names none."""
        names_any = self.found.verdict.status in ("named", "one_of")
        return tuple(t.members for t in self.found.found) if names_any else ()

    @property
    def described(self) -> tuple[str, ...]:
        """Forms of the unnamed terms that hold-out laps confirm."""
        return tuple(str(t.form) for t in self.found.described if t.confirmed)

    @property
    def outcome(self) -> str:
        """`right`, `wrong`, or `silent` if an effect should have been named or described."""
        names = {name for members in self.named for name in members}
        firsts = {members[0] for members in self.named}
        if firsts & self.never:
            return "wrong"
        if self.wanted & {*names, *self.described}:
            return "right"
        if names - self.also_present:
            return "wrong"
        return "silent" if self.wanted else "right"


def try_all(data: Path, folder: Path) -> list[FieldTrial]:
    """Diagnose everything; the tables go to `folder`. InputError if the recordings are not there."""
    if not (data / "bmw_i3" / "trips.csv").is_file():
        raise InputError("--data", str(data), "a folder with bmw_i3/trips.csv and its trips, and husky_warthog")
    winter, warm = [n for n in trips(data) if n.startswith("TripB")], [n for n in trips(data) if n.startswith("TripA1")]
    mixed = winter[1::4]  # the last trips all follow short stops: they contain no cold start
    known, unknown = folder / "clock", folder / "no_clock"

    def of_car(names: Sequence[str], hide: Sequence[str], clock: bool = True, held_out: Sequence[str] | None = None) -> Diagnosis:
        paths = [car(data, name, known if clock else unknown, clock) for name in names]
        return diagnose(read_recordings(paths, None), load_base("bmw_i3"), DiagnosisOptions(hide=hide, holdout=held_out))

    def of_robot(name: str, hide: Sequence[str] = ()) -> Diagnosis:
        return diagnose(read_recordings([robot(data, name, folder)], None), load_base("husky"), DiagnosisOptions(hide=hide))

    return [
        FieldTrial(
            "car, 11 winter trips", AIR + ", standing time", WARM, UPHILL, of_car(winter, ["ambient"], False, mixed)
        ),
        FieldTrial("the same", AIR, WARM, UPHILL, of_car(winter, ["ambient"], True, mixed)),
        FieldTrial("car, 10 summer trips", "nothing", NOTHING, UPHILL, of_car(warm, [])),
        FieldTrial("car, hilly trips A06, A07, A11, A12", "elevation", UPHILL, NOTHING, of_car(HILLY, ["grade"])),
        FieldTrial("the same", "nothing", NOTHING, UPHILL, of_car(HILLY, [])),
        FieldTrial("car, one route twice, B16 and B17", "elevation", NOTHING, UPHILL, of_car(TWICE, ["grade"])),
        FieldTrial("robot on wet grass", "all that shows turning", NOTHING, TURNING, of_robot("husky_wetgrass", SHOWS_TURNING)),
        FieldTrial("the same", "yaw rate, heading, position", TURNING, NOTHING, of_robot("husky_wetgrass", BUT_WHEELS)),
        FieldTrial("the same", "yaw rate", TURNING, NOTHING, of_robot("husky_wetgrass", SHOWS_TURNING[:1])),
        FieldTrial("the same", "nothing that the base has", TURNING, NOTHING, of_robot("husky_wetgrass")),
        FieldTrial("robot, wheels off the ground", "nothing", NOTHING, TURNING, of_robot("husky_avide2")),
    ]  # fmt: skip


@dataclass(frozen=True)
class Start:
    """Start of one trip, and the concealed facts."""

    trip: str
    stood_h: float
    ambient: float
    lacks: float  # torque missing in the base, re-fitted to all trips, in the first three minutes [Nm]; nan if not comparable
    state: float = np.nan  # fitted to this trip alone, see `warmth.Starts`
    std: float = np.nan

    @property
    def cold(self) -> bool:
        """Whether it had stood for a night or a day."""
        return self.stood_h > COLD_AFTER_H


def starts(data: Path, tried: FieldTrial) -> list[Start]:
    """Unsealed standing time and ambient temperature, with each trip's missing torque at its beginning."""
    rows, found = trips(data), []
    for i, session in enumerate(tried.found.sessions):
        row, early = rows[Path(session.name).stem], session.used & (session.time < COLD_S)
        stood = float(row["hours_since_previous_trip_ended"] or "nan")
        lacks = float(tried.found.refitted.residuals[i][early].mean()) if early.any() else float("nan")
        found.append(Start(row["trip"], stood, float(row["ambient_degc"]), lacks))
    return found


def acts_early(tried: FieldTrial, index: int) -> float:
    """Time during which the first named effect acts in the first `COLD_S` of one recording [s]."""
    name = tried.found.sessions[index].name
    spans = tried.found.found[0].spans if tried.found.found else ()
    return sum(max(0.0, min(s.end, COLD_S) - s.begin) for s in spans if s.recording == name)


@dataclass(frozen=True, eq=False)
class RepeatedRoute:
    """Residuals of two drives of one route and the slope by the elevation, each [Nm] and [1] over distance [m], and the
    correlation of the residuals with each other and with the slope.
    """

    distance: Array
    residuals: Array  # (2, n)
    slope: Array
    repeats: float
    follows_slope: float


def twice(tried: FieldTrial) -> RepeatedRoute:
    """Residuals tied to position on a route driven twice, with the concealed slope."""
    residuals, slopes = [], []
    for i, session in enumerate(tried.found.sessions):
        far = session.distance - session.distance[0]
        grid = np.arange(500.0, far[-1] - 500.0, EVERY_M)
        used = session.used
        residuals.append(_smooth(np.interp(grid, far[used], tried.found.refitted.residuals[i][used])))
        table = np.genfromtxt(session.name, delimiter=",", names=True)
        grade = np.interp(session.time, table["time_s"] - table["time_s"][0], table["grade"])
        slopes.append(_smooth(np.interp(grid, far, grade)))
    n = min(map(len, residuals))
    both, mean = np.array([r[:n] for r in residuals]), np.asarray(np.mean([s[:n] for s in slopes], axis=0), dtype=float)
    distance = np.arange(500.0, 500.0 + n * EVERY_M, EVERY_M)[:n]
    repeats, follows = (float(np.corrcoef(*pair)[0, 1]) for pair in ((both[0], both[1]), (both.mean(axis=0), mean)))
    return RepeatedRoute(distance, both, mean, repeats, follows)


def _smooth(series: Array) -> Array:
    return np.asarray(np.convolve(series, np.ones(SMOOTHED) / SMOOTHED, mode="same"))

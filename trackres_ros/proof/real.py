"""The diagnosis on real recordings with a measured channel concealed, and again with it given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from trackres_ros.diagnosis import Diagnosis, diagnose, load_base, read_recordings
from trackres_ros.errors import InputError
from trackres_ros.proof.real_data import car, robot, trips

Array = NDArray[np.float64]

WARM = frozenset({"warmup", "roadwheel_tyres", "viscous_bearing"})
UPHILL = frozenset({"grade", "grade_profile"})
TURNING = frozenset({"turning_scrub", "cornering"})
AIR = "ambient temperature"
NOTHING: frozenset[str] = frozenset()
HILLY = ("TripA06", "TripA07", "TripA11", "TripA12")
TWICE = ("TripB16", "TripB17")
COLD_S = 180.0
COLD_AFTER_H = 5.0
EVERY_M, SMOOTHED = 50.0, 5


@dataclass(frozen=True, eq=False)
class Tried:
    """One trial.

    Attributes
    ----------
    what, hidden
        The recordings in words, and what was concealed.
    wanted
        Effects one of which ought to be named; empty where nothing ought to.
    never
        Effects that must not be named: what was given, or cannot be.
    found
        The diagnosis.
    """

    what: str
    hidden: str
    wanted: frozenset[str]
    never: frozenset[str]
    found: Diagnosis

    @property
    def named(self) -> tuple[tuple[str, ...], ...]:
        """Classes it stands by."""
        spoke = self.found.verdict.status in ("named", "one_of")
        return tuple(f.step.members for f in self.found.found) if spoke else ()

    @property
    def judged(self) -> str:
        """Right, wrong, or silent where it ought to have spoken."""
        names = {name for members in self.named for name in members}
        firsts = {members[0] for members in self.named}
        if firsts & self.never:
            return "wrong"
        if self.wanted:
            return "right" if names & self.wanted else ("wrong" if names else "silent")
        return "wrong" if names else "right"


def try_all(data: Path, folder: Path) -> list[Tried]:
    """Diagnose everything; the tables go to `folder`.

    Raises
    ------
    InputError
        If the recordings are not there.
    """
    if not (data / "bmw_i3" / "trips.csv").is_file():
        raise InputError("--data", str(data), "a folder with bmw_i3/trips.csv and its trips, and husky_warthog")
    winter, warm = [n for n in trips(data) if n.startswith("TripB")], [n for n in trips(data) if n.startswith("TripA1")]
    known, unknown = folder / "clock", folder / "no_clock"

    def of_car(names: Sequence[str], hide: Sequence[str], clock: bool = True) -> Diagnosis:
        paths = [car(data, name, known if clock else unknown, clock) for name in names]
        return diagnose(read_recordings(paths, None), load_base("bmw_i3"), hide=hide)

    def of_robot(name: str, hide: Sequence[str] = ()) -> Diagnosis:
        return diagnose(read_recordings([robot(data, name, folder)], None), load_base("husky"), hide=hide)

    return [
        Tried("car, 11 winter trips, cold and warm", AIR + ", standing time", WARM, UPHILL, of_car(winter, ["ambient"], False)),
        Tried("the same", AIR, WARM, UPHILL, of_car(winter, ["ambient"])),
        Tried("car, 10 summer trips", "nothing", NOTHING, UPHILL, of_car(warm, [])),
        Tried("car, hilly trips A06, A07, A11, A12", "elevation", UPHILL, NOTHING, of_car(HILLY, ["grade"])),
        Tried("the same", "nothing", NOTHING, UPHILL, of_car(HILLY, [])),
        Tried("car, one route twice, B16 and B17", "elevation", NOTHING, UPHILL, of_car(TWICE, ["grade"])),
        Tried("robot on wet grass", "yaw rate", NOTHING, TURNING, of_robot("husky_wetgrass", ["yaw_rate"])),
        Tried("the same", "nothing that the base has", TURNING, NOTHING, of_robot("husky_wetgrass")),
        Tried("robot, wheels off the ground", "nothing", NOTHING, TURNING, of_robot("husky_avide2")),
    ]  # fmt: skip


@dataclass(frozen=True)
class Start:
    """The beginning of one trip: torque that the base, re-fitted to all trips, lacks in the first three minutes [Nm]."""

    trip: str
    stood_h: float
    ambient: float
    lacks: float


def starts(data: Path, tried: Tried) -> list[Start]:
    """Unseal standing time and ambient temperature beside what each trip's beginning lacked."""
    rows, found = trips(data), []
    for session, predicted in zip(tried.found.sessions, tried.found.refitted.predicted, strict=True):
        row, early = rows[Path(session.name).stem], session.used & (session.time < COLD_S)
        stood = float(row["hours_since_previous_trip_ended"] or "nan")
        lacks = float((session.torque - predicted.torque)[early].mean())
        found.append(Start(row["trip"], stood, float(row["ambient_degc"]), lacks))
    return found


def locked_to_position(tried: Tried) -> float:
    """Correlation over distance of the residuals of two drives of one route."""
    residuals = []
    for session, predicted in zip(tried.found.sessions, tried.found.refitted.predicted, strict=True):
        far = session.distance - session.distance[0]
        grid = np.arange(500.0, far[-1] - 500.0, EVERY_M)
        used = session.used
        plain = np.interp(grid, far[used], (session.torque - predicted.torque)[used])
        residuals.append(np.convolve(plain, np.ones(SMOOTHED) / SMOOTHED, mode="same"))
    n = min(map(len, residuals))
    return float(np.corrcoef(residuals[0][:n], residuals[1][:n])[0, 1])


def page(data: Path, tried: Sequence[Tried]) -> str:
    """All of it in words and tables."""
    lines = [
        "| Recordings | Concealed | Said | Mean error on held-out laps, re-fitted and with effects [Nm] | Judged |",
        "|---|---|---|---|---|",
    ]
    for t in tried:
        said = "; ".join(" or ".join(members) for members in t.named) or t.found.verdict.status
        mae = t.found.held_out.mae
        lines.append(f"| {t.what} | {t.hidden} | {said} | {mae['refitted']:.3g}, {mae['with_effects']:.3g} | {t.judged} |")
    lines += ["", "What it said, word for word:", ""]
    lines += [f"- {t.what}, without {t.hidden}: {t.found.verdict.sentence}" for t in tried]
    begun = starts(data, tried[0])
    lines += ["", "## The car's starts, unsealed", ""]
    lines += ["| Trip | Stood [h] | Ambient [degC] | Lacks in the first three minutes [Nm] |", "|---|---|---|---|"]
    lines += [f"| {s.trip} | {s.stood_h:.1f} | {s.ambient:g} | {s.lacks:.0f} |" for s in sorted(begun, key=lambda s: -s.stood_h)]
    stood, lacks = np.array([s.stood_h for s in begun]), np.array([s.lacks for s in begun])
    rank = spearmanr(stood, lacks)
    cold = stood > COLD_AFTER_H
    lines += [
        "",
        f"After a night or a day ({COLD_AFTER_H:g} h and more) the first three minutes lack {lacks[cold].mean():.0f} Nm, "
        f"after a short stop {lacks[~cold].mean():.0f} Nm; "
        f"rank correlation with the time it stood {rank.statistic:.2f} (p = {rank.pvalue:.2g}).",
    ]
    twice = next(t for t in tried if "twice" in t.what)
    lines += [
        "",
        f"On the route driven twice the residuals repeat over distance with a correlation of {locked_to_position(twice):.2f}: "
        "locked to position, which is not yet grade. "
        + ("Grade was not named." if twice.judged == "right" else "And yet something was named."),
    ]
    return "\n".join(lines) + "\n"

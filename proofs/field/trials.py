# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnoses public recordings of real vehicles with a measured channel concealed, and again with it given.

The project holds none of them. The car: Steinstraeter, Buberger, Trifonov, "Battery and Heating Data in Real Driving Cycles",
IEEE DataPort, doi:10.21227/6jr9-5235. The robots: norlab-ulaval, DRIVE, BSD-3. The trolley bus: Widmer, Ritter, Onder, "ZTBus: A
Large Dataset of Time-Resolved City Bus Driving Missions", Scientific Data 10 (2023) 687.
"""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from proofs.tables import Rows
from trackres_ros.arrays import Array
from trackres_ros.diagnosis import Diagnosis, DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.diagnosis.empirical.payload import Payload
from trackres_ros.errors import InputError
from trackres_ros.output.table import write_table
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.slopes import slopes
from trackres_ros.route.track import Frame
from trackres_ros.text import figures
from trackres_ros.units import EARTH_M, GRAVITY, KMH_PER_MPS

FINAL_DRIVE = 9.665
SECONDS_PER_H = 3600.0
SLOWEST_MPS, YAW_OVER_S = 0.1, 0.5
NM_PER_A = 1.0  # assumed: unit of the results of the robots
POSITION = {"latitude_deg": "y", "longitude_deg": "x"}
RADIUS_M = {"husky": 0.159, "warthog": 0.3}
OF_CAR = ("Time [s]", "Velocity [km/h]", "Elevation [m]", "Motor Torque [Nm]", "Ambient Temperature")


def trips(data: Path) -> dict[str, dict[str, str]]:
    """Rows of the car's trips.csv by name."""
    with (data / "bmw_i3" / "trips.csv").open(encoding="utf-8") as lines:
        return {row["trip"]: row for row in csv.DictReader(lines)}


def car(data: Path, name: str, folder: Path, clock: bool = True, ground: str = "grade") -> Path:
    """Write one trip of the car: torque at the wheels, elevation as `ground` (`grade`, `altitude_m` or nothing), and its standing
    time before. Without `clock` it begins at 0 s, and the standing time is unknown.
    """
    text = gzip.decompress((data / "bmw_i3" / f"{name}.csv.gz").read_bytes()).decode("latin-1")
    header, *lines = [line.split(";") for line in text.splitlines()]
    place = [next(i for i, column in enumerate(header) if column.startswith(title)) for title in OF_CAR]
    table = np.array(
        [[float(line[i]) if line[i].strip() else np.nan for i in place] for line in lines if len(line) >= len(header) - 1]
    )
    _, first = np.unique(table[:, 0], return_index=True)
    time, kmh, height, torque, ambient = table[first].T
    speed = kmh / KMH_PER_MPS
    trip = trips(data)[name]
    start = datetime.fromisoformat(trip["start_local"]).replace(tzinfo=UTC).timestamp() if clock else 0.0
    stood_s = SECONDS_PER_H * float(trip["hours_since_previous_trip_ended"] or "nan") if clock else np.nan
    columns = {
        "time_s": start + time,
        "speed_mps": speed,
        "torque_nm": torque * FINAL_DRIVE,
        "ambient_degc": ambient,
        **({ground: slopes(time, speed, height).value if ground == "grade" else height} if ground else {}),
        "stood_s": np.full(len(time), stood_s),
    }
    return _write(folder / f"{name}.csv", columns)


def robot(data: Path, name: str, folder: Path) -> Path:
    """Write one recording of a skid-steered robot.

    Its sides turn at different speeds: the torque is the power of both sides' currents over the mean speed. Heading and yaw rate
    are those of the laser scans' position, as one of the robots records no gyroscope. The position is relative to a point on
    the equator.
    """
    text = gzip.decompress((data / "husky_warthog" / f"{name}.csv.gz").read_bytes()).decode()
    rows = list(csv.DictReader(io.StringIO(text)))

    def column(title: str) -> Array:
        return np.array([float(row[title]) if row[title] not in ("", "nan") else np.nan for row in rows])

    time = column("ros_time") * 1e-9
    there = np.concatenate(([False], np.diff(time) > 0.0)) & (time > 1.0)
    radius = RADIUS_M[name.partition("_")[0]]
    power, mean, rims = np.zeros(len(rows)), np.zeros(len(rows)), {}
    signed = float(np.nanmin(column("left_wheel_current"))) < -1.0
    for side in ("left", "right"):
        speed, current = radius * column(f"meas_{side}_vel"), column(f"{side}_wheel_current")
        power += current * (speed if signed else np.abs(speed))
        mean += 0.5 * speed
        rims[side] = speed
    is_moving = np.abs(mean) > SLOWEST_MPS
    yaw = np.unwrap(2.0 * np.arctan2(column("icp_quat_z"), column("icp_quat_w"))[there])
    place = time[there]
    result_after, result_before = (np.interp(place + side * 0.5 * YAW_OVER_S, place, yaw) for side in (1.0, -1.0))
    columns = {
        "time_s": place,
        "speed_mps": mean[there],
        "torque_nm": np.where(is_moving, NM_PER_A * power / np.where(is_moving, mean, 1.0), np.nan)[there],
        "yaw_rate_radps": (result_after - result_before) / YAW_OVER_S,
        "heading_rad": yaw,
        **{name: np.degrees(column(f"icp_pos_{axis}")[there] / EARTH_M) for name, axis in POSITION.items()},
        **{f"wheel_speed_mps/{side}": rim[there] for side, rim in rims.items()},
    }
    return _write(folder / f"{name}.csv", columns)


def _write(path: Path, columns: dict[str, Array]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_table(path, columns)
    return path


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
        FieldTrial("car, 11 winter trips", AIR, WARM, UPHILL, of_car(winter, ["ambient"], True, mixed)),
        FieldTrial("car, 10 summer trips", "nothing", NOTHING, UPHILL, of_car(warm, [])),
        FieldTrial("car, hilly trips A06, A07, A11, A12", "elevation", UPHILL, NOTHING, of_car(HILLY, ["grade"])),
        FieldTrial("car, hilly trips A06, A07, A11, A12", "nothing", NOTHING, UPHILL, of_car(HILLY, [])),
        FieldTrial("car, one route twice, B16 and B17", "elevation", NOTHING, UPHILL, of_car(TWICE, ["grade"])),
        FieldTrial("robot on wet grass", "all that shows turning", NOTHING, TURNING, of_robot("husky_wetgrass", SHOWS_TURNING)),
        FieldTrial("robot on wet grass", "yaw rate, heading, position", TURNING, NOTHING, of_robot("husky_wetgrass", BUT_WHEELS)),
        FieldTrial("robot on wet grass", "yaw rate", TURNING, NOTHING, of_robot("husky_wetgrass", SHOWS_TURNING[:1])),
        FieldTrial("robot on wet grass", "nothing that the base has", TURNING, NOTHING, of_robot("husky_wetgrass")),
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
    rows, result = trips(data), []
    for i, session in enumerate(tried.found.sessions):
        row, early = rows[Path(session.name).stem], session.used & (session.time < COLD_S)
        stood = float(row["hours_since_previous_trip_ended"] or "nan")
        lacks = float(tried.found.refitted.residuals[i][early].mean()) if early.any() else float("nan")
        result.append(Start(row["trip"], stood, float(row["ambient_degc"]), lacks))
    return result


def acts_early(tried: FieldTrial, index: int) -> float:
    """Time during which the first named effect acts in the first `COLD_S` of one recording [s]."""
    name = tried.found.sessions[index].name
    spans = tried.found.found[0].spans if tried.found.found else ()
    return sum(max(0.0, min(s.end, COLD_S) - s.begin) for s in spans if s.recording == name)


@dataclass(frozen=True, eq=False)
class RepeatedRoute:
    """Correlation of the residuals of two drives of one route, over distance."""

    repeats: float  # with each other
    follows_slope: float  # their mean with the slope by the elevation


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
    pair_here, mean = np.array([r[:n] for r in residuals]), np.asarray(np.mean([s[:n] for s in slopes], axis=0), dtype=float)
    return RepeatedRoute(
        *(float(np.corrcoef(*pair)[0, 1]) for pair in ((pair_here[0], pair_here[1]), (pair_here.mean(axis=0), mean)))
    )


def _smooth(series: Array) -> Array:
    return np.asarray(np.convolve(series, np.ones(SMOOTHED) / SMOOTHED, mode="same"))


BUS_FOLDER, BUS, BUS_TOPICS = "ztbus", "ztbus_hess19", "ztbus"
SAME_PLACE_M = 15.0
SLOPE_OVER_M = 300.0
LONG_STRETCH_S = 300.0  # of driving
CLOSE = 0.08  # of the passengers' weight


@dataclass(frozen=True)
class PayloadFound:
    """Comparison of the found payload with the passengers: values of each stretch, masses relative to their mean [kg]."""

    mass: Array
    std: Array
    true: Array
    correlation: float  # of the found masses with the passengers', weighted by time
    close: int  # joined stretches, see `mass_of_joined`, with a mean mass within `CLOSE` of the passengers' weight
    long: int  # all joined stretches
    longest_s: float  # driving in the longest stretch


def missions(data: Path) -> list[Path]:
    """The recordings of the bus that are there."""
    return sorted((data / BUS_FOLDER).glob("*.csv.gz"))


def try_bus(data: Path) -> list[FieldTrial]:
    """Diagnose each of the concealments; empty without missions."""
    paths = missions(data)
    if not paths:
        return []
    topics = Topics.load(BUS_TOPICS)

    def without(*hide: str) -> Diagnosis:
        return diagnose(read_recordings(paths, topics), load_base(BUS).with_topics(topics), DiagnosisOptions(hide=hide))

    wanted = {
        "nothing": ((), UPHILL),
        "altitude": (("altitude",), UPHILL),
        "altitude and position": (("altitude", "latitude", "longitude"), NOTHING),
        "passengers": (("passengers",), frozenset({"payload"})),
        "steering angle": (("steering_angle",), NOTHING),
        "ambient temperature": (("ambient",), WARM),
        "brake pressure": (("brake",), NOTHING),
    }
    return [
        FieldTrial("trolley bus, a mission of 4.4 h", hidden, names, NOTHING, without(*roles), UPHILL)
        for hidden, (roles, names) in wanted.items()
    ]


def slope_found(tried: FieldTrial, given: FieldTrial) -> tuple[float, float] | None:
    """Correlation of the found slope with that of the altitude, which `given` has, averaged over all passes of a place and over
    300 m, and coefficient of its regression on that one; None without one.
    """
    final = tried.found.final
    if not UPHILL & set(final.effect_names):
        return None
    named = next(name for name in final.effect_names if name in UPHILL)
    radius = tried.found.base.facts.radius
    result, true = [], []
    for session, adds in zip(given.found.sessions, final.contribution(named), strict=True):
        surveyed = slope_by_all_passes(session.latitude, session.longitude, session.altitude, session.distance)
        there = session.used & np.isfinite(surveyed) & (np.abs(adds) > 0.0)
        result.append((adds / (session.weight * radius))[there])
        true.append(surveyed[there])
    x, y = np.concatenate(true), np.concatenate(result)
    return float(np.corrcoef(x, y)[0, 1]), float(np.polyfit(x, y, 1)[0])


def slope_by_all_passes(latitude: Array, longitude: Array, altitude: Array, distance: Array) -> Array:
    """Slope of the altitude averaged over all passes of each place, over 300 m; nan where unknown."""
    x, y = Frame.of_positions(latitude, longitude).metres(latitude, longitude)
    known = np.isfinite(x) & np.isfinite(altitude)
    place = np.column_stack([x, y])[known]
    near = cKDTree(place).query_ball_point(place, SAME_PLACE_M)
    mean = np.array([altitude[known][rows].mean() for rows in near])
    forecast, behind = (np.interp(distance + side * 0.5 * SLOPE_OVER_M, distance[known], mean) for side in (1.0, -1.0))
    slope = np.full(len(distance), np.nan)
    is_inside = (distance - 0.5 * SLOPE_OVER_M > distance[known][0]) & (distance + 0.5 * SLOPE_OVER_M < distance[known][-1])
    slope[is_inside & known] = ((forecast - behind) / SLOPE_OVER_M)[is_inside & known]
    return slope


def payload_found(tried: FieldTrial, given: FieldTrial) -> PayloadFound | None:
    """Compare the found masses with the passengers, which `given` has; None without any."""
    stretches = next((t.pattern.stretches for t in tried.found.described if isinstance(t.pattern, Payload)), ())
    if not stretches:
        return None
    known = {s.name: s for s in given.found.sessions}
    driven, rows = [], []
    for stretch in stretches:
        session = known[stretch.recording]
        there = (session.time >= stretch.begin_s) & (session.time < stretch.end_s) & session.used
        if there.any():
            driven.append(float(there.sum()) * session.step)
            people = float(session.payload[there].mean()) / GRAVITY
            rows.append((stretch.mass, stretch.std, people))
    mass, std, true = np.array(rows).T
    weight = np.array(driven)
    mass, people = mass - np.average(mass, weights=weight), true - np.average(true, weights=weight)
    covariance = np.cov(np.stack([mass, people]), aweights=weight)
    correlation = float(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))
    deviation, carried = (mass_of_joined(x, weight) for x in (mass - people, true))
    close = int((np.abs(deviation) < CLOSE * carried).sum())
    return PayloadFound(mass, std, people, correlation, close, len(deviation), float(weight.max()))


def mass_of_joined(mass: Array, driven: Array) -> Array:
    """Means over consecutive stretches, joined until they have more than `LONG_STRETCH_S` of driving [s]; a shorter rest at the
    end is dropped.
    """
    joined, begin = list[float](), 0
    for end in range(1, len(mass) + 1):
        if driven[begin:end].sum() > LONG_STRETCH_S:
            joined.append(float(np.average(mass[begin:end], weights=driven[begin:end])))
            begin = end
    return np.array(joined)


def against_given(tried: Sequence[FieldTrial]) -> tuple[Rows, PayloadFound | None]:
    """Of `try_bus`: the found slopes against that of the altitude, and the found payload; nothing without a mission."""
    given_values = next((t for t in tried if t.hidden == "nothing"), None)
    if given_values is None:
        return [], None
    slopes = [slope_row(t.hidden, *slope) for t in tried if (slope := slope_found(t, given_values)) is not None]
    return slopes, payload_found(next(t for t in tried if t.hidden == "passengers"), given_values)


def slope_row(hidden: str, correlation: float, coefficient: float) -> dict[str, str]:
    """See `slope_found`."""
    return {"concealed": hidden, "correlation": f"{correlation:.2f}", "coefficient": f"{coefficient:.2f}"}


def payload_numbers(found: PayloadFound) -> list[tuple[str, str]]:
    """The masses against the passengers, as text."""
    error = float(np.sqrt(np.mean((found.mass - found.true) ** 2)))
    return [
        ("bus: stretches between stops", str(len(found.mass))),
        ("bus: correlation of the masses with the passengers", f"{found.correlation:.2f}"),
        ("bus: standard deviation of the passengers, 70 kg each [kg]", figures(float(found.true.std()))),
        ("bus: error of the masses [kg]", figures(error)),
        ("bus: stated standard deviation of the masses [kg]", figures(float(found.std.mean()))),
        ("bus: driving in the longest stretch [s]", f"{found.longest_s:.0f}"),
        (f"bus: stretches joined to {LONG_STRETCH_S:.0f} s of driving", str(found.long)),
        (f"bus: of these within {CLOSE:.0%} of the passengers' weight", str(found.close)),
    ]

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sessions: recordings as evenly spaced series in SI, with masks for their use; the facts of a vehicle, notes, and the split."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import PurePath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.roles import PASSENGER_KG
from trackres_ros.recording.slopes import runs_of
from trackres_ros.text import told_apart
from trackres_ros.units import MAD_TO_STD, STANDSTILL_MPS
from trackres_ros.vehicle.gears import Gears

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AROUND = 5  # steps, odd
MOST_KEPT = 8  # cached shifts
MOST_LAGS = 4  # steps before a step that the whitening of its residual needs; a fit uses steps with all of these
FEWEST_FITTED = MOST_LAGS + 1  # such steps: fewer ones fit the noise exactly
ALWAYS_KNOWN = ("speed", "accel", "weight", "distance", "drive_torque", "ambient", "belt")  # inputs of effects
NOT_RECORDED = dict.fromkeys(("latitude", "longitude", "altitude", "steering_angle", "passengers"), np.nan) | {
    "payload": 0.0, "torque_by_place": 0.0,
}  # fmt: skip
"""Default values of optional series."""


@dataclass(frozen=True, eq=False)
class Cumulative:
    """A measured quantity on its own times: times [s], and its integral up to each."""

    times: Array
    integral: Array
    _cache: dict[tuple[float, ...], Array] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, times: Array, value: Array) -> Cumulative:
        """Along straight lines between samples."""
        steps = 0.5 * (value[1:] + value[:-1]) * np.diff(times)
        return cls(times, np.concatenate(([0.0], np.cumsum(steps))))

    def means(self, begin: Array, step: float) -> Array:
        """Means over steps that begin at some times [s]."""
        edges = np.interp(np.stack([begin, begin + step]), self.times, self.integral)
        return np.asarray((edges[1] - edges[0]) / step)

    def later_means(self, begin: Array, step: float, delay: float) -> Array:
        """The same, some time `delay` [s]; cached for the last few, as most derivatives of a fit keep the delay."""
        key = len(begin), float(begin[0]), step, delay
        result = self._cache.get(key)
        if result is None:
            result = self.means(begin + delay, step)
            if len(self._cache) >= MOST_KEPT:
                self._cache.clear()
            self._cache[key] = result
        return result


@dataclass(frozen=True, eq=False)
class Way:
    """Positions within the steps of a session: a fixed number in each, evenly spaced in time, shape (n times that number,)."""

    latitude: Array  # [rad]; nan where unknown
    longitude: Array  # [rad]
    driven: Array  # distance since the start of the session [m]


@dataclass(frozen=True, eq=False)
class DriveSession:
    """One recording. All series have the shape (n,), evenly spaced by `step` [s]; nan where unknown.

    The noise of the acceleration refers to a smoothed speed and does not depend on the noise assumed for the speed: it hides no
    share of the inertia. An unseen drive before it, `gap` ago, is assumed to be like this one.
    """

    name: str  # of the recording
    step: float
    time: Array  # from the start of the recording [s]
    speed: Array  # [m/s]
    accel: Array  # [m/s^2]
    weight: Array  # [N]
    ambient: Array  # [degC]
    grade: Array  # rise over run
    yaw_rate: Array  # [rad/s]
    heading: Array  # [rad]
    distance: Array  # [m]
    torque: Array  # measured at the sprockets, whole vehicle [Nm]
    belt: Array  # measured [degC]
    used: Mask  # samples whose torque may be compared
    block: NDArray[np.int64]  # number of the lap, or of the piece, counted through all sessions
    gap: float = np.inf  # time off since the previous session [s]; infinite where the belt starts at ambient temperature
    after_unseen: bool = False  # whether the drive before is not among the recordings
    first_drive: bool = False  # whether a start at ambient temperature is the vehicle's first one, without a saved state
    given: frozenset[str] = field(default_factory=frozenset)  # the known channels
    computed: frozenset[str] = field(default_factory=frozenset)  # from others, where a replay has less: see `results.diagnosis`
    torque_course: Cumulative | None = None  # the torque as measured, for delays of less than a step
    accel_noise: float = 0.0  # standard deviation due to errors of the speed [m/s^2]; 0 where unknown
    torque_noise: float = 0.0  # of a step's mean, due to sample-to-sample noise [Nm]; 0 where unknown
    belt_shows_surface: bool = False  # whether the belt temperature is that of the surface
    start_s: float = np.nan  # [s since 1970, UTC]; nan without a clock of the day
    grade_std: float = np.nan  # of a grade derived from an altitude
    latitude: Array = field(default_factory=lambda: np.empty(0))  # [rad]
    longitude: Array = field(default_factory=lambda: np.empty(0))  # [rad]
    altitude: Array = field(default_factory=lambda: np.empty(0))  # [m]
    steering_angle: Array = field(default_factory=lambda: np.empty(0))  # [rad]
    passengers: Array = field(default_factory=lambda: np.empty(0))  # number on board, between counts
    payload: Array = field(default_factory=lambda: np.empty(0))  # part of the weight [N]
    torque_by_place: Array = field(default_factory=lambda: np.empty(0))  # against travel [Nm]
    way: Way | None = None  # positions within its steps
    bindings: Mapping[str, TopicBinding] = field(default_factory=dict)  # how each role was read
    live_filter: LiveFilter | None = None  # that fits its speeds; None where the acceleration is recorded, or for slow samples

    def __post_init__(self) -> None:
        for name, default in NOT_RECORDED.items():
            if len(getattr(self, name)) != len(self.time):
                object.__setattr__(self, name, np.full(len(self.time), default))

    def __len__(self) -> int:
        return len(self.time)

    @property
    def pace(self) -> float:
        """Time scale over that of a drive, see `pace`."""
        return pace(self.step)

    def stretches(self, mask: Mask) -> Iterator[tuple[float, float]]:
        """Begin and end [s] of each stretch inside a mask."""
        for begin, end in runs_of(mask):
            yield float(self.time[begin]), float(self.time[end - 1] + self.step)

    @cached_property
    def weights(self) -> tuple[float, float]:
        """The least and the most weight [N]."""
        return float(self.weight.min()), float(self.weight.max())

    @cached_property
    def ahead(self) -> Array:
        """1 driving forward and -1 in reverse, at rest as at the next start; shape (n,). Times it, a torque below zero brakes."""
        moving_rows = np.flatnonzero(np.abs(self.speed) > STANDSTILL_MPS)
        next_rows = np.searchsorted(moving_rows, np.arange(len(self)))
        return np.copysign(
            1.0, np.append(self.speed[moving_rows], self.speed[moving_rows[-1:]])[next_rows] if len(moving_rows) else self.speed
        )

    @cached_property
    def accel_around(self) -> Array:
        """Mean acceleration over `AROUND` steps [m/s^2], in which errors of the speed at the edges of a step cancel."""
        count = np.convolve(np.ones(len(self)), np.ones(AROUND), mode="same")
        return np.asarray(np.convolve(self.accel, np.ones(AROUND), mode="same") / count)


def shown_names(sessions: Sequence[DriveSession]) -> list[str]:
    """Name of each recording where room is short."""
    return told_apart([s.name for s in sessions])


def whole_past(mask: Mask, lags: int) -> Mask:
    """Whether a sample and the `lags` before it can be used."""
    is_valid = mask.copy()
    for lag in range(1, lags + 1):
        is_valid[lag:] &= mask[:-lag]
        is_valid[:lag] = False
    return is_valid


def with_unseen(sessions: Sequence[DriveSession]) -> Iterator[tuple[DriveSession, bool]]:
    """Sessions in sequence, with the unrecorded drives before them; and whether each is an unrecorded one."""
    for session in sessions:
        if session.after_unseen:
            yield replace(session, gap=np.inf, after_unseen=False), True
        yield session, False


@dataclass(frozen=True, eq=False)
class Split:
    """Numbers of the blocks to fit on, and of the hold-out blocks."""

    training: tuple[int, ...]
    held_out: tuple[int, ...]
    text: str

    def training_mask(self, session: DriveSession) -> Mask:
        """Samples of a session to fit on."""
        return session.used & np.isin(session.block, self.training)

    def held_out_mask(self, session: DriveSession) -> Mask:
        """Samples of a session to hold out."""
        return session.used & np.isin(session.block, self.held_out)


STEP_S = 1.0  # mean torque over a step against its change of speed: exact for any course within
LEAST_SAMPLES = 5  # in a step: with fewer, sampling affects the change of speed and the mean torque as much as the drive does
SLOWEST_MPS, SLOWEST_SHARE = 0.3, 0.1  # of the greatest speed; below both friction may be static


def pace(step: float) -> float:
    """Time scale of a recording over that of a drive: 1, or less for a quick machine with steps of less than `STEP_S`.

    It scales the built-in times of the diagnosis (length of a piece, of a long gap).
    """
    return min(1.0, step / STEP_S)


class LiveFilter(NamedTuple):
    """Settings of the live filter of the acceleration that fit a recording's speeds, named as in the estimator's `Settings`."""

    speed_std_mps: float
    acceleration_std: float
    acceleration_time_s: float


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Facts of a vehicle for the checks of its recordings."""

    weight: float  # [N], for recordings without it
    max_speed: float  # [m/s]
    ambient: float  # [degC], for recordings without it
    friction_brakes: bool | None  # whether they may add to a braking torque, if not recorded; None for a vehicle without
    belt_shows_surface: bool = False  # whether a measured belt temperature is that of the surface, as from infrared
    gears: Gears | None = None  # between motor and sprockets; None if not in the file
    torque_scale: float = 1.0  # shown over true torque: sessions have the true one [Nm]
    torque_share: tuple[float, float] = (1.0, 1.0)  # limits of true over expected torque, by the ranges of the file
    passenger_kg: float = PASSENGER_KG  # of one passenger
    track_width: float | None = None  # distance of left from right wheels [m]; None if not in the file
    has_belt: bool = False  # whether notes on belts apply
    is_vehicle: bool = True  # whether words and times of vehicles apply; else a slide, or a model of the user's own
    friction: float = 0.0  # torque that an offset and friction which the model lacks may reach [Nm]
    axles: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # by axle, nominal loads of its assemblies [N]

    def total_load(self, loads: Mapping[str, Array], payload: Array | float = 0.0) -> Array:
        """Load of the whole vehicle [N], from loads of it, of axles or of assemblies by role, alike in shape, at least one.

        Where that of an axle or assembly is unknown, it is the nominal one with its share of a counted payload [N].
        """
        load_share = 1.0 + payload / self.weight
        if "load" in loads:
            return loads["load"]
        if not loads.keys() <= {f"load/{name}" for axle, assemblies in self.axles.items() for name in (axle, *assemblies)}:
            return np.asarray(np.sum(list(loads.values()), axis=0))
        no_load = np.full_like(next(iter(loads.values())), np.nan)
        total = np.zeros_like(no_load)
        for axle, nominal in self.axles.items():
            axle_load, *assembly_loads = (loads.get(f"load/{name}", no_load) for name in (axle, *nominal))
            total_of_parts = np.sum(
                [
                    np.where(np.isfinite(x), x, load * load_share)
                    for x, load in zip(assembly_loads, nominal.values(), strict=True)
                ],
                axis=0,
            )
            total += np.where(np.isfinite(axle_load), axle_load, total_of_parts)
        return total

    @property
    def slowest(self) -> float:
        """Speed below which friction may be static [m/s]."""
        return min(SLOWEST_MPS, SLOWEST_SHARE * self.max_speed)


TURNS, OUTLIER = 10, 1.5  # Huber's


def robust_least_squares(columns: Array, y: Array) -> Array:
    """Least squares with less weight on outliers; columns may be collinear."""
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-12)
    weight = np.ones(len(y))
    values = np.zeros(columns.shape[1])
    for _ in range(TURNS):
        root = np.sqrt(weight)
        values = np.linalg.lstsq(columns / scale * root[:, np.newaxis], y * root, rcond=None)[0] / scale
        residual = np.abs(y - columns @ values)
        weight = np.minimum(1.0, OUTLIER * MAD_TO_STD * float(np.median(residual)) / np.maximum(residual, 1e-12))
    return values


class WarningNote(str):
    """A note on which the user should act: a recording or a channel is not used, or two inputs contradict each other.

    Any other note states an assumption or a correction.
    """

    __slots__ = ()


class SensorFinding(WarningNote):
    """A warning on a sensor that another input contradicts. The verdict has it too, so that the two never disagree.

    Parameters
    ----------
    text
        The warning.
    says
        The same as a sentence of the verdict.
    effect, value
        The error as an effect of the catalogue, with the value of its first parameter; empty where there is none.
    """

    statement: str
    effect: str
    value: float

    def __new__(cls, text: str, statement: str, effect: str = "", value: float = 0.0) -> SensorFinding:
        """A string with attributes."""
        finding = super().__new__(cls, text)
        finding.statement, finding.effect, finding.value = statement, effect, value
        return finding


FEWEST_SESSIONS = 4
HELD_OUT_SHARE = 0.25
FULL_STOP_S = 5.0
PIECES, SHORTEST_PIECE_S, LONGEST_PIECE_S = 20, 60.0, 300.0
FEWEST_DRIVES = 8


def split_laps(sessions: Sequence[DriveSession], held_out: int | Sequence[str] | None = None) -> Split:
    """Choose the hold-out blocks: the last ones, or `held_out`.

    That is the number of the last sessions (of several) or blocks, or the names of recordings, or of laps as in a report
    ("drive_3.csv: 5"). With names, added recordings do not change the hold-out set. A part of a name holds out all recordings
    that have it, unless one is called so.

    Raises
    ------
    InputError
        If nothing, or too little, would remain to fit on, or a name is not among the recordings.
    """
    choice = _choose(sessions, held_out)
    rows = sum(int(whole_past(choice.training_mask(s), MOST_LAGS).sum()) for s in sessions)
    if rows < FEWEST_FITTED:
        raise too_short_pieces(", ".join(s.name for s in sessions), sessions[0].step)
    return choice


def _choose(sessions: Sequence[DriveSession], held_out: int | Sequence[str] | None) -> Split:
    blocks = [sorted(set(s.block.tolist())) for s in sessions]
    by_session = len(sessions) >= FEWEST_SESSIONS or (isinstance(held_out, int) and held_out < len(sessions) > 1)
    if held_out is not None and not isinstance(held_out, int):
        laps = {lap_name(s, b): b for s, session_blocks in zip(sessions, blocks, strict=True) for b in session_blocks}
        lap_blocks = {
            b for lap, b in laps.items() if any(lap == name if name in laps else lap.endswith(name) for name in held_out)
        }
        part_names = [name for name in held_out if not any(lap.endswith(name) for lap in laps)]
        unknown_names = [name for name in part_names if not any(name in s.name for s in sessions)]
        if unknown_names:
            raise InputError("--holdout", unknown_names[0], f"part of a name among {', '.join(s.name for s in sessions)}")
        names_of = [(s.name, PurePath(s.name).stem) for s in sessions]
        exact_names = {name for names in names_of for name in names}
        chosen_indices = {
            i for i, names in enumerate(names_of) for name in part_names if name in (names if name in exact_names else names[0])
        }
        if lap_blocks:
            return _by_laps(sessions, blocks, lap_blocks.union(*(blocks[i] for i in chosen_indices)))
    elif by_session:
        count = held_out if isinstance(held_out, int) else max(1, round(HELD_OUT_SHARE * len(sessions)))
        chosen_indices = set(range(len(sessions) - count, len(sessions)))
    else:
        return _last_laps(sessions, [b for session_blocks in blocks for b in session_blocks], held_out)
    training = tuple(b for i, session_blocks in enumerate(blocks) if i not in chosen_indices for b in session_blocks)
    if not training or not chosen_indices:
        allowed, lap = f"some, but not all, of the {len(sessions)} recordings", lap_name(sessions[-1], blocks[-1][-1])
        raise InputError("--holdout", held_out, allowed, f"or laps by name, such as '{lap}'")
    text = f"held out: {', '.join(sessions[i].name for i in sorted(chosen_indices))}"
    return Split(training, tuple(b for i in sorted(chosen_indices) for b in blocks[i]), text)


def lap_name(session: DriveSession, block: int) -> str:
    """A lap as in a report: the recording, and its number there."""
    return f"{session.name}: {block - session.block[0] + 1}"


def _last_laps(sessions: Sequence[DriveSession], laps: Sequence[int], held_out: int | None) -> Split:
    """Hold out so many of the last laps, by default a quarter; the last driven ones if the vehicle is parked in all of these."""
    compared_blocks = set(np.concatenate([s.block[s.used] for s in sessions]).tolist())
    end, parking_text = len(laps), ""
    count = max(1, round(HELD_OUT_SHARE * end)) if held_out is None else held_out
    if 0 < count < end and compared_blocks.isdisjoint(laps[-count:]):
        end = 1 + max((i for i, lap in enumerate(laps) if lap in compared_blocks), default=-1)
        count = max(1, round(HELD_OUT_SHARE * end)) if held_out is None else held_out
        parking_text = f", before {len(laps) - end} without a comparable torque"
    if not 0 < count < end:
        raise InputError("--holdout", count, f"1 to {end - 1} of the {end} laps or pieces")
    first_lap = end - count
    return Split(
        tuple(laps[:first_lap]), tuple(laps[first_lap:]), f"the last {count} of {end} laps or pieces are held out{parking_text}"
    )


def _by_laps(sessions: Sequence[DriveSession], blocks: Sequence[Sequence[int]], held_out: set[int]) -> Split:
    training = tuple(b for laps in blocks for b in laps if b not in held_out)
    if not training:
        raise InputError("--holdout", sorted(held_out), "some, but not all, of the laps")
    text = (
        f"held out: {', '.join(lap_name(s, b) for s, laps in zip(sessions, blocks, strict=True) for b in laps if b in held_out)}"
    )
    return Split(training, tuple(sorted(held_out)), text)


def lap_numbers(session: DriveSession) -> NDArray[np.int64]:
    """Number of the drive between two stops, or of a piece of equal length if there are few stops; shape (n,), from 0."""
    is_standing = np.abs(session.speed) < SLOWEST_MPS
    full_stop = FULL_STOP_S * session.pace
    cuts = [begin for begin, end in runs_of(is_standing) if begin > 0 and (end - begin) * session.step >= full_stop]
    if len(cuts) >= FEWEST_DRIVES - 1:
        return np.searchsorted(np.array(cuts), np.arange(len(session)), side="right").astype(np.int64)
    duration = len(session) * session.step
    length = min(max(duration / PIECES, SHORTEST_PIECE_S * session.pace), LONGEST_PIECE_S * session.pace)
    pieces = max(1, int(duration // length))
    return np.minimum((np.arange(len(session)) * pieces) // len(session), pieces - 1).astype(np.int64)


def too_short_pieces(where: str, step: float) -> InputError:
    """Error if the samples to fit on come in pieces too short for a fit, in steps of `step` [s]."""
    statement = "a torque of the fitted laps that is too short, or has too many gaps"
    allowed = f"driving for more than {MOST_LAGS * step:.3g} s without a gap"
    return InputError(where, statement, allowed, "record the torque without gaps, or give a longer recording")

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines sessions: recordings as evenly spaced series in SI, with masks for their use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.settings import LiveFilter, pace
from trackres_ros.recording.bindings import TopicBinding
from trackres_ros.recording.slopes import runs_of
from trackres_ros.text.names import told_apart
from trackres_ros.units import STANDSTILL_MPS

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

    at: Array
    integral: Array
    _asked: dict[tuple[float, ...], Array] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, at: Array, value: Array) -> Cumulative:
        """Along straight lines between samples."""
        steps = 0.5 * (value[1:] + value[:-1]) * np.diff(at)
        return cls(at, np.concatenate(([0.0], np.cumsum(steps))))

    def means(self, begin: Array, step: float) -> Array:
        """Means over steps that begin at some times [s]."""
        edges = np.interp(np.stack([begin, begin + step]), self.at, self.integral)
        return np.asarray((edges[1] - edges[0]) / step)

    def later_means(self, begin: Array, step: float, later: float) -> Array:
        """The same, some time `later` [s]; cached for the last few, as most derivatives of a fit keep the delay."""
        asked = len(begin), float(begin[0]), step, later
        found = self._asked.get(asked)
        if found is None:
            found = self.means(begin + later, step)
            if len(self._asked) >= MOST_KEPT:
                self._asked.clear()
            self._asked[asked] = found
        return found


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
        """Time scale over that of a drive, see `settings.pace`."""
        return pace(self.step)

    def stretches(self, inside: Mask) -> Iterator[tuple[float, float]]:
        """Begin and end [s] of each stretch inside a mask."""
        for begin, end in runs_of(inside):
            yield float(self.time[begin]), float(self.time[end - 1] + self.step)

    @cached_property
    def weights(self) -> tuple[float, float]:
        """The least and the most weight [N]."""
        return float(self.weight.min()), float(self.weight.max())

    @cached_property
    def ahead(self) -> Array:
        """1 driving forward and -1 in reverse, at rest as at the next start; shape (n,). Times it, a torque below zero brakes."""
        moves = np.flatnonzero(np.abs(self.speed) > STANDSTILL_MPS)
        after = np.searchsorted(moves, np.arange(len(self)))
        return np.copysign(1.0, np.append(self.speed[moves], self.speed[moves[-1:]])[after] if len(moves) else self.speed)

    @cached_property
    def accel_around(self) -> Array:
        """Mean acceleration over `AROUND` steps [m/s^2], in which errors of the speed at the edges of a step cancel."""
        inside = np.convolve(np.ones(len(self)), np.ones(AROUND), mode="same")
        return np.asarray(np.convolve(self.accel, np.ones(AROUND), mode="same") / inside)


def shown_names(sessions: Sequence[DriveSession]) -> list[str]:
    """Name of each recording where room is short."""
    return told_apart([s.name for s in sessions])


def whole_past(mask: Mask, lags: int) -> Mask:
    """Whether a sample and the `lags` before it can be used."""
    valid = mask.copy()
    for lag in range(1, lags + 1):
        valid[lag:] &= mask[:-lag]
        valid[:lag] = False
    return valid


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

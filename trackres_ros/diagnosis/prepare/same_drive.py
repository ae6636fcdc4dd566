# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recognises two recordings of one drive, in whole or in part: cut, overlapping, or with repeated or missing samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.sampling import ordered
from trackres_ros.diagnosis.prepare.session import Array, Mask
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.roles import base_role

SAME_S, SAME_MPS, SAME_NM = 1e-3, 1e-4, 0.1  # a table rounds by less, and two drives differ by more
SAME = 1.0 + 1e-9  # of the tolerances
PIECE_S, PIECES = 10.0, 6  # of driving at a changing speed: a minute in common is no chance
LONGEST_STEP_S = 2.0  # that a change of speed counts for
PROBES, PROBE_EVERY_S = 8, 0.1  # samples of a piece to compare, and their least distance
MOST_MISSED = 0.1  # of them: a copy may lack samples

Indices = NDArray[np.intp]


def common_roles(one: Recording, other: Recording) -> tuple[str, ...]:
    """The speed and the torques that both have; empty without a speed."""
    roles = [role for role in one.series if role in other.series and base_role(role) == "torque"]
    return ("speed", *roles) if "speed" in one.series and "speed" in other.series else ()


@dataclass(frozen=True, eq=False)
class Course:
    """Speed and torques of a recording at the samples of the speed, by time, whatever the order and number of its rows."""

    at: Array  # [s]
    values: Array  # in units of `SAME_MPS` and `SAME_NM`, the speed first, shape (roles, n)
    order: Indices  # samples by their `_keys`
    keys: Array  # in that order

    @classmethod
    def of(cls, recording: Recording, roles: Sequence[str]) -> Course:
        """The course of a recording that has these roles, the speed first."""
        at, speed = ordered(recording.series["speed"], recording.start_ns)
        values = [speed / SAME_MPS]
        for role in roles[1:]:
            its_at, torque = ordered(recording.series[role], recording.start_ns)
            values.append(np.concatenate(([np.nan], torque))[np.searchsorted(its_at, at, side="right")] / SAME_NM)
        keys = _keys(np.array(values))
        order = np.argsort(keys, kind="stable")
        return cls(at, np.array(values), order, keys[order])

    @property
    def spacing(self) -> float:
        """Usual time between two samples [s]."""
        return float(np.median(np.diff(self.at))) if len(self.at) > 1 else np.inf

    def probes(self) -> Indices:
        """Samples from each piece of driving at a changing speed, shape (pieces, PROBES)."""
        rows = np.arange(0, len(self.at), max(1, round(PROBE_EVERY_S / self.spacing)))
        speed, known = self.values[0, rows], np.isfinite(self.values[:, rows]).all(axis=0)
        rows = rows[known & (np.abs(np.diff(speed, prepend=np.nan)) > SAME) & (np.abs(speed) > SAME)]
        if not len(rows):
            return np.empty((0, PROBES), np.intp)
        driven = np.cumsum(np.minimum(np.diff(self.at[rows], prepend=-np.inf), LONGEST_STEP_S))
        ends = np.searchsorted(driven, np.arange(0.0, driven[-1], PIECE_S))
        return np.asarray(rows[np.linspace(ends[:-1], ends[1:] - 1, PROBES, axis=1).astype(np.intp)])

    def lacks(self, at: Array, values: Array) -> Mask:
        """At which of some times there is no sample with these values, shape (times,)."""
        after = np.clip(np.searchsorted(self.at, at), 1, len(self.at) - 1)
        nearest = after - (at - self.at[after - 1] < self.at[after] - at)
        apart = np.abs(self.values[:, nearest] - values[:, None])
        return np.asarray((np.abs(self.at[nearest] - at) > 2.0 * SAME_S) | ~(apart <= SAME).all(axis=0))


def same_drive(one: Course, other: Course) -> bool:
    """Whether two recordings have equal speeds, and torques if any, at times the same distance apart, but for rounding.

    That holds for all samples since their starts, or for `PIECES` pieces of driving. A constant speed in a part is no proof.
    Nor is an equal speed with another torque: a driving cycle may be driven or simulated twice.
    """
    in_step = len(one.at) == len(other.at) > 0 and np.allclose(one.at, other.at, 0.0, SAME_S)
    whole = in_step and np.allclose(one.values, other.values, 0.0, SAME, equal_nan=True)
    few, many = (one, other) if one.spacing >= other.spacing else (other, one)  # a copy may have fewer samples
    return whole or (len(few.at) > 1 and len(many.at) > 1 and _has_pieces(few, few.probes(), many))


def _has_pieces(few: Course, probes: Indices, many: Course) -> bool:
    """Whether another course has `PIECES` pieces in a row.

    The rarest probe of a piece gives possible shifts of time, the others are looked up after the shift.
    """
    values = few.values[:, probes]
    reach = SAME * float(_keys(np.ones((len(values), 1)))[0])
    first = np.searchsorted(many.keys, _keys(values) - reach)
    behind = np.searchsorted(many.keys, _keys(values) + reach, side="right")
    found = behind > first
    count = np.where(found, behind - first, len(many.at) + 1)
    likely = found.mean(axis=1) >= 1.0 - 2.0 * MOST_MISSED
    for piece in range(len(probes) - PIECES + 1):
        if not likely[piece : piece + PIECES].all():
            continue
        rarest = int(np.argmin(count[piece]))
        alike = many.order[first[piece, rarest] : behind[piece, rarest]]
        alike = alike[(np.abs(many.values[:, alike] - values[:, piece, rarest, None]) <= SAME).all(axis=0)]
        shift, missed = many.at[alike] - few.at[probes[piece, rarest]], np.zeros(len(alike))
        for number, probe in enumerate(probes[piece : piece + PIECES].T.ravel()):
            missed += many.lacks(few.at[probe] + shift, few.values[:, probe])
            possible = missed <= 1.0 + MOST_MISSED * number
            shift, missed = shift[possible], missed[possible]
            if not len(shift):
                break
        if len(shift):
            return True
    return False


def _keys(values: Array) -> Array:
    """One number for the values of each sample, which hardly any other sample has; shape of `values` without its first axis."""
    return np.asarray(np.tensordot(np.sqrt(np.arange(1.0, len(values) + 1.0)), values, axes=1))

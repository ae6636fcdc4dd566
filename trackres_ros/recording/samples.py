# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines samples in SI and in log order: the blocks that a source is read in, the series of one role, and findings."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import TopicBinding, Topics

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SampleBlock:
    """A run of samples in log order; all arrays have the same length n."""

    role: NDArray[np.int16]  # index into the `roles` of the source, shape (n,)
    # time of measurement, and time of logging [ns]. In a table both are the time column, shape (n,)
    stamp_ns: IntArray
    arrival_ns: IntArray
    value: FloatArray  # value in the unit of the role; NaN for a message that could not be decoded, shape (n,)

    def __len__(self) -> int:
        return len(self.role)


def standing_time(standing_s: FloatArray, name: str) -> float:
    """Standing time before a recording [s] by its samples of the role `stood`, nan without any; `name` is the recording's.

    Raises InputError for a negative one.
    """
    finite_s = standing_s[np.isfinite(standing_s)]
    if len(finite_s) and finite_s[0] < 0.0:
        raise InputError(f"{name}: stood", f"{finite_s[0]:g} s", "0 s or more", "give the time since the previous drive ended")
    return float(finite_s[0]) if len(finite_s) else np.nan


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault or an oddity of the samples of one role."""

    # role ("" for the whole recording), and kind: see `trackres_ros.recording.recording.findings_of`
    role: str
    kind: str
    count: int  # number of samples
    # first occurrence [s], of a replay from its first row, as its time_s, else from the first valid speed; NaN without a place
    first_time_s: float
    text: str  # one sentence for the user


class Source(Protocol):
    """Source of samples: a bag or a table, read in blocks so that memory does not grow."""

    @property
    def name(self) -> str:
        """Name for reports: the path."""

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles in the order that `SampleBlock.role` counts."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Guesses, used stamps and ignored channels."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of reading itself, of the last `blocks` run, such as malformed messages."""

    @property
    def torque_candidates(self) -> tuple[str, ...]:
        """Columns or topics that are not read and may hold a torque."""

    @property
    def zero_is_unset(self) -> bool:
        """Whether stamp 0 means "never set" (bags); in a table it is the time 0 s."""

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """Read from the beginning, in log order, at most `max_rows` samples at a time."""


class BoundSource(Source, Protocol):
    """A source with the origin of each of its roles, and the lines of the topics file that it uses."""

    @property
    def topics(self) -> Topics | None:
        """The topics file without the lines of roles that the source does not use."""

    @property
    def bindings(self) -> Mapping[str, TopicBinding]:
        """By role."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """All samples of one role, in log order; arrays as in `SampleBlock`."""

    stamp_ns: IntArray
    arrival_ns: IntArray
    value: FloatArray

    def __len__(self) -> int:
        return len(self.value)


def set_stamps(samples: Series, delay_ns: int = 0) -> IntArray:
    """Stamps [ns], shape (n,); one that was never set is the log time, as far off as the last set one, as in the estimate.

    `delay_ns`: of the role, as without any set stamp none has it.
    """
    rows, unset_rows = np.arange(len(samples)), samples.stamp_ns == 0
    if not unset_rows.any():
        return samples.stamp_ns
    offsets_ns = np.append(samples.stamp_ns - samples.arrival_ns, -delay_ns)
    first_row = -1 if unset_rows.all() else int(np.argmin(unset_rows))
    last = np.maximum.accumulate(np.where(unset_rows, first_row, rows))
    return np.where(unset_rows, samples.arrival_ns + offsets_ns[last], samples.stamp_ns)


def first_valid(samples: Series | SampleBlock, rows: NDArray[np.bool_], zero_is_unset: bool) -> tuple[int, int] | None:
    """Stamp and arrival [ns] of the first finite value among some rows, shape (n,); a stamp that was never set is the arrival."""
    valid_rows = rows & np.isfinite(samples.value)
    if not valid_rows.any():
        return None
    stamp_ns, arrival_ns = (int(times[np.argmax(valid_rows)]) for times in (samples.stamp_ns, samples.arrival_ns))
    return arrival_ns if zero_is_unset and not stamp_ns else stamp_ns, arrival_ns

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What was recorded: samples by role in SI, in log order, and what was found wrong with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from trackres_ros.text.html import listed, panel, table
from trackres_ros.text.numbers import figures

if TYPE_CHECKING:
    from trackres_ros.recording.bindings import TopicBinding, Topics

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOVING_MPS, DROP_SAMPLES = 0.5, 3
"""A drop to 0 counts where the samples on both sides are faster [m/s], and it is short; assumed: above the noise of a
standing wheel, and shorter than any stop, even where each sample is published twice or thrice."""
OFFSET_NS = 500_000_000
"""Header stamps this far from log time are another clock, not a delay [ns]; assumed, above any transport delay."""
GAP_NS = 1_000_000_000
GAP_FACTOR = 10
"""A gap is longer than both a second and ten median steps; assumed: what a belt's temperature would feel."""
STUCK_NS = 60_000_000_000
"""A changing quantity does not keep one value this long [ns]; assumed."""
SAME_LEVEL = 1e-6
"""Levels closer than this share of the largest are one, but for rounding, of float32 too."""
GRID_TOLERANCE = 1e-3
"""How far a step may be from a whole number of quanta [quanta]; float32 in km/h needs 1e-5."""


@dataclass(frozen=True, slots=True)
class Role:
    """What a kind of input means.

    Attributes
    ----------
    unit : str
        Unit of its values inside the program.
    text : str
        What it is.
    parts : bool
        Whether it may be given for each axle or assembly (``load/front``).
    lively : bool
        Whether a moving vehicle changes it all the time, so that a constant value means a stuck sensor.
    """

    unit: str
    text: str
    parts: bool = False
    lively: bool = False


ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "speed": Role("m/s", "forward speed of the vehicle", lively=True),
        "load": Role("N", "weight carried by the tracks, total or of an axle or assembly", parts=True),
        "torque": Role("Nm", "measured torque at the sprockets, whole vehicle or of an assembly", parts=True, lively=True),
        "ambient": Role("degC", "temperature of the air"),
        "belt": Role("degC", "measured temperature of the rubber belt", parts=True),
        "accel": Role("m/s2", "acceleration along the track, without the share of gravity", lively=True),
        "grade": Role("1", "slope as rise over run, positive uphill"),
        "yaw_rate": Role("rad/s", "turning rate about the upward axis", lively=True),
        "heading": Role("rad", "direction of travel about the upward axis"),
        "distance": Role("m", "distance travelled"),
    }
)


def base_role(role: str) -> str:
    """Return the role without its axle or assembly: ``load`` of ``load/front``."""
    return role.partition("/")[0]


@dataclass(frozen=True, slots=True)
class Block:
    """A run of samples in log order; all arrays have the same length n.

    Attributes
    ----------
    role : ndarray of int16, shape (n,)
        Index into the `roles` of the source.
    stamp_ns, arrival_ns : ndarray of int64, shape (n,)
        Time of measurement, and time of logging [ns]. In a table both are the time column.
    value : ndarray of float64, shape (n,)
        Value in the unit of the role; NaN for a message that could not be decoded.
    """

    role: NDArray[np.int16]
    stamp_ns: IntArray
    arrival_ns: IntArray
    value: FloatArray

    def __len__(self) -> int:
        return len(self.role)


@dataclass(frozen=True, slots=True)
class Finding:
    """Something wrong, or worth knowing, about the samples of one role.

    Attributes
    ----------
    role, kind : str
        Which role ("" for the whole recording), and what: see `trackres_ros.recording.recording.findings_of`.
    count : int
        How many samples.
    first_time_s : float
        Where it was first seen, from the start of the recording [s]; NaN where it has no place.
    text : str
        One sentence for the user.
    """

    role: str
    kind: str
    count: int
    first_time_s: float
    text: str


class Source(Protocol):
    """Where samples come from: a bag or a table, read in blocks so that memory does not grow."""

    @property
    def name(self) -> str:
        """Name for reports: the path."""

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles in the order that `Block.role` counts."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was guessed, which stamps are used, what is ignored."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What reading itself met, of the last `blocks` run: malformed messages, for one."""

    @property
    def zero_is_unset(self) -> bool:
        """Whether stamp 0 means "never set" (bags); in a table it is the time 0 s."""

    def blocks(self, max_rows: int = 65536) -> Iterator[Block]:
        """Read from the beginning, in log order, at most `max_rows` samples at a time."""


@dataclass(frozen=True, slots=True)
class Series:
    """All samples of one role, in log order; arrays as in `Block`."""

    stamp_ns: IntArray
    arrival_ns: IntArray
    value: FloatArray

    def __len__(self) -> int:
        return len(self.value)


@dataclass(frozen=True, slots=True, repr=False)
class Recording:
    """A recording in memory; it is a `Source` too, and gives its samples in the order in which they were read.

    Attributes
    ----------
    name : str
        Where it is from.
    series : mapping of role to Series
        Every role of the source, also those without a sample.
    notes : tuple of str
        What was guessed and which stamps are used.
    findings : tuple of Finding
        What was found wrong.
    zero_is_unset : bool
        See `Source`.
    order : ndarray of int16, shape (samples of all roles,), optional
        Index into `roles` of each sample in the order of the log; by time of logging without it, speed last.
    paths : tuple of Path
        The files it was read from.
    bindings : mapping of role to TopicBinding
        Which topic or column each role was read from.
    topics : Topics, optional
        The topics file that was named.
    """

    name: str
    series: Mapping[str, Series]
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    zero_is_unset: bool = True
    order: NDArray[np.int16] | None = None
    paths: tuple[Path, ...] = ()
    bindings: Mapping[str, TopicBinding] = field(default_factory=dict)
    topics: Topics | None = None

    @classmethod
    def from_source(cls, source: Source) -> Recording:
        """Read a source to its end and look at what came.

        Parameters
        ----------
        source : Source
            A bag or a table.

        Raises
        ------
        InputError
            What the source cannot read.
        """
        parts: list[list[tuple[IntArray, IntArray, FloatArray]]] = [[] for _ in source.roles]
        order = [np.empty(0, np.int16)]
        for block in source.blocks():
            order.append(block.role)
            for index, part in enumerate(parts):
                rows = np.flatnonzero(block.role == index)
                if rows.size == len(block):
                    part.append((block.stamp_ns, block.arrival_ns, block.value))
                elif rows.size:
                    part.append((block.stamp_ns[rows], block.arrival_ns[rows], block.value[rows]))
        series = {role: _joined(part) for role, part in zip(source.roles, parts, strict=True)}
        start_ns = _start_ns(series, source.zero_is_unset)
        found = [*source.findings]
        for role, samples in series.items():
            found += findings_of(role, samples, start_ns, source.zero_is_unset)
        read = MappingProxyType(series)
        return cls(source.name, read, source.notes, tuple(found), source.zero_is_unset, np.concatenate(order))

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles in the order that `order` counts."""
        return tuple(self.series)

    def blocks(self, max_rows: int = 65536) -> Iterator[Block]:
        """All samples once more, in the order of the log; see `Source`."""
        order = self._by_arrival() if self.order is None else self.order
        place = np.empty(len(order), np.intp)  # of each sample among those of its role
        for index in range(len(self.series)):
            rows = np.flatnonzero(order == index)
            place[rows] = np.arange(len(rows))
        for start in range(0, len(order), max_rows):
            role, at = order[start : start + max_rows], place[start : start + max_rows]
            stamp_ns, arrival_ns, value = np.empty(len(role), np.int64), np.empty(len(role), np.int64), np.empty(len(role))
            for index, samples in enumerate(self.series.values()):
                rows = np.flatnonzero(role == index)
                stamp_ns[rows] = samples.stamp_ns[at[rows]]
                arrival_ns[rows] = samples.arrival_ns[at[rows]]
                value[rows] = samples.value[at[rows]]
            yield Block(role, stamp_ns, arrival_ns, value)

    def _by_arrival(self) -> NDArray[np.int16]:
        """Samples by their time of logging, and speed last among those logged at once."""
        roles = [index for index, _ in sorted(enumerate(self.series), key=lambda pair: pair[1] == "speed")]
        of = list(self.series.values())
        arrival = np.concatenate([of[index].arrival_ns for index in roles])
        return np.repeat(np.array(roles, np.int16), [len(of[index]) for index in roles])[np.argsort(arrival, kind="stable")]

    @property
    def start_ns(self) -> int:
        """Stamp of time 0: the first of speed that is set, or of the first role with samples [ns]."""
        return _start_ns(self.series, self.zero_is_unset)

    def time_s(self, role: str) -> FloatArray:
        """Return the stamps of a role from the start of the recording [s], shape (n,)."""
        return _seconds(self.series[role].stamp_ns - self.start_ns)

    def aligned(self) -> dict[str, FloatArray]:
        """Hold every role on the samples of speed.

        Returns
        -------
        dict of str to ndarray, each of the shape of speed
            ``time_s`` and every role: the last finite value that had been logged when the sample of speed was,
            never a later one; NaN before the first. Speed itself is left as it is.
        """
        speed = self.series["speed"]
        clock = _clock(speed.arrival_ns)
        held: dict[str, FloatArray] = {"time_s": self.time_s("speed"), "speed": speed.value}
        for role, samples in self.series.items():
            if role == "speed":
                continue
            finite = np.isfinite(samples.value)
            last = np.searchsorted(_clock(samples.arrival_ns[finite]), clock, side="right")
            held[role] = np.concatenate(([np.nan], samples.value[finite]))[last]
        return held

    def __repr__(self) -> str:
        return "\n".join(self.report())

    def _repr_html_(self) -> str:
        rows = [(role, *_measures(samples), ROLES[base_role(role)].unit) for role, samples in self.series.items()]
        notes = [f"{role}: {text}" if role else text for role, text in self._findings()]
        return panel(
            f"Recording {self.name}",
            table(("role", "samples", "rate [Hz]", "least", "greatest", "unit"), rows),
            listed("Found", notes),
            listed("Notes", self.notes, folded=True),
        )

    def _findings(self) -> Iterator[tuple[str, str]]:
        """Role and text of each finding, with where it was first."""
        for finding in self.findings:
            first = f" (first at {finding.first_time_s:.2f} s)" if np.isfinite(finding.first_time_s) else ""
            yield finding.role, finding.text + first

    def report(self) -> list[str]:
        """Return lines of text: what is there, what was assumed, and what was found wrong."""
        lines = [f"Recording {self.name}"]
        for role, samples in self.series.items():
            lines.append(f"  {role} [{ROLES[base_role(role)].unit}]: {_summary(samples)}")
        if self.notes:
            lines += ["Notes", *(f"  {note}" for note in self.notes)]
        if self.findings:
            lines.append("Found")
        return [*lines, *(f"  {role}: {text}" if role else f"  {text}" for role, text in self._findings())]


def findings_of(role: str, samples: Series, start_ns: int, zero_is_unset: bool = True) -> list[Finding]:
    """Look at one role and say what is wrong with it.

    Parameters
    ----------
    role : str
        Its name; the unit and what is normal depend on it.
    samples : Series
        Its samples in log order.
    start_ns : int
        Start of the recording [ns].
    zero_is_unset : bool
        Whether stamp 0 means "never set".

    Returns
    -------
    list of Finding
        Kinds: ``empty``, ``non_finite``, ``zero_stamp``, ``duplicate_stamp``, ``backward_stamp``, ``stamp_offset``,
        ``gap``, ``quantised``, ``stuck``, ``dropout``.
    """
    unit, lively = ROLES[base_role(role)].unit, ROLES[base_role(role)].lively
    finite = np.isfinite(samples.value)
    if not finite.any():
        text = "no sample at all" if not len(samples) else f"none of {len(samples)} values is finite"
        return [Finding(role, "empty", len(samples), float("nan"), text)]
    found: list[Finding] = []

    def note(kind: str, at: NDArray[np.intp], text: str) -> None:
        if at.size:
            first, clock = int(at[0]), samples.stamp_ns
            begin = start_ns
            if kind == "zero_stamp":
                clock, begin = samples.arrival_ns, int(samples.arrival_ns[0])
            found.append(Finding(role, kind, int(at.size), (int(clock[first]) - begin) / 1e9, text))

    bad = np.flatnonzero(~finite)
    note("non_finite", bad, f"{bad.size} values are not finite")
    unset = np.flatnonzero(samples.stamp_ns == 0) if zero_is_unset else bad[:0]
    note("zero_stamp", unset, f"{unset.size} stamps are zero: never set")
    _look_at_stamps(samples, note)
    value = samples.value[finite]
    runs = np.flatnonzero(np.concatenate(([True], value[1:] != value[:-1])))
    step = _quantum(value, runs)
    if step:
        repeats = 1.0 - len(runs) / len(value)
        text = f"values come in steps of {_step_text(step, unit)}; {repeats:.0%} repeat the one before"
        note("quantised", np.flatnonzero(finite)[:1], text)
    if lively:
        _look_for_stuck(samples, np.flatnonzero(finite), runs, note)
    if base_role(role) == "speed":
        _look_for_drops(samples, note)
    return found


class _Note(Protocol):
    def __call__(self, kind: str, at: NDArray[np.intp], text: str) -> None: ...


def _look_at_stamps(samples: Series, note: _Note) -> None:
    """Note duplicate and backward stamps, gaps, and an offset from log time; zero stamps are another matter."""
    rows = np.flatnonzero(samples.stamp_ns != 0)
    if not rows.size:
        return
    stamp = samples.stamp_ns[rows]
    step = np.diff(stamp)
    same, back = np.flatnonzero(step == 0), np.flatnonzero(step < 0)
    note("duplicate_stamp", rows[same + 1], f"{same.size} stamps equal the one before")
    if back.size:
        text = f"{back.size} stamps lie before the one before, by up to {_span(int(-step[back].min()))}"
        note("backward_stamp", rows[back + 1], text)
    offset = int(np.median(stamp - samples.arrival_ns[rows]))
    if abs(offset) > OFFSET_NS:
        side = "before" if offset < 0 else "after"
        note("stamp_offset", rows, f"header stamps lie {_span(abs(offset))} {side} log time (median)")
    forward = step[step > 0]
    if forward.size:
        limit = max(GAP_NS, GAP_FACTOR * int(np.median(forward)))
        gaps = np.flatnonzero(step > limit)
        if gaps.size:
            text = f"{gaps.size} gaps longer than {_span(limit)}, the longest {_span(int(step[gaps].max()))}"
            note("gap", rows[gaps], text)


def _look_for_stuck(samples: Series, rows: NDArray[np.intp], runs: NDArray[np.intp], note: _Note) -> None:
    """Note runs of one non-zero value that last longer than `STUCK_NS`; `runs` are their starts among `rows`."""
    last = np.append(runs[1:], len(rows)) - 1
    lasting = samples.stamp_ns[rows[last]] - samples.stamp_ns[rows[runs]]
    stuck = (lasting > STUCK_NS) & (samples.value[rows[runs]] != 0.0)
    if stuck.any():
        at = np.flatnonzero(np.repeat(stuck, last - runs + 1))
        longest = _span(int(lasting[stuck].max()))
        text = f"{int(stuck.sum())} times one non-zero value for more than 60 s, at most {longest}"
        note("stuck", rows[at], text)


def _look_for_drops(samples: Series, note: _Note) -> None:
    """Note where speed is exactly 0 for a sample or a few, and moving right before and after."""
    zero = np.concatenate(([False], samples.value == 0.0, [False]))
    start, stop = np.flatnonzero(zero[1:] & ~zero[:-1]), np.flatnonzero(zero[:-1] & ~zero[1:])
    inside = (start > 0) & (stop < len(samples)) & (stop - start <= DROP_SAMPLES)
    start, stop = start[inside], stop[inside]
    moving = (np.abs(samples.value[start - 1]) > MOVING_MPS) & (np.abs(samples.value[stop]) > MOVING_MPS)
    at = start[moving]
    note("dropout", at, f"{at.size} times it drops to exactly 0 for {DROP_SAMPLES} samples or fewer while moving")


def _quantum(value: FloatArray, runs: NDArray[np.intp]) -> float:
    """Return the step a sensor quantises to, or 0.

    All values lie on one grid, and either most values last for several samples or the same few come again and
    again; a steady ramp of a computed profile does neither.
    """
    levels = np.unique(value)
    if len(levels) < 3 or len(value) < 20:
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > SAME_LEVEL * np.abs(levels).max()]
    if len(steps) < 2:
        return 0.0
    step = float(steps.min())
    ratio = steps / step
    if float(np.abs(ratio - np.rint(ratio)).max()) > GRID_TOLERANCE:
        return 0.0
    lasting = float(np.median(np.diff(np.append(runs, len(value)))))
    return step if lasting >= 2.0 or len(runs) >= 4 * len(steps) else 0.0


def _joined(parts: list[tuple[IntArray, IntArray, FloatArray]]) -> Series:
    if not parts:
        return Series(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    stamp_ns, arrival_ns, value = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Series(stamp_ns, arrival_ns, value)


def _start_ns(series: Mapping[str, Series], zero_is_unset: bool) -> int:
    for role in sorted(series, key=lambda role: role != "speed"):
        stamp_ns = series[role].stamp_ns
        if stamp_ns.size:
            return int(stamp_ns[np.argmax(stamp_ns != 0) if zero_is_unset else 0])
    return 0


def _clock(arrival_ns: IntArray) -> IntArray:
    """Log time that never runs backward, as it may where one bag follows another."""
    return np.maximum.accumulate(arrival_ns) if arrival_ns.size else arrival_ns


def _seconds(span_ns: IntArray) -> FloatArray:
    return span_ns / 1e9


def _span(span_ns: int) -> str:
    """Return a span of time in the unit a reader would choose."""
    for size, unit in ((86400e9, "days"), (3600e9, "h"), (60e9, "min"), (1e9, "s"), (1e6, "ms")):
        if span_ns >= (2 if unit in ("h", "min") else 1) * size:
            return f"{figures(span_ns / size)} {unit}"
    return f"{span_ns} ns"


def _step_text(step: float, unit: str) -> str:
    return f"{figures(step, 4)} m/s ({figures(step * 3.6)} km/h)" if unit == "m/s" else f"{figures(step, 4)} {unit}"


def _measures(samples: Series) -> tuple[str, str, str, str]:
    """Number of samples, rate [Hz], least and greatest value; a text is empty where there is none."""
    finite = samples.value[np.isfinite(samples.value)]
    if not finite.size:
        return str(len(samples)), "", "", ""
    steps = np.diff(samples.stamp_ns)
    median = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    rate = figures(1e9 / median, 4) if median else ""
    return str(len(samples)), rate, figures(finite.min(), 6), figures(finite.max(), 6)


def _summary(samples: Series) -> str:
    count, rate, low, high = _measures(samples)
    if not low:
        return f"{count} samples, none with a value"
    return f"{count} samples{f' at {rate} Hz' if rate else ''}, {low} to {high}"

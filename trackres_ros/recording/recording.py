# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds a recording in memory: every role's samples in SI, in log order, with their defects and what its wheels show."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trackres_ros.recording.roles import ROLES, base_role
from trackres_ros.recording.samples import Finding, FloatArray, IntArray, SampleBlock, Series, Source, first_valid, set_stamps
from trackres_ros.text import figures, html_table, listed, number_of, panel

if TYPE_CHECKING:
    from trackres_ros.recording.bindings import TopicBinding, Topics

MOVING_MPS, DROP_SAMPLES = 0.5, 3
"""A short drop to 0 is a dropout where the samples on both sides are faster [m/s]; assumed: above the noise of a
standing wheel, and shorter than any stop, even where each sample is published twice or thrice."""
OFFSET_NS = 500_000_000
"""Header stamps this far from log time are another clock, not a delay [ns]; assumed, above any transport delay."""
GAP_NS = 1_000_000_000
GAP_FACTOR = 10
"""A gap is longer than both a second and ten median steps; assumed: it affects a belt's temperature."""
STUCK_NS = 60_000_000_000
"""A changing quantity does not keep one value this long [ns]; assumed."""
SAME_LEVEL = 1e-6
"""Levels closer than this share of the largest are one, but for rounding, of float32 too."""
GRID_TOLERANCE = 1e-3
"""How far a step may be from a whole number of quanta [quanta]; float32 in km/h needs 1e-5."""


def findings_of(role: str, samples: Series, start: tuple[int, int], zero_is_unset: bool) -> list[Finding]:
    """Find the defects of one role: kinds ``empty``, ``non_finite``, ``zero_stamp``, ``duplicate_stamp``, ``backward_stamp``,
    ``stamp_jump``, ``stamp_offset``, ``gap``, ``quantised``, ``stuck``, ``dropout``.

    `role`: the unit and the normal range depend on it; `samples`: in log order; `start`: stamp and arrival [ns] of
    the first valid speed; `zero_is_unset`: whether stamp 0 means "never set".
    """
    unit, is_lively = ROLES[base_role(role)].unit, ROLES[base_role(role)].is_lively
    is_finite = np.isfinite(samples.value)
    if not is_finite.any():
        text = "no sample at all" if not len(samples) else f"none of {len(samples)} values is finite"
        return [Finding(role, "empty", len(samples), float("nan"), text)]
    findings: list[Finding] = []

    def note(kind: str, rows_at_fault: NDArray[np.intp], text: str) -> None:
        if rows_at_fault.size:
            of_log = zero_is_unset and not samples.stamp_ns[rows_at_fault[0]]
            clock = samples.arrival_ns if of_log else samples.stamp_ns
            findings.append(
                Finding(role, kind, int(rows_at_fault.size), (int(clock[rows_at_fault[0]]) - start[of_log]) / 1e9, text)
            )

    bad_rows = np.flatnonzero(~is_finite)
    note("non_finite", bad_rows, f"{number_of(bad_rows.size, 'value is', 'values are')} not finite")
    unset_rows = np.flatnonzero(samples.stamp_ns == 0) if zero_is_unset else bad_rows[:0]
    note("zero_stamp", unset_rows, f"{number_of(unset_rows.size, 'stamp is', 'stamps are')} zero (never set)")
    _look_at_stamps(samples, np.flatnonzero(samples.stamp_ns != 0) if zero_is_unset else np.arange(len(samples)), note)
    value = samples.value[is_finite]
    runs = np.flatnonzero(np.concatenate(([True], value[1:] != value[:-1])))
    step = _quantum(value, runs)
    if step:
        repeat_share = 1.0 - len(runs) / len(value)
        text = f"values are quantised in steps of {_step_text(step, unit)}; {repeat_share:.0%} repeat the previous one"
        note("quantised", np.flatnonzero(is_finite)[:1], text)
    if is_lively:
        _look_for_stuck(
            samples, np.flatnonzero(is_finite), runs, set_stamps(samples) if zero_is_unset else samples.stamp_ns, note
        )
    if base_role(role) == "speed":
        _look_for_drops(samples, note)
    return findings


class _Note(Protocol):
    def __call__(self, kind: str, rows_at_fault: NDArray[np.intp], text: str) -> None: ...


def _look_at_stamps(samples: Series, rows: NDArray[np.intp], note: _Note) -> None:
    """Note duplicate and backward stamps, gaps, jumps ahead of log time, and an offset from it; `rows` are those whose stamp was
    set.
    """
    if not rows.size:
        return
    stamp = samples.stamp_ns[rows]
    step = np.diff(stamp)
    equal_rows, back = np.flatnonzero(step == 0), np.flatnonzero(step < 0)
    note(
        "duplicate_stamp", rows[equal_rows + 1], f"{number_of(equal_rows.size, 'stamp equals', 'stamps equal')} the previous one"
    )
    if back.size:
        count_text, largest_step = number_of(back.size, "stamp is", "stamps are"), _span(int(-step[back].min()))
        text = f"{count_text} earlier than the previous one, by up to {largest_step}"
        note("backward_stamp", rows[back + 1], text)
    offset = int(np.median(stamp - samples.arrival_ns[rows]))
    if abs(offset) > OFFSET_NS:
        side = "before" if offset < 0 else "after"
        note("stamp_offset", rows, f"header stamps are {_span(abs(offset))} {side} log time (median)")
    forward = step[step > 0]
    if forward.size:
        limit = max(GAP_NS, GAP_FACTOR * int(np.median(forward)))
        arrival_steps = np.diff(samples.arrival_ns[rows])
        excess = step - arrival_steps
        jumps = np.flatnonzero((step > limit) & (excess > limit))
        if jumps.size:
            jump_text, largest_step = number_of(jumps.size, "stamp jumps", "stamps jump"), _span(int(excess[jumps].max()))
            note("stamp_jump", rows[jumps], f"{jump_text} ahead of log time, by up to {largest_step}")
        effective_steps = np.where(excess > limit, arrival_steps, step)
        gaps = np.flatnonzero((step > limit) & (effective_steps > limit))
        if gaps.size:
            text = (
                f"{number_of(gaps.size, 'gap')} longer than {_span(limit)}, the longest {_span(int(effective_steps[gaps].max()))}"
            )
            note("gap", rows[gaps], text)


def _look_for_stuck(samples: Series, rows: NDArray[np.intp], runs: NDArray[np.intp], stamp_ns: IntArray, note: _Note) -> None:
    """Note runs of one non-zero value that last longer than `STUCK_NS`; `runs` are their starts among `rows`."""
    last = np.append(runs[1:], len(rows)) - 1
    run_ns = stamp_ns[rows[last]] - stamp_ns[rows[runs]]
    is_stuck = (run_ns > STUCK_NS) & (samples.value[rows[runs]] != 0.0)
    if is_stuck.any():
        stuck_rows = np.flatnonzero(np.repeat(is_stuck, last - runs + 1))
        longest_span = _span(int(run_ns[is_stuck].max()))
        text = f"{number_of(int(is_stuck.sum()), 'period')} with one non-zero value for more than 60 s, at most {longest_span}"
        note("stuck", rows[stuck_rows], text)


def _look_for_drops(samples: Series, note: _Note) -> None:
    """Note where speed is exactly 0 for a sample or a few, and moving right before and after."""
    zero = np.concatenate(([False], samples.value == 0.0, [False]))
    start, stop = np.flatnonzero(zero[1:] & ~zero[:-1]), np.flatnonzero(zero[:-1] & ~zero[1:])
    is_drop = (start > 0) & (stop < len(samples)) & (stop - start <= DROP_SAMPLES)
    start, stop = start[is_drop], stop[is_drop]
    is_moving = (np.abs(samples.value[start - 1]) > MOVING_MPS) & (np.abs(samples.value[stop]) > MOVING_MPS)
    drop_rows = start[is_moving]
    note(
        "dropout",
        drop_rows,
        f"{number_of(drop_rows.size, 'dropout')} to exactly 0 for {DROP_SAMPLES} samples or fewer while moving",
    )


def _quantum(value: FloatArray, runs: NDArray[np.intp]) -> float:
    """Return the step a sensor quantises to, or 0.

    All values are on one grid, and either most values last for several samples or the same few recur;
    a steady ramp of a computed profile does neither.
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
    run_length = float(np.median(np.diff(np.append(runs, len(value)))))
    return step if run_length >= 2.0 or len(runs) >= 4 * len(steps) else 0.0


def _span(span_ns: int) -> str:
    """Return a span of time in the unit a reader would choose."""
    for size, unit in ((86400e9, "days"), (3600e9, "h"), (60e9, "min"), (1e9, "s"), (1e6, "ms")):
        if span_ns >= (2 if unit in ("h", "min") else 1) * size:
            return f"{figures(span_ns / size)} {unit}"
    return f"{span_ns} ns"


def _step_text(step: float, unit: str) -> str:
    return f"{figures(step, 4)} m/s ({figures(step * 3.6)} km/h)" if unit == "m/s" else f"{figures(step, 4)} {unit}"


SLOWEST_MPS = 2.0  # below it pulses of a wheel come too slowly
STRAIGHT_RAD = 0.05  # of steering: wheels at the outside of a turn have a longer way
STRAIGHT_RADPS = 0.03  # of turning, without a recorded steering
PIECES, FEWEST_EACH = 8, 30
SURE = 3.0  # standard deviations
KNM = 1e3  # Nm


@dataclass(frozen=True, slots=True)
class Wheel:
    """One wheel against the vehicle."""

    name: str  # as in the role
    # its speed over that of the vehicle without torque, and its standard deviation: the wheel rolls on its nominal radius over
    # the ratio
    ratio: float
    ratio_std: float
    # relative excess of its speed over the vehicle's, per kNm of torque on all wheels; nan without a recorded torque
    slip: float
    slip_std: float


def wheels(aligned_series: Mapping[str, FloatArray]) -> tuple[Wheel, ...]:
    """Wheel ratios and slips of a recording, if it drives straight for long enough.

    `aligned_series`: roles on the samples of the speed, from `Recording.aligned`.

    Notes
    -----
    The speed v_w of a wheel is fitted by r v + k v T + tau a by least squares. These are the ratio r, the slip k by torque T, and
    the delay tau between the two speeds with acceleration a, which would otherwise look like slip. Standard deviations
    are those between consecutive pieces of the recording.
    """
    time, speed = aligned_series["time_s"], aligned_series["speed"]
    roles = [role for role in aligned_series if base_role(role) == "wheel_speed"]
    if not roles or len(time) < PIECES * FEWEST_EACH:
        return ()
    step = np.gradient(time)
    is_usable = np.isfinite(speed) & (np.abs(speed) > SLOWEST_MPS) & (step > 0.0)
    if "steering_angle" in aligned_series:
        is_usable &= np.abs(aligned_series["steering_angle"]) < STRAIGHT_RAD
    elif "yaw_rate" in aligned_series:
        is_usable &= np.abs(aligned_series["yaw_rate"]) < STRAIGHT_RADPS
    accel = np.gradient(speed) / np.where(step > 0.0, step, np.nan)
    columns = [speed, accel]
    if "torque" in aligned_series and np.nanmax(np.abs(aligned_series["torque"]), initial=0.0) > 0.0:
        columns.append(speed * aligned_series["torque"] / KNM)
        is_usable &= np.isfinite(aligned_series["torque"])
    return tuple(
        wheel
        for role in roles
        if (wheel := _fit_wheel(role.partition("/")[2] or role, np.stack(columns, axis=1), aligned_series[role], is_usable))
        is not None
    )


def _fit_wheel(name: str, columns: FloatArray, rim: FloatArray, is_usable: np.ndarray) -> Wheel | None:
    rows = np.flatnonzero(is_usable & np.isfinite(rim) & np.isfinite(columns).all(axis=1))
    pieces = [piece for piece in np.array_split(rows, PIECES) if len(piece) >= FEWEST_EACH]
    if len(pieces) < PIECES:
        return None
    solution = np.linalg.lstsq(columns[rows], rim[rows], rcond=None)[0]
    piece_solutions = np.array([np.linalg.lstsq(columns[piece], rim[piece], rcond=None)[0] for piece in pieces])
    std = np.std(piece_solutions, axis=0, ddof=1) / np.sqrt(len(pieces))
    slip, slip_std = (float(solution[2]), float(std[2])) if len(solution) > 2 else (np.nan, np.nan)
    return Wheel(name, float(solution[0]), float(std[0]), slip, slip_std)


def driven_wheels(wheels: Sequence[Wheel]) -> dict[str, tuple[float, float]]:
    """Wheels that surely turn faster under torque than the one with the least slip, by how much per kNm, and its std.

    That one rolls freely, or slips least: the vehicle's own speed may be that of the driven wheels.
    """
    if any(np.isnan(wheel.slip) for wheel in wheels):
        return {}
    free_wheel = min(wheels, key=lambda wheel: wheel.slip)
    slips = {wheel.name: (wheel.slip - free_wheel.slip, float(np.hypot(wheel.slip_std, free_wheel.slip_std))) for wheel in wheels}
    return {name: (slip, std) for name, (slip, std) in slips.items() if slip > SURE * std}


def wheel_notes(aligned_series: Mapping[str, FloatArray]) -> list[str]:
    """Radii and slip of the wheels, a sentence each; empty if none is recorded for long enough."""
    wheel_list = wheels(aligned_series)
    if not wheel_list:
        return []
    ratios = ", ".join(f"{wheel.name} {wheel.ratio:.4f} +- {wheel.ratio_std:.4f}" for wheel in wheel_list)
    notes = [f"wheel speed over vehicle speed, straight on without torque (divide each radius by it): {ratios}"]
    slipping = driven_wheels(wheel_list)
    if slipping:
        slip_list = ", ".join(f"{name} {slip:.3%} +- {std:.3%}" for name, (slip, std) in slipping.items())
        free_wheel, largest_slip = min(wheel_list, key=lambda wheel: wheel.slip), max(slip for slip, _ in slipping.values())
        text = f"wheels that turn faster than {free_wheel.name} under torque, with their slip per kNm: {slip_list}"
        is_behind = free_wheel.slip < -0.5 * largest_slip  # its speed is closer to that of the slipping wheels
        notes.append(f"{text}; the vehicle's speed has the same slip" if is_behind else text)
    return notes


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Recording:
    """A recording in memory; also a `Source` that yields its samples in the order of reading.

    Attributes
    ----------
    name : str
        Name of the source.
    series : mapping of role to Series
        Samples by role, including roles without a sample; arrays are read-only.
    notes : tuple of str
        Guesses and the stamps in use.
    findings : tuple of Finding
        Defects of the recording.
    zero_is_unset : bool
        See `Source`.
    order : ndarray of int16, shape (samples of all roles,), optional
        Index into `roles` of each sample in log order; without it the order is by log time, speed last. Where log
        time steps back in every role that has not ended, a new stretch begins.
    paths : tuple of Path
        The files it was read from.
    bindings : mapping of role to TopicBinding
        Topic or column of each role.
    topics : Topics, optional
        The lines of the topics file that it uses.
    torque_candidates : tuple of str
        Unused columns or topics that may hold a torque.
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
    torque_candidates: tuple[str, ...] = ()

    @classmethod
    def from_source(cls, source: Source) -> Recording:
        """Read a source to its end, and find defects in its samples. Raises InputError for content that it cannot read."""
        blocks = list(source.blocks())
        series = {role: _series_of(blocks, index) for index, role in enumerate(source.roles)}
        findings = (*source.findings, *_defects(series.__getitem__, source))
        return cls(
            source.name,
            MappingProxyType(series),
            source.notes,
            findings,
            source.zero_is_unset,
            np.concatenate([np.empty(0, np.int16), *(block.role for block in blocks)]),
            torque_candidates=source.torque_candidates,
        )

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles in the order of `order`."""
        return tuple(self.series)

    def without(self, hidden_roles: Collection[str]) -> Recording:
        """The recording without some roles; a role hides those of its axles and assemblies too."""
        shown_series = {
            role: s for role, s in self.series.items() if role not in hidden_roles and base_role(role) not in hidden_roles
        }
        if self.order is None:
            return replace(self, series=shown_series)
        numbers = np.array([list(shown_series).index(role) if role in shown_series else -1 for role in self.series], np.int16)[
            self.order
        ]
        return replace(self, series=shown_series, order=numbers[numbers >= 0])

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """All samples again, in the order of the log, at most `max_rows` at a time."""
        order = self.log_order()
        place = np.empty(len(order), np.intp)  # of each sample among those of its role
        for index in range(len(self.series)):
            rows = np.flatnonzero(order == index)
            place[rows] = np.arange(len(rows))
        for start in range(0, len(order), max_rows):
            role, places = order[start : start + max_rows], place[start : start + max_rows]
            stamp_ns, arrival_ns, value = np.empty(len(role), np.int64), np.empty(len(role), np.int64), np.empty(len(role))
            for index, samples in enumerate(self.series.values()):
                rows = np.flatnonzero(role == index)
                stamp_ns[rows] = samples.stamp_ns[places[rows]]
                arrival_ns[rows] = samples.arrival_ns[places[rows]]
                value[rows] = samples.value[places[rows]]
            yield SampleBlock(role, stamp_ns, arrival_ns, value)

    def log_order(self) -> NDArray[np.int16]:
        """Index into `roles` of each sample in log order, shape (samples of all roles,): `order`; without it by log time, stretch
        by stretch between its steps back, and speed last of those at once.
        """
        if self.order is not None:
            return self.order
        roles = [index for index, _ in sorted(enumerate(self.series), key=lambda pair: pair[1] == "speed")]
        log_times = [samples.arrival_ns for samples in (list(self.series.values())[index] for index in roles)]
        in_turn = np.lexsort((np.concatenate(log_times), np.concatenate(_stretches(log_times))))
        return np.repeat(np.array(roles, np.int16), [len(times) for times in log_times])[in_turn]

    @property
    def start_ns(self) -> int:
        """Stamp of time 0 [ns]: the earliest valid one of speed, or of the first role with samples."""
        first_role = next((r for r in sorted(self.series, key=lambda role: role != "speed") if len(self.series[r])), "")
        return int(_stamps(self, first_role).min()) if first_role else 0

    def time_s(self, role: str) -> FloatArray:
        """Return the stamps of a role from the start of the recording [s], shape (n,).

        Parameters
        ----------
        role : str
            One of `roles`.

        Returns
        -------
        ndarray of float64, shape (n,)
            Times [s]; 0 is `start_ns`.
        """
        return (_stamps(self, role) - self.start_ns) / 1e9

    def aligned(self) -> dict[str, FloatArray]:
        """Resample every role to the samples of speed, by sample and hold.

        Returns
        -------
        dict of str to ndarray, each of the shape of speed
            ``time_s`` and every role: the last finite value logged before the sample of speed, or at the
            same time, never a later one; NaN before the first. Speed itself is unchanged.
        """
        order = self.log_order()
        arrival_ns = np.empty(len(order), np.int64)
        for index, samples in enumerate(self.series.values()):
            arrival_ns[order == index] = samples.arrival_ns
        turn = np.cumsum(np.diff(arrival_ns, prepend=arrival_ns[:1]) != 0)  # in the log, which may begin anew; one at one time
        turns = {role: turn[order == index] for index, role in enumerate(self.series)}
        aligned_series: dict[str, FloatArray] = {"time_s": self.time_s("speed"), "speed": self.series["speed"].value.copy()}
        for role, samples in self.series.items():
            if role == "speed":
                continue
            is_finite = np.isfinite(samples.value)
            last = np.searchsorted(turns[role][is_finite], turns["speed"], side="right")
            aligned_series[role] = np.concatenate(([np.nan], samples.value[is_finite]))[last]
        return aligned_series

    def __repr__(self) -> str:
        return "\n".join(self.report())

    def _repr_html_(self) -> str:
        rows = [(role, *_measures(self, role), ROLES[base_role(role)].unit) for role in self.series]
        notes = [f"{role}: {text}" if role else text for role, text in self._findings()]
        return panel(
            f"Recording {self.name}",
            html_table(("role", "samples", "rate [Hz]", "least", "greatest", "unit"), rows),
            listed("Found", notes),
            listed("Notes", [*self.notes, *self.wheel_notes()], folded=True),
        )

    def wheel_notes(self, roles: Collection[str] | None = None) -> list[str]:
        """Rolling radii and slip from recorded wheel speeds, a sentence each; empty if no wheel is recorded for long enough.

        `roles`: the roles to use; all of them by default.
        """
        used_roles = set(self.series if roles is None else roles)
        if not any(base_role(role) == "wheel_speed" for role in used_roles):
            return []
        return wheel_notes({role: values for role, values in self.aligned().items() if role in used_roles | {"time_s"}})

    def _findings(self) -> Iterator[tuple[str, str]]:
        """Role and text of each finding, with its first time."""
        for finding in self.findings:
            first_time = f" (first at {finding.first_time_s:.2f} s)" if np.isfinite(finding.first_time_s) else ""
            yield finding.role, finding.text + first_time

    def report(self) -> list[str]:
        """Report contents, assumptions and defects, one line each.

        Returns
        -------
        list of str
            Lines of text.
        """
        lines = [f"Recording {self.name}"]
        lines += [f"  {role} [{ROLES[base_role(role)].unit}]: {_summary(self, role)}" for role in self.series]
        notes = [*self.notes, *self.wheel_notes()]
        if notes:
            lines += ["Notes", *(f"  {note}" for note in notes)]
        if self.findings:
            lines.append("Found")
        return [*lines, *(f"  {role}: {text}" if role else f"  {text}" for role, text in self._findings())]


def _stretches(log_times: Sequence[IntArray]) -> list[IntArray]:
    """How often the log began anew before each sample, from the log times of each role.

    It began anew where all roles step back together. Roles may end before, and are then in the first stretch. Else a step
    back is a sample out of turn.
    """
    steps = [np.diff(times, prepend=times[:1]) < 0 for times in log_times]
    spans = [(times[np.roll(back, -1)], times[back]) for times, back in zip(log_times, steps, strict=True)]
    last, first_times = spans[-1]  # log times before and after each step of the last role
    is_restart = all(
        ((latest > first_times) & (earliest < last)).all()
        if len(latest) == len(last)
        else not len(latest) and (times <= last[0]).all()
        for times, (latest, earliest) in zip(log_times, spans, strict=True)
    )
    return [np.cumsum(back & is_restart) for back in steps]


def with_stamps(recording: Recording) -> Recording:
    """The recording with stamps that are all set, see `set_stamps`."""
    return replace(recording, series={r: replace(s, stamp_ns=_stamps(recording, r)) for r, s in recording.series.items()})


def _stamps(recording: Recording, role: str) -> IntArray:
    """Stamps of a role [ns], all of them set."""
    samples, delay_ns = recording.series[role], recording.bindings[role].delay_ns if role in recording.bindings else 0
    return set_stamps(samples, delay_ns) if recording.zero_is_unset else samples.stamp_ns


def topics_in_use(recordings: Sequence[Recording]) -> Topics | None:
    """The lines of topics files that recordings use; a role has the line of the first one that names it."""
    topics_given = [recording.topics for recording in recordings if recording.topics]
    lines = {role: line for topics in reversed(topics_given) for role, line in topics.bindings.items()}
    return replace(topics_given[0], bindings=MappingProxyType(lines)) if topics_given else None


def _series_of(blocks: Sequence[SampleBlock], index: int) -> Series:
    """The samples of one role."""
    rows = [block.role == index for block in blocks]

    def join(name: str, kind: type) -> NDArray[Any]:
        parts = (getattr(block, name)[block_rows] for block, block_rows in zip(blocks, rows, strict=True))
        column = np.concatenate([np.empty(0, kind), *parts])
        column.setflags(write=False)
        return column

    return Series(join("stamp_ns", np.int64), join("arrival_ns", np.int64), join("value", np.float64))


def defects_of(blocks: Sequence[SampleBlock], source: Source) -> tuple[Finding, ...]:
    """Defects of the samples of a source; joins one role after another, as all together may be large."""
    return tuple(_defects(lambda role: _series_of(blocks, source.roles.index(role)), source))


def _defects(series: Callable[[str], Series], source: Source) -> Iterator[Finding]:
    """Defects by role, of the stamps as recorded, without a `delay_s`.

    Their times begin at the first valid speed, which may not have the earliest stamp.
    """
    start, bindings = (0, 0), getattr(source, "bindings", {})
    for role in sorted(source.roles, key=lambda role: role == "speed"):
        samples = series(role)
        start = first_valid(samples, np.ones(len(samples), np.bool_), source.zero_is_unset) or start
    for role in source.roles:
        samples = series(role)
        if role in bindings and bindings[role].delay_ns:
            unset_rows = source.zero_is_unset & (samples.stamp_ns == 0)
            samples = replace(samples, stamp_ns=np.where(unset_rows, 0, samples.stamp_ns + bindings[role].delay_ns))
        yield from findings_of(role, samples, start, source.zero_is_unset)


def _measures(recording: Recording, role: str) -> tuple[str, str, str, str]:
    """Number of samples, rate [Hz], least and greatest value of a role; empty texts without samples."""
    samples = recording.series[role]
    finite_values = samples.value[np.isfinite(samples.value)]
    if not finite_values.size:
        return str(len(samples)), "", "", ""
    steps = np.diff(_stamps(recording, role))
    median = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    rate = figures(1e9 / median, 4) if median else ""
    return str(len(samples)), rate, figures(finite_values.min(), 6), figures(finite_values.max(), 6)


def _summary(recording: Recording, role: str) -> str:
    count, rate, lowest, highest = _measures(recording, role)
    if not lowest:
        return f"{count} samples, none with a value"
    return f"{count} samples{f' at {rate} Hz' if rate else ''}, {lowest} to {highest}"

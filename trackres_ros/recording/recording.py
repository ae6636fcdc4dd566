# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds a recording in memory: every role's samples in SI, in log order, with their defects."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.recording.quality import findings_of
from trackres_ros.recording.roles import ROLES, base_role
from trackres_ros.recording.samples import Finding, FloatArray, IntArray, SampleBlock, Series, Source, first_valid, set_stamps
from trackres_ros.recording.wheels import wheel_notes
from trackres_ros.text import figures, html_table, listed, panel

if TYPE_CHECKING:
    from trackres_ros.recording.binding import TopicBinding
    from trackres_ros.recording.bindings import Topics


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
        found = (*source.findings, *_defects(series.__getitem__, source))
        return cls(
            source.name,
            MappingProxyType(series),
            source.notes,
            found,
            source.zero_is_unset,
            np.concatenate([np.empty(0, np.int16), *(block.role for block in blocks)]),
            torque_candidates=source.torque_candidates,
        )

    @property
    def roles(self) -> tuple[str, ...]:
        """Roles in the order of `order`."""
        return tuple(self.series)

    def without(self, hidden: Collection[str]) -> Recording:
        """The recording without some roles; a role hides those of its axles and assemblies too."""
        shown = {role: s for role, s in self.series.items() if role not in hidden and base_role(role) not in hidden}
        if self.order is None:
            return replace(self, series=shown)
        numbers = np.array([list(shown).index(role) if role in shown else -1 for role in self.series], np.int16)[self.order]
        return replace(self, series=shown, order=numbers[numbers >= 0])

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """All samples again, in the order of the log, at most `max_rows` at a time."""
        order = self.log_order()
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
            yield SampleBlock(role, stamp_ns, arrival_ns, value)

    def log_order(self) -> NDArray[np.int16]:
        """Index into `roles` of each sample in log order, shape (samples of all roles,): `order`; without it by log time, stretch
        by stretch between its steps back, and speed last of those at once.
        """
        if self.order is not None:
            return self.order
        roles = [index for index, _ in sorted(enumerate(self.series), key=lambda pair: pair[1] == "speed")]
        logged = [samples.arrival_ns for samples in (list(self.series.values())[index] for index in roles)]
        in_turn = np.lexsort((np.concatenate(logged), np.concatenate(_stretches(logged))))
        return np.repeat(np.array(roles, np.int16), [len(one) for one in logged])[in_turn]

    @property
    def start_ns(self) -> int:
        """Stamp of time 0 [ns]: the earliest valid one of speed, or of the first role with samples."""
        first = next((r for r in sorted(self.series, key=lambda role: role != "speed") if len(self.series[r])), "")
        return int(_stamps(self, first).min()) if first else 0

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
        held: dict[str, FloatArray] = {"time_s": self.time_s("speed"), "speed": self.series["speed"].value.copy()}
        for role, samples in self.series.items():
            if role == "speed":
                continue
            finite = np.isfinite(samples.value)
            last = np.searchsorted(turns[role][finite], turns["speed"], side="right")
            held[role] = np.concatenate(([np.nan], samples.value[finite]))[last]
        return held

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
        used = set(self.series if roles is None else roles)
        if not any(base_role(role) == "wheel_speed" for role in used):
            return []
        return wheel_notes({role: values for role, values in self.aligned().items() if role in used | {"time_s"}})

    def _findings(self) -> Iterator[tuple[str, str]]:
        """Role and text of each finding, with its first time."""
        for finding in self.findings:
            first = f" (first at {finding.first_time_s:.2f} s)" if np.isfinite(finding.first_time_s) else ""
            yield finding.role, finding.text + first

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


def _stretches(logged: Sequence[IntArray]) -> list[IntArray]:
    """How often the log began anew before each sample, from the log times of each role.

    It began anew where all roles step back together. Roles may end before, and are then in the first stretch. Else a step
    back is a sample out of turn.
    """
    steps = [np.diff(one, prepend=one[:1]) < 0 for one in logged]
    spans = [(one[np.roll(back, -1)], one[back]) for one, back in zip(logged, steps, strict=True)]
    last, first = spans[-1]  # log times before and after each step of the last role
    anew = all(
        ((high > first) & (low < last)).all() if len(high) == len(last) else not len(high) and (one <= last[0]).all()
        for one, (high, low) in zip(logged, spans, strict=True)
    )
    return [np.cumsum(back & anew) for back in steps]


def stamped(recording: Recording) -> Recording:
    """The recording with stamps that are all set, see `set_stamps`."""
    return replace(recording, series={r: replace(s, stamp_ns=_stamps(recording, r)) for r, s in recording.series.items()})


def _stamps(recording: Recording, role: str) -> IntArray:
    """Stamps of a role [ns], all of them set."""
    samples, delay_ns = recording.series[role], recording.bindings[role].delay_ns if role in recording.bindings else 0
    return set_stamps(samples, delay_ns) if recording.zero_is_unset else samples.stamp_ns


def topics_in_use(recordings: Sequence[Recording]) -> Topics | None:
    """The lines of topics files that recordings use; a role has the line of the first one that names it."""
    given = [recording.topics for recording in recordings if recording.topics]
    lines = {role: line for topics in reversed(given) for role, line in topics.bindings.items()}
    return replace(given[0], bindings=MappingProxyType(lines)) if given else None


def _series_of(blocks: Sequence[SampleBlock], index: int) -> Series:
    """The samples of one role."""
    rows = [block.role == index for block in blocks]

    def joined(name: str, kind: type) -> NDArray[Any]:
        parts = (getattr(block, name)[at] for block, at in zip(blocks, rows, strict=True))
        column = np.concatenate([np.empty(0, kind), *parts])
        column.setflags(write=False)
        return column

    return Series(joined("stamp_ns", np.int64), joined("arrival_ns", np.int64), joined("value", np.float64))


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
            unset = source.zero_is_unset & (samples.stamp_ns == 0)
            samples = replace(samples, stamp_ns=np.where(unset, 0, samples.stamp_ns + bindings[role].delay_ns))
        yield from findings_of(role, samples, start, source.zero_is_unset)


def _measures(recording: Recording, role: str) -> tuple[str, str, str, str]:
    """Number of samples, rate [Hz], least and greatest value of a role; empty texts without samples."""
    samples = recording.series[role]
    finite = samples.value[np.isfinite(samples.value)]
    if not finite.size:
        return str(len(samples)), "", "", ""
    steps = np.diff(_stamps(recording, role))
    median = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    rate = figures(1e9 / median, 4) if median else ""
    return str(len(samples)), rate, figures(finite.min(), 6), figures(finite.max(), 6)


def _summary(recording: Recording, role: str) -> str:
    count, rate, low, high = _measures(recording, role)
    if not low:
        return f"{count} samples, none with a value"
    return f"{count} samples{f' at {rate} Hz' if rate else ''}, {low} to {high}"

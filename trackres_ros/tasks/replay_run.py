# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Feeds a recording through the estimator into a table or bag, and a picture. The same messages give the same bits, here and
live.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.disturbance import DisturbanceWatch
from trackres_ros.estimator.drives import by_column
from trackres_ros.estimator.energy import DriveTotals, StepTimes
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.records import Steps
from trackres_ros.estimator.snapshot import read_learning, rest_session, resume
from trackres_ros.files.output_files import BAG_SUFFIX
from trackres_ros.learning.columns import LearningColumns, column_names
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.store import LearnedFile, since_saved
from trackres_ros.node.measured_torque import MismatchSettings
from trackres_ros.output.bag import OutputBag
from trackres_ros.output.preview import ResultPreview
from trackres_ros.output.table import TableWriter
from trackres_ros.recording.recording import defects_of
from trackres_ros.recording.roles import GROUND, POSITION, base_role
from trackres_ros.recording.samples import Finding, SampleBlock, Source, first_valid, standing_time
from trackres_ros.tasks.replay_comparison import TorqueTotals
from trackres_ros.units import NANOSECOND
from trackres_ros.vehicle import AnyVehicle

BLOCK_ROWS = 8192  # results of so many messages stay in the cache and in memory already had
MOST_KEPT = 10_000_000
"""Samples kept for inspection, a quarter of a gigabyte; ten hours of three channels at 50 Hz are half as many. The inspection
takes 0.2 GB more with four roles, 0.8 GB with one."""
THERE, TORQUE = "disturbance_probability", "disturbance_torque_nm"
MEANING = MappingProxyType(
    {
        THERE: "probability that a spell of the vehicle file's `disturbance` is present; nan for a drift",
        TORQUE: "its estimated torque against travel [Nm], from the previous 5 s blocks; no other column includes it",
    }
)
TIME_RESET, CLOCK_JUMPED = int(at.Reason.TIME_RESET), int(at.Reason.CLOCK_JUMPED)
LOOKED_AT = [at.Results.residual_nm, at.Results.speed_mps, at.Results.accel_mps2, at.Results.reasons]


class KeptSource:
    """A source that passes another on, and keeps its blocks on request, to search them for defects afterwards."""

    def __init__(self, source: Source, keep: bool) -> None:
        self._source, self._keep = source, keep
        self._stored_blocks: list[SampleBlock] = []
        self._over_limit = False
        self.name, self.roles = source.name, source.roles
        self.zero_is_unset = source.zero_is_unset
        self.torque_candidates = source.torque_candidates

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the reader; see `Source`."""
        return self._source.notes

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of reading itself."""
        if not self._over_limit:
            return self._source.findings
        text = f"more than {MOST_KEPT} samples: gaps, stuck and quantised values are not searched"
        return (*self._source.findings, Finding("", "too_long", 1, float("nan"), text))

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """Blocks of the source."""
        self._stored_blocks.clear()
        samples = 0
        for block in self._source.blocks(max_rows):
            samples += len(block)
            if self._keep and samples > MOST_KEPT:
                self._stored_blocks.clear()
                self._keep, self._over_limit = False, True
            if self._keep:
                self._stored_blocks.append(block)
            yield block

    def all_findings(self) -> tuple[Finding, ...]:
        """Defects of the samples; only those of reading if the blocks were not kept."""
        return (*self.findings, *defects_of(self._stored_blocks, self._source)) if self._keep else self.findings


@dataclass(frozen=True, eq=False)
class Replayed:
    """Result of a replay: the session at the end, and the data of the picture and the report."""

    session: Session
    messages: int
    steps: int
    totals: DriveTotals
    counts: tuple[tuple[str, at.Count, int], ...]  # of these messages alone, as `Session.counts`
    reasons: Mapping[at.Reason, int]  # of these steps
    picture: Array  # (samples, 1 + columns): time [s] and results, thinned
    last: Array  # last row of results
    late_s: float  # from the first valid speed, which may be refused, to the first row
    learner: Learner | None = None
    learned_file: LearnedFile | None = None  # that it was asked to write
    comparison: Mapping[str, Any] | None = None  # the error as a diagnosis compares it, where it was asked for


def channel_indices(session: Session, roles: Sequence[str], learns: bool = False) -> NDArray[np.int16]:
    """Channel of each role of a source, shape (roles,); -1 of an unneeded role, such as one of the ground without learning.

    Raises InputError for a role of an axle or assembly that the vehicle does not have.
    """
    channels = session.estimator.channels
    foreign = [role for role in roles if role not in channels and base_role(role) in at.CHANNELS]
    if foreign:
        raise at.not_of_vehicle(foreign[0], channels)
    idle = {*(() if session.estimator.vehicle.route else POSITION), *(() if learns else GROUND)}
    in_use = [role in channels and role not in idle for role in roles]
    return np.array([session.channel(r) if n else -1 for r, n in zip(roles, in_use, strict=True)], dtype=np.int16)


class Resumed(NamedTuple):
    """What a recording continues."""

    session: Session
    off_s: float | None  # its standing time, 0 if it has none; None in the same stream
    learned: Any  # plain values of the state file, with their time by the clock of the recording; None without any
    unlearned_s: float | None  # see `store.since_saved`


def resumed(source: Source, estimator: Estimator, path: Path) -> Resumed:
    """Go on from a state file: in the same stream, or after time off where the times of a source begin before its end.

    Raises
    ------
    InputError
        As `snapshot.resume`; if the source cannot be read, or its standing time is negative.
    """
    session, first, learned = resume(estimator, path), next(source.blocks(BLOCK_ROWS), None), read_learning(estimator, path)
    last, jump = at.Times(session.memory.times[at.SPEED]), estimator.constants.number.clock_jump_ns
    if first is None or not last.seen:
        return Resumed(session, None, learned, None)
    off_s = None
    if min(last.last_stamp - first.stamp_ns[0], last.last_arrival - first.arrival_ns[0]) > jump:
        of_stood = [role == "stood" for role in source.roles]
        off_s = standing_time(first.value[np.array(of_stood)[first.role]], source.name)
        off_s = 0.0 if math.isnan(off_s) else off_s
        session = rest_session(session, off_s)
    end_s, begin_s = int(last.last_arrival) * NANOSECOND, int(first.arrival_ns[0]) * NANOSECOND
    return Resumed(session, off_s, *since_saved(path, learned, end_s, begin_s, off_s))


def replay(
    source: Source,
    estimator: Estimator,
    write: Callable[[Steps], None] | None = None,
    session: Session | None = None,
    progress: Callable[[float], None] | None = None,
    learner: Learner | None = None,
    torques: TorqueTotals | None = None,
) -> Replayed:
    """Feed a source through a session, block by block: memory does not grow with the recording.

    Parameters
    ----------
    write
        Takes the results of each block.
    session
        A session to continue; by default a new one.
    progress
        Takes the number of messages of each block.
    learner
        Learns from each step, as live; its columns then follow those of the estimate.
    torques
        Takes the results of each block, with the times of their steps.

    Raises
    ------
    InputError
        If the source holds no usable speed, or cannot be read.
    """
    session = session or estimator.session()
    channel_of = channel_indices(session, source.roles, learner is not None)
    not_needed = bool((channel_of < 0).any())
    names = () if learner is None else column_names(learner.learnables)
    preview, totals = ResultPreview(len(estimator.columns) + len(names)), DriveTotals(estimator.vehicle)
    times = StepTimes(estimator.settings)
    counters, reasons = session.memory.counters.copy(), session.memory.reasons.copy()  # of earlier recordings
    handle_block = session.handle_block if learner is None else LearningSteps(session, learner).handle_block

    def take(steps: Steps) -> None:
        if len(steps):
            step_s = times.step_times(steps)
            totals.add(step_s, by_column(estimator, steps.rows))
            if torques is not None:
                torques.add(step_s, steps.rows)
        preview.take(steps, write)

    messages, start = 0, None
    with ThreadPoolExecutor(max_workers=1) as worker:  # the kernel releases the interpreter: reading continues meanwhile
        pending: Future[Steps] | None = None
        for block in source.blocks(BLOCK_ROWS):
            messages += len(block)
            start = start or first_valid(block, block.role == source.roles.index("speed"), source.zero_is_unset)
            channel = channel_of[block.role]
            if not_needed:
                rows = channel >= 0
                channel = channel[rows]
                block = SampleBlock(block.role[rows], block.stamp_ns[rows], block.arrival_ns[rows], block.value[rows])
            last, pending = pending, worker.submit(handle_block, channel, block.stamp_ns, block.arrival_ns, block.value)
            if last:
                take(last.result())
            if progress:
                progress(len(block))
        if pending:
            take(pending.result())
    counts = tuple(session.counts(counters))
    if not preview.steps:
        refusals = ", ".join(f"{name} {count.name.lower()} {number}" for name, count, number in counts)
        faults = [finding.text for finding in source.findings if finding.role in ("speed", "") and finding.count]
        raise InputError(
            source.name,
            f"{messages} messages, but no usable speed ({'; '.join([refusals, *faults]).strip('; ') or 'no message'})",
            "at least one finite, plausible speed",
            "check topic or channel, field, scale and unit of the speed",
        )
    reason_counts = session.reason_counts(reasons)
    late_s = (preview.first_ns - start[0]) * NANOSECOND if start else 0.0
    return Replayed(
        session, messages, preview.steps, totals, counts, reason_counts, preview.samples, preview.last, late_s, learner
    )


class LearningSteps:
    """Takes messages as `Session.handle_block` does, but lets a learner look at each step before the next one, as live."""

    def __init__(self, session: Session, learner: Learner) -> None:
        self._session, self._learner = session, learner
        self._columns = LearningColumns(learner)

    def handle_block(
        self, channel: NDArray[np.int16], stamp_ns: NDArray[np.int64], arrival_ns: NDArray[np.int64], value: Array
    ) -> Steps:
        """Process many messages; the columns of the learner follow those of each step."""
        session, learner = self._session, self._learner
        rows, stamps, arrivals = [], [], []
        for message in zip(channel.tolist(), stamp_ns.tolist(), arrival_ns.tolist(), value.tolist(), strict=True):
            estimate = session.feed(*message)
            if estimate is None:
                continue
            row, of_speed = estimate.row.tolist(), at.Times(session.memory.times[at.SPEED])
            stamp = int(of_speed.last_stamp)
            learner.take(stamp, row, session)
            rows.append([*row, *self._columns.row_values(row, session)])
            stamps.append(stamp)
            arrivals.append(int(of_speed.last_arrival))
        width = len(session.estimator.columns) + len(column_names(learner.learnables))
        table = np.array(rows, dtype=float).reshape(-1, width)
        return Steps(np.array(stamps, dtype=np.int64), np.array(arrivals, dtype=np.int64), table)


class DisturbanceColumns:
    """Takes the results of a replay block by block, in their order; has no columns without a disturbance to watch for."""

    def __init__(self, vehicle: AnyVehicle) -> None:
        self._watch = None if vehicle.disturbance is None else DisturbanceWatch(vehicle.disturbance)
        self.names: tuple[str, ...] = () if self._watch is None else tuple(MEANING)

    def of(self, steps: Steps) -> list[Array]:
        """The columns of a block, each of shape (steps,)."""
        watch, compares = self._watch, MismatchSettings().compares
        if watch is None:
            return []
        columns = np.empty((len(self.names), len(steps)))
        times, rows = (steps.stamp_ns.tolist(), steps.arrival_ns.tolist()), steps.rows[:, LOOKED_AT].tolist()
        for i, (stamp, arrival, (residual, speed, accel, reasons)) in enumerate(zip(*times, rows, strict=True)):
            if int(reasons) & TIME_RESET:
                watch.restart()
            counts = compares(speed, accel)
            jumped = bool(int(reasons) & CLOCK_JUMPED)
            belief = watch.take(stamp, residual if counts else math.nan, speed, stamp - arrival, jumped)
            columns[:, i] = belief.there, belief.torque_nm
        return list(columns)


@contextmanager
def result_writer(path: Path, estimator: Estimator, learner: Learner | None = None) -> Iterator[Callable[[Steps], None]]:
    """A writer for the kind of file a path names: `.mcap` as topics, `.csv`, `.csv.gz`, `.parquet` or `.mf4` as a table."""
    if path.suffix.lower() == BAG_SUFFIX:
        with OutputBag(path, estimator, learner) as bag:
            yield bag.write
        return
    disturbance = DisturbanceColumns(estimator.vehicle)
    learned = () if learner is None else column_names(learner.learnables)
    names = ["time_s", "stamp_ns", *estimator.columns, *learned, *disturbance.names]
    with TableWriter(path, names, estimates=True) as table:
        first: list[int] = []

        def write(steps: Steps) -> None:
            first[:] = first or [int(steps.stamp_ns[0])]
            columns = [(steps.stamp_ns - first[0]) * NANOSECOND, steps.stamp_ns]
            table.write_columns([*columns, *(steps.rows[:, i] for i in range(steps.rows.shape[1])), *disturbance.of(steps)])

        yield write

"""Recording -> estimator -> table or bag, and a picture. The same messages give the same bits, here and live."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.csvs import TableWriter
from trackres_ros.errors import InputError
from trackres_ros.estimator import layout as at
from trackres_ros.estimator.estimator import Estimator, Session, Steps
from trackres_ros.estimator.settings import Settings
from trackres_ros.output_bag import OutputBag
from trackres_ros.recording import Source
from trackres_ros.topics import Topics

Array = NDArray[np.float64]

BAG_SUFFIX = ".mcap"
PICTURE_SAMPLES = 8000       # kept for the picture; twice as many are thinned to half
NANOSECOND = 1e-9


@dataclass(frozen=True, eq=False)
class Replayed:
    """What a replay gave: the session with its counters, and what the picture and the report need."""

    session: Session
    messages: int
    steps: int
    duration_s: float
    picture: Array               # (samples, 1 + columns): time [s] and results, thinned
    last: Array                  # last row of results
    reasons: dict[at.Reason, int]  # steps at which each reason held


def settings_for(settings: Settings, topics: Topics | None) -> Settings:
    """Settings with what the topics file says of the belt sensor."""
    belts = [topics[role] for role in topics if role.partition("/")[0] == "belt"] if topics else []
    if not belts:
        return settings
    kinds = {(belt.sensor, belt.std_k) for belt in belts}
    if len(kinds) > 1:
        raise InputError(f"{topics.origin if topics else ''}: belt", sorted(kinds), "one sensor and std_k for all belts")
    return replace(settings, belt_sensor=belts[0].sensor, belt_measured_std_k=belts[0].std_k)


def channel_indices(session: Session, roles: Sequence[str]) -> NDArray[np.int16]:
    """Channel of each role of a source, shape (roles,).

    Raises
    ------
    InputError
        For a role of an axle or assembly that the vehicle does not have.
    """
    channels = session.estimator.channels
    unknown = [role for role in roles if role not in channels]
    if unknown:
        vehicle = session.estimator.vehicle
        places = [name for name in channels if "/" in name]
        raise InputError(f"role {unknown[0]}", f"vehicle {vehicle.name}", f"{', '.join(at.CHANNELS)}, {', '.join(places)}")
    return np.array([session.channel(role) for role in roles], dtype=np.int16)


def replay(source: Source, estimator: Estimator, write: Callable[[Steps], None] | None = None,
           session: Session | None = None, progress: Callable[[float], None] | None = None) -> Replayed:
    """Feed a source through a session, block by block: memory does not grow with the recording.

    Parameters
    ----------
    write
        Takes the results of each block.
    session
        A session to go on with; by default a new one.
    progress
        Takes the number of messages of each block.

    Raises
    ------
    InputError
        If the source holds no usable speed, or cannot be read.
    """
    session = session or estimator.session()
    channel_of = channel_indices(session, source.roles)
    messages = steps = 0
    first_ns = last_ns = 0
    thinned = _Thinned(len(estimator.columns))
    reasons: dict[at.Reason, int] = {}
    last = np.empty(0)
    for block in source.blocks():
        result = session.handle_block(channel_of[block.role], block.stamp_ns, block.arrival_ns, block.value)
        messages += len(block)
        if progress:
            progress(len(block))
        if not len(result.rows):
            continue
        if not steps:
            first_ns = int(result.stamp_ns[0])
        steps += len(result.rows)
        last_ns, last = int(result.stamp_ns[-1]), result.rows[-1].copy()
        flags = result.rows[:, at.OUT_REASONS].astype(np.int64)
        for flag in np.unique(flags):
            for reason in at.Reason(int(flag)):
                reasons[reason] = reasons.get(reason, 0) + int(np.count_nonzero(flags == flag))
        thinned.add((result.stamp_ns - first_ns) * NANOSECOND, result.rows)
        if write:
            write(result)
    if not steps:
        refused = ", ".join(f"{name} {count.name.lower()} {number}" for name, count, number in session.counts())
        raise InputError(source.name, f"{messages} messages, none of them a usable speed ({refused or 'no message'})",
                         "at least one finite, plausible speed", "check topic, field, scale and unit of the speed")
    return Replayed(session, messages, steps, (last_ns - first_ns) * NANOSECOND, thinned.samples(), last, reasons)


@contextmanager
def result_writer(path: Path, estimator: Estimator) -> Iterator[Callable[[Steps], None]]:
    """A writer for the kind of file a path names: `.mcap` as topics, `.csv`, `.csv.gz` or `.parquet` as a table."""
    if path.suffix.lower() == BAG_SUFFIX:
        with OutputBag(path, estimator) as bag:
            yield bag.write
        return
    with TableWriter(path, ["time_s", "stamp_ns", *estimator.columns]) as table:
        first: list[int] = []

        def write(steps: Steps) -> None:
            first[:] = first or [int(steps.stamp_ns[0])]
            columns = [(steps.stamp_ns - first[0]) * NANOSECOND, steps.stamp_ns]
            table.write_columns([*columns, *(steps.rows[:, i] for i in range(steps.rows.shape[1]))])

        yield write


class _Thinned:
    """Every n-th sample, n doubling as they come, so that a picture of any length costs the same memory."""

    def __init__(self, columns: int) -> None:
        self._kept = np.empty((0, 1 + columns))
        self._stride, self._seen = 1, 0

    def add(self, time_s: NDArray[np.floating[Any]], rows: Array) -> None:
        chosen = np.arange(-self._seen % self._stride, len(time_s), self._stride)
        self._seen += len(time_s)
        self._kept = np.concatenate([self._kept, np.column_stack([time_s[chosen], rows[chosen]])])
        while len(self._kept) > 2 * PICTURE_SAMPLES:
            self._kept, self._stride = self._kept[::2], 2 * self._stride

    def samples(self) -> Array:
        return self._kept

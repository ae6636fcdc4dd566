# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Splits sessions into fitted and hold-out laps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.prepare.refuse import too_short_pieces
from trackres_ros.diagnosis.prepare.session import FEWEST_FITTED, MOST_LAGS, DriveSession, Split, whole_past
from trackres_ros.diagnosis.prepare.settings import SLOWEST_MPS
from trackres_ros.errors import InputError
from trackres_ros.recording.slopes import runs_of

FEWEST_SESSIONS = 4
HELD_OUT_SHARE = 0.25
FULL_STOP_S = 5.0
PIECES, SHORTEST_PIECE_S, LONGEST_PIECE_S = 20, 60.0, 300.0
FEWEST_DRIVES = 8


def split(sessions: Sequence[DriveSession], held_out: int | Sequence[str] | None = None) -> Split:
    """Choose the hold-out blocks: the last ones, or `held_out`.

    That is the number of the last sessions (of several) or blocks, or the names of recordings, or of laps as in a report
    ("drive_3.csv: 5"). With names, added recordings do not change the hold-out set. A part of a name holds out all recordings
    that have it, unless one is called so.

    Raises
    ------
    InputError
        If nothing, or too little, would remain to fit on, or a name is not among the recordings.
    """
    chosen = _chosen(sessions, held_out)
    rows = sum(int(whole_past(chosen.training_mask(s), MOST_LAGS).sum()) for s in sessions)
    if rows < FEWEST_FITTED:
        raise too_short_pieces(", ".join(s.name for s in sessions), sessions[0].step)
    return chosen


def _chosen(sessions: Sequence[DriveSession], held_out: int | Sequence[str] | None) -> Split:
    blocks = [sorted(set(s.block.tolist())) for s in sessions]
    by_session = len(sessions) >= FEWEST_SESSIONS or (isinstance(held_out, int) and held_out < len(sessions) > 1)
    if held_out is not None and not isinstance(held_out, int):
        laps = {lap_name(s, b): b for s, of in zip(sessions, blocks, strict=True) for b in of}
        by_name = {b for lap, b in laps.items() if any(lap == name if name in laps else lap.endswith(name) for name in held_out)}
        whole = [name for name in held_out if not any(lap.endswith(name) for lap in laps)]
        unknown = [name for name in whole if not any(name in s.name for s in sessions)]
        if unknown:
            raise InputError("--holdout", unknown[0], f"part of a name among {', '.join(s.name for s in sessions)}")
        called = [(s.name, PurePath(s.name).stem) for s in sessions]
        exact = {name for names in called for name in names}
        chosen = {i for i, names in enumerate(called) for name in whole if name in (names if name in exact else names[0])}
        if by_name:
            return _by_laps(sessions, blocks, by_name.union(*(blocks[i] for i in chosen)))
    elif by_session:
        count = held_out if isinstance(held_out, int) else max(1, round(HELD_OUT_SHARE * len(sessions)))
        chosen = set(range(len(sessions) - count, len(sessions)))
    else:
        return _last_laps(sessions, [b for of in blocks for b in of], held_out)
    training = tuple(b for i, of in enumerate(blocks) if i not in chosen for b in of)
    if not training or not chosen:
        allowed, lap = f"some, but not all, of the {len(sessions)} recordings", lap_name(sessions[-1], blocks[-1][-1])
        raise InputError("--holdout", held_out, allowed, f"or laps by name, such as '{lap}'")
    text = f"held out: {', '.join(sessions[i].name for i in sorted(chosen))}"
    return Split(training, tuple(b for i in sorted(chosen) for b in blocks[i]), text)


def lap_name(session: DriveSession, block: int) -> str:
    """A lap as in a report: the recording, and its number there."""
    return f"{session.name}: {block - session.block[0] + 1}"


def _last_laps(sessions: Sequence[DriveSession], laps: Sequence[int], held_out: int | None) -> Split:
    """Hold out so many of the last laps, by default a quarter; the last driven ones if the vehicle is parked in all of these."""
    compared = set(np.concatenate([s.block[s.used] for s in sessions]).tolist())
    end, parked = len(laps), ""
    count = max(1, round(HELD_OUT_SHARE * end)) if held_out is None else held_out
    if 0 < count < end and compared.isdisjoint(laps[-count:]):
        end = 1 + max((i for i, lap in enumerate(laps) if lap in compared), default=-1)
        count = max(1, round(HELD_OUT_SHARE * end)) if held_out is None else held_out
        parked = f", before {len(laps) - end} without a comparable torque"
    if not 0 < count < end:
        raise InputError("--holdout", count, f"1 to {end - 1} of the {end} laps or pieces")
    first = end - count
    return Split(tuple(laps[:first]), tuple(laps[first:]), f"the last {count} of {end} laps or pieces are held out{parked}")


def _by_laps(sessions: Sequence[DriveSession], blocks: Sequence[Sequence[int]], held_out: set[int]) -> Split:
    training = tuple(b for of in blocks for b in of if b not in held_out)
    if not training:
        raise InputError("--holdout", sorted(held_out), "some, but not all, of the laps")
    text = f"held out: {', '.join(lap_name(s, b) for s, of in zip(sessions, blocks, strict=True) for b in of if b in held_out)}"
    return Split(training, tuple(sorted(held_out)), text)


def lap_numbers(session: DriveSession) -> NDArray[np.int64]:
    """Number of the drive between two stops, or of a piece of equal length if there are few stops; shape (n,), from 0."""
    standing = np.abs(session.speed) < SLOWEST_MPS
    full_stop = FULL_STOP_S * session.pace
    cuts = [begin for begin, end in runs_of(standing) if begin > 0 and (end - begin) * session.step >= full_stop]
    if len(cuts) >= FEWEST_DRIVES - 1:
        return np.searchsorted(np.array(cuts), np.arange(len(session)), side="right").astype(np.int64)
    duration = len(session) * session.step
    length = min(max(duration / PIECES, SHORTEST_PIECE_S * session.pace), LONGEST_PIECE_S * session.pace)
    pieces = max(1, int(duration // length))
    return np.minimum((np.arange(len(session)) * pieces) // len(session), pieces - 1).astype(np.int64)

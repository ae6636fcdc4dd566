# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sorts recordings independently of their given order and names."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from trackres_ros.recording.recording import Recording
from trackres_ros.recording.samples import Series


def in_order(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings by their start; those with equal starts by their samples: of speed, then of the other roles.

    Recordings that all start at 0 s have no common clock. Their order is then arbitrary but reproducible: the
    hold-out set depends on it.
    """
    return sorted(recordings, key=lambda r: (r.start_ns, _digests(r), r.name))


def _digests(recording: Recording) -> list[str]:
    roles = sorted(recording.series, key=lambda role: (role != "speed", role))
    return [_digest(recording.series[role], recording.start_ns) for role in roles]


def _digest(series: Series, start_ns: int) -> str:
    content = hashlib.blake2b((series.stamp_ns - start_ns).tobytes(), digest_size=16)
    content.update(series.value.tobytes())
    return content.hexdigest()

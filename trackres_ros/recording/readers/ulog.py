# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads ULog, the log of PX4: the fields of each topic by its own timestamps."""

import contextlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.recording.channel_file import CHUNK_ROWS, Channel, ChannelFile, ChannelRows, ChosenChannel
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.samples import Finding

TIME = "timestamp"
"""The field of each topic with its time since the start of the autopilot [us]."""


class ULogFile(ChannelFile):
    """The topics of a ULog, read as a whole: a channel is a field, and its group the topic, with the number from a second one on.

    ULog has no units. Format: PX4, ULog File Format, https://docs.px4.io/main/en/dev_log/ulog_file_format.html
    """

    def __init__(self, path: Path, name: str) -> None:
        from pyulog import ULog

        with contextlib.redirect_stdout(io.StringIO()):  # its remarks on damage
            log = ULog(str(path))
        self.name = name
        timed_topics = [topic for topic in log.data_list if TIME in topic.data]
        self._topics: dict[str, dict[str, Any]] = {
            topic.name + (f"_{topic.multi_id}" if topic.multi_id else ""): topic.data for topic in timed_topics
        }
        self.channels = [Channel(field, "", topic) for topic, data in self._topics.items() for field in data if field != TIME]
        self.notes = ("times are since the start of the autopilot; ULog has no units",)
        self._lost_ms = [dropout.duration for dropout in log.dropouts]
        self._is_damaged = bool(log.file_corruption)

    def settle(self, time: ChosenChannel | None, channels: Sequence[ChosenChannel]) -> None:
        """Choose the channels to read."""
        super().settle(time, channels)
        self.findings = tuple(self._defects())

    def _defects(self) -> Iterator[Finding]:
        if self._lost_ms:
            text = f"the logger dropped messages {len(self._lost_ms)} times, for {sum(self._lost_ms) / 1e3:g} s in all"
            yield Finding("", "missing", len(self._lost_ms), float("nan"), text)
        if self._is_damaged:
            yield Finding("", "structure", 1, float("nan"), "parts of the file are damaged: their messages are lost")

    def streams(self) -> Sequence[Iterator[ChannelRows]]:
        """The topics in use; that of the last channel, the speed, last."""
        groups = [self.channels[channel.place].group for channel in self.wanted]
        return [self._rows(group) for group in sorted(set(groups), key=lambda group: (group == groups[-1], group))]

    def _rows(self, group: str) -> Iterator[ChannelRows]:
        data = self._topics[group]
        columns = [(column, self.channels[channel.place]) for column, channel in enumerate(self.wanted)]
        fields = [(column, data[channel.name]) for column, channel in columns if channel.group == group]
        stamps = np.asarray(data[TIME], np.int64) * 1000
        for start in range(0, len(stamps), CHUNK_ROWS):
            rows = slice(start, start + CHUNK_ROWS)
            cells = np.full((len(stamps[rows]), len(self.wanted)), np.nan)
            for column, values in fields:
                cells[:, column] = values[rows]
            yield ChannelRows(stamps[rows], np.ones(len(cells), np.bool_), cells, ~np.isnan(cells))


KINDS = (
    FileKind("a ULog", (".ulg", ".ulog"), lambda path, name, _: [ULogFile(path, name)], (("pyulog", "ulog"),), checked=True),
)

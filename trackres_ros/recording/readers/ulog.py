# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads ULog, the log of PX4: the fields of each topic by its own timestamps."""

import contextlib
import io
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.recording.channel_file import CHUNK_ROWS, Channel, ChannelFile, ChannelRows, ChosenChannel
from trackres_ros.recording.opening import FileKind
from trackres_ros.recording.samples import Finding

HEADER_BYTES, HEAD = 16, struct.Struct("<HB")
"""Length of the header of a file; length and type of a message."""
SUBSCRIPTION = ord("A")
DEFINITIONS, DATA = frozenset(b"BFIMPQA"), frozenset(b"ARDIMPQLCSO")
"""Types of messages before and after the first subscription."""
TIME = "timestamp"
"""The field of each topic with its time since the start of the autopilot [us]."""


class ULogFile(ChannelFile):
    """The topics of a ULog, read as a whole: a channel is a field, and its group the topic, with the number from a second one on.

    ULog has no units. Format: PX4, ULog File Format, https://docs.px4.io/main/en/dev_log/ulog_file_format.html
    """

    def __init__(self, path: Path, name: str) -> None:
        from pyulog import ULog

        with path.open("rb") as file, contextlib.redirect_stdout(io.StringIO()) as remarks:
            log = ULog(file)  # which closes it only if it is whole
        self._is_damaged = bool(log.file_corruption or remarks.getvalue() or not _is_contiguous(path.read_bytes()))
        self.name = name
        timed_topics = [topic for topic in log.data_list if TIME in topic.data]
        self._topics: dict[str, dict[str, Any]] = {
            topic.name + (f"_{topic.multi_id}" if topic.multi_id else ""): topic.data for topic in timed_topics
        }
        self.channels = [Channel(field, "", topic) for topic, data in self._topics.items() for field in data if field != TIME]
        self.notes = ("times are since the start of the autopilot; ULog has no units",)
        self._lost_ms = [dropout.duration for dropout in log.dropouts]

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
        for channel in self.wanted:
            field = self.channels[channel.place]
            count = int(np.count_nonzero(np.isnan(self._topics[field.group][field.name])))
            if count:
                text = f"{count} values of {channel.name} are not a number: they give no sample"
                yield Finding(channel.role, "absent", count, float("nan"), text)

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


def _is_contiguous(data: bytes) -> bool:
    """Whether messages of known types follow one another to the end of a file; pyulog skips others without a remark."""
    offset, types = HEADER_BYTES, DEFINITIONS
    while offset + HEAD.size <= len(data):
        length, kind = HEAD.unpack_from(data, offset)
        types = DATA if kind == SUBSCRIPTION else types
        if kind not in types:
            return False
        offset += HEAD.size + length
    return offset == len(data)


KINDS = (
    FileKind("a ULog", (".ulg", ".ulog"), lambda path, name, _: [ULogFile(path, name)], (("pyulog", "ulog"),), checked=True),
)

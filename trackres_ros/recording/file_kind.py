# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines a kind of recording: its suffixes, required library, and reader of channels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.channel_file import ChannelFile
from trackres_ros.recording.channel_source import ChannelSource
from trackres_ros.recording.reading import check_file
from trackres_ros.recording.samples import BoundSource

GROUP = "trackres_ros.readers"
"""The entry points by which an installed package adds kinds of its own."""


@dataclass(frozen=True, slots=True)
class FileKind:
    """A kind of recording that is read through its channels.

    Attributes
    ----------
    name : str
        For messages: the kind of file, as in ``an MDF file``.
    suffixes : tuple of str
        In lower case, with the dot.
    read : callable
        Opens a file: takes path, its name for messages, and the topics file, if given; returns the `ChannelFile`. Of
        several, such as the sheets of a workbook, the first one with a time and a speed is read.
    needs : tuple of (str, str)
        Required modules, each with the extra that installs it.
    checked : bool
        Whether `trackres_ros.recording.reading.check_file` knows the first bytes of the files.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, str, Topics | None], Sequence[ChannelFile]]
    needs: tuple[tuple[str, str], ...] = ()
    checked: bool = False

    def source(self, paths: Sequence[Path], topics: Topics | None) -> BoundSource:
        """Open one file.

        Raises InputError for several files, or one that cannot be read; MissingExtraError if a library is not installed.
        """
        if len(paths) > 1:
            given = ", ".join(str(path) for path in paths)
            raise InputError("recordings", given, "several bags, or one other file", "give them one at a time")
        for module, extra in self.needs:
            if find_spec(module) is None:
                raise MissingExtraError(f"reading {self.name}", module, extra)
        if self.checked:
            check_file(paths[0])
        return ChannelSource(paths[0], topics, self.read, self.name)


@dataclass(frozen=True, slots=True)
class BagKind:
    """Bags, of which several are read one after another."""

    suffixes: tuple[str, ...]
    source: Callable[[Sequence[Path], Topics | None], BoundSource]

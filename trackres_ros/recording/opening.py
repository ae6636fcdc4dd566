# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Opens a recording by the kind of its suffix."""

import pkgutil
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.recording import readers
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.channel_file import ChannelFile
from trackres_ros.recording.channel_source import ChannelSource
from trackres_ros.recording.reading import check_file, check_there, content_of, in_one_line
from trackres_ros.recording.samples import BoundSource
from trackres_ros.text import some_of

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
            path_list = ", ".join(str(path) for path in paths)
            raise InputError("recordings", path_list, "several bags, or one other file", "give them one at a time")
        for module, extra_name in self.needs:
            try:
                import_module(module)  # here, as the limits of reading are for content
            except ImportError:
                raise MissingExtraError(f"reading {self.name}", module, extra_name) from None
        if self.checked:
            check_file(paths[0])
        return ChannelSource(paths[0], topics, self.read, self.name)


@dataclass(frozen=True, slots=True)
class BagKind:
    """Bags, of which several are read one after another."""

    suffixes: tuple[str, ...]
    source: Callable[[Sequence[Path], Topics | None], BoundSource]


ROWS = "csv.writer(open('drive.csv', 'w')).writerows([['time_s', 'speed_mps']] + "
OPENPILOT = (
    f'python -c "import csv, sys; from openpilot.tools.lib.logreader import LogReader; {ROWS}'
    "[[event.logMonoTime / 1e9, event.carState.vEgo] for event in LogReader(sys.argv[1]) if event.which() == 'carState'])\""
    " {path}"
)
"""With the log reader of openpilot, which defines its messages."""
AS_TABLE = "if it is a table of text, copy it to a CSV: cp {path} {copy}"
CONVERSIONS: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (
        (".tdms",),
        "a TDMS file of LabVIEW",
        'pip install npTDMS pandas && python -c "import sys, nptdms; nptdms.TdmsFile.read(sys.argv[1])'
        ".as_dataframe(time_index=True).to_csv('drive.csv', index_label='time_s')\" {path}",
    ),
    (
        (".fit",),
        "a FIT file of a bicycle computer or watch",
        f'pip install fitdecode && python -c "import csv, sys, fitdecode; {ROWS}'
        "[[part.get_value('timestamp').timestamp(), part.get_value('enhanced_speed', fallback=part.get_value('speed', "
        "fallback=''))] for part in fitdecode.FitReader(sys.argv[1]) if isinstance(part, fitdecode.FitDataMessage) "
        "and part.name == 'record'])\" {path}",
    ),
    (
        ("rlog", "rlog.bz2", "rlog.zst", "qlog", "qlog.bz2", "qlog.zst"),
        "a log of openpilot",
        f"in the environment of openpilot: {OPENPILOT}",
    ),
    (
        (".bag.active",),
        "a ROS 1 bag that its recorder has not closed",
        "with ROS 1: rosbag reindex {path} && mv {path} {finished}",
    ),
    (
        (".xls", ".ods"),
        "a workbook of another program",
        "save it as .xlsx, or run: libreoffice --headless --convert-to xlsx {path}",
    ),
    ((".zip", ".7z", ".rar", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst"), "an archive", "unpack it first"),
    ((".txt", ".tsv", ".tab", ".dat", ".prn", ".data"), "a suffix of many formats", AS_TABLE),
)
"""Ends of names that are not read: what such a file is, and how to make one that is read."""
MOST_NAMED = 3
AMBIGUOUS = (".log", ".part")
"""Suffixes that are not searched for in folders: many programs write such files, and a recording may be in progress."""


@cache
def shipped_kinds() -> tuple[FileKind | BagKind, ...]:
    """The kinds of this package: those that each module in `readers` registers by its name `KINDS`."""
    modules = [import_module(f"{readers.__name__}.{entry.name}") for entry in pkgutil.iter_modules(readers.__path__)]
    return tuple(kind for module in modules for kind in getattr(module, "KINDS", ()))


@cache
def further_kinds() -> tuple[FileKind, ...]:
    """The kinds of other installed packages, by the names of their entry points.

    Raises InputError for one that cannot be imported, or is no kind.
    """
    kinds: list[FileKind] = []
    for point in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        with in_one_line(
            Path(f"entry point {GROUP}: {point.name}"), "a tuple of FileKind that can be imported", "repair or remove its package"
        ):
            kinds_loaded = point.load()
        if not isinstance(kinds_loaded, tuple) or not all(isinstance(kind, FileKind) for kind in kinds_loaded):
            raise InputError(f"entry point {GROUP}: {point.name}", kinds_loaded, "a tuple of FileKind")
        kinds += kinds_loaded
    return tuple(kinds)


def suffixes() -> tuple[str, ...]:
    """Suffixes of all kinds, in lower case."""
    return tuple(dict.fromkeys(suffix for kind in (*shipped_kinds(), *further_kinds()) for suffix in kind.suffixes))


def stem(path: Path) -> str:
    """Name of a recording without the suffix of its kind; other dots stay, such as those of a date."""
    kind = _by_name(path.name, shipped_kinds()) or (None if path.is_dir() else _by_name(path.name, further_kinds()))
    ends = [suffix for suffix in (kind.suffixes if kind else ()) if path.name.lower().endswith(suffix)]
    return path.name[: len(path.name) - max(map(len, ends), default=0)]


def open_source(paths: Sequence[Path], topics: Topics | None = None) -> BoundSource:
    """Return the source for the recording at some paths.

    `paths`: bags, read one after another, or one other recording; `topics`: topic or channel of each role; by default guessed by
    message type or by name and unit, or standard columns. Raises InputError for nothing there, a suffix or directory that is no
    recording, several kinds, or several files that are no bags; MissingExtraError if the library for this kind is not installed.
    """
    if not paths:
        raise InputError("recording", "no path", _allowed())
    kinds = [_kind_of(path) for path in paths]
    return next((kind for kind in kinds if isinstance(kind, FileKind)), kinds[0]).source(paths, topics)


def _allowed() -> str:
    *first_suffixes, last = suffixes()
    return f"a rosbag2 directory, {', '.join(first_suffixes)} or {last}"


def _kind_of(path: Path) -> FileKind | BagKind:
    """The kind of recording at a path, by suffix or content of the directory."""
    check_there(path)
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return next(kind for kind in shipped_kinds() if isinstance(kind, BagKind))
        file_names = sorted(file.name for file in path.iterdir() if file.name.lower().endswith(suffixes()))
        remedy = (
            "give the path of the recording in it" if file_names else "a rosbag2 directory has one; ros2 bag reindex writes it"
        )
        given = f"no metadata.yaml, but {some_of(file_names, MOST_NAMED)}" if file_names else "a directory without metadata.yaml"
        raise InputError(str(path), given, _allowed(), remedy)
    match = _by_name(path.name, shipped_kinds()) or _by_name(path.name, further_kinds())
    if match is None:
        raise _refusal(path)
    return match


def _refusal(path: Path) -> InputError:
    """The error of a file of no kind: what it is by its content or its name, and how to make one that is read."""
    name = path.name.lower()
    given, remedy = path.suffix or "no suffix", "export it as a CSV table from the program that wrote it"
    for ends, description, conversion in CONVERSIONS:
        if name.endswith(ends):
            places = {"path": path, "copy": path.with_suffix(".csv"), "finished": path.with_suffix("")}
            given = f"{path.suffix}, {description}" if path.suffix else description
            remedy = conversion.format(**{key: shlex.quote(str(place)) for key, place in places.items()})
            break
    else:
        if content := content_of(path):
            given, remedy = f"{given}, {content[0]} by its content", content[1]
    return InputError(str(path), given, _allowed(), remedy)


def _by_name(name: str, kinds: Iterable[FileKind | BagKind]) -> FileKind | BagKind | None:
    return next((kind for kind in kinds if name.lower().endswith(kind.suffixes)), None)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Unpacks archives inside bags up to a ceiling: a few bytes may request all of the memory."""

import bz2
import shutil
import struct
import tempfile
import zlib
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, BinaryIO, Protocol

from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.text import figures

MAX_CHUNK_BYTES = 2**28
"""Of a chunk's content; recorders write chunks of 1 to 4 MB, or of one message. Reading it takes twice that in memory."""
MAX_MESSAGE_BYTES = 2**26
"""Of one message; assumed: no message with a number of a vehicle is as large, an image of 20 megapixels is."""
ZSTD_MAGIC, ZSTD_SKIPPABLE, ZSTD_BLOCK_BYTES = 0xFD2FB528, 0x184D2A50, 2**17
"""RFC 8878: a frame, a frame to skip (the last four bits vary), and the most that one block unpacks to."""


class TooLargeError(ValueError):
    """It would unpack to more than the ceiling."""


class _Decompressor(Protocol):
    """As bz2, lz4.frame and compression.zstd have it."""

    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...

    @property
    def eof(self) -> bool: ...

    @property
    def unused_data(self) -> bytes | None: ...


class _Zstandard:
    """The older library for zstd behind the interface of the newer one."""

    eof, unused_data = True, b""

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        """Unpack all frames, at most `max_length` bytes."""
        zstandard = _zstandard()
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
            unpacked: bytes = reader.read(max_length)
        return unpacked


def _zstd_module() -> ModuleType | None:
    """That of Python 3.14, or its backport, if there is one."""
    for name in ("compression.zstd", "backports.zstd"):
        with suppress(ImportError):
            return import_module(name)
    return None


def _zstd() -> Callable[[], _Decompressor]:
    module = _zstd_module()
    return _Zstandard if module is None else module.ZstdDecompressor


def _zstandard() -> ModuleType:
    try:
        import zstandard
    except ImportError:
        raise MissingExtraError("unpacking zstd", "zstandard", "bags") from None
    return zstandard


def _lz4() -> _Decompressor:
    try:
        from lz4.frame import LZ4FrameDecompressor
    except ImportError:
        raise MissingExtraError("unpacking lz4", "lz4", "bags") from None
    decompressor: _Decompressor = LZ4FrameDecompressor()
    return decompressor


def check_zstd() -> None:
    """Refuse zstd data without a library to unpack them. Raises MissingExtraError if no library for it is installed."""
    if _zstd_module() is None:
        _zstandard()


def unpackers() -> dict[str, Callable[[bytes, int], bytes]]:
    """Return the decompressor of an MCAP chunk, by its compression's name: it takes packed bytes and their unpacked size."""
    return {"": lambda data, _: data, "zstd": _of_size(_zstd()), "lz4": _of_size(_lz4)}


def unpack_file(packed: Path, to: Path) -> None:
    """Unpack a file of zstd, for which `check_space` has found space."""
    module = _zstd_module()
    with ExitStack() as files:
        out = files.enter_context(to.open("wb"))
        if module is None:
            _zstandard().ZstdDecompressor().copy_stream(files.enter_context(packed.open("rb")), out)
        else:
            shutil.copyfileobj(files.enter_context(module.open(packed, "rb")), out)


def unpacked(make: Callable[[], _Decompressor], data: bytes, most: int) -> bytes:
    """Unpack all concatenated archives in some bytes.

    `make`: makes a decompressor; `data`: one or several complete archives; `most`: the ceiling [bytes]. Raises TooLargeError if
    there is more; EOFError if it ends within an archive.
    """
    parts = []
    left = most
    while data:
        one = make()
        parts.append(one.decompress(data, left + 1))
        left -= len(parts[-1])
        if left < 0:
            raise TooLargeError(f"it unpacks to more than {most} bytes")
        if not one.eof:
            raise EOFError("truncated compressed data")
        data = one.unused_data or b""
    return parts[0] if len(parts) == 1 else b"".join(parts)


def unpack_message(data: bytes) -> bytes:
    """Unpack a message of a rosbag2 that is compressed message by message."""
    return unpacked(_zstd(), data, MAX_MESSAGE_BYTES)


def set_ceilings() -> None:
    """Put decompressors that stop into the tables from which rosbags takes its own, which do not."""
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import storage_mcap as mcap

    makers: dict[str, Callable[[], _Decompressor]] = {"zstd": _zstd(), "bz2": bz2.BZ2Decompressor}
    if find_spec("lz4"):  # rosbags has another one without it
        makers["lz4"] = _lz4
    for name, make in makers.items():
        if name in mcap.DECOMPRESSORS:
            mcap.DECOMPRESSORS[name] = _of_size(make)
        if name in ros1.decompressors:
            ros1.decompressors[name] = partial(unpacked, make, most=MAX_CHUNK_BYTES)


def set_can_ceilings() -> None:
    """Replace python-can's decompressor for BLF by one with a ceiling."""
    from can.io import blf

    stopping = {**vars(zlib), "decompressobj": lambda: SimpleNamespace(decompress=_inflate)}
    setattr(blf, "zlib", SimpleNamespace(**stopping))  # noqa: B010 - a module


def set_mdf_ceilings() -> None:
    """Replace asammdf's decompressor likewise, and prevent its failure on a file that it could not open."""
    from asammdf.blocks import mdf_v4, utils, v4_constants

    if hasattr(utils, "DECOMPRESS_FUNC_MAP"):
        for kind in (v4_constants.DZ_BLOCK_DEFLATE, v4_constants.DZ_BLOCK_TRANSPOSED):
            utils.DECOMPRESS_FUNC_MAP[kind] = _inflate
    else:  # before 8.8
        setattr(mdf_v4, "decompress", lambda data, bufsize=0: _inflate(data))  # noqa: ARG005, B010 - a module
    setattr(mdf_v4.MDF4, "__del__", _close_quietly)  # noqa: B010 - a method


def _close_quietly(mdf: Any) -> None:
    with suppress(Exception):
        mdf.close()


def _inflate(data: bytes) -> bytes:
    """Unpack the first archive in some bytes, up to the ceiling of a message."""
    one = zlib.decompressobj()
    whole = one.decompress(data, MAX_MESSAGE_BYTES)
    if one.unconsumed_tail:
        raise TooLargeError(f"it unpacks to more than {MAX_MESSAGE_BYTES} bytes")
    if not one.eof:
        raise EOFError("truncated compressed data")
    return whole


def _of_size(make: Callable[[], _Decompressor]) -> Callable[[bytes, int], bytes]:
    """Unpack a chunk of MCAP of a stated size."""

    def unpack(data: bytes, size: int) -> bytes:
        if size > MAX_CHUNK_BYTES:
            raise TooLargeError(f"a chunk of {size} bytes; at most {MAX_CHUNK_BYTES} are read")
        return unpacked(make, data, size)

    return unpack


def check_space(path: Path) -> None:
    """Refuse a file that unpacks to more than fits into the temporary folder, where rosbags unpacks it."""
    with path.open("rb") as file:
        check_free(_zstd_bound(file), path, "zstd that unpacks to up to {} GB")


def check_free(size: int, path: Path, what: str) -> None:
    """Refuse a file that takes more bytes than are free in the temporary folder. Raises InputError with `what` and the size."""
    folder = tempfile.gettempdir()
    free = shutil.disk_usage(folder).free
    if size > free:
        allowed = f"{figures(free / 1e9)} GB, which are free in {folder}"
        raise InputError(str(path), what.format(figures(size / 1e9)), allowed, "name another folder: export TMPDIR=FOLDER")


def _zstd_bound(file: BinaryIO) -> int:
    """Largest unpacked size of a file's frames [bytes], from the heads of their blocks; ends at a damaged one."""
    blocks = 0
    while len(head := file.read(8)) == 8:
        magic, length = struct.unpack("<II", head)
        if magic & 0xFFFFFFF0 == ZSTD_SKIPPABLE:
            file.seek(length, 1)
            continue
        if magic != ZSTD_MAGIC:
            break
        descriptor = head[4]
        single = descriptor >> 5 & 1
        of_size = (single, 2, 4, 8)[descriptor >> 6]
        file.seek(5 + (1 - single) + (0, 1, 2, 4)[descriptor & 3] + of_size - 8, 1)
        last = False
        while not last and len(block := file.read(3)) == 3:
            field = int.from_bytes(block, "little")
            last = bool(field & 1)
            kind, length = field >> 1 & 3, field >> 3
            file.seek(1 if kind == 1 else length, 1)
            blocks += 1
        file.seek(4 * (descriptor >> 2 & 1), 1)
    return blocks * ZSTD_BLOCK_BYTES

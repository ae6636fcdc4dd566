# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Small files that request much memory, disk or time end in one line; the limits hold nobody else."""

from __future__ import annotations

import gzip
import resource
import signal
import sqlite3
import struct
import threading
import time
import zipfile
import zlib
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from trackres_ros.errors import InputError
from trackres_ros.recording import reading
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.reading import read_in_steps

pytest.importorskip("rosbags")
pytest.importorskip("mcap")
pytest.importorskip("zstandard")
pytest.importorskip("openpyxl")
pytest.importorskip("asammdf")
pytest.importorskip("cantools")

from drive_files import DBC, Drive, topics_of
from drive_files import KINDS as KINDS_OF_DRIVES
from ros_messages import STORE, build, stamped, twist

MANY = 2**28
TWIST = "geometry_msgs/msg/TwistStamped"
TOPICS = Topics.parse({"speed": {"topic": "/speed", "type": TWIST, "field": "twist.linear.x"}})


def packed_table(folder: Path) -> Path:
    path = folder / "run.csv.gz"
    path.write_bytes(gzip.compress(b"time_s,speed_mps\n0,1\n" + b" " * MANY, 1))
    return path


def workbook(folder: Path) -> Path:
    import openpyxl

    book, path, bomb = openpyxl.Workbook(), folder / "run.xlsx", folder / "bomb.xlsx"
    book.active.append(["time_s", "speed_mps"])
    book.save(path)
    with zipfile.ZipFile(path) as total, zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as packed:
        for name in total.namelist():
            packed.writestr(name, b"<a/>" * (MANY // 32) if name == "xl/styles.xml" else total.read(name))
    return bomb


def mdf(folder: Path) -> Path:
    from asammdf import MDF, Signal

    path, time_s = folder / "run.mf4", np.arange(20_000) / 100.0
    with MDF(version="4.10") as file:
        file.append([Signal(np.sin(time_s), time_s, unit="m/s", name="Speed")])
        path = Path(file.save(path, compression=1))
    data = path.read_bytes()
    block, bomb = data.index(b"##DZ"), zlib.compress(bytes(MANY), 1)
    head = data[block : block + 24] + data[block + 24 : block + 32] + struct.pack("<QQ", MANY, len(bomb))
    data = data.replace(struct.pack("<Q", block), struct.pack("<Q", len(data)))
    path.write_bytes(data + head[:8] + struct.pack("<Q", len(head) + len(bomb)) + head[16:] + bomb)
    return path


def can_log(folder: Path) -> Path:
    name, write = KINDS_OF_DRIVES["BLF"]
    write(Drive(2.0), folder / name)
    data, bomb = (folder / name).read_bytes(), zlib.compress(bytes(MANY), 1)
    block = data.index(b"LOBJ")
    head = data[block : block + 8] + struct.pack("<II", 32 + len(bomb), 10) + struct.pack("<H6xI4x", 2, MANY)
    (folder / name).write_bytes(data[:block] + head + bomb)
    return folder / name


def matlab(folder: Path) -> Path:
    from scipy.io import savemat

    path = folder / "run.mat"
    savemat(path, {"t": np.zeros(MANY // 8)}, do_compression=True)
    return path


def chunk(compression: str):
    def write(folder: Path) -> Path:
        from mcap.writer import CompressionType, Writer

        with (folder / "run.mcap").open("wb") as file:
            writer = Writer(file, compression=CompressionType[compression])
            writer.start("ros2", "somebody")
            schema = writer.register_schema(TWIST, "ros2msg", STORE.generate_msgdef(TWIST, ros_version=2)[0].encode())
            channel = writer.register_channel("/speed", "cdr", schema)
            writer.add_message(channel, 1, bytes(MANY), 1)
            writer.finish()
        return folder / "run.mcap"

    return write


def database(mode: str):
    def write(folder: Path) -> Path:
        import zstandard
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        writer = Writer(folder / "run", version=9, storage_plugin=StoragePlugin.SQLITE3)
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
        message = STORE.serialize_cdr(build(TWIST, header=stamped(1, ""), twist=twist(1.0)), TWIST)
        with writer:
            writer.write(writer.add_connection("/speed", TWIST, typestore=STORE), 1, bytes(message))
        bomb = zstandard.ZstdCompressor().compress(bytes(MANY))
        if mode == "FILE":
            next((folder / "run").glob("*.zstd")).write_bytes(bomb)
        else:
            with closing(sqlite3.connect(folder / "run" / "run.db3")) as file, file:
                file.execute("UPDATE messages SET data = ?", (bomb,))
        return folder / "run"

    return write


BOMBS = {
    "csv.gz": packed_table, "xlsx": workbook, "MF4": mdf, "BLF": can_log, "MATLAB 5": matlab, "mcap zstd": chunk("ZSTD"),
    "mcap lz4": chunk("LZ4"), "message": database("MESSAGE"), "file": database("FILE"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BOMBS)
def test_nothing_unpacks_beyond_the_limit(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(reading, "LEAST_BYTES", 2**26)
    (tmp_path / "bus.dbc").write_text(DBC)
    path = BOMBS[kind](tmp_path)
    topics = (
        Topics.parse(topics_of("BLF"), "t.yaml", tmp_path) if kind == "BLF" else TOPICS if path.suffix in ("", ".mcap") else None
    )
    result_befores = {limit: resource.getrlimit(limit) for limit in (resource.RLIMIT_DATA, resource.RLIMIT_FSIZE)}
    # Where memory ends, libxml2 speaks of the syntax.
    with pytest.raises(InputError, match=r"content that takes more than|File too large|XMLSyntaxError") as error_info:
        for _ in open_source([path], topics).blocks():
            pass
    assert path.name in str(error_info.value)
    assert {limit: resource.getrlimit(limit) for limit in result_befores} == result_befores


def endless(parts: int):
    yield from range(parts)
    while True:
        time.process_time()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the timer may hit a callback, and comes again
def test_a_step_without_end_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "LEAST_S", 0.1)
    handler, parts = signal.getsignal(signal.SIGVTALRM), read_in_steps(tmp_path, "a file", endless(3))
    assert [next(parts) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputError, match=r"content that takes more than 0\.1 s"):
        next(parts)
    assert signal.getsignal(signal.SIGVTALRM) is handler


def test_work_between_steps_has_no_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "LEAST_BYTES", 2**20)
    monkeypatch.setattr(reading, "LEAST_S", 0.05)
    for _ in read_in_steps(tmp_path, "a file", iter(range(3))):
        held, begun = bytearray(2**26), time.process_time()
        while time.process_time() - begun < 0.05:
            pass
        assert len(held) == 2**26


def test_another_thread_has_the_limits_too(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "LEAST_BYTES", 2**26)
    monkeypatch.setattr(reading, "LEAST_S", 0.05)

    def slow(seconds: float):
        begun = time.process_time()
        while time.process_time() - begun < seconds:
            yield
        yield

    refusals = []

    def read() -> None:
        for parts in ((bytearray(MANY) for _ in range(1)), slow(0.2)):
            try:
                for _ in read_in_steps(tmp_path, "a file", parts):
                    pass
            except InputError as error:
                refusals.append(str(error))

    thread = threading.Thread(target=read)
    thread.start()
    thread.join()
    assert len(refusals) == 2
    assert "64 MB of memory" in refusals[0]
    assert "0.05 s" in refusals[1]

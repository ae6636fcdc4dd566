# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Law: an MCAP file cut off anywhere gives the messages up to its last whole block, says so, and can be finished."""

import json
import random
import shutil

import numpy as np
import pytest

import trackres_ros as tr

pytest.importorskip("rosbags")
from ros_messages import STORE, build, fill, write_speeds
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from trackres_ros.output.mcap import BagWriter

NUMBER = "std_msgs/msg/Float64"
TOPICS = {"speed": {"topic": "/speed", "type": NUMBER, "field": "data"}}
START_NS, COUNT = 1_700_000_000_000_000_000, 600


def message(row):
    return bytes(STORE.serialize_cdr(build(NUMBER, data=float(row)), NUMBER))


def by_us(path):
    """Written in blocks of 50 messages, as while recording."""
    with BagWriter(path) as bag:
        text = STORE.generate_msgdef(NUMBER, ros_version=2)[0]
        speed, load = (bag.raw_topic(name, NUMBER, text) for name in ("/speed", "/load"))
        for row in range(COUNT):
            bag.write_raw(speed, message(row), START_NS + row * 10**7)
            if row % 10 == 0:
                bag.write_raw(load, message(0), START_NS + row * 10**7)
            if row % 50 == 49:
                bag.flush()


def by_others(path, **chunks):
    """Written by the library of the format: definitions in the chunks, or no chunks."""
    pytest.importorskip("mcap.writer")
    write_speeds(path, NUMBER, ((START_NS + row * 10**7, message(row)) for row in range(COUNT)), chunk_size=4096, **chunks)


def by_rosbags(path):
    folder = path.with_suffix("")
    bag = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    fill(bag, (("/speed", NUMBER, START_NS + row * 10**7, message(row)) for row in range(COUNT)))
    shutil.move(next(folder.glob("*.mcap")), path)


def without_chunks(path):
    by_others(path, use_chunking=False)


def with_lz4(path):
    by_others(path, compression="LZ4")


def whole_blocks(path):
    """Content read; None if the file was cut off before its first complete block."""
    try:
        return tr.read(path, topics=TOPICS)
    except tr.InputError as error:
        if "one with at least one complete message" not in str(error):
            raise
        return None


@pytest.mark.parametrize("write", [by_us, by_others, with_lz4, by_rosbags, without_chunks])
def test_a_file_cut_anywhere_is_read_up_to_its_last_whole_block(write, tmp_path):
    total, cut, repetition = (tmp_path / name for name in ("whole.mcap", "whole.mcap.part", "again.mcap"))
    write(total)
    raw, chance, read = total.read_bytes(), random.Random(4), []
    for size in sorted(chance.sample(range(len(raw) // 4, len(raw)), 25)):
        rubbish = chance.choice([b"", bytes(700), chance.randbytes(40)])  # as a power cut leaves behind
        cut.write_bytes(raw[:size] + rubbish)
        if not (result := whole_blocks(cut)):
            continue
        rows = result.series["speed"].value
        assert np.array_equal(rows, np.arange(len(rows)))
        read.append(len(rows))
        assert any("is unfinished" in finding.text for finding in result.findings)
        recovered = tr.recover(cut, output=repetition)
        assert cut.exists()
        with Reader(repetition) as bag:
            assert len(list(bag.messages())) == recovered.messages >= len(rows)
        finished = tr.read(repetition, topics=TOPICS)
        assert np.array_equal(finished.series["speed"].value, rows)
    assert read == sorted(read)
    if write is not by_rosbags:  # which has one chunk of it all
        assert read[0] < 300
    assert read[-1] > COUNT - 60


def test_a_recovered_file_holds_for_the_library_of_the_format(tmp_path):
    reader = pytest.importorskip("mcap.reader")
    total, cut, repetition = (tmp_path / name for name in ("whole.mcap", "cut.mcap", "again.mcap"))
    by_us(total)
    cut.write_bytes(total.read_bytes()[:-2000])
    recovered = tr.recover(cut, output=repetition)
    with repetition.open("rb") as file:
        bag = reader.make_reader(file, validate_crcs=True)
        assert bag.get_summary().statistics.message_count == recovered.messages == len(list(bag.iter_messages()))
        assert {channel.topic for channel in bag.get_summary().channels.values()} == {"/speed", "/load"}


def test_recover_reports_what_it_wrote_and_refuses_other_files(good, trackres, tmp_path):
    total, part = tmp_path / "whole.mcap", tmp_path / "drive.mcap.part"
    by_us(total)
    part.write_bytes(total.read_bytes()[:-5000])
    statement = json.loads(good("recover", part, "-o", tmp_path / "drive.mcap", "--json"))
    assert statement["written"] == str(tmp_path / "drive.mcap")
    assert statement["messages"] > 500
    assert f"{statement['messages']} messages, {statement['duration_s']:.1f} s" in good(
        "recover", part, "-o", tmp_path / "drive.mcap"
    )
    part.write_bytes(total.read_bytes()[:60])
    (tmp_path / "text.mcap").write_text("no bag")
    for given_values, output, text in (
        (total, "out.mcap", "an MCAP file that was not finished"),
        (part, "out.mcap", "one with at least one complete message"),
        (tmp_path / "text.mcap", "out.mcap", "an MCAP bag"),
        (tmp_path / "nothing.part", "out.mcap", "no such file or folder"),
        (part, "out.csv", "ends in .mcap"),
        (part, "none/out.mcap", "folder"),
    ):
        outcome = trackres("recover", given_values, "-o", tmp_path / output)
        assert outcome.returncode == 2
        assert text in outcome.stderr, outcome.stderr
        assert not (tmp_path / "out.mcap").exists()

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Caches: whatever their content, the numbers are the same, and no foreign code is run."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from trackres_ros.files import cache
from trackres_ros.files.cache import cached_arrays

SHAPES = {"a": (3, 4), "b": (), "c": (5,)}
ARRAYS = {"a": np.arange(12.0).reshape(3, 4), "b": np.array(-1.5), "c": np.linspace(0, 1, 5)}


def damages(random):
    """Named ways in which a file may be other than it was written."""
    named = {
        "empty": lambda data: b"",
        "cut": lambda data: data[: len(data) // 2],
        "one byte less": lambda data: data[:-1],
        "one byte more": lambda data: data + b"\0",
        "zeros": lambda data: bytes(len(data)),
        "other bytes": lambda data: random.bytes(len(data)),
    }

    def flipped(data):
        place = int(random.integers(0, len(data)))
        return data[:place] + bytes([data[place] ^ (1 << int(random.integers(0, 8)))]) + data[place + 1 :]

    return {**named, **{f"flipped {i}": flipped for i in range(40)}}


DAMAGES = damages(np.random.default_rng(5))


def test_a_damaged_table_is_computed_anew_and_written_again(tmp_path):
    computed = []

    def again():
        return cached_arrays("key", SHAPES, lambda: computed.append(1) or ARRAYS, tmp_path)

    again()
    total = (tmp_path / "key.arrays").read_bytes()
    for count, (name, damage) in enumerate(DAMAGES.items(), 2):
        (tmp_path / "key.arrays").write_bytes(damage(total))
        result = again()
        assert len(computed) == count, name
        assert all(np.array_equal(result[key], ARRAYS[key]) for key in SHAPES)
        assert (tmp_path / "key.arrays").read_bytes() == total
        again()
        assert len(computed) == count, name


def test_the_cache_keeps_the_newest_tables_up_to_its_limit(tmp_path, monkeypatch):
    cached_arrays("first", SHAPES, lambda: ARRAYS, tmp_path)
    size = (tmp_path / "first.arrays").stat().st_size
    os.utime(tmp_path / "first.arrays", ns=(0, 0))
    (tmp_path / "of_others").write_bytes(bytes(10 * size))
    monkeypatch.setattr(cache, "MOST_KEPT", 3 * size)
    for count in range(1, 6):
        result = cached_arrays(f"key{count}", SHAPES, lambda: ARRAYS, tmp_path)
        os.utime(tmp_path / f"key{count}.arrays", ns=(count, count))
        assert all(np.array_equal(result[name], ARRAYS[name]) for name in SHAPES)
    assert {path.name for path in tmp_path.glob("*.arrays")} == {"key3.arrays", "key4.arrays", "key5.arrays"}
    assert (tmp_path / "of_others").is_file()


def test_the_table_of_another_key_is_not_taken(tmp_path):
    cached_arrays("one", SHAPES, lambda: ARRAYS, tmp_path)
    shutil.copy(tmp_path / "one.arrays", tmp_path / "two.arrays")
    other = cached_arrays("two", SHAPES, lambda: {**ARRAYS, "b": np.array(7.0)}, tmp_path)
    assert other["b"] == 7.0


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_what_is_not_a_file_in_its_place_stops_nothing(tmp_path, make):
    make(tmp_path / "key.arrays")
    assert np.array_equal(cached_arrays("key", SHAPES, lambda: ARRAYS, tmp_path)["a"], ARRAYS["a"])


@pytest.fixture
def said(caplog):
    """Messages on caches, from the beginning."""
    cache._warn.cache_clear()
    yield lambda: [record.getMessage() for record in caplog.records]
    cache._warn.cache_clear()


def private(path):
    path.mkdir(mode=0o700)
    return path


def test_a_folder_of_our_own_serves_and_is_closed_to_others(tmp_path, said):
    folder = private(tmp_path / "own") / "trackres"
    assert cache.usable_folder(folder) == folder
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o755)
    assert cache.usable_folder(folder) == folder
    assert folder.stat().st_mode & 0o777 == 0o700
    assert not said()


@pytest.mark.parametrize("which", ["itself", "above"])
def test_a_folder_that_others_can_write_to_is_refused_once(tmp_path, said, which):
    folder = private(tmp_path / "own") / "trackres"
    folder.mkdir(mode=0o700)
    (folder if which == "itself" else folder.parent).chmod(0o777)
    computed = []

    def compute():
        computed.append(1)
        return ARRAYS

    for _ in range(3):
        cached_arrays("key", SHAPES, compute, folder)
    assert len(computed) == 3
    assert not list(folder.iterdir())
    assert len(said()) == 1
    assert "other users can write" in said()[0]


def test_a_sticky_folder_above_is_fine_and_as_the_cache_is_not(tmp_path, said):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    assert cache.usable_folder(shared / "mine") is not None
    assert cache.usable_folder(shared) is None


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_a_folder_of_another_user_is_refused(tmp_path, said):
    folder = private(tmp_path / "theirs")
    os.chown(folder, 12345, 12345)
    assert cache.usable_folder(folder / "trackres") is None
    assert "belongs to another user" in said()[0]


def test_a_symbolic_link_counts_as_where_it_leads(tmp_path, said):
    open_to_all = private(tmp_path / "open")
    (tmp_path / "link").symlink_to(open_to_all)
    open_to_all.chmod(0o777)
    assert cache.usable_folder(tmp_path / "link" / "trackres") is None


def test_without_a_home_there_is_no_cache_and_it_is_said(monkeypatch, said):
    def none():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", none)
    assert cached_arrays("key", SHAPES, lambda: ARRAYS)["b"] == ARRAYS["b"]
    assert said()


# Through the command line


@pytest.fixture
def simulate(tmp_path, monkeypatch, good, said):
    """The result of a simulation with its tables in a folder, and what it says of caches."""
    words = ["simulate", "--vehicle", "agri3t", "--speed-kmh", "10", "--duration-s", "20", "--dt", "0.5"]

    def run(folder):
        monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
        good(*words, "-o", str(tmp_path / "out.csv"))
        return (tmp_path / "out.csv").read_bytes(), said()

    return run


def test_a_simulation_with_damaged_or_no_tables_gives_the_same(simulate, tmp_path):
    total = simulate(tmp_path / "warm")
    assert total[1] == []
    files = list((tmp_path / "warm" / "trackres").glob("*.arrays"))
    assert files
    for file in files:
        file.write_bytes(DAMAGES["cut"](file.read_bytes()))
    assert simulate(tmp_path / "warm") == total
    (tmp_path / "in the way").write_text("")
    output, messages = simulate(tmp_path / "in the way")
    assert output == total[0]
    assert "not cached" in messages[0]
    assert len(messages) == 1

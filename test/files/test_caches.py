# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Caches: whatever their content, the numbers are the same, and no foreign code is run."""

import os
import pickle
import shutil
import subprocess
import sys
import time
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest

from trackres_ros.files import cache, own_files
from trackres_ros.files.cached_arrays import cached_arrays
from trackres_ros.jit import compiled as compiling

needs_numba = pytest.mark.skipif(not compiling.HAVE_NUMBA, reason="numba is not installed: nothing is compiled")

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
        at = int(random.integers(0, len(data)))
        return data[:at] + bytes([data[at] ^ (1 << int(random.integers(0, 8)))]) + data[at + 1 :]

    return {**named, **{f"flipped {i}": flipped for i in range(40)}}


DAMAGES = damages(np.random.default_rng(5))


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_table_is_computed_anew_and_written_again(tmp_path, name):
    computed = []

    def compute():
        computed.append(1)
        return ARRAYS

    cached_arrays("key", SHAPES, compute, tmp_path)
    whole = (tmp_path / "key.arrays").read_bytes()
    (tmp_path / "key.arrays").write_bytes(DAMAGES[name](whole))
    again = cached_arrays("key", SHAPES, compute, tmp_path)
    assert len(computed) == 2
    assert all(np.array_equal(again[key], ARRAYS[key]) for key in SHAPES)
    assert (tmp_path / "key.arrays").read_bytes() == whole
    cached_arrays("key", SHAPES, compute, tmp_path)
    assert len(computed) == 2


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
    cache._say.cache_clear()
    yield lambda: [record.getMessage() for record in caplog.records]
    cache._say.cache_clear()


def private(path):
    path.mkdir(mode=0o700)
    return path


def test_a_folder_of_our_own_serves_and_is_closed_to_others(tmp_path, said):
    folder = private(tmp_path / "own") / "trackres"
    assert cache.usable(folder) == folder
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o755)
    assert cache.usable(folder) == folder
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
    assert cache.usable(shared / "mine") is not None
    assert cache.usable(shared) is None


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_a_folder_of_another_user_is_refused(tmp_path, said):
    folder = private(tmp_path / "theirs")
    os.chown(folder, 12345, 12345)
    assert cache.usable(folder / "trackres") is None
    assert "belongs to another user" in said()[0]


def test_a_symbolic_link_counts_as_where_it_leads(tmp_path, said):
    open_to_all = private(tmp_path / "open")
    (tmp_path / "link").symlink_to(open_to_all)
    open_to_all.chmod(0o777)
    assert cache.usable(tmp_path / "link" / "trackres") is None


def test_without_a_home_there_is_no_cache_and_it_is_said(monkeypatch, said):
    def none():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", none)
    assert cached_arrays("key", SHAPES, lambda: ARRAYS)["b"] == ARRAYS["b"]
    assert said()


# Compiled code


def square(x):
    return x * x + 1.0


@pytest.fixture
def code(tmp_path, monkeypatch):
    """A folder for compiled code, and the one file in it."""
    monkeypatch.setattr(compiling._library.config, "CACHE_DIR", str(tmp_path))
    assert compiling.compiled(square)(3.0) == 10.0
    (path,) = tmp_path.rglob("*.code")
    return path


def compiled_anew():
    """Whether a new dispatcher of the same function had to compile."""
    fresh = compiling.compiled(square)
    assert fresh(3.0) == 10.0
    return not fresh.stats.cache_hits


@needs_numba
def test_compiled_code_is_taken_from_the_cache(code):
    assert compiling.is_cached(compiling.compiled(square))
    assert not compiled_anew()
    assert code.stat().st_mode & 0o077 == 0


@needs_numba
@pytest.mark.parametrize("name", list(DAMAGES)[:9])
def test_damaged_code_is_compiled_anew_and_written_again(code, name):
    code.write_bytes(DAMAGES[name](code.read_bytes()))
    assert not compiling.is_cached(compiling.compiled(square))
    assert compiled_anew()
    assert not compiled_anew()


class Bomb:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@needs_numba
def test_a_pickle_that_we_did_not_write_is_never_opened(code, tmp_path):
    code.write_bytes(pickle.dumps(Bomb(tmp_path / "ran")))
    assert compiled_anew()
    assert not (tmp_path / "ran").exists()


@needs_numba
@pytest.mark.parametrize("payload", [b"", b"\x80\x05.", pickle.dumps(None), pickle.dumps((1, 2)), pickle.dumps(("x",) * 9)])
def test_sealed_code_that_cannot_be_loaded_is_compiled_anew(code, payload):
    code.write_bytes(own_files.sealed(code.name, payload))
    assert compiled_anew()
    assert not compiled_anew()


@needs_numba
def test_code_in_a_folder_open_to_others_is_not_loaded(code, tmp_path, monkeypatch, said):
    other = private(tmp_path / "other")
    shutil.copytree(code.parent, other / code.parent.name)
    (other / code.parent.name).chmod(0o777)
    monkeypatch.setattr(compiling._library.config, "CACHE_DIR", str(other))
    assert compiled_anew()
    assert "other users can write" in said()[0]


# Through the command line


SHORT_S, LONG_S = 20, 30000  # a long one waits for compiled steps, a short first one does not


def simulation(out, seconds):
    command = [sys.executable, "-m", "trackres_ros.cli.main", "simulate", "--vehicle", "agri3t", "--speed-kmh", "10"]
    return [*command, "--duration-s", str(seconds), "--dt", "0.5", "-o", str(out)]


def simulate(folder, out, repository, seconds=SHORT_S, **environment):
    given = {**os.environ, "XDG_CACHE_HOME": str(folder), **environment}
    command = simulation(out, seconds)
    done = subprocess.run(command, env=given, capture_output=True, text=True, timeout=300, cwd=repository, check=False)
    assert done.returncode == 0, done.stderr
    return out.read_bytes(), done.stderr


@pytest.fixture(scope="module")
def warm(tmp_path_factory, repository):
    """A cache with all inputs of a simulation, without compiled code, and the simulation's result."""
    folder = tmp_path_factory.mktemp("warm")
    return folder, simulate(folder, folder / "out.csv", repository, TRACKRES_INTERPRETED="1")[0]


@pytest.mark.parametrize("name", ["empty", "cut", "flipped 3"])
def test_a_simulation_with_damaged_tables_gives_the_same(warm, tmp_path, repository, name):
    folder, whole = warm
    shutil.copytree(folder / "trackres", tmp_path / "trackres")
    files = list((tmp_path / "trackres").glob("*.arrays"))
    assert files
    for file in files:
        file.write_bytes(DAMAGES[name](file.read_bytes()))
    assert simulate(tmp_path, tmp_path / "out.csv", repository, TRACKRES_INTERPRETED="1") == (whole, "")


@pytest.mark.parametrize("place", ["a file", "read-only"])
def test_a_simulation_without_a_cache_gives_the_same_and_says_so(warm, tmp_path, repository, place):
    folder = tmp_path / "in the way" if place == "a file" else Path("/proc/none")
    if place == "a file":
        folder.write_text("")
    out, said = simulate(folder, tmp_path / "out.csv", repository, TRACKRES_INTERPRETED="1")
    assert out == warm[1]
    assert said.count("\n") == 1
    assert "not cached" in said


@needs_numba
@pytest.mark.long
def test_a_simulation_with_damaged_code_gives_the_same(tmp_path, repository, warm_code):
    whole, _ = simulate(tmp_path, tmp_path / "whole.csv", repository, LONG_S)
    files = warm_code("advance_along.entry", "advance_along", "start.entry")
    for file, damage in zip(files, cycle(("other bytes", "cut", "empty")), strict=False):
        file.write_bytes(DAMAGES[damage](file.read_bytes()))
    assert simulate(tmp_path, tmp_path / "again.csv", repository, LONG_S) == (whole, "")
    assert not [path for path in files if own_files.unsealed(path.name, path.read_bytes()) is None]


@needs_numba
@pytest.mark.long
def test_a_first_run_compiles_in_the_background_for_the_next(tmp_path, repository, warm_code):
    for path in warm_code("advance_along.entry"):
        path.unlink()
    first, _ = simulate(tmp_path, tmp_path / "first.csv", repository)
    deadline = time.monotonic() + 1500.0
    while not list(tmp_path.rglob("*advance_along.entry*.code")) and time.monotonic() < deadline:
        time.sleep(0.2)
    warm_code("advance_along.entry")
    assert simulate(tmp_path, tmp_path / "second.csv", repository)[0] == first


@needs_numba
@pytest.mark.long
def test_two_processes_at_once_leave_a_cache_that_is_whole(tmp_path, repository, warm_code):
    for path in warm_code("advance_along.entry", "advance_along", "start.entry"):
        path.unlink()
    given = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    both = [
        subprocess.Popen(simulation(tmp_path / f"{i}.csv", LONG_S), env=given, cwd=repository, stderr=subprocess.DEVNULL)
        for i in range(2)
    ]
    assert [process.wait(timeout=300) for process in both] == [0, 0]
    warm_code("advance_along.entry", "start.entry")
    files = [path for path in (tmp_path / "trackres").rglob("*") if path.is_file()]
    assert not [path for path in files if own_files.unsealed(path.name, path.read_bytes()) is None]
    assert (tmp_path / "0.csv").read_bytes() == (tmp_path / "1.csv").read_bytes()

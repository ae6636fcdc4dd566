# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of files that are replaced together: after any fault, or a kill at any point, all are the old or all the new ones."""

import errno
import json
import os
import random
import shutil
import signal
import stat
import subprocess
import sys
import time
import warnings
from contextlib import suppress
from itertools import count

import pytest
from faults import Faults, child, contents, shown

import trackres_ros as tr
from trackres_ros.files import own_files
from trackres_ros.files.file_sets import (
    BACK,
    FORMAT,
    FORWARD,
    Member,
    RepairWarning,
    file_set,
    is_free,
    present_content,
    settle,
    trial_folder,
)

OLD = {"a.txt": b"old a", "sub/b.txt": b"old b", "gone.txt": b"old c"}
NEW = {"a.txt": b"new a, longer", "sub/b.txt": b"new b", "other/d.txt": b"new d"}
NEVER = 1 << 30


@pytest.fixture(scope="module")
def layouts(good, tmp_path_factory):
    """Layouts of two vehicles."""
    folders = {vehicle: tmp_path_factory.mktemp(vehicle) for vehicle in ("xgd24d", "agri3t")}
    for vehicle, folder in folders.items():
        good("layouts", "--vehicle", vehicle, "-o", folder)
    return [contents(folder) for folder in folders.values()]


def lay(folder, files):
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def replace_all(folder, new=NEW, gone=("gone.txt",)):
    with file_set():
        for name, content in new.items():
            own_files.write(folder / name, content)
        for name in gone:
            own_files.remove(folder / name)


def anew(folder, files):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    lay(folder, files)
    return folder


def settled(folder):
    """A later process, which only reads."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RepairWarning)
        settle(folder)
    return shown(folder)


def test_a_command_that_fails_at_any_call_leaves_the_old_files(trackres, layouts, tmp_path):
    old, new = layouts
    for n in count(1):
        folder = anew(tmp_path / "out", old)
        with Faults(folder, n, n) as faults:
            outcome = trackres("layouts", "--vehicle", "agri3t", "-o", folder)
        if not faults.hit:
            break
        assert shown(folder) == (old if outcome.returncode else new), (n, faults.calls, outcome)
        assert outcome.returncode in (0, 2), outcome
        if outcome.returncode:
            assert "No space left on device" in outcome.stderr, outcome.stderr
            assert ".new" not in outcome.stderr, outcome.stderr
    assert n > 30
    assert contents(folder) == new


@pytest.mark.parametrize("link", [True, False])
def test_a_disk_full_from_any_call_on_mixes_no_files(tmp_path, link, monkeypatch):
    if not link:  # as on a stick with FAT
        monkeypatch.setattr(os, "link", lambda *_: (_ for _ in ()).throw(OSError(errno.EPERM, "no links")))
    for n in count(1):
        folder = anew(tmp_path / "out", OLD)
        with Faults(folder, n, NEVER) as faults:
            try:
                replace_all(folder)
                failed = False
            except OSError:
                failed = True
        if not faults.hit:
            break
        result = settled(folder)
        assert result in (OLD, NEW), (n, faults.calls)
        assert failed or result == NEW, n
        replace_all(folder)
        assert contents(folder) == NEW, n  # no leftovers
    assert n > 40


def test_a_process_killed_at_any_call_leaves_one_set(tmp_path):
    repaired = 0
    for n in count(1):
        folder = anew(tmp_path / "out", OLD)
        with child() as number:
            if number is None:
                with Faults(folder, n, n, kill=True):
                    replace_all(folder)
        with warnings.catch_warnings(record=True) as statement:
            warnings.simplefilter("always")
            half = shown(folder) not in (OLD, NEW)
            settle(folder)
        result = shown(folder)
        assert result in (OLD, NEW), n
        assert not half or (len(statement) == 1 and statement[0].category is RepairWarning), (n, statement)
        repaired += half
        if result == NEW and contents(folder) == NEW and n > 60:
            break
        replace_all(folder)
        assert contents(folder) == NEW, n
    assert repaired >= 3


def test_a_repair_that_is_killed_or_fails_is_repaired_too(tmp_path):
    half = tmp_path / "half"
    anew(half, OLD)
    calls = _calls(half)
    first_move = len(calls) - calls[::-1].index("link")  # all are prepared: somewhere behind it the files are moved
    for stop in range(first_move, len(calls) + 1, 2):
        anew(half, OLD)
        with child() as number:
            if number is None:
                with Faults(half, stop, stop, kill=True):
                    replace_all(half)
        for n in count(1):
            folder = tmp_path / "out"
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(half, folder)
            with Faults(folder, n, n) as faults, warnings.catch_warnings():
                warnings.simplefilter("ignore", RepairWarning)
                with suppress(OSError):
                    settle(folder)
            assert settled(folder) in (OLD, NEW), (stop, n)
            if not faults.hit:
                break


def _calls(folder):
    with Faults(folder, NEVER, NEVER) as faults:
        replace_all(folder)
    return faults.calls


def test_a_failed_undo_is_undone_by_the_next_reader(tmp_path):
    calls = _calls(anew(tmp_path / "out", OLD))
    place = len(calls) - calls[::-1].index("replace")  # the last file does not come in place
    for n in count(1):
        folder = anew(tmp_path / "out", OLD)
        with Faults(folder, place, place, again=place + n) as faults, pytest.raises(OSError, match="No space left"):
            replace_all(folder)
        assert settled(folder) in (OLD, NEW), n
        if faults.count < place + n:
            break
    assert n > 3


def test_a_command_repairs_what_a_killed_one_left_and_says_so(trackres, layouts, tmp_path):
    old, new = layouts
    folder = anew(tmp_path / "out", old)
    with Faults(folder, NEVER, NEVER) as faults:
        trackres("layouts", "--vehicle", "agri3t", "-o", folder)
    last = len(faults.calls) - faults.calls[::-1].index("replace")
    anew(folder, old)
    with child() as number:
        if number is None:
            with Faults(folder, last, last, kill=True):
                trackres("layouts", "--vehicle", "agri3t", "-o", folder)
    assert shown(folder) not in (old, new)
    outcome = trackres("layouts", "--vehicle", "xgd24d", "-o", folder)
    assert outcome.returncode == 0
    assert f"{folder}: a run ended while it replaced files that belong together" in outcome.stderr
    assert contents(folder) == old


def test_a_vehicle_is_never_read_beside_files_of_another_run(tmp_path, good):
    good("vehicle", "new", "mine", "--like", "xgd24d", "-o", tmp_path)
    text = (tmp_path / "mine.yaml").read_text()
    site = "schema: trackres.surroundings/1\n"
    calls = 1
    while True:
        (tmp_path / "mine.yaml").write_text(text)
        (tmp_path / "site.yaml").write_text("# old\n" + site)
        with child() as number:
            if number is None:
                with Faults(tmp_path, calls, calls, kill=True), file_set():
                    own_files.write(tmp_path / "site.yaml", ("# new\n" + site).encode())
                    own_files.write(tmp_path / "mine.yaml", text.replace("name: mine", "name: yours").encode())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RepairWarning)
            name = tr.load_vehicle(tmp_path / "mine.yaml").name
        is_new = (tmp_path / "site.yaml").read_text().startswith("# new")
        assert is_new == (name == "yours")
        if is_new and not any(path.name.startswith(".") for path in tmp_path.iterdir()):
            break
        calls += 1
    assert calls > 15


def test_a_real_process_killed_at_random_times_leaves_one_set(tmp_path):
    program = (
        "import sys, pathlib\n"
        "from trackres_ros.files import own_files\n"
        "from trackres_ros.files.file_sets import file_set\n"
        "folder = pathlib.Path(sys.argv[1])\n"
        "print('begun', flush=True)\n"
        "for number in range(10**9):\n"
        "    with file_set():\n"
        "        for name in ('top.txt', *(f'{one}/file.txt' for one in 'abcdefg')):\n"
        "            own_files.write(folder / name, f'{number}'.encode() * 1000)\n"
    )
    rolled = random.Random(1)
    for kills in range(8):
        running = [
            subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE) for _ in range(2)
        ]  # two runs at once
        for item in running:
            item.stdout.readline()
        time.sleep(rolled.uniform(0.0, 0.2))
        for item in running:
            item.send_signal(signal.SIGKILL)
            item.wait()
            item.stdout.close()
        result = set(settled(tmp_path).values())
        assert len(result) <= 1, kills
    replace_all(tmp_path, dict.fromkeys(("top.txt", *(f"{item}/file.txt" for item in "abcdefg")), b"end"), ())
    assert set(contents(tmp_path).values()) == {b"end"}
    assert len(contents(tmp_path)) == 8


def test_an_exception_in_the_block_changes_nothing(tmp_path):
    lay(tmp_path, OLD)

    def fail():
        with file_set():
            own_files.write(tmp_path / "a.txt", b"new")
            own_files.remove(tmp_path / "gone.txt")
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert contents(tmp_path) == OLD


def test_inside_a_set_its_files_are_seen_as_they_will_be(tmp_path):
    lay(tmp_path, OLD)
    with file_set():
        own_files.write(tmp_path / "a.txt", b"new")
        own_files.write(tmp_path / "d.txt", b"more")
        own_files.remove(tmp_path / "gone.txt")
        assert [present_content(tmp_path / name) for name in ("a.txt", "d.txt", "gone.txt", "sub/b.txt")] == [
            b"new", b"more", None, b"old b",
        ]  # fmt: skip
        assert [is_free(tmp_path / name) for name in ("a.txt", "d.txt", "gone.txt", "e.txt")] == [False, False, True, True]
        with file_set():  # one within it belongs to it
            own_files.write(tmp_path / "e.txt", b"later")
        assert (tmp_path / "a.txt").read_bytes() == b"old a"
        assert not (tmp_path / "e.txt").exists()
    assert (tmp_path / "e.txt").read_bytes() == b"later"


def test_permissions_links_and_files_of_others_stay(tmp_path):
    real = tmp_path / "elsewhere"
    anew(real, {"kept.txt": b"old", "mine.txt": b"of the user"})
    folder = tmp_path / "out"
    folder.symlink_to(anew(tmp_path / "target", {**OLD, "notes.md": b"of the user"}))
    (folder / "link.txt").symlink_to(real / "kept.txt")
    (folder / "a.txt").chmod(0o640)
    replace_all(folder, {**NEW, "link.txt": b"new"})
    assert folder.is_symlink()
    assert (folder / "link.txt").is_symlink()
    assert contents(real) == {"kept.txt": b"new", "mine.txt": b"of the user"}
    assert contents(tmp_path / "target") == {**NEW, "link.txt": b"new", "notes.md": b"of the user"}
    assert stat.S_IMODE((folder / "a.txt").stat().st_mode) == 0o640


def test_a_set_over_several_folders_is_whole_from_each_of_them(tmp_path):
    folders = [tmp_path / name for name in "abc"]
    for n in count(1):
        for folder in folders:
            anew(folder, {"x": b"old"})
        with child() as number:
            if number is None:
                with Faults(tmp_path, n, n, kill=True), file_set():
                    for folder in folders:
                        own_files.write(folder / "x", b"new")
        for folder in folders[n % 3 :]:  # whoever reads first, from there
            settled(folder)
        if n % 3:
            shown_there = {(folder / "x").read_bytes() for folder in folders}
            assert len(shown_there) == 1, n
        with file_set():
            for folder in folders:
                own_files.write(folder / "x", b"last")
        assert [contents(folder) for folder in folders] == [{"x": b"last"}] * 3, n
        if n > 70:
            break


def test_a_journal_of_a_stranger_touches_no_file_outside(tmp_path):
    home, theirs = tmp_path / "home", tmp_path / "unpacked"
    anew(home, {"precious.txt": b"mine"})
    result = (home / "precious.txt").stat()
    seal = [result.st_size, result.st_mtime_ns]
    token = "0123456789abcdef"
    anew(theirs, {})
    for kind in ("new", "old"):
        Member(theirs / "precious.txt", None).neighbour(token, kind).write_bytes(b"evil")
    (theirs / "link").symlink_to(home)
    for journal in (FORWARD, BACK):
        for name in ("../home/precious.txt", "link/precious.txt"):
            for new, old in (([4, 5], None), (None, seal), ([4, 5], [4, 5])):
                content = {"format": FORMAT, "token": token, "home": "", "roots": [], "files": [[name, new, old]]}
                (theirs / journal).write_text(json.dumps(content))
                settled(theirs)
                assert contents(home) == {"precious.txt": b"mine"}


def test_a_journal_whose_folders_are_gone_holds_up_nobody(tmp_path):
    for folder in ("a", "b"):
        anew(tmp_path / folder, {"sub/x": b"old"})
    calls = 0
    while not (tmp_path / "a" / FORWARD).exists():
        calls += 1
        with child() as number:
            if number is None:
                with Faults(tmp_path, calls, calls, kill=True), file_set():
                    for folder in ("a", "b"):
                        own_files.write(tmp_path / folder / "x", b"new")
                        own_files.write(tmp_path / folder / "sub" / "x", b"new")
    shutil.rmtree(tmp_path / "b")
    shutil.rmtree(tmp_path / "a" / "sub")
    assert settled(tmp_path / "a") == {"x": b"new"}


def test_a_forked_process_writes_by_itself(tmp_path):
    with file_set():
        own_files.write(tmp_path / "ours", b"ours")
        with child() as number:
            if number is None:
                own_files.write(tmp_path / "theirs", b"theirs")
        assert contents(tmp_path) == {"theirs": b"theirs"}
    assert contents(tmp_path) == {"ours": b"ours", "theirs": b"theirs"}


def test_a_name_of_the_greatest_length_can_be_replaced(tmp_path):
    names = ["x" * 242, "y" * 255]
    with file_set():
        for name in names:
            own_files.write(tmp_path / name, b"new")
    assert shown(tmp_path) == dict.fromkeys(names, b"new")


def test_a_damaged_journal_is_refused_with_a_remedy(tmp_path, refused):
    for content in (b"", b"{}", b"[]", b'{"format": "trackres-set", "token": "../..", "home": "", "roots": [], "files": []}'):
        (tmp_path / FORWARD).write_bytes(content)
        line = refused("layouts", "--vehicle", "xgd24d", "-o", tmp_path)
        assert f"or delete {tmp_path / FORWARD}" in line
        (tmp_path / FORWARD).unlink()


def test_a_trial_within_a_set_is_read_at_once(tmp_path):
    with file_set():
        own_files.write(tmp_path / "kept.txt", b"kept")
        with trial_folder() as folder:
            own_files.write(folder / "trial.txt", b"trial")
            assert (folder / "trial.txt").read_bytes() == b"trial"
        assert not (tmp_path / "kept.txt").exists()
    assert (tmp_path / "kept.txt").read_bytes() == b"kept"
    assert not folder.exists()

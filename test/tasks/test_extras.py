# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands with an optional library missing, and interrupted commands."""

import json
import os
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

import pytest
from waiting import wait_for

from trackres_ros.tasks import main as cli_main

# Runs each command in a fork of a process that has loaded the command line alone, without the modules that are blocked.
FORKS = """
import json, os, sys
blocked, commands = json.loads(sys.argv[1])
sys.modules.update(dict.fromkeys(blocked))
from trackres_ros.tasks.main import main
for number, (modules, words) in enumerate(commands):
    child = os.fork()
    if child == 0:
        os.chdir(str(number))
        for stream, name in ((1, "out"), (2, "err")):
            os.dup2(os.open(f"../{number}.{name}", os.O_WRONLY | os.O_CREAT), stream)
        sys.modules.update(dict.fromkeys(modules))
        main(words)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
OPTIONAL = "rosbags pyarrow pandas xarray matplotlib jinja2 cyclonedds distributed SALib fsspec"


def without(blocked, commands, folder):
    """For each of some commands, each with modules that are missing: exit code, both outputs, and the files it made."""
    for number in range(len(commands)):
        (folder / str(number) / "here").mkdir(parents=True)
        rows = "".join(f"{i * 0.1:.1f},2.0\n" for i in range(30))
        (folder / str(number) / "drive.csv").write_text("time_s,speed_mps\n" + rows)
    environment = {**os.environ, "TRACKRES_INTERPRETED": "1"}
    command = [sys.executable, "-c", FORKS, json.dumps([blocked, commands])]
    process = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    for number, code in enumerate(map(int, process.stdout.split())):
        made = {path.name for path in (folder / str(number)).rglob("*")} - {"here", "drive.csv"}
        yield code, *((folder / f"{number}.{name}").read_text() for name in ("out", "err")), made


NEEDED = [
    (("fleet", "drive.csv", "--vehicle", "agri3t", "-o", "out"), ("distributed", "fsspec", "pyarrow", "jinja2")),
    (("trend", "here"), ("pyarrow",)),
    (("sensitivity", "agri3t"), ("SALib",)),
    (("record-sample", "-o", "out.mcap"), ("rosbags",)),
    (("simulate", "--vehicle", "agri3t", "--speed-kmh", "5", "-o", "out.parquet"), ("pyarrow",)),
    (("simulate", "--vehicle", "agri3t", "--speed-kmh", "5", "-o", "out.mcap"), ("rosbags",)),
    (("replay", "drive.csv", "--vehicle", "agri3t", "-o", "out.parquet"), ("pyarrow",)),
    (("replay", "drive.csv", "--vehicle", "agri3t", "-o", "out.mcap"), ("rosbags",)),
    (("live", "--edge", "dds", "--vehicle", "agri3t"), ("cyclonedds",)),
    (("live", "--edge", "dds", "--vehicle", "agri3t", "--record", "out.mcap"), ("rosbags",)),
    (("compare", "agri3t", "xgd24d", "-o", "out"), ("matplotlib",)),
    (("coastdown", "drive.csv", "--vehicle", "agri3t", "--picture", "out.png"), ("matplotlib",)),
    (("play", "lap.mcap"), ("cyclonedds",)),
]


def test_a_library_that_is_missing_is_said_before_any_work(tmp_path):
    cases = [([module], words) for words, modules in NEEDED for module in modules]
    for (modules, words), (code, output, err, made) in zip(cases, without([], cases, tmp_path), strict=True):
        text, nothing = (output, err) if "--json" in words else (err, output)
        assert (code, nothing, made) == (2, "", set()), (modules, words, err)
        assert text.count("\n") == 1, text
        assert "pip install" in text


def test_without_any_of_them_the_rest_works(tmp_path):
    works = [
        ("simulate", "--vehicle", "agri3t", "--speed-kmh", "5", "--duration-s", "5", "-o", "out.csv"),
        ("replay", "drive.csv", "--vehicle", "agri3t", "-o", "out.csv"),
        ("sweep", "agri3t", "--vary", "loss_modulus_scale=0.9,1.1", "-o", "out.csv"),
        ("explain", "--vehicle", "agri3t", "--speed-kmh", "5", "--belt-degc", "20"),
        ("effects",),
    ]
    for number in (1, 2):  # with a picture of earlier results
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / "out.png").touch()
    for code, output, err, made in without(OPTIONAL.split(), [([], words) for words in works], tmp_path):
        assert code == 0, err
        assert output, err
        assert "Traceback" not in err
        assert "out.png" not in made


def into(stdout, stderr, *words):
    """Exit code of a command with these two streams, given as descriptors; None is a stream that the caller has closed."""
    streams = [None if to is None else os.fdopen(os.dup(to), "w") for to in (stdout, stderr)]
    with redirect_stdout(streams[0]), redirect_stderr(streams[1]):
        with pytest.raises(SystemExit) as error_info:
            cli_main.main([str(word) for word in words])
        for stream in (sys.stdout, sys.stderr):
            stream.close()
    return error_info.value.code


def test_a_closed_or_full_stream_changes_no_result(tmp_path):
    output, err = tmp_path / "out.csv", tmp_path / "err"
    simulate = ("simulate", "--vehicle", "agri3t", "--speed-kmh", 5, "--duration-s", 5, "-o", output)
    unread, closed = os.pipe()
    os.close(unread)
    full, errors = os.open("/dev/full", os.O_WRONLY), os.open(err, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stdout, stderr, code in ((None, errors, 0), (errors, None, 0), (closed, errors, 0), (full, errors, 2)):
        for words in (simulate, (*simulate, "--json")):
            os.truncate(err, 0)
            assert into(stdout, stderr, *words) == code, (stdout, stderr, words)
            assert output.stat().st_size > 100
            output.unlink()
            if stderr is not None:
                assert err.read_text().count("\n") == (code != 0)
                assert ("standard output: No space left" in err.read_text()) == (code != 0)
    assert into(closed, errors, "--help") == 0
    assert into(full, None, "repla", "--json") == 2
    for item in (closed, full, errors):
        os.close(item)


def test_an_interrupted_command_lists_the_files_it_has_written(tmp_path):
    command = [sys.executable, "-m", "trackres_ros", "fleet", "sample", "-o", str(tmp_path / "fleet")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert wait_for(lambda: list(tmp_path.rglob("*.csv")) or process.poll() is not None, working=process.pid)
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "written so far" in text
    first = sorted(path for path in (tmp_path / "fleet").rglob("*.csv"))[0]
    assert str(first) in text


SWALLOWED = """
import os, signal, threading, weakref
from trackres_ros.tasks import interrupts
interrupts.AGAIN_S = 0.2
interrupts.insist()
class Some: pass
def callback(_):  # what is raised in here goes nowhere
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000):  # until the signal is handled
        pass
some = Some()
watched = weakref.ref(some, callback)
del some
try:
    threading.Event().wait(60.0)
except KeyboardInterrupt:
    interrupts.interrupt_handled()
    os.kill(os.getpid(), signal.SIGINT)
    print("taken")
"""


def test_a_swallowed_interrupt_is_raised_again_until_handled():
    process = subprocess.run([sys.executable, "-c", SWALLOWED], capture_output=True, text=True, check=True, timeout=50)
    assert process.stdout == "taken\n"
    assert "Exception ignored" in process.stderr


MET_IN_A_STRING = """
import sys
from trackres_ros.tasks import interrupts
interrupts.insist()
try:
    exec("import os, signal, threading; os.kill(os.getpid(), signal.SIGINT); threading.Event().wait(60.0)")
except KeyboardInterrupt:
    interrupts.interrupt_handled()
    sys.exit(interrupts.INTERRUPTED)
"""


def test_an_interrupt_during_eval_of_a_string_exits_with_130(tmp_path):
    (tmp_path / "interrupted.py").write_text(MET_IN_A_STRING)
    process = subprocess.run([sys.executable, "-m", "interrupted"], cwd=tmp_path, timeout=50, capture_output=True)
    assert process.returncode == 130


def test_a_command_interrupted_before_it_wrote_says_so(tmp_path, monkeypatch, capsys):
    def stop(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli_main.cli, "main", stop)
    with pytest.raises(SystemExit) as error_info:
        cli_main.main(["simulate"])
    assert error_info.value.code == 130
    assert "nothing was written" in capsys.readouterr().err

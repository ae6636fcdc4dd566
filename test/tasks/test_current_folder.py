# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands run in a folder of unpacked recordings that also holds traps: nothing in it runs, and no settings of it are read."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from waiting import wait_for

from trackres_ros.files.resources import find_topics, find_vehicle

COLD = "PYTHONSAFEPATH", "TRACKRES_INTERPRETED"  # variables that would keep a trap from being reached
DRIVE = "time_s,speed_mps\n" + "".join(f"{0.1 * i:.1f},{8.0 if i > 20 else 0.4 * i:.1f}\n" for i in range(100))
COMMAND = "from trackres_ros.__main__ import main\n\nif __name__ == '__main__':\n    main()\n"
OWN = "import trackres_ros as tr\n\ntr.replay('drive.csv', vehicle='xgd24d')\n"
FIRST = {
    "a program of one's own": (OWN, ()),
    "simulate": (COMMAND, ("simulate", "--vehicle", "xgd24d", "--speed-kmh", "30", "--duration-s", "20", "-o", "out.csv")),
    "replay": (COMMAND, ("replay", "drive.csv", "--vehicle", "xgd24d", "-o", "out.csv")),
    "live": (COMMAND, ("live", "--vehicle", "xgd24d", "--transport", "dds", "--quiet", "-p", "state_file:=none")),
}


@pytest.fixture
def folder(tmp_path):
    """A drive among traps: modules of every name, settings of libraries, and files with the names of shipped ones."""
    made = tmp_path / "recordings"
    made.mkdir()
    mark = tmp_path / "sprung"
    names = {*sys.stdlib_module_names, *packages_distributions(), "trackres_ros", "sitecustomize", "usercustomize", "trap"}
    assert {"json", "runpy", "numpy", "yaml"} <= names
    for name in names:
        (made / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write('{name} ')\n")
    (made / "trackres_ros").mkdir()
    for name in ("__init__", "__main__"):
        (made / "trackres_ros" / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write('trackres_ros ')\n")
    (made / "trap-1.0.dist-info").mkdir()
    (made / "trap-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: trap\nVersion: 1.0\n")
    (made / "trap-1.0.dist-info" / "entry_points.txt").write_text("[trackres_ros.readers]\ntrap = trap:KINDS\n")
    (made / "matplotlibrc").write_text("trap: 1\n")
    (made / "xgd24d").write_text(find_vehicle("xgd24d").read_text() + "\neffect_files: [trap.py]\n")
    (made / "sample").write_text(find_topics("sample").read_text() + "\ntrap: 1\n")
    (made / "drive.csv").write_text(DRIVE)
    return made


@pytest.fixture
def start(folder, tmp_path):
    """Starts a program that lies elsewhere, as an installed command does. None of its processes outlives the test."""
    script = tmp_path / "bin" / "trackres"
    script.parent.mkdir()
    plain = {name: value for name, value in os.environ.items() if name not in COLD}

    def start(program, words, **variables):
        script.write_text(program)
        words = [sys.executable, str(script), *words]
        given_valuess = {"cwd": folder, "env": {**plain, **variables, "OF_THIS_TEST": str(tmp_path)}, "text": True}
        return subprocess.Popen(words, **given_valuess, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    yield start
    for process in ours(tmp_path):
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)


def ours(folder):
    """Processes that still run with our variable, whoever has started them."""
    for entry in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if f"OF_THIS_TEST={folder}\0".encode() in entry.read_bytes():
                yield int(entry.parent.name)


def nothing_sprang(folder):
    mark = folder.parent / "sprung"
    return (mark.read_text() if mark.exists() else "", (folder / "code").exists()) == ("", False)


def ended_well(process):
    output, err = process.communicate()
    assert process.returncode == 0, output + err
    assert "matplotlibrc" not in err
    return output


def test_a_trap_springs_where_python_looks_for_modules_here(folder):
    """So the traps are good."""
    subprocess.run([sys.executable, "-m", "trackres_ros"], cwd=folder, capture_output=True)
    assert not nothing_sprang(folder)


@pytest.mark.parametrize("first", FIRST)
def test_a_first_start_among_traps_springs_none(first, start, folder, tmp_path):
    kept, live, variables = tmp_path / "cache", first == "live", {}
    if live:
        pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install trackres_ros[dds]")
        import peer

        variables = {"CYCLONEDDS_URI": peer.LOOPBACK, "ROS_DOMAIN_ID": str(peer.domain_of_worker(73))}
    process = start(*FIRST[first], XDG_CACHE_HOME=str(kept), **variables)
    assert wait_for(lambda: not nothing_sprang(folder) or [*kept.rglob("*.arrays")] or process.poll(), patience_s=600.0)
    if live:
        process.send_signal(signal.SIGINT)
    ended_well(process)
    assert nothing_sprang(folder)


def test_a_shipped_vehicle_is_checked_among_traps(start, folder):
    ended_well(start(COMMAND, ("vehicle", "check", "xgd24d", "--points", "10")))
    assert nothing_sprang(folder)


@pytest.mark.long
def test_workers_of_a_fleet_among_traps_spring_none(start, folder):
    pytest.importorskip("distributed", reason="the extra fleet is not installed")
    words = ["fleet", "run", "drive.csv", "--vehicle", "xgd24d", "--workers", "1", "--period", "none", "-o", "out"]
    text = start(COMMAND, words).communicate()
    assert "drive.csv: given 'no torque" in text[1], text  # so a worker has read it
    assert nothing_sprang(folder)

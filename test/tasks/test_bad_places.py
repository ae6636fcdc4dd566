# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Places that cannot be written, disks that are full, and files that a vehicle file names but that are no rubber files."""

import os
import resource
import signal
from pathlib import Path

import pytest

import trackres_ros as tr
from trackres_ros.files.output_files import output_folder
from trackres_ros.tasks.main import cli

SECRET = "root:x:0:0"


@pytest.fixture
def little_room():
    """No file of this process becomes larger than a few bytes, as on a disk that is full."""
    result_before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def begin():
        resource.setrlimit(resource.RLIMIT_FSIZE, (64, result_before[1]))

    yield begin
    resource.setrlimit(resource.RLIMIT_FSIZE, result_before)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("vehicle", "new", "mine", "-o"), ""),
        (("simulate", "--vehicle", "agri3t", "--speed-kmh", "5", "--duration-s", "9", "-o"), "out.csv"),
        (("sweep", "agri3t", "--vary", "loss_modulus_scale=0.9,1.1", "-o"), "out.csv"),
    ],
)
def test_a_full_disk_is_one_line_with_the_file(trackres, refused, little_room, tmp_path, words, name):
    trackres(*words, tmp_path / f"first{name}")  # writes a file for later
    little_room()
    assert str(tmp_path) in refused(*words, tmp_path / name)


@pytest.fixture(scope="module")
def inputs(good, tmp_path_factory):
    """A folder with the inputs of commands."""
    folder = tmp_path_factory.mktemp("inputs")
    good("vehicle", "new", "vehicle", "-o", folder)
    (folder / "d.csv").write_text("time_s,speed_mps\n0,1\n1,2\n9,2\n")
    (folder / "link.csv").symlink_to("d.csv")
    (folder / "vehicle.csv").write_text("of an instrument\n")
    (folder / "topics.yaml").write_text("speed: {column: speed_mps}\n")
    (folder / "params.yaml").write_text("gap_s: 2.0\n")
    (folder / "route.csv").write_text("latitude_deg,longitude_deg,course_deg,slope,std,passes\n47,8,90,0.01,0.001,4\n")
    (folder / "around.yaml").write_text("schema: 1\nvehicle: vehicle\nroute: route.csv\neffects: {}\n")
    return folder


@pytest.mark.parametrize("place", ["/proc/nope/out", "/dev/null/out", "d.csv/out"])
@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("diagnose d.csv --vehicle vehicle.yaml", "-o"),
        ("compare vehicle.yaml vehicle.yaml", "-o"),
        ("coastdown d.csv --vehicle vehicle.yaml", "--save-vehicle .yaml"),
        ("coastdown d.csv --vehicle vehicle.yaml", "--picture .png"),
        ("export c vehicle.yaml", "-o"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_first(refused, inputs, monkeypatch, words, option, place):
    def never(*_args, **_more):
        raise AssertionError("work began")

    cli.get_command(None, words.split()[0])  # loaded before its function is another
    for work in ("trackres_ros.tasks.diagnose.diagnose", "trackres_ros.coastdown", "trackres_ros.tools.fleet.compare.compare"):
        monkeypatch.setattr(work, never)
    result_before = sorted(inputs.rglob("*"))
    option, *suffix = option.split()
    assert place in refused(*words.split(), option, "".join([place, *suffix]), cwd=inputs)
    assert sorted(inputs.rglob("*")) == result_before


def test_a_check_of_a_place_leaves_nothing_there(tmp_path):
    assert output_folder(tmp_path / "new" / "folder") == tmp_path / "new" / "folder"
    assert not list(tmp_path.iterdir())
    (tmp_path / "report.json").mkdir()
    with pytest.raises(tr.InputError, match="can be replaced"):
        output_folder(tmp_path, names=["report.json"])


OF_REPLAY = (
    "replay d.csv --vehicle vehicle.yaml --surroundings around.yaml --topics topics.yaml --params params.yaml --learning watch"
)
OF_SWEEP = "sweep vehicle.yaml --vary loss_modulus_scale=1 --cycle d.csv"


@pytest.mark.parametrize(
    "words",
    [
        "simulate --vehicle vehicle.yaml --profile d.csv -o d.csv",
        "simulate --vehicle vehicle.yaml --profile d.csv -o link.csv",
        "simulate --vehicle vehicle.yaml --speed-kmh 5 -o rubber/nr_sbr_10hz.csv",
        f"{OF_SWEEP} -o d.csv",
        f"{OF_SWEEP} -o rubber/nr_sbr_10hz.csv",
        *(f"{OF_REPLAY} -o {item}.csv" for item in ("d", "route")),
        *(f"{OF_REPLAY} -o x.csv --save-vehicle {item}.yaml" for item in ("vehicle", "around", "topics", "params")),
        *(f"{OF_REPLAY} -o x.csv --save-state {item}" for item in ("d.csv", "vehicle.yaml", "topics.yaml", "vehicle.csv")),
        "compound fit vehicle.csv --vehicle vehicle.yaml -o .",
        "compound fit rubber/nr_sbr_10hz.csv --vehicle vehicle.yaml -o .",
        "diagnose d.csv --vehicle vehicle.yaml -o .",
    ],
)
def test_no_output_replaces_an_input(refused, inputs, words):
    result_befores = {path: path.read_bytes() for path in inputs.rglob("*") if path.is_file()}
    shown = refused(*words.split(), cwd=inputs)
    assert ("which it would overwrite" in shown) or ("which is another kind of file" in shown)
    assert {path: path.read_bytes() for path in inputs.rglob("*") if path.is_file()} == result_befores


@pytest.mark.parametrize("outputs", [
    "-o x.csv --save-state x.csv", "-o x.csv --save-state ./x.png", "-o y.csv --save-state x.yaml --save-vehicle x.yaml",
])  # fmt: skip
def test_no_output_of_a_replay_replaces_another(refused, inputs, tmp_path, outputs):
    shown_text = refused("replay", inputs / "d.csv", "--vehicle", "agri3t", "--learning", "watch", *outputs.split(), cwd=tmp_path)
    assert "a file for each output" in shown_text
    assert "--save-state" in shown_text
    assert not list(tmp_path.iterdir())


def test_recordings_of_different_names_have_different_results(good, inputs, tmp_path):
    names = [b"2025.06.19.csv", b"2025.06.22.CSV", b"caf\xe9.csv", b"caf\xea.csv"]
    for name in names:
        recording = tmp_path / os.fsdecode(name)
        recording.write_bytes((inputs / "d.csv").read_bytes())
        good("replay", recording, "--vehicle", "agri3t", cwd=tmp_path)
    results = {path.name.partition("_replay.")[0] for path in tmp_path.glob("*_replay.*")}
    assert results == {"2025.06.19", "2025.06.22", "caf\\xe9", "caf\\xea"}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet", ".mf4", ".mcap"])
def test_an_output_may_have_a_name_that_is_not_utf_8(good, inputs, tmp_path, suffix):
    output = tmp_path / (os.fsdecode(b"caf\xe9") + suffix)
    good("replay", inputs / "d.csv", "--vehicle", "agri3t", "-o", output)
    assert output.is_file()


def test_no_saved_result_replaces_an_input(inputs, monkeypatch):
    monkeypatch.chdir(inputs)
    result_before = (inputs / "d.csv").read_bytes()
    for result in (tr.replay("d.csv", "agri3t"), tr.simulate("agri3t", profile="d.csv")):
        with pytest.raises(tr.InputError, match="overwrite"):
            result.save(inputs / "link.csv")
    with pytest.raises(tr.InputError, match="overwrite"):
        tr.CoastdownResult(None, (), [inputs / "vehicle.yaml"]).save_vehicle(inputs / "vehicle.yaml")
    assert (inputs / "d.csv").read_bytes() == result_before


@pytest.mark.usefixtures("undrawn")
def test_a_saved_state_replaces_only_a_state(good, inputs, tmp_path):
    state, output = tmp_path / "state", tmp_path / "x.csv"
    state.touch()  # an empty file is no loss
    for resumed in ((), ("--resume", state)):
        good("replay", inputs / "d.csv", "--vehicle", "agri3t", *resumed, "--save-state", state, "-o", output)
    assert state.read_bytes().startswith(b'{"format"')


@pytest.mark.parametrize("content", [f"{SECRET}:root:/root:/bin/bash\n" * 9, f"T_degC,{SECRET}\n" + "1,2\n" * 9, f"{SECRET}\n"])
@pytest.mark.parametrize("inside", [False, True])
def test_of_a_file_that_is_no_rubber_file_nothing_is_shown(refused, good, tmp_path, content, inside):
    good("vehicle", "new", "mine", "-o", tmp_path / "vehicles")
    file = tmp_path / "vehicles" / "mine.yaml"
    other = Path("other.txt") if inside else Path("..") / "other.txt"
    (file.parent / other).write_text(content)
    file.write_text(file.read_text().replace("file: rubber/nr_sbr_10hz.csv", f"file: {other}"))
    shown = refused("vehicle", "check", file)
    assert "other.txt" in shown
    assert SECRET not in shown
    assert "without the column" in shown


def test_a_rubber_file_in_a_sibling_folder_serves(good, tmp_path):
    good("vehicle", "new", "mine", "-o", tmp_path / "vehicles")
    file = tmp_path / "vehicles" / "mine.yaml"
    (tmp_path / "vehicles" / "rubber").rename(tmp_path / "rubber")
    file.write_text(file.read_text().replace("file: rubber/", "file: ../rubber/"))
    assert "rubber" in good("vehicle", "check", file)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres export`: its output replays as `trackres replay` does; also the check of a folder, and refusals."""

import csv
import json
import re
import subprocess
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from built import EQUAL, have
from hypothesis import example, given
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.snapshot import save
from trackres_ros.learning.learner import ON, Learner
from trackres_ros.learning.parameters import STEP
from trackres_ros.learning.store import continue_session, learner_content
from trackres_ros.tools.export.c_source import check_names, in_c
from trackres_ros.tools.export.exporting import Request, translated

EFFECT = '''
"""A guard that the belt touches."""

from trackres_ros.effects import Effect, Parameter, Terms


class SideGuard(Effect):
    name = "side_guard"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "a guard touches the belt"
    needs = ("speed",)
    parameters = (Parameter("torque", "Nm", 0.0, 2000.0, 300.0, "while it touches", off=0.0),)

    def terms(self, at, p):
        return Terms(torque=p.torque * at.direction)
'''


def read(path):
    """Columns of a CSV; an empty cell is nan."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


@pytest.fixture
def own(tmp_path, good):
    """A vehicle with an effect of its own."""
    good("vehicle", "new", "mine", "--like", "ztbus_hess19", cwd=tmp_path)
    (tmp_path / "guard.py").write_text(EFFECT)
    with (tmp_path / "mine.yaml").open("a") as file:
        file.write("effect_files: [guard.py]\neffects:\n  side_guard: {torque: {value: 80.0, range: [60.0, 100.0]}}\n")
    return tmp_path


@pytest.mark.skipif(not have("cmake", "gcc"), reason="cmake or gcc is not installed")
def test_the_program_beside_it_gives_the_rows_of_a_replay(own, good):
    good("export", "c", "mine.yaml", "-o", "out", cwd=own)
    random, time = np.random.default_rng(4), np.arange(0.0, 300.0, 0.05)
    time[4000:] += 9 * 86400.0  # a pause of more than one step may last
    kmh = np.clip(np.cumsum(random.normal(0.0, 0.3, len(time))), -5.0, 45.0)
    lines = [
        f"{t:.3f},{v:.4f},{20 + 0.01 * t:.2f},{'' if i % 7 else 200000 + i},ignored"
        for i, (t, v) in enumerate(zip(time, kmh, strict=True))
    ]
    lines[3000:3000] = [f"{time[2990]:.3f},{kmh[2999]:.4f},20.0,,late"]
    lines[:1], lines[7:7] = ["", lines[0]], ["", ""]  # empty lines, and the mark of UTF-8
    text = "\ufefftime_s,speed_kmh,ambient_degc,weight_n,remark\n" + "\n".join(lines) + "\n\n"
    (own / "drive.csv").write_text(text, encoding="utf-8")
    subprocess.run(["cmake", "-S", "out", "-B", "out/build"], cwd=own, check=True, capture_output=True)
    subprocess.run(["cmake", "--build", "out/build"], cwd=own, check=True, capture_output=True)
    with (own / "c.csv").open("w") as file:
        subprocess.run(["out/build/trackres_replay", "drive.csv"], cwd=own, check=True, stdout=file)
    tr.replay(own / "drive.csv", own / "mine.yaml", output=own / "replay.csv")
    result, expectation = read(own / "c.csv"), read(own / "replay.csv")
    assert len(result["time_s"]) == len(time)
    assert np.abs(expectation["effects_nm"]).max() > 50.0
    for name, column in expectation.items():
        np.testing.assert_allclose(result[name], column, rtol=EQUAL, atol=EQUAL, err_msg=name)


def test_an_export_belongs_until_something_changes(own, trackres):
    assert trackres("export", "c", "mine.yaml", "-o", "out", cwd=own).returncode == 0
    assert trackres("export", "--check", "out", cwd=own).returncode == 0
    changes = {
        "guard.py": "values of the vehicle",
        "out/trackres.c": "trackres.c was changed after the export",
        "mine.yaml": "the vehicle file",
    }
    for name, text in changes.items():
        result_before = (own / name).read_text()
        (own / name).write_text(result_before + ("# \n" if name[-1] != "c" else " "))
        outcome = trackres("export", "--check", "out", "--json", cwd=own)
        assert outcome.returncode == 1
        assert any(text in line for line in json.loads(outcome.stdout)["differs"]), outcome.stdout
        (own / name).write_text(result_before)
    (own / "mine.yaml").rename(own / "moved.yaml")
    assert "give its path" in trackres("export", "--check", "out", cwd=own).stderr
    assert trackres("export", "--check", "out", "--vehicle", "moved.yaml", cwd=own).returncode == 0


def test_an_effect_that_c_cannot_say_is_refused_with_its_line(own, refused):
    text = EFFECT.replace("        return Terms(torque=p.torque", '        name = "a"\n        return Terms(torque=len(name)')
    (own / "guard.py").write_text(text)
    line = text.splitlines().index('        name = "a"') + 1
    shown_text = refused("export", "c", "mine.yaml", "-o", "out", cwd=own)
    assert f"guard.py:{line}: given" in shown_text
    assert "own-effect.md" in shown_text
    assert not (own / "out").exists()


@pytest.mark.parametrize("name", ["mine.yaml", "xgd24d"])
def test_the_export_begins_with_what_a_restarted_node_knows(own, trackres, name, monkeypatch):
    monkeypatch.chdir(own)
    estimator, random = tr.Estimator(tr.load_vehicle(name)), np.random.default_rng(3)
    session, learner = estimator.session(), Learner(estimator, ON)
    session.handle(at.SPEED, 0, 0, 1.0)
    s, numbers = learner.learned, list(learner.own)
    for learned_values in (s.mean, s.applied):
        learned_values[numbers] = random.uniform(0.2, 0.5, len(numbers)) * np.fmin(learner.prior.high[numbers], 0.1)
        learned_values[at.OF_BELT] = 3.0 if estimator.assemblies else 0.0
    s.aim[:] = s.applied
    s.covariance *= 0.1
    save(session, own / "off", 0.0, learner_content(learner))
    refusal = trackres("export", "c", name, "-o", "out", "--state", "off", cwd=own)
    assert "without active learned parameters" in refusal.stderr
    s.fresh.better, s.lasting_nm, s.step_s, s.mean[STEP] = True, 250.0, 10.0, 250.0
    save(session, own / "on", 0.0, learner_content(learner))
    export_result = translated(Request(name, state=Path("on")))
    repetition, live = Learner(estimator, ON), estimator.session()
    continue_session(live, repetition, json.loads((own / "on").read_text())["learning"], off_s=0.0)
    for i in range(30):
        row = live.handle(at.SPEED, i * 10**8, i * 10**8, 0.0).row.tolist()
        repetition.take(i * 10**8, row, live)
    first = slice(0, at.Learned.sensitivities.start)
    begins = next(array.start for array in export_result.parts.arrays if array.name == "carried_learned")
    assert begins[first] == pytest.approx(live.learned[first], rel=1e-3, abs=1e-6)
    assert live.learned[at.Learned.on] == 1.0
    assert live.learned[at.Learned.torque] == at.Learned(live.learned).departures[at.OF_BELT] == 0.0


def test_the_head_names_vehicle_file_hash_and_version(own, good):
    for _ in range(2):  # an export is replaced by another
        good("export", "c", "mine.yaml", "-o", "out", cwd=own)
    head = (own / "out" / "trackres.h").read_text()[:900]
    digest = json.loads((own / "out" / "trackres_export.json").read_text())["vehicle_sha256"]
    assert all(part in head for part in ("mine.yaml", digest, tr.__version__))


@pytest.mark.parametrize("name", ["main.c", "CMakeLists.txt", "trackres.c", "trackres.h"])
def test_an_export_replaces_only_an_export(own, refused, name):
    foreign = own / "out" / name
    foreign.parent.mkdir()
    foreign.write_text("of another program")
    assert f"another {name}" in refused("export", "c", "mine.yaml", "-o", "out", cwd=own)
    assert [path.read_text() for path in foreign.parent.iterdir()] == ["of another program"]


@given(st.lists(st.text("abABz_-09", min_size=1, max_size=4), unique=True, max_size=6))
@example(["front-left", "front_left"])
@example(["a", "A"])
def test_each_name_of_an_axle_has_its_own_in_c(axles):
    channels = ("speed", *(f"load/{axle}" for axle in axles))
    in_capitals = {in_c(channel).upper() for channel in channels}
    assert all(re.fullmatch("[A-Z_][A-Z0-9_]*", name) for name in in_capitals)
    with nullcontext() if len(in_capitals) == len(channels) else pytest.raises(InputError, match="rename one of them"):
        check_names(channels)


@pytest.mark.parametrize("content", ["", "[]", "{", '{"format": "trackres-export", "version": 1}'])
def test_a_folder_without_an_export_is_refused(content, tmp_path, refused):
    (tmp_path / "trackres_export.json").write_text(content)
    assert "written by trackres export c" in refused("export", "--check", tmp_path)

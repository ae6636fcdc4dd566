# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`tr.diagnose` is `trackres diagnose`, as objects."""

import copy
import json
import pickle
import re
import shutil
import sys
from contextlib import suppress
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from faults import Faults, contents, shown

import trackres_ros as tr
from trackres_ros.diagnosis.base.loading import load_base
from trackres_ros.diagnosis.prepare.session import WarningNote
from trackres_ros.diagnosis.report.charts import Picture
from trackres_ros.files import own_files
from trackres_ros.files.resources import shipped_road_vehicles
from trackres_ros.vehicle import RoadVehicle
from trackres_ros.vehicle.writing.changes import FileChanges


@pytest.fixture(scope="module")
def found(scrub_result):
    return scrub_result[0]


@pytest.fixture(scope="module")
def written(found, tmp_path_factory):
    return found.report(tmp_path_factory.mktemp("found") / "report")


def values_of(vehicle):
    return {path: (q.value, q.low, q.high, q.flag) for path, q in vehicle.parameters.items()}


def effects_of(vehicle):
    return [(a.effect.name, dict(a.values), dict(a.ranges)) for a in vehicle.effects]


def test_it_finds_what_the_command_finds(scrub_result, scrubbed):
    (result, stages), (_, of_command, outcome) = scrub_result, scrubbed
    assert result.as_dict() == of_command
    assert result.sentence == of_command["verdict"]["sentence"]
    assert (result.status, result.grade) == ("named", "confirmed")
    assert outcome.stdout.startswith(repr(result))
    assert [f"  {stage}" for stage in (*stages, "report")] == outcome.stderr.splitlines()


PAST = "the acceleration from past speeds alone"


@pytest.mark.parametrize(
    ("computed", "says"),
    [
        ((), ""),
        (("heading",), ""),  # that no effect needs
        (("accel",), PAST),
        (("yaw_rate", "heading"), "no yaw rate"),
        (("accel", "grade", "yaw_rate"), f"{PAST}, no slope from the altitude, no yaw rate"),
    ],
)
def test_it_says_which_inputs_a_replay_does_not_compute(found, computed, says):
    other, d = copy.copy(found), found.diagnosis
    sessions = [replace(s, computed=frozenset(computed)) for s in d.gated.sessions]
    other.diagnosis = replace(d, gated=replace(d.gated, sessions=sessions))
    assert (f"A replay computes {says}, so its error is larger" in repr(other)) == bool(says)
    assert ("A replay computes" in repr(other)) == bool(says)


def test_the_report_is_the_commands(written, found, scrubbed):
    folder, _, _ = scrubbed
    names = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
    assert names == {path.relative_to(written) for path in written.rglob("*") if path.is_file()}
    assert {path.name for path in found.written} <= {name.name for name in names}
    for name in names:
        statement, text = (without_provenance((place / name).read_bytes()) for place in (folder, written))
        assert statement == text, name


def without_provenance(content):
    """A file without the table of when and by which command it was made."""
    return re.sub(rb'<table id="provenance">.*?</table>', b"", content, flags=re.DOTALL)


def test_the_vehicle_is_that_of_the_written_file(found, written):
    loaded = tr.load_vehicle(written / "vehicle.yaml")
    assert values_of(found.vehicle) == values_of(loaded)
    assert effects_of(found.vehicle) == effects_of(loaded)
    assert [name for name, _, _ in effects_of(loaded)] == ["turning_scrub"]
    assert found.vehicle is found.vehicle
    assert found.vehicle.source.is_file()


def test_the_vehicle_serves_at_once_and_is_better(found, xgd24d, recorded):
    path = recorded("turning_scrub")[1]
    error = {}
    for name, value in (("given", xgd24d), ("found", found.vehicle)):
        result = tr.replay(path, value)
        moves = np.abs(result["speed_mps"]) > 0.3
        error[name] = float(np.nanmean(np.abs(result["residual_nm"][moves])))
    assert error["found"] < 0.75 * error["given"]


def test_an_effect_that_was_found_says_its_value(found):
    (scrub,) = found.effects
    assert scrub.name == "turning_scrub"
    assert scrub.values["friction"] == pytest.approx(0.3, rel=0.2)
    assert repr(scrub).startswith("<turning_scrub: friction 0.")
    assert repr(scrub).endswith("; confirmed>")


def test_a_diagnosis_is_copied_and_pickled_whole(found):
    for repetition in (copy.deepcopy(found), pickle.loads(pickle.dumps(found))):
        assert repetition.as_dict() == found.as_dict()


def test_a_notebook_shows_sentence_values_and_a_picture(found):
    page = found._repr_html_()
    assert found.sentence.split(":")[0] in page
    assert "friction" in page
    assert "data:image/png;base64," in page
    assert "nan" not in page.split("<img")[0]


def test_the_terminal_shows_the_warnings_alone(found):
    notes = ("an assumption", *(WarningNote(f"{n}.csv: not used") for n in range(12)))
    noted = replace(found.diagnosis, gated=replace(found.diagnosis.gated, notes=notes))
    result = tr.DiagnosisResult(noted, found._base_file, found.recordings)
    assert result.warnings == notes[1:]
    assert json.loads(json.dumps(result.as_dict()))["warnings"] == list(notes[1:])
    assert repr(result).count("Warning: ") == 10
    assert "\n2 more warnings are in report.json." in repr(result)
    assert "an assumption" not in repr(result)
    assert "Warning" not in repr(found)


def test_given_surroundings_stay_and_found_ones_are_not_added(found, xgd24d, effects):
    site, headwind = (tr.effects.Active(effects[name], effects[name].values()) for name in ("grade_profile", "headwind"))
    here = load_base(replace(xgd24d, surroundings=(site,)))
    with_wind = replace(found.diagnosis, kept=FileChanges(None, (headwind,), {}, "a wind is kept"))
    result = tr.DiagnosisResult(with_wind, here, found.recordings)
    assert result.vehicle.surroundings == (site,)
    assert found.vehicle.surroundings == ()


def test_without_the_libraries_of_the_page_the_rest_is_written(found, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    monkeypatch.setattr("trackres_ros.diagnosis.report.pictures.draw_all", lambda *_: [])  # they take long
    (tmp_path / "bare").mkdir()
    result_befores = [tmp_path / "bare" / name for name in ("report.html", "effect_earlier.svg", "of_mine.svg")]
    for file in result_befores:
        file.write_text("<title>Diagnosis of another vehicle</title>")
    with pytest.warns(UserWarning, match=r"no page: .*pip install jinja2"):
        folder = found.report(tmp_path / "bare")
    assert (folder / "vehicle.yaml").is_file()
    assert json.loads((folder / "report.json").read_text()) == found.as_dict()
    assert [file.exists() for file in result_befores] == [False, False, True]  # an earlier page would contradict report.json
    for file in result_befores:
        file.write_text("<title>Of somebody else</title>")
    with pytest.warns(UserWarning, match="no page"):
        found.report(folder)
    assert all(file.exists() for file in result_befores)


def test_a_full_disk_leaves_the_previous_diagnosis(found, tmp_path, monkeypatch):
    def drawn(_, folder):  # the real ones take long
        own_files.write(folder / "believed.svg", b"<svg/>")
        return [Picture(folder / "believed.svg", "believed", "as believed")]

    monkeypatch.setattr("trackres_ros.diagnosis.report.pictures.draw_all", drawn)
    monkeypatch.setattr("trackres_ros.tasks.diagnose._plots", lambda _: "not drawn")
    folder = found.report(tmp_path / "report")
    result_before = dict.fromkeys([name for name in contents(folder) if not name.startswith("rubber/")], b"of the run before")
    result_before |= {"report.html": b"<title>Diagnosis of the run before</title>", "effect_before.svg": b"of the run before"}
    result_before |= {"notes.txt": b"of the user"}
    assert {"vehicle.yaml", "report.json", "believed.svg"} < set(result_before)
    for call in count(1, 3):
        shutil.rmtree(folder)
        for name, content in result_before.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        failed = True
        with Faults(folder, call, call) as faults, suppress(tr.InputError, OSError):
            found.report(folder)
            failed = False
        result_after = shown(folder)
        if failed:
            assert result_after == result_before, (call, faults.calls)
            continue
        assert "effect_before.svg" not in result_after
        assert result_after.pop("notes.txt") == b"of the user"
        assert b"of the run before" not in result_after.values(), (call, faults.calls)
        if not faults.hit:
            break
    assert call > 60


def test_a_vehicle_that_was_changed_in_memory_is_refused(recorded, xgd24d):
    from trackres_ros.vehicle import variants

    changed = variants(xgd24d)({"chassis.bearing_friction": 0.004})
    with pytest.raises(tr.InputError, match=r"chassis\.bearing_friction"):
        tr.diagnose(recorded(), changed)


def test_a_road_vehicle_is_given_by_name_and_comes_back_as_one(found):
    name = next(iter(shipped_road_vehicles()))
    base = load_base(name)
    nothing = replace(found.diagnosis, base=base.base, kept=FileChanges(None, (), {}, "nothing is kept"))
    result = tr.DiagnosisResult(found.diagnosis, base, found.recordings)
    result.diagnosis = nothing
    road = result.vehicle
    assert isinstance(road, RoadVehicle)
    assert dict(road.values) == dict(base.base.vehicle.values)
    assert load_base(road).title == base.title


def test_matrices_are_computed_by_one_thread(recorded):
    control, used = pytest.importorskip("threadpoolctl"), []

    def threads():
        return {library["num_threads"] for library in control.threadpool_info() if library["user_api"] == "blas"}

    def at_the_first_stage(_):
        used.append(threads())
        raise InterruptedError

    with control.threadpool_limits(2, user_api="blas"):
        result_before = threads()
        with pytest.raises(InterruptedError):
            tr.diagnose(recorded(), "xgd24d", on_stage=at_the_first_stage)
        assert used == [{1}]
        assert threads() == result_before


@pytest.mark.parametrize("command", [tr.diagnose, tr.coastdown])
@pytest.mark.parametrize("used", [True, False])
def test_only_lines_in_use_give_settings(tmp_path, command, used):
    (tmp_path / "drive.csv").write_text("time_s,speed_mps,a\n0,1,20\n1,2,20\n")
    source = {"column": "a"} if used else {"topic": "/a", "type": "a/msg/A", "field": "a"}
    topics = {f"belt/{side}_left": {**source, "sensor": sensor} for side, sensor in (("front", "mean"), ("rear", "surface"))}
    with pytest.raises(tr.InputError) as error_info:  # the recording is too short too
        command(tmp_path / "drive.csv", "xgd24d", topics=topics)
    assert ("one sensor and std_k for all belts" in str(error_info.value)) == used

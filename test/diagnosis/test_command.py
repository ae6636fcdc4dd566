# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres diagnose` as a user types it."""

import html
import json
import re
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from trackres_ros.cli.main import cli
from trackres_ros.diagnosis import read_recordings
from trackres_ros.diagnosis.report.content import report
from trackres_ros.diagnosis.stages.prepare import prepared
from trackres_ros.errors import InputError
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.offline.replay import replay
from trackres_ros.recording.opening import open_source
from trackres_ros.vehicle import load

FORM = {"schema", "recordings", "base", "verdict", "effects", "heldout", "not_visible", "rejected", "advice"}


def test_the_schema_of_the_report_refuses_what_is_none(scrubbed, check_form):
    _, found, _ = scrubbed
    check_form(found)
    check_form({**found, "more": 1})  # additions are allowed
    for bad in (
        {key: value for key, value in found.items() if key != "verdict"},
        {**found, "schema": 2},
        {**found, "verdict": {**found["verdict"], "grade": "sure"}},
        {**found, "effects": [{**found["effects"][0], "parameters": {"friction": 0.3}}]},
        {**found, "heldout": {**found["heldout"], "mae": {"nominal": "60"}}},
    ):
        with pytest.raises(jsonschema.ValidationError):
            check_form(bad)


def found_in(run, paths, out, *options):
    """The report of a run that went well."""
    done = run(paths, out, *options)
    assert done.exit_code == 0, done.exception
    return json.loads((out / "report.json").read_text())


def table(path):
    header = path.read_text().splitlines()[0].split(",")
    return header, np.loadtxt(path, delimiter=",", skiprows=1)


def changed(path, folder, **columns):
    """A copy of a table with columns changed by functions."""
    header, rows = table(path)
    for name, change in columns.items():
        rows[:, header.index(name)] = change(rows[:, header.index(name)])
    copy = folder / path.name
    np.savetxt(copy, rows, delimiter=",", header=",".join(header), comments="", fmt="%.6f")
    return copy


def test_it_names_what_was_left_out_and_how_large_it_is(scrubbed):
    _, found, done = scrubbed
    assert set(found) >= FORM
    assert found["verdict"]["status"] == "named"
    (effect,) = found["effects"]
    assert effect["name"] == "turning_scrub"
    low, high = effect["parameters"]["friction"]["ci95"]
    assert low < 0.3 < high
    assert 0.38 * 0.3 < high - low < 0.45 * 0.3  # a fifth either way for the function, and a little for the noise
    assert effect["evidence"]["stability"] >= 0.8
    assert found["verdict"]["sentence"] in done.output
    assert any(r["variable"] == "yaw rate" for r in effect["where"]["regime"])
    assert effect["where"]["time"]


def test_the_fit_improves_on_laps_it_never_saw(scrubbed):
    _, found, _ = scrubbed
    mae, low = found["heldout"]["mae"], found["heldout"]["improvement_ci95"][0]
    assert mae["with_effects"] < 0.6 * min(mae["refitted"], mae["nominal"])
    assert low > 0.0


def test_the_vehicle_file_it_leaves_is_what_it_fitted(scrubbed, recorded, tmp_path):
    out, found, _ = scrubbed
    vehicle = load(out / "vehicle.yaml")
    assert [a.effect.name for a in vehicle.effects] == ["turning_scrub"]

    def error(of):
        errors = []
        replay(open_source([recorded("turning_scrub")[1]]), Estimator(of), lambda steps: errors.append(steps.rows))
        rows, columns = np.concatenate(errors), Estimator(of).column_index
        residual = rows[:, columns["residual_nm"]][np.abs(rows[:, columns["speed_mps"]]) > 0.3]
        return np.nanmean(np.abs(residual))

    # Each sample has 45 Nm of noise; what is above it was the missing effect.
    assert error(vehicle) < 0.75 * error(load("xgd24d"))
    assert found["verdict"]["sentence"] in (out / "vehicle.yaml").read_text().replace("# ", "")


def test_the_page_says_the_same_as_the_report(scrubbed):
    out, found, _ = scrubbed
    page = (out / "report.html").read_text()
    assert html.escape(found["verdict"]["sentence"], quote=False) in html.unescape(page)
    for stage in ("nominal", "refitted", "with_effects"):
        shown = re.search(rf'id="mae-{stage}">([^<]+)<', page).group(1)
        assert float(shown) == pytest.approx(found["heldout"]["mae"][stage], rel=5e-3)
    assert page.count("<img") == page.count('alt="') > 4
    assert not re.search(r'(src|href)="(?!data:|#)', page)


def test_without_an_effect_it_names_none(run, recorded, tmp_path):
    found = found_in(run, recorded(), tmp_path / "out")
    assert found["verdict"]["status"] == "none"
    assert not found["effects"]


def test_a_parameter_that_is_off_is_no_physics(recorded, tmp_path):
    content = yaml.safe_load(load("xgd24d").source.read_text())
    content["chassis"]["bearing_friction"].update(value=0.0045, range=[0.0015, 0.0075])
    content["rubber"]["file"] = str(load("xgd24d").source.parent / content["rubber"]["file"])
    vehicle = tmp_path / "off.yaml"
    vehicle.write_text(yaml.safe_dump(content))
    command = ["diagnose", *map(str, recorded()), "--vehicle", str(vehicle), "-o", str(tmp_path / "out"), "--quick", "--no-page"]
    assert CliRunner().invoke(cli, command).exit_code == 0
    found = json.loads((tmp_path / "out" / "report.json").read_text())
    assert found["verdict"]["status"] == "none"
    assert "bearing_friction" in found["verdict"]["sentence"]
    assert found["base"]["refitted"]["bearing_friction"]["value"] == pytest.approx(0.0075, rel=0.1)


def test_python_and_command_give_the_same_for_the_same_seed(scrubbed, recorded, diagnosed):
    assert report(diagnosed, recorded("turning_scrub")) == scrubbed[1]


def test_what_is_hidden_is_not_used(run, recorded, tmp_path):
    found = found_in(run, recorded("turning_scrub"), tmp_path / "out", "--hide", "yaw_rate", "--hide", "heading")
    why = {n["name"]: n["why"] for n in found["not_visible"]}
    assert "yaw_rate" in why["turning_scrub"]
    assert all(e["name"] != "turning_scrub" for e in found["effects"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"torque_nm": lambda x: -x}, "scale of -1"),
        ({"torque_nm": lambda x: x * 1e-3}, "scale of 1000"),
        ({"torque_nm": lambda x: np.full_like(x, 500.0)}, "torque"),
        ({"speed_mps": lambda x: x * 3.6}, "0.27778"),
        ({"speed_mps": lambda x: 0.0 * x}, "moves"),
        ({"torque_nm": lambda x: np.full_like(x, np.nan)}, "no torque"),
    ],
)
def test_what_cannot_be_used_is_refused_with_a_remedy(run, recorded, tmp_path, change, said):
    bad = [changed(path, tmp_path, **change) for path in recorded()]
    done = run(bad, tmp_path / "out")
    assert isinstance(done.exception, InputError)
    assert said in str(done.exception)


def test_too_short_is_refused(run, recorded, tmp_path):
    short = tmp_path / "short.csv"
    short.write_text("\n".join(recorded()[0].read_text().splitlines()[:50]))
    done = run([short], tmp_path / "out")
    assert isinstance(done.exception, InputError)
    assert "120 s" in str(done.exception)


def test_a_gap_is_counted_and_does_not_make_an_effect(run, recorded, tmp_path):
    holed = []
    for path in recorded():
        lines = path.read_text().splitlines()
        holed.append(tmp_path / path.name)
        holed[-1].write_text("\n".join(lines[:900] + lines[1500:]))
    found = found_in(run, holed, tmp_path / "out")
    assert found["verdict"]["status"] == "none"
    left_out = {x["reason"]: x["samples"] for x in found["rejected"]}
    assert 2 * 100 < left_out["no speed"] < 2 * 125


def test_a_channel_without_values_or_life_is_as_if_not_recorded(run, recorded, tmp_path):
    paths = recorded("turning_scrub")
    dead = {"yaw_rate_radps": lambda x: 0.0 * x, "heading_rad": lambda x: np.nan * x}
    found = found_in(run, [changed(path, tmp_path, **dead) for path in paths], tmp_path / "out")
    assert any(n["name"] == "turning_scrub" for n in found["not_visible"])
    assert not any("turning_scrub" in e["class"] for e in found["effects"])
    assert sum("never changes" in note for note in found["notes"]) == len(paths)


def test_recordings_of_two_vehicles_are_told(recorded, loaded, tmp_path):
    one, *others = recorded(count=3)
    recordings = read_recordings([changed(one, tmp_path, torque_nm=lambda x: x + 6000.0), *others], None)
    checked, *_ = prepared(recordings, loaded)
    (told,) = (note for note in checked.notes if "same vehicle" in note)
    assert told.startswith(f"{tmp_path / one.name}: ")


def test_what_is_noted_of_recordings_is_in_the_report(diagnosed):
    noted = replace(diagnosed, gated=replace(diagnosed.gated, notes=("something is odd",)))
    assert report(noted, [])["notes"] == ["something is odd"]


def test_where_nothing_is_explained_nothing_is_concluded(run, recorded, tmp_path):
    rng = np.random.default_rng(2)
    (path,) = recorded(count=1, minutes=5.0)
    done = run([changed(path, tmp_path, torque_nm=lambda x: rng.normal(4000.0, 3000.0, len(x)))], tmp_path / "out")
    assert isinstance(done.exception, InputError)
    assert "no conclusion is possible" in str(done.exception)
    assert not (tmp_path / "out").exists()


def bad_files(good, folder):
    """Files that cannot be used, by the reason that is to be given."""
    lines = good[0].read_text().splitlines()
    (folder / "copy").mkdir()
    standing = changed(good[1], folder / "copy", speed_mps=lambda v: 0.0 * v).rename(folder / "standing.csv")
    contents = {
        "at least 120 s": ("short.csv", lines[:50]),
        "no torque": ("no_torque.csv", [",".join(line.split(",")[:-2]) for line in lines]),
        "line 901": ("cut.csv", [*lines[:900], lines[900][:20]]),
        "a rosbag2 directory": ("notes.txt", ["rain"]),
    }
    for name, content in contents.values():
        (folder / name).write_text("\n".join(content))
    return {"a vehicle that moves": standing, **{reason: folder / name for reason, (name, _) in contents.items()}}


def test_order_names_and_bad_files_change_nothing(run, recorded, tmp_path):
    texts = []
    for folder, names, order in ((tmp_path / "a", "123", (0, 1, 2)), (tmp_path / "b", "312", (2, 0, 1))):
        folder.mkdir()
        good = []
        for name, path in zip(names, recorded(count=3, minutes=4.0), strict=True):
            good.append(changed(path, folder, time_s=lambda t: t - t[0]).rename(folder / f"{name}.csv"))
        bad = bad_files(good, folder) if texts else {}
        found = found_in(run, [*bad.values(), *(good[i] for i in order)], folder / "out")
        for reason, path in bad.items():
            (note,) = (n for n in found["notes"] if n.startswith(f"{path}: not used: "))
            assert reason in note
        found["notes"] = [n for n in found["notes"] if "not used: " not in n]
        found["rejected"] = [x for x in found["rejected"] if "left out" not in x["reason"]]
        text = json.dumps(found)
        for i, path in enumerate(good):
            text = text.replace(str(path), f"drive {i}")
        texts.append(text)
    assert texts[0] == texts[1]
    done = run(list(bad.values()), tmp_path / "out")
    assert isinstance(done.exception, InputError)
    assert all(path.name in str(done.exception) and reason in str(done.exception) for reason, path in bad.items())


def test_a_recording_that_is_not_there_is_refused(run, recorded, tmp_path):
    done = run([*recorded(), tmp_path / "nothing.csv"], tmp_path / "out")
    assert isinstance(done.exception, InputError)
    assert "no such file or folder" in str(done.exception)


def test_one_speed_alone_shows_little_and_says_so(run, loaded, tmp_path):
    n = 3000
    time, speed = 0.2 * np.arange(n), np.full(n, 5.0)
    rng = np.random.default_rng(3)
    columns = {"time_s": time, "speed_mps": speed, "torque_nm": rng.normal(5500.0, 40.0, n)}
    path = tmp_path / "steady.csv"
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    found = found_in(run, [path], tmp_path / "out")
    assert len(found["not_visible"]) > 10
    assert found["verdict"]["status"] in ("none", "one_of", "unexplained") or found["verdict"]["grade"] != "confirmed"
    assert found["written"]["effects"] == []


def test_a_clock_that_is_off_is_put_right(run, recorded, tmp_path):
    moved = []
    for path in recorded("turning_scrub"):
        header, rows = table(path)
        late = np.roll(rows[:, header.index("torque_nm")], 25)  # 5 s
        moved.append(changed(path, tmp_path, torque_nm=lambda x, late=late: late))
    found = found_in(run, moved, tmp_path / "out")
    assert sum("; corrected" in note for note in found["notes"]) == 2
    assert [e["name"] for e in found["effects"]] == ["turning_scrub"]


def test_a_speed_that_reads_too_high_is_in_the_class(run, recorded, tmp_path):
    paths = []
    for path in recorded():
        header, rows = table(path)
        speed = rows[:, header.index("speed_mps")]
        way = np.concatenate([[0.0], np.cumsum(np.abs(speed[1:] + speed[:-1]) / 2.0 * np.diff(rows[:, header.index("time_s")]))])
        rows = np.column_stack([rows, way])
        rows[:, header.index("speed_mps")] *= 1.04
        keep = [
            i
            for i, name in enumerate([*header, "distance_m"])
            if not name.startswith(("accel", "distance_m")) or i == len(header)
        ]
        names = ",".join([*header, "distance_m"][i] for i in keep)
        paths.append(tmp_path / path.name)
        np.savetxt(paths[-1], rows[:, keep], delimiter=",", header=names, comments="", fmt="%.6f")
    found = found_in(run, paths, tmp_path / "out")
    assert any("is 4.0% more than the recorded distance" in note for note in found["notes"])
    assert any("speed_scale" in e["class"] for e in found["effects"])


def test_options_are_checked(run, recorded, tmp_path):
    for options, said in ((("--hide", "gradient"), "did you mean grade"), (("--holdout", "nobody"), "part of a name")):
        done = run(recorded(), tmp_path / "out", *options)
        assert isinstance(done.exception, InputError)
        assert said in str(done.exception)

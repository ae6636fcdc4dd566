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
from csv_tables import changed, rewritten, written
from scipy.integrate import cumulative_trapezoid

from trackres_ros.diagnosis import pipeline, read_recordings
from trackres_ros.diagnosis.preparation import checked_sessions
from trackres_ros.diagnosis.report.content import report
from trackres_ros.errors import InputError

FORM = {"schema", "recordings", "base", "verdict", "effects", "heldout", "not_visible", "rejected", "advice"}


def test_the_schema_of_the_report_refuses_what_is_none(scrubbed, check_form):
    _, result, _ = scrubbed
    check_form(result)
    check_form({**result, "more": 1})  # additions are allowed
    for bad in (
        {key: value for key, value in result.items() if key != "verdict"},
        {**result, "schema": 2},
        {**result, "verdict": {**result["verdict"], "grade": "sure"}},
        {**result, "effects": [{**result["effects"][0], "parameters": {"friction": 0.3}}]},
        {**result, "heldout": {**result["heldout"], "mae": {"nominal": "60"}}},
    ):
        with pytest.raises(jsonschema.ValidationError):
            check_form(bad)


def found_in(run, paths, out, *options):
    """The report of a run that went well."""
    process = run(paths, out, *options)
    assert process.exit_code == 0, process.exception
    return json.loads((out / "report.json").read_text())


def test_it_names_what_was_left_out_and_how_large_it_is(scrubbed):
    _, result, outcome = scrubbed
    assert set(result) >= FORM
    assert result["verdict"]["status"] == "named"
    (effect,) = result["effects"]
    assert effect["name"] == "turning_scrub"
    low, high = effect["parameters"]["friction"]["ci95"]
    assert low < 0.3 < high
    assert 0.38 * 0.3 < high - low < 0.45 * 0.3  # a fifth either way for the function, and a little for the noise
    assert effect["evidence"]["stability"] >= 0.8
    assert result["verdict"]["sentence"] in outcome.output
    assert any(r["variable"] == "yaw rate" for r in effect["where"]["regime"])
    assert effect["where"]["time"]
    mae, low = result["heldout"]["mae"], result["heldout"]["improvement_ci95"][0]
    assert mae["with_effects"] < 0.6 * min(mae["refitted"], mae["nominal"])
    assert low > 0.0


def test_the_vehicle_file_begins_with_the_verdict(scrubbed):
    output, result, _ = scrubbed
    assert result["verdict"]["sentence"] in (output / "vehicle.yaml").read_text().replace("# ", "")


def test_each_written_file_is_listed_with_its_place(scrubbed):
    output, _, outcome = scrubbed
    listed = outcome.output.rpartition(f"{output}: ")[2].split("\n")[0].split(", ")
    assert sorted(listed) == sorted(str(path.relative_to(output)) for path in output.rglob("*") if path.is_file())


def test_the_page_says_the_same_as_the_report(scrubbed):
    output, result, _ = scrubbed
    page = (output / "report.html").read_text()
    assert html.escape(result["verdict"]["sentence"], quote=False) in html.unescape(page)
    for stage in ("nominal", "refitted", "with_effects"):
        shown = re.search(rf'id="mae-{stage}">([^<]+)<', page).group(1)
        assert float(shown) == pytest.approx(result["heldout"]["mae"][stage], rel=5e-3)
    assert page.count("<img") == page.count('alt="') > 4
    assert not re.search(r'(src|href)="(?!data:|#)', page)


def test_a_gap_is_counted_and_does_not_make_an_effect(run, recorded, tmp_path):
    holed = []
    for path in recorded():
        lines = path.read_text().splitlines()
        holed.append(tmp_path / path.name)
        holed[-1].write_text("\n".join(lines[:900] + lines[1500:]))
    result = found_in(run, holed, tmp_path / "out")
    assert result["verdict"]["status"] == "none"
    assert not result["effects"]
    left_out = {x["reason"]: x["samples"] for x in result["rejected"]}
    assert 2 * 100 < left_out["no speed"] < 2 * 125


def test_a_channel_without_life_or_hidden_is_not_used(run, recorded, tmp_path):
    paths = [changed(path, tmp_path, yaw_rate_radps=lambda x: 0.0 * x) for path in recorded("turning_scrub")]
    result = found_in(run, paths, tmp_path / "out", "--hide", "heading")
    reasons = {n["name"]: n["why"] for n in result["not_visible"]}
    assert "yaw_rate" in reasons["turning_scrub"]
    assert "heading" in reasons["grade_profile"]
    assert not any("turning_scrub" in e["class"] for e in result["effects"])
    assert sum("never changes" in note for note in result["notes"]) == len(paths)


def test_a_channel_without_values_is_as_if_not_recorded(recorded, loaded, tmp_path):
    (path,) = recorded(count=1, minutes=5.0)
    empty = changed(path, tmp_path, ambient_degc=lambda x: np.nan * x)
    given_valuess = [checked_sessions(read_recordings([item], None), loaded)[0].sessions[0].given for item in (path, empty)]
    assert given_valuess[0] - given_valuess[1] == {"ambient"}


def test_recordings_of_two_vehicles_are_told(recorded, loaded, tmp_path):
    item, *others = recorded(count=3)
    recordings = read_recordings([changed(item, tmp_path, torque_nm=lambda x: x + 6000.0), *others], None)
    checked, *_ = checked_sessions(recordings, loaded)
    (statement,) = (note for note in checked.notes if "same vehicle" in note)
    assert statement.startswith(f"{tmp_path / item.name}: ")


def test_what_is_noted_of_recordings_is_in_the_report(diagnosed):
    noted = replace(diagnosed, gated=replace(diagnosed.gated, notes=("something is odd",)))
    assert report(noted, [])["notes"] == ["something is odd"]


def test_where_nothing_is_explained_nothing_is_concluded(run, recorded, tmp_path):
    rng = np.random.default_rng(2)
    (path,) = recorded(count=1, minutes=5.0)
    process = run([changed(path, tmp_path, torque_nm=lambda x: rng.normal(4000.0, 3000.0, len(x)))], tmp_path / "out")
    assert isinstance(process.exception, InputError)
    assert "no conclusion is possible" in str(process.exception)
    assert not (tmp_path / "out").exists()


def bad_files(good, folder):
    """Files that cannot be used, by the reason that is to be given."""
    lines = good[0].read_text().splitlines()
    (folder / "copy").mkdir()
    standing = changed(good[1], folder / "copy", speed_mps=lambda v: 0.0 * v).rename(folder / "standing.csv")
    contents = {
        "at least 120 s": ("short.csv", lines[:50]),
        "no torque": ("no_torque.csv", [",".join(line.split(",")[:-2]) for line in lines]),
        "line 901": ("half_a_line.csv", [*lines[:900], lines[900][:20], lines[901]]),
        "a suffix of many formats": ("notes.txt", ["rain"]),
    }
    for name, content in contents.values():
        (folder / name).write_text("\n".join(content))
    return {"a vehicle that moves": standing, **{reason: folder / name for reason, (name, _) in contents.items()}}


def test_order_names_and_bad_files_change_nothing(run, recorded, tmp_path, monkeypatch):
    """Up to the fits: what is fitted does not know the files."""
    made, prepare = [], pipeline.prepare

    def only_prepared(*given):
        made.append(prepare(*given))
        raise InputError("a test", "a diagnosis", "what is prepared")

    monkeypatch.setattr(pipeline, "prepare", only_prepared)
    for folder, names, order in ((tmp_path / "a", "123", (0, 1, 2)), (tmp_path / "b", "312", (2, 0, 1))):
        folder.mkdir()
        good = []
        for name, path in zip(names, recorded(count=3, minutes=4.0), strict=True):
            good.append(changed(path, folder, time_s=lambda t: t - t[0]).rename(folder / f"{name}.csv"))
        bad = bad_files(good, folder) if made else {}
        assert "what is prepared" in str(run([*bad.values(), *(good[i] for i in order)], folder / "out").exception)
    item, other = made
    for reason, path in bad.items():
        (note,) = (n for n in other.gated.notes if n.startswith(f"{path}: not used: "))
        assert reason in note
    assert len(other.gated.notes) == len(item.gated.notes) + len(bad)
    assert {
        reason_here: seconds for reason_here, seconds in other.gated.exclusions.items() if "left out" not in reason_here
    } == dict(item.gated.exclusions)
    assert item.split.held_out == other.split.held_out
    for a, b in zip(item.sessions, other.sessions, strict=True):
        for name in ("torque", "speed", "accel", "weight", "ambient", "yaw_rate", "heading", "belt", "gap", "used", "block"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    process = run(list(bad.values()), tmp_path / "out")
    assert all(path.name in str(process.exception) and reason in str(process.exception) for reason, path in bad.items())


def test_one_speed_alone_shows_little_and_says_so(run, tmp_path):
    n = 300
    torque = np.random.default_rng(3).normal(5500.0, 40.0, n)
    columns = {"time_s": np.arange(float(n)), "speed_mps": np.full(n, 5.0), "torque_nm": torque}
    result = found_in(run, [written(tmp_path / "steady.csv", columns)], tmp_path / "out")
    assert len(result["not_visible"]) > 10
    assert result["verdict"]["status"] in ("none", "one_of", "unexplained") or result["verdict"]["grade"] != "confirmed"
    assert result["kept"]["vehicle"] == []  # a slope may be the cause, but the vehicle has none


def test_a_clock_that_is_off_is_put_right(recorded, loaded, tmp_path):
    paths = recorded("turning_scrub")
    late = [changed(path, tmp_path, torque_nm=lambda x: np.roll(x, 25)) for path in paths]  # 5 s
    right, moved = (checked_sessions(read_recordings(item, None), loaded)[0] for item in (paths, late))
    assert sum("; corrected" in note for note in moved.notes) == 2
    for value, other in zip(right.sessions, moved.sessions, strict=True):
        pair = value.used & other.used
        pair[:10] = pair[-10:] = False
        assert pair.sum() > 0.9 * value.used.sum()
        np.testing.assert_allclose(other.torque[pair], value.torque[pair], atol=1e-3 * np.ptp(value.torque))


def test_a_speed_that_reads_too_high_is_in_the_class(run, recorded, tmp_path):
    def too_high(columns):
        del columns["accel_mps2"]
        columns["distance_m"] = cumulative_trapezoid(np.abs(columns["speed_mps"]), columns["time_s"], initial=0.0)
        columns["speed_mps"] *= 1.04

    paths = [rewritten(path, tmp_path, too_high) for path in recorded()[:1]]
    result = found_in(run, paths, tmp_path / "out")
    assert any("is 4.0 % more than the recorded distance" in note for note in result["notes"])
    assert any("speed_scale" in e["class"] for e in result["effects"])


def test_paths_and_options_are_checked(run, recorded, tmp_path):
    for given_values, text in (
        (("--hide", "gradient"), "did you mean grade"),
        (("--holdout", "nobody"), "part of a name"),
        ((tmp_path / "nothing.csv",), "no such file or folder"),
    ):
        process = run([*recorded(), *given_values], tmp_path / "out")
        assert isinstance(process.exception, InputError)
        assert text in str(process.exception)

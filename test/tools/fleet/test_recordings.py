# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which recordings there are, whose they are, and rows that come into their place whole."""

import errno
import os
import shutil
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from fleet_rows import row as good_row

from trackres_ros.errors import InputError, MissingExtraError

pytest.importorskip("fsspec")
pytest.importorskip("pyarrow")

from trackres_ros.files.own_files import PART
from trackres_ros.recording.reading import reading
from trackres_ros.tools.fleet import periods
from trackres_ros.tools.fleet import run as fleet_run
from trackres_ros.tools.fleet import task as fleet_task
from trackres_ros.tools.fleet.dataset import FleetDataset
from trackres_ros.tools.fleet.recordings import LOCK, FoundRecording, find_recordings, is_there
from trackres_ros.tools.fleet.task import AGAIN, Task, analyse, broken_row
from trackres_ros.tools.fleet.trends import without_copies, without_overlaps
from trackres_ros.tools.fleet.vehicles import digest, digest_of_values, one_vehicle, read_fleet

KEPT = "url", "stamp", "inputs"


@pytest.fixture
def folder(tmp_path):
    for name in ("a/one.csv", "a/two.mcap", "b/three.csv.gz", "b/notes.txt", "c/bag/metadata.yaml", "c/bag/bag_0.db3"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    return tmp_path


def names(found, top):
    return [one.url.removeprefix(f"{top}/") for one in found]


def test_a_folder_yields_its_recordings_and_a_bag_folder_is_one(folder):
    assert names(find_recordings([str(folder)]), folder) == ["a/one.csv", "a/two.mcap", "b/three.csv.gz", "c/bag"]


@pytest.mark.parametrize("form", ["{}/a/*.csv", "file://{}/a/*.csv", "{}/a/one.csv"])
def test_paths_globs_and_urls_lead_to_the_same(folder, form):
    assert names(find_recordings([form.format(folder)]), folder) == ["a/one.csv"]


@pytest.mark.parametrize("name", ["a[1].csv", "[ab]", "x::y.csv", "x::y", "what?", "*", "é ü.csv"])
@pytest.mark.parametrize("form", ["{}/", "", "./"])
def test_a_path_that_exists_is_no_glob_and_no_url(folder, monkeypatch, name, form):
    monkeypatch.chdir(folder)
    path = folder / name if "." in name else folder / name / "z.csv"
    path.parent.mkdir(exist_ok=True)
    path.touch()
    (found,) = find_recordings([form.format(folder) + name])
    assert (found.url, found.problem) == (str(path), "")
    assert is_there(found.url)
    path.unlink()
    assert not is_there(found.url)


def test_linked_folders_are_searched_once_and_never_in_a_loop(folder):
    (folder / "elsewhere" / "t2").mkdir(parents=True)
    (folder / "elsewhere" / "t2" / "x.csv").touch()
    (folder / "elsewhere" / "t2" / "back").symlink_to(folder / "depot")
    (folder / "depot" / "t1").mkdir(parents=True)
    (folder / "depot" / "t1" / "y.csv").touch()
    for name, to in (("t2", "../elsewhere/t2"), ("up", "."), ("newest", "t1"), ("again.csv", "../elsewhere/t2"), ("gone", "no")):
        (folder / "depot" / name).symlink_to(to)
    assert names(find_recordings([f"{folder}/depot"]), folder / "depot") == ["again.csv/x.csv", "t1/y.csv"]
    (folder / "depot" / "again.csv").unlink()
    assert names(find_recordings([f"{folder}/depot"]), folder / "depot") == ["t1/y.csv", "t2/x.csv"]


def test_each_recording_comes_once_however_often_it_is_named(folder):
    found = names(find_recordings([str(folder / "a"), str(folder), str(folder / "a" / "one.csv")]), folder)
    assert found[:2] == ["a/one.csv", "a/two.mcap"]
    assert len(list(find_recordings([str(folder), str(folder)]))) == 4


@pytest.mark.parametrize("form", ["{}", "{}/*", "{}/**"])
def test_a_folder_of_results_holds_no_recordings(folder, form):
    before = names(find_recordings([form.format(folder)]), folder)
    results = FleetDataset(folder / "b" / "results")
    results.prepare()
    results.put(row("a"), None)
    with fleet_run.alone(results.folder):
        (results.folder / "alerts.csv").write_text("vehicle\n")
    assert names(find_recordings([form.format(folder)]), folder) == before


@pytest.mark.parametrize("place", ["nowhere", "*.bag", "empty"])
def test_a_place_where_nothing_is_says_so_and_the_others_go_on(folder, place):
    (folder / "empty").mkdir()
    first, *others = find_recordings([str(folder / place), str(folder / "a")])
    assert first.problem
    assert not any(other.problem for other in others)
    assert len(others) == 2


def test_a_name_that_is_not_utf8_is_a_broken_row(folder, in_this_process, monkeypatch):
    fleet, dataset = fleet_of(folder, "vehicles: {a: xgd24d}"), FleetDataset(folder / "results")
    in_this_process(fleet_run)
    monkeypatch.setattr(fleet_run, "analyse", lambda task: {**good_row(1, "a"), "url": task.url, "stamp": task.stamp})
    (folder / "a" / "two.mcap").unlink()
    for name in (b"a/Vers\xfcch.csv", b"a/\xfc/x.csv", b"a/\xff/metadata.yaml"):
        path = folder / os.fsdecode(name)
        path.parent.mkdir(exist_ok=True)
        path.touch()
    places = [str(folder / "a"), str(folder / "a" / "*.csv"), str(folder / os.fsdecode(b"\xfe"))]
    for _ in range(2):  # also with its rows already there
        counts = fleet_run.run(places, fleet, dataset)
        assert (counts.found, counts.broken) == (5, 4)
    assert names(find_recordings(places), folder) == ["a/Vers\\xfcch.csv", "a/one.csv", "a/\\xfc/x.csv", "a/\\xff", "\\xfe"]
    reasons = {one["url"]: one["reason"] for one in dataset.rows() if one["status"] == "broken"}
    assert all(reason.startswith(f"{url}: ") for url, reason in reasons.items())
    assert sum("not UTF-8" in reason for reason in reasons.values()) == 3


@pytest.mark.parametrize("form", ["{}", "{}/*", "file://{}"])
def test_a_folder_that_cannot_be_read_is_a_row_until_it_can(folder, form, in_this_process, monkeypatch):
    fleet, dataset = fleet_of(folder, "vehicles: {a: xgd24d, c: xgd24d}"), FleetDataset(folder / "results")
    in_this_process(fleet_run)
    monkeypatch.setattr(fleet_run, "analyse", lambda task: {**good_row(1, "a"), "url": task.url, "stamp": task.stamp})
    scandir = os.scandir

    def refused(path):
        if path in closed:
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refused)
    dataset.folder.mkdir()
    (dataset.folder / LOCK).touch()
    (folder / "a" / "deep" / "deeper").mkdir(parents=True)
    (folder / "a" / "deep" / "deeper" / "x.csv").touch()
    everything = ["a/deep/deeper/x.csv", "a/one.csv", "a/two.mcap", "b/three.csv.gz", "c/bag"]
    for names_of, there in (
        ((), everything),
        (("a/deep/deeper", "c"), ["a/deep/deeper", *everything[1:4], "c"]),
        (("a",), ["a", *everything[3:]]),
        ((), everything),
    ):
        closed = [f"{folder}/{name}" for name in names_of]
        found = list(find_recordings([form.format(folder)]))
        assert sorted(names(found, folder)) == there
        assert [one.problem for one in found if one.url in closed] == ["PermissionError: Permission denied"] * len(closed)
        fleet_run.run([form.format(folder)], fleet, dataset)
        of_now = {one["url"] for one in dataset.rows() if "Permission" in (one["reason"] or "")}
        assert of_now == set(closed)


def test_an_unknown_kind_of_url_is_one_line():
    with pytest.raises(InputError, match="fsspec knows"):
        list(find_recordings(["nonsense://x"]))


def test_the_stamp_changes_with_the_file(folder):
    (before,) = find_recordings([str(folder / "a" / "one.csv")])
    (folder / "a" / "one.csv").write_text("another")
    (after,) = find_recordings([str(folder / "a" / "one.csv")])
    assert before.stamp != after.stamp
    (bag,) = find_recordings([str(folder / "c")])
    (folder / "c" / "bag" / "bag_0.db3").write_text("another one")
    (other,) = find_recordings([str(folder / "c")])
    assert bag.url == other.url
    assert bag.stamp != other.stamp


def fleet_of(tmp_path, text):
    path = tmp_path / "fleet.yaml"
    path.write_text(text)
    return read_fleet(path)


def test_a_recordings_vehicle_comes_from_its_folder_or_pattern(tmp_path):
    fleet = fleet_of(
        tmp_path, 'vehicles: {t1: xgd24d, t2: {file: xgd24d, recordings: ["other/*.csv"], limits: {bearing_friction: 0.01}}}'
    )
    assert fleet.vehicle_of("/data/t1/x.csv").name == "t1"
    assert fleet.vehicle_of("s3://bucket/other/y.csv").name == "t2"
    assert fleet.vehicles["t2"].limits == {"bearing_friction": 0.01}
    with pytest.raises(InputError, match="of no vehicle"):
        fleet.vehicle_of("/data/t10/x.csv")
    with pytest.raises(InputError, match="t1, t2"):
        fleet.vehicle_of("/data/t1/other/x.csv")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("vehicles: {}", "vehicles"),
        ("vehicles: {a/b: xgd24d}", "folder"),
        ("vehicles: {..: xgd24d}", "folder"),
        ("vehicles: {none: xgd24d}", "folder"),
        ("vehicles: {a: nothing.yaml}", "nothing.yaml"),
        ("vehicles: {a: {fil: xgd24d}}", "did you mean file?"),
        ("vehicles: {a: {file: }}", "vehicles.a.file: given None"),
        ("vehicles: {a: ''}", "fleet.yaml: vehicles.a: given ''"),
        ("vehicles: {a: {file: xgd24d, topics: ''}}", "fleet.yaml: vehicles.a.topics"),
        ("vehicles: {a: {file: xgd24d, topic: x}}", "topics"),
        ("vehicles: {a: {file: xgd24d, recordings: 3}}", "a text or a list"),
        ("vehicles: {a: {file: xgd24d, limits: {x: hot}}}", "limits"),
        *((f"vehicles: {{{name}: xgd24d}}", "in quotes") for name in ("0123", "12e3", "yes", "0x1F", "1_0", "1:30", "~", "1.50")),
        ("vehicles: {7: xgd24d, '7': xgd24d}", "each name once"),
        ("vehicle: {a: xgd24d}", "vehicles"),
        ("[1, 2]", "vehicles"),
    ],
)
def test_a_bad_fleet_file_is_one_line(tmp_path, text, part):
    with pytest.raises(InputError, match=part) as refused:
        fleet_of(tmp_path, text)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["7", "2026-06-01", "1.5", '"0123"', "'yes'", "-3"])
def test_a_vehicle_has_the_name_that_its_file_says(tmp_path, name):
    assert list(fleet_of(tmp_path, f"vehicles:\n  {name} : xgd24d\n").vehicles) == [name.strip("'\"")]


@pytest.mark.parametrize("of", [digest, digest_of_values])
@pytest.mark.parametrize(
    "text",
    ["dbc: x.f", "dbc: [y, x.f]", "dbc: {1: x.f}", "effect_files: [x.f]", "rubber: {file: x.f}", f"dbc: [x.f, {'y' * 999}]"],
)
def test_a_digest_follows_whatever_file_is_named(tmp_path, of, text):
    (tmp_path / "t.yaml").write_text(text)
    seen = {of(tmp_path / "t.yaml")}
    for content in "ab":
        (tmp_path / "x.f").write_text(content)
        seen.add(of(tmp_path / "t.yaml"))
    assert len(seen) == 3


def test_words_of_a_vehicle_file_do_not_alter_its_values(tmp_path):
    files = [tmp_path / f"{number}.yaml" for number in range(3)]
    for file, value, words in zip(files, (1.0, 1.0, 2.0), ("a", "b", "a"), strict=True):
        file.write_text(f"# {words}\ntitle: {words}\nx: {{value: {value}, reason: {words}}}\n")
    assert len(set(map(digest, files))) == 3
    assert digest_of_values(files[0]) == digest_of_values(files[1]) != digest_of_values(files[2])


def row(url, **more):
    vehicle = more.pop("vehicle", "t 1/é")
    return {**broken_row(FoundRecording(url, "1"), vehicle, "x", "why"), **more}


def test_a_row_is_read_back_unchanged_and_replaces_the_old_one(tmp_path):
    dataset = FleetDataset(tmp_path)
    dataset.prepare()
    good = good_row(1, "t 1/é", "2026-01")
    first = dataset.put({**good, "url": "a"}, None)
    (back,) = dataset.rows()
    assert {name: back[name] for name in good} == {**good, "url": "a"}
    second = dataset.put(row("a", stamp="2", day="2026-01-03"), first)
    assert not first.exists()
    assert second.exists()
    assert [r["day"] for r in dataset.rows(["url", "day"])] == ["2026-01-03"]


def test_what_a_killed_run_leaves_is_no_row(tmp_path):
    dataset = FleetDataset(tmp_path)
    dataset.prepare()
    old = dataset.put(row("a"), None)
    os.utime(old, (1.0, 1.0))
    new = dataset.put(row("a", stamp="2"), None)  # it died before it took the older away
    (new.parent / f"{new.name}xyz{PART}").write_bytes(b"half")
    torn = new.parent / "0000-0000.parquet"
    torn.write_bytes(new.read_bytes()[:100])
    dataset.prepare()
    index = dataset.index()
    assert list(index) == ["a"]
    assert index["a"].stamp == "2"
    assert not old.exists()
    assert not torn.exists()
    assert not list(tmp_path.rglob(f"*{PART}"))


def test_any_tool_can_read_the_dataset(tmp_path):
    pd = pytest.importorskip("pandas")
    dataset = FleetDataset(tmp_path)
    for url in ("a", "b"):
        dataset.put(row(url, vehicle="t1", day="2026-01-02", mismatch=0.5), None)
    frame = pd.read_parquet(tmp_path / "rows")
    assert sorted(frame["url"]) == ["a", "b"]
    assert set(frame["vehicle"].astype(str)) == {"t1"}


def good(vehicle, start_s):
    dated = {"vehicle": vehicle, "start_s": start_s, "duration_s": 600.0, "url": f"{vehicle}{start_s}", "day": "2026-01-01"}
    return {**dated, "status": "good"}


def test_a_later_recording_is_dropped_if_its_clock_overlaps():
    rows = [good("a", 1e9), good("a", 1e9 + 300.0), good("a", 1e9 + 600.0), good("b", 1e9 + 100.0)]
    kept, left_out = without_overlaps(rows)
    assert [r["url"] for r in left_out] == ["a1000000300.0"]
    assert "clock" in left_out[0]["reason"]
    assert len(kept) == 3
    undated = [{**good("a", 0.0), "url": name, "day": "none"} for name in "xy"]
    assert len(without_overlaps(undated)[0]) == 2
    between = {**good("a", 1e9 + 100.0), "status": "broken"}
    assert without_overlaps([*rows, between])[1] == left_out


def test_of_equal_beginnings_the_longest_recording_stays():
    whole = good("a", 1e9)
    cut = {**whole, "url": "0", "duration_s": 250.0}
    for rows in ([whole, cut], [cut, whole]):
        assert without_overlaps(rows)[0] == [whole]


@pytest.mark.parametrize(
    ("content", "part"),
    [
        ("time_s,speed_kmh\n0,0\n10,36\n200,36\n", "torque"),
        ("hello", "time_s"),
        ("", ""),
    ],
)
def test_a_broken_recording_is_a_row_with_its_reason(tmp_path, content, part):
    path = tmp_path / "x.csv"
    path.write_text(content)
    done = analyse(Task(str(path), "1", one_vehicle("xgd24d", None).vehicles["xgd24d"]))
    assert done["status"] == "broken"
    assert part in done["reason"]
    assert "\n" not in done["reason"]
    assert "a bug" not in done["reason"]


@pytest.mark.parametrize(
    ("error", "again"),
    [
        (MemoryError(), True),
        (ModuleNotFoundError("No module named 'rosbags'"), True),
        (MissingExtraError("reading bags", "rosbags", "bags"), True),
        (OSError(errno.EIO, "Input/output error"), True),
        (OSError("no gzip file"), False),
        (EOFError("cut off"), False),
    ],
)
def test_a_fault_of_the_machine_is_tried_again(tmp_path, monkeypatch, error, again):
    """Whether it is raised as it is, or as the line that reading makes of it."""

    def raised(_):
        raise error

    def read(_):
        with reading(tmp_path, "a recording"):
            raise error

    task = Task(str(tmp_path / "x.csv"), "1", one_vehicle("xgd24d", None).vehicles["xgd24d"])
    for fault in (raised, read) if again else (read,):
        monkeypatch.setattr(fleet_task, "_content", fault)
        done = analyse(task)
        assert done["inputs"] == (AGAIN if again else task.inputs)
        assert "a bug" not in done["reason"]


@pytest.mark.parametrize("name", ["xgd24d.yaml", "topics/sample.yaml"])
def test_a_file_that_changes_midway_is_a_reason_of_that_run(tmp_path, repository, name):
    shutil.copytree(repository / "config", tmp_path / "config")
    files = tmp_path / "config" / "xgd24d.yaml", tmp_path / "config" / "topics" / "sample.yaml"
    vehicle = one_vehicle(*map(str, files)).vehicles["xgd24d"]
    changed = tmp_path / "config" / name
    changed.write_text(changed.read_text() + "\n# another\n")
    done = analyse(Task(str(tmp_path / "x.csv"), "1", vehicle))
    assert "modified during the run" in done["reason"]
    assert done["inputs"] == AGAIN


def test_a_worker_uses_the_topics_file_as_it_is_now(tmp_path, monkeypatch):
    topics, seen = tmp_path / "topics.yaml", []
    (tmp_path / "x.csv").write_text("time_s,speed_mps,n\n" + "".join(f"{i},{i},9\n" for i in range(60)))
    monkeypatch.setattr(fleet_task, "_replayed", lambda *_: {})
    monkeypatch.setattr("trackres_ros.tools.fleet.likelihood.evidence", lambda _, loaded: seen.append(loaded.known.passenger_kg))
    for kg in (60.0, 90.0):
        topics.write_text(f"speed: {{column: speed_mps}}\npassengers: {{column: n, kg_each: {kg}}}\n")
        analyse(Task(str(tmp_path / "x.csv"), "1", one_vehicle("ztbus_hess19", str(topics)).vehicles["ztbus_hess19"]))
    assert seen == [60.0, 90.0]


@pytest.mark.parametrize(("order", "day"), [(1, 3), (-1, 3), (1, 0)])  # of finished rows; of the recording, 0: broken
def test_equal_content_counts_once_where_it_is_found(tmp_path, monkeypatch, in_this_process, order, day):
    fleet, dataset = fleet_of(tmp_path, "vehicles: {a: xgd24d, b: xgd24d}"), FleetDataset(tmp_path / "results")
    in_this_process(fleet_run)
    run_pieces = fleet_run.run_pieces

    def made(task):
        day = int(Path(task.url).read_text())
        made = broken_row(FoundRecording(task.url, task.stamp), task.vehicle.name, task.inputs, "why")
        return {**(good_row(day, task.vehicle.name) if day else made), **{key: made[key] for key in KEPT}, "content": f"{day}"}

    monkeypatch.setattr(fleet_run, "analyse", made)
    monkeypatch.setattr(fleet_run, "run_pieces", lambda *words: list(run_pieces(*words))[::order])
    for name, content in (("a/1.csv", 1), ("b/2.csv", 2), ("a/x.csv", day), ("b/y.csv", day)):
        (tmp_path / "depot" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "depot" / name).write_text(f"{content}")
    dataset.put(row(f"{dataset.folder}/alerts.csv"), None)  # earlier versions took results for recordings
    for before, after, counts in (
        ("", "", "a/x.csv"),
        ("a/x.csv", "", "b/y.csv"),
        ("b/y.csv", "b/z.csv", "b/z.csv"),
        ("b/z.csv", "a/z.csv", "a/z.csv"),
        ("a/z.csv", "b/z.csv", "b/z.csv"),  # its row of that name is still there
        ("b/z.csv", "", "b/z.csv"),  # a deleted recording still counts
    ):
        if after:
            (tmp_path / "depot" / before).rename(tmp_path / "depot" / after)
        elif before:
            (tmp_path / "depot" / before).unlink()
        found = fleet_run.run([f"{tmp_path}/depot"], fleet, dataset)
        there = [int(path.read_text()) for path in tmp_path.glob("depot/*/*.csv")]
        assert (found.kept + found.good, found.broken) == (len(there) - there.count(0), there.count(0))
        counted, _ = without_copies(dataset.rows(["url", "vehicle", "status", "copy_of"]))
        diagnosed = [url for one in periods.periods(dataset, fleet, found.urls, ()) for url in one.urls]
        assert sorted(diagnosed) == sorted(one["url"] for one in counted if one["status"] == "good")
        both = () if day or before else ("b/y.csv",)  # broken ones that are found are no copies
        expected = {f"{tmp_path}/depot/{name}" for name in ("a/1.csv", "b/2.csv", counts, *both)}
        assert {one["url"] for one in counted} == expected


def test_a_report_stays_unless_its_recordings_are_at_fault(tmp_path, monkeypatch, in_this_process):
    fleet, dataset, asked = fleet_of(tmp_path, "vehicles: {a: xgd24d}"), FleetDataset(tmp_path), []

    def diagnose(paths, *_, **__):
        asked.append([int(path.stem) for path in paths])
        if fault:
            raise fault
        return SimpleNamespace(report=lambda folder: (folder.mkdir(), (folder / "report.json").write_text(f"{asked[-1]}")))

    def outcome(period):
        try:
            return period, periods.diagnose_period(period)
        except InputError as error:
            return period, error

    in_this_process(periods)
    monkeypatch.setattr(periods, "run_pieces", lambda _client, _function, work: map(outcome, work))
    monkeypatch.setattr("trackres_ros.diagnose", diagnose, raising=False)
    missing, short = MissingExtraError("reading bags", "rosbags", "bags"), InputError("x", "no torque", "some")
    there, made = set(), []
    for added, gone, fault, chosen in (
        ([1, 2, 3, 4, 5, 6, 7], [], None, [1, 3, 5, 7]),
        ([], [3, 7], None, None),  # their rows still count
        ([8], [], missing, [1, 4, 6, 8]),
        ([], [], None, [1, 4, 6, 8]),
        ([], [1, 2, 4, 5, 6, 8], None, None),
        ([9], [9], None, None),
        ([10], [], None, [10]),
        ([11], [], short, [10, 11]),
    ):
        there = (there | {*added}) - {*gone}
        for number in added:
            (tmp_path / f"{number}.csv").touch()
            dataset.put({**good_row(number, "a"), "url": f"{tmp_path}/{number}.csv", "content": f"{number}"}, None)
        for number in gone:
            (tmp_path / f"{number}.csv").unlink()
        urls = {f"{tmp_path}/{number}.csv" for number in there}
        stayed = periods.diagnose_periods(dataset, fleet, urls, "local", None, (), lambda *_: nullcontext(lambda _: None))
        assert asked == ([chosen] if chosen else [])
        assert [str(missing) in line for line in stayed] == ([True] if fault is missing else [])
        made = made if fault is missing or not chosen else chosen
        ((name, text),) = ((path.name, path.read_text()) for path in tmp_path.glob("diagnosis/a/2026-03/re*"))
        assert (name, text) == (("reason.txt", str(short)) if fault is short else ("report.json", f"{made}"))
        asked.clear()

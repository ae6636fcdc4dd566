# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Changes as rows for other programs, and the text of a month with recordings without a load."""

import csv
import json
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from fleet_rows import row as good_row
from waiting import wait_for

pytest.importorskip("fsspec")
pytest.importorskip("pyarrow")

from proofs.fleet import write_recording
from trackres_ros.diagnosis import load_base
from trackres_ros.errors import InputError
from trackres_ros.tools.fleet.alerts import COLUMNS, alerts, checked_url
from trackres_ros.tools.fleet.changes import DAY_S
from trackres_ros.tools.fleet.compare import REPORT, compare, compare_text
from trackres_ros.tools.fleet.dataset import LISTS_OF_NUMBERS, NUMBERS, FleetDataset
from trackres_ros.tools.fleet.page.write import write_pages
from trackres_ros.tools.fleet.periods import DIAGNOSES, INPUTS, REASON, verdicts
from trackres_ros.tools.fleet.recordings import FoundRecording
from trackres_ros.tools.fleet.run import alone, keep_limits, limits_of
from trackres_ros.tools.fleet.sample import draw_fleet
from trackres_ros.tools.fleet.task import Task, analyse, broken_row
from trackres_ros.tools.fleet.trends import day_of, sentences, trends, without_copies
from trackres_ros.tools.fleet.vehicles import digest_of_values, one_vehicle, read_fleet
from trackres_ros.vehicle.writing.changes import FileChanges

BEGIN_S, RECORDINGS = 1.75e9, 12


def row(vehicle, number, mismatch=0.04, load=True, moved=0.0):
    """A recording that says bearings are `moved` standard deviations of the file off, and everything else is as in the file."""
    start = BEGIN_S + 2.0 * DAY_S * number
    return {
        **good_row(0, vehicle), "url": f"/data/{vehicle}/{number}.csv", "content": f"{vehicle}{number}", "start_s": start,
        "day": day_of(start), "mismatch": mismatch, "load_recorded": load, "vehicle_values": "v", "nominal": [0.0075, 1.0],
        "precision": [400.0, 0.0, 400.0],
        "linear": [400.0 * (moved + 0.02 * np.sin(number)), 8.0 * np.cos(3 * number)],
    }  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folder of a fleet of two vehicles; the bearings of the second one change for good."""
    found = FleetDataset(tmp_path_factory.mktemp("fleet") / "results")
    found.prepare()
    for number in range(RECORDINGS):
        found.put(row("steady", number), None)
        found.put(row("worn", number, moved=1.5 if number >= RECORDINGS // 2 else 0.0), None)
    return found.folder


@pytest.fixture
def dataset(written, tmp_path):
    """A copy of it that a test may change."""
    return FleetDataset(shutil.copytree(written, tmp_path / "results"))


@contextmanager
def hook(answer):
    """A web server on loopback that answers a POST with a code; returns its address and the received content."""
    received = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            received.append((self.headers["Content-Type"], self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(answer)
            self.send_header("Location", "/elsewhere")
            self.end_headers()

        def log_message(self, *_):
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/secret", received
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_changes_are_a_table_a_message_and_an_exit_code(dataset, trackres, tmp_path):
    with hook(204) as (url, received):
        done = trackres("trend", dataset.folder, "--alerts", tmp_path / "a.csv", "--webhook", url, "--exit-code", "--json")
    assert done.returncode == 3
    (alert,) = json.loads(done.stdout)["alerts"]
    assert (alert["vehicle"], alert["parameter"]) == ("worn", "bearing_friction")
    ((kind, body),) = received
    assert kind == "application/json"
    assert json.loads(body)["alerts"] == [alert]
    with (tmp_path / "a.csv").open() as file:
        (written,) = csv.DictReader(file)
    assert tuple(written) == COLUMNS == tuple(alert)
    assert written["text"] == alert["text"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_an_alert_is_sent_though_nothing_can_be_printed(dataset):
    with hook(204) as (url, received), Path("/dev/full").open("w") as full:
        words = ("trend", dataset.folder, "--webhook", url, "--exit-code")
        done = subprocess.run([sys.executable, "-m", "trackres_ros", *words], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 3
    assert done.stderr == "trackres: standard output: No space left on device\n"
    assert len(received) == 1


@pytest.mark.parametrize("answer", [302, 500])
def test_a_webhook_that_fails_is_a_warning_and_exit_code_4(dataset, trackres, answer):
    with hook(answer) as (url, _):
        done = trackres("trend", dataset.folder, "--webhook", url)
    assert done.returncode == 4
    assert f"answered {answer}" in done.stderr
    assert "secret" not in done.stderr
    assert "worn: bearing_friction" in done.stdout
    done = trackres("trend", dataset.folder, "--webhook", url)  # nobody listens there any more
    assert done.returncode == 4
    assert "the webhook failed: http://127.0.0.1" in done.stderr


@pytest.mark.parametrize("kind", ["step", "ramp"])
def test_a_repaired_fault_stays_an_alert_with_its_end(dataset, kind):
    for number in range(3 * RECORDINGS):
        off = 0.0 if not 8 <= number < 20 else 1.5 if kind == "step" else 0.3 * (number - 7)
        dataset.put(row("worn", number, moved=off), None)
    found = trends(dataset, {None: {"bearing_friction": 0.012}})
    (alert,) = alerts(found)
    assert (alert["kind"], alert["since"], alert["ended"], alert["limit"]) == (kind, *(row("", n)["day"] for n in (8, 20)), None)
    assert alert["text"].endswith(f"and came back by {alert['ended']}")
    assert f"back by {alert['ended']}" in write_pages(dataset.folder, found, dataset).read_text()


def test_without_a_change_nothing_is_sent_and_the_exit_code_is_0(dataset, trackres, tmp_path):
    words = ("trend", dataset.folder, "--name", "steady", "--webhook", "http://127.0.0.1:9", "--exit-code")
    done = trackres(*words, "--alerts", tmp_path / "a.csv")
    assert (done.returncode, done.stderr) == (0, "")
    assert f"{RECORDINGS} of {RECORDINGS} recordings of 1 vehicle compared" in done.stdout
    assert (tmp_path / "a.csv").read_text().splitlines() == [",".join(COLUMNS)]


@pytest.mark.parametrize(
    "url", ["ftp://x/y", "http://", "x", "http://h:99999/", "http://h:x/", "file:///etc/passwd", "http://a b/"]
)
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(InputError, match="--webhook"):
        checked_url(url)


@pytest.mark.parametrize("limit", ["-1", "inf", "nan", "1e13", "", "x"])
def test_a_limit_is_finite_and_not_negative(refused, limit, dataset, tmp_path):
    assert "--limit" in refused("trend", dataset.folder, "--limit", f"bearing_friction={limit}")
    (tmp_path / "fleet.yaml").write_text(f"vehicles: {{a: {{file: xgd24d, limits: {{bearing_friction: {limit or 'x'}}}}}}}")
    with pytest.raises(InputError, match="limits"):
        read_fleet(tmp_path / "fleet.yaml")


def test_a_limit_is_its_vehicles_own_and_a_given_one_of_all(dataset, tmp_path):
    of_both = "{worn: {file: xgd24d, limits: {bearing_friction: 0.012}}, b: {file: xgd24d, limits: {bearing_friction: 0.03}}}"
    (tmp_path / "fleet.yaml").write_text(f"vehicles: {of_both}")
    fleet = read_fleet(tmp_path / "fleet.yaml")
    keep_limits(dataset.folder, fleet)
    kept = limits_of(dataset.folder, {})
    assert {name: of for name, of in kept.items() if of} == {name: v.limits for name, v in fleet.vehicles.items()}
    with pytest.raises(InputError, match="--limit"):
        trends(dataset, {None: {"film_scale": 1.0}})
    assert trends(dataset, {"b": {"film_scale": 1.0}}) == trends(dataset, {})  # of a vehicle without a usable recording
    for number in range(RECORDINGS):
        of_file = {"vehicle_values": fleet.vehicles["worn"].values}
        dataset.put({**row("worn", number, moved=0.3 * max(0, number - 4)), **of_file}, None)
    given = limits_of(dataset.folder, {"bearing_friction": 0.02})
    for limits, limit in (({}, None), ({"b": kept["b"]}, None), (kept, 0.012), (given, 0.02)):
        (change,) = trends(dataset, limits, vehicle="worn")["vehicles"]["worn"]["changes"]
        assert change["kind"] == "ramp"
        assert (change["forecast"] and change["forecast"]["limit"]) == limit
    (dataset.folder / "fleet.json").write_text('{"limits": {"bearing_friction": 0.012}}')  # of version 0.1.0
    assert limits_of(dataset.folder, {}) == {None: {"bearing_friction": 0.012}}


def test_recordings_without_load_do_not_set_a_months_mean(dataset):
    dataset.put(row("steady", RECORDINGS, mismatch=0.5, load=False), None)
    dataset.put(row("unloaded", 0, mismatch=0.5, load=False), None)
    found = trends(dataset, {})
    month = day_of(BEGIN_S + 2.0 * DAY_S * RECORDINGS)[:7]
    cell = found["months"]["steady"][month]
    assert cell["mismatch"] == pytest.approx(0.04)
    assert cell["without_load"] == 1
    assert found["vehicles"]["steady"]["mismatch"] == pytest.approx(0.04)
    (only,) = found["months"]["unloaded"].values()
    assert only["mismatch"] is None
    assert "2 recordings have no load" in "\n".join(sentences(found))
    page = write_pages(dataset.folder, found, dataset).read_text()
    assert '<small class="unloaded">50.0 % · 1, 1 without load' in page
    assert "4.0 % · 5, 1 without load" in page
    assert "50.0 % without load" in (dataset.folder / "vehicles" / "steady.html").read_text()


def test_a_recording_without_a_day_alters_no_search_for_changes(dataset):
    before = trends(dataset, {})
    for vehicle in ("steady", "worn", "timeless"):
        dataset.put({**row(vehicle, RECORDINGS), "start_s": 0.0, "day": "none"}, None)
    found = trends(dataset, {})
    assert found["vehicle_years"] == before["vehicle_years"]
    for name, was in before["vehicles"].items():
        now = found["vehicles"][name]
        assert all(now[key] == was[key] for key in ("first_day", "last_day", "years"))
        assert now["recordings"] == was["recordings"] + 1
        assert now["least_gain"] == pytest.approx(was["least_gain"], rel=0.1)
        assert [c["since"] for c in now["changes"]] == [c["since"] for c in was["changes"]]
        assert all(min(times) > 1e9 for times, *_ in now["levels"].values())
    timeless = found["vehicles"]["timeless"]
    assert (timeless["first_day"], timeless["years"], timeless["changes"], timeless["levels"]) == (None, 0.0, [], {})
    assert [one["vehicle"] for one in found["undated"]] == ["steady", "timeless", "worn"]
    assert "3 recordings not searched for changes" in "\n".join(sentences(found))
    page = write_pages(dataset.folder, found, dataset).read_text()
    assert all(f"{one['url']}: its clock gives no day" in page for one in found["undated"])


def report(folder, effects, **refitted):
    """A folder of a diagnosis with values and their intervals."""

    def each(values):
        return {
            name: {"unit": "Nm", "value": value, "ci95": ci95, "of_file": of[0] if of else None}
            for name, (value, ci95, *of) in values.items()
        }

    folder.mkdir()
    content = {
        "base": {"refitted": each(refitted)},
        "effects": [{"name": name, "parameters": each(of)} for name, of in effects.items()],
    }
    (folder / REPORT).write_text(json.dumps(content))
    return str(folder)


def test_each_parameter_of_two_reports_is_compared_or_listed(tmp_path):
    one = report(tmp_path / "1", {}, a=(1.0, [0.9, 1.1]), b=(2.0, [1.0, 3.0]), c=(3.0, None), d=(4.0, [3.0, 5.0]))
    of_other = {"drag": {"size": (7.0, [6.0, 8.0]), "end": (8.0, None)}}
    other = report(tmp_path / "2", of_other, a=(1.15, [1.05, 1.25]), b=(9.0, [8.0, 10.0]), c=(5.0, None), d=(6.0, [None, 7.0]))
    found = compare(one, other)
    assert [(q["parameter"], q["differs"]) for q in found["parameters"]] == [("a", False), ("b", True)]
    assert [(q["parameter"], q["one"], q["other"], q["why"]) for q in found["not_compared"]] == [
        ("d", 4.0, 6.0, "only a bound is known in other"),
        ("c", 3.0, 5.0, "only a bound is known in one and in other"),
        ("drag.size", None, 7.0, "not in one"),
        ("drag.end", None, 8.0, "not in one"),
    ]
    for line in compare_text(found).splitlines()[3:5]:  # the column and the verdict have one threshold
        change, reach, differs = line.split()[-3:]
        assert (abs(float(change)) > float(reach)) == (differs == "yes")
    assert compare_text(found).count("Not compared: ") == 4


def test_factors_on_values_of_two_files_are_compared_over_one(tmp_path):
    """As of a month whose vehicle file is that of the month before: 1.2 times 40 is what 1 times 48 is."""
    one = report(tmp_path / "1", {}, film=(1.2, [1.1, 1.3], 40.0), heat=(1.2, None, 40.0))
    other = report(tmp_path / "2", {}, film=(1.0, [0.95, 1.05], 48.0), heat=(1.0, None, 48.0))
    found = compare(one, other)
    (film,), (heat,) = found["parameters"], found["not_compared"]
    assert (film["other"], heat["other"]) == pytest.approx((1.2, 1.2))
    assert film["other_std"] == pytest.approx(0.06 / 1.96)
    fitted = load_base("xgd24d").base
    fitted.write(tmp_path / "v.yaml", FileChanges(fitted.nominal | {"film_scale": 1.2, "capacity_scale": 1.1}, (), {}), "fitted")
    designs = {q["parameter"]: q["other"] for q in compare("xgd24d", str(tmp_path / "v.yaml"))["parameters"]}
    assert (designs["film_scale"], designs["capacity_scale"]) == pytest.approx((1.2, 1.1), rel=1e-5)
    for folder, of_file in (("may", 40.0), ("june", 48.0)):
        FleetDataset(tmp_path / folder).put({**row("worn", 0), "of_file": [None, of_file]}, None)
        FleetDataset(tmp_path / "both").put({**row(folder, 0), "of_file": [None, of_file]}, None)
    assert [one["vehicles"] for one in trends(FleetDataset(tmp_path / "both"), {})["types"]] == [["june"], ["may"]]
    bearings, loss = compare(str(tmp_path / "may"), str(tmp_path / "june"))["parameters"]
    assert (bearings["one"], 1.2 * loss["one"]) == pytest.approx((bearings["other"], loss["other"]))


def test_only_searched_vehicles_may_be_false_alarms(dataset):
    for number in range(3):
        dataset.put(row("new", number), None)
    for rate in (0.2, 10.0):
        found = trends(dataset, {}, rate)
        expected = {name: vehicle["expected_false_alarms"] for name, vehicle in found["vehicles"].items()}
        assert expected["new"] == 0.0 < expected["steady"] <= 0.5  # of an unchanged vehicle's draws at most half may pass
        assert found["expected_false_alarms"] == pytest.approx(sum(expected.values()))
    assert "1 vehicle has too few recordings to look for a change" in sentences(found)
    write_pages(dataset.folder, found, dataset)
    for name, searched in (("new", False), ("steady", True)):
        text = (dataset.folder / "vehicles" / f"{name}.html").read_text()
        assert ("not changed beyond chance" in text, "too few recordings" in text) == (searched, not searched)


FITTED, ANY = {"nominal": [0.009, 1.0]}, {}


@pytest.mark.parametrize(
    ("vehicle", "known", "other"),  # before or after another vehicle; whether the present file is known; the older file
    [("first", False, FITTED), ("first", True, ANY), ("worn", False, ANY), ("worn", True, FITTED)],
)
def test_recordings_of_an_older_vehicle_file_are_only_listed(dataset, vehicle, known, other):
    older, present = (range(RECORDINGS // 2), range(RECORDINGS // 2, RECORDINGS))[:: -1 if known else 1]
    if known:
        (dataset.folder / "fleet.json").write_text(json.dumps({"values": {vehicle: "v"}}))
    for number in present:
        dataset.put(row(vehicle, number), None)
    for number in older:
        for path in dataset.folder.glob(f"rows/vehicle={vehicle}/day={row(vehicle, number)['day']}/*"):
            path.unlink()
    alone, one = trends(dataset, {}), f"{dataset.folder}:{vehicle}"
    compared = compare(one, one)
    for number in older:
        dataset.put({**row(vehicle, number), **other, "vehicle_values": "w"}, None)
    found = trends(dataset, {})
    outdated = [f"/data/{vehicle}/{number}.csv" for number in older]
    assert [one["url"] for one in found["outdated"]] == outdated
    assert found == {**alone, "outdated": found["outdated"], "recordings": alone["recordings"] + len(outdated)}
    assert f"{len(outdated)} recordings not used because their vehicle's file has changed" in "\n".join(sentences(found))
    page = write_pages(dataset.folder, found, dataset).read_text()
    assert all(f"{url}: its vehicle file has other values" in page for url in outdated)
    again = compare(one, f"{one}@{row(vehicle, older[0])['day']}")  # of the older file alone
    assert [q["one"] for q in again["parameters"]] == [q["one"] for q in compared["parameters"]]
    assert [one["url"] for one in again["outdated"]] == outdated
    assert again["one"].endswith("(6 recordings, without 6 of an older vehicle file)")
    assert again["other"].endswith("(1 recordings)")
    (dataset.folder / "fleet.json").write_text(json.dumps({"values": {vehicle: "x"}}))
    found = trends(dataset, {})
    assert vehicle not in found["vehicles"]
    assert [line for line in sentences(found) if line.startswith(f"{vehicle}: not compared")]
    with pytest.raises(InputError, match="analyse it again"):
        trends(dataset, {}, vehicle=vehicle)


def test_a_row_without_the_digest_of_its_values_is_compared(dataset):
    before = trends(dataset, {})
    dataset.put({**row("steady", 1), "vehicle_values": None}, None)  # of an earlier version
    assert trends(dataset, {}) == before


@pytest.mark.parametrize(("day", "whole"), [("2025-06-1", False), ("2025-06", True), ("2025", True), ("2025-06-17", True)])
@pytest.mark.parametrize("vehicle", ["worn", "depot:worn@2025"])
def test_a_beginning_of_a_day_is_a_year_a_month_or_a_day(dataset, day, whole, vehicle):
    for number in range(3):
        dataset.put({**row("worn", number), "vehicle": vehicle}, None)
    assert row("worn", 1)["day"] == "2025-06-17"
    side = f"{dataset.folder}:{vehicle}"
    if whole:
        assert f"@{day} (" in compare(f"{side}@{day}", side)["one"]
    else:
        with pytest.raises(InputError, match="a day, month or year"):
            compare(f"{side}@{day}", side)


def test_a_vehicle_with_only_unusable_recordings_has_its_line(dataset):
    silent = dataset.put(broken_row(FoundRecording("/data/silent/1.csv", "1"), "silent", "x", "no speed"), None)
    page = write_pages(dataset.folder, trends(dataset, {}), dataset)
    assert 'href="vehicles/silent.html"' in page.read_text()
    assert "None of its recordings could be compared" in (page.parent / "vehicles" / "silent.html").read_text()
    dataset.put({**row("worn", 0), "url": "/data/silent/1.csv"}, silent)  # with another name its page goes
    write_pages(dataset.folder, trends(dataset, {}), dataset)
    assert sorted(one.name for one in (page.parent / "vehicles").iterdir()) == ["steady.html", "worn.html"]


def test_copies_are_only_listed(dataset):
    before, kept = trends(dataset, {}), row("worn", 0)["url"]
    for name, status in (("copy", "good"), ("worn", "broken")):
        dataset.put({**row("worn", 0), "vehicle": name, "url": f"/data/{name}/x.csv", "status": status, "copy_of": kept}, None)
    for month in ("copy/2025-06", "worn/2025-06", "worn/2025-05"):  # reports of recordings that were elsewhere
        (dataset.folder / DIAGNOSES / month).mkdir(parents=True)
        for name in (INPUTS, REASON):
            (dataset.folder / DIAGNOSES / month / name).touch()
    shown = verdicts(dataset.folder, without_copies(dataset.rows())[0])
    assert [(name, *months) for name, months in shown.items()] == [("worn", "2025-06")]
    found = trends(dataset, {})
    assert [one["url"] for one in found["copies"]] == ["/data/copy/x.csv", "/data/worn/x.csv"]
    assert found == {**before, "copies": found["copies"], "recordings": before["recordings"] + 2}
    assert "2 recordings not used because another recording has the same content" in "\n".join(sentences(found))
    page = write_pages(dataset.folder, found, dataset).read_text()
    assert all(f"{one['url']}: it has the same content as {kept}" in page for one in found["copies"])
    assert "x.csv" not in (dataset.folder / "vehicles" / "worn.html").read_text()


def test_a_row_is_of_the_recorded_load_and_the_file(tmp_path):
    """A hidden one is as one that was not."""
    vehicle = one_vehicle("xgd24d", None).vehicles["xgd24d"]
    (truck,) = draw_fleet(1, 1, 1.0, 3.0, (), seed=1)
    path = write_recording(tmp_path, truck, 0, 3.0)
    with path.open() as file:
        rows = list(csv.DictReader(file))
    for name, dropped in (("with", ()), ("without", ("weight_n",))):
        assert set(dropped) <= set(rows[0])
        with (tmp_path / f"{name}.csv").open("w") as file:
            table = csv.DictWriter(file, [key for key in rows[0] if key not in dropped], extrasaction="ignore")
            table.writeheader()
            table.writerows(rows)
        done = analyse(Task(str(tmp_path / f"{name}.csv"), "1", vehicle))
        assert done["load_recorded"] == (name == "with"), done["reason"]
        assert done["vehicle_values"] == digest_of_values(vehicle.file)
        of_file = {q.name: q.of_file for q in load_base(vehicle.file).base.parameters}
        assert list(done["of_file"]) == [of_file.get(name) for name in done["names"]]
    hidden = analyse(Task(str(tmp_path / "with.csv"), "1", vehicle, hide=("load",)))
    alike = {"load_recorded", *NUMBERS, *LISTS_OF_NUMBERS} - {"took_s"}
    assert {name: hidden[name] for name in alike & set(done)} == {name: done[name] for name in alike & set(done)}


def test_one_run_at_a_time_writes_into_a_folder(tmp_path, refused):
    program = "import sys, time; from pathlib import Path; from trackres_ros.tools.fleet.run import alone\n"
    program += "with alone(Path(sys.argv[1])): print('held', flush=True); time.sleep(600)"
    first = subprocess.Popen([sys.executable, "-c", program, tmp_path / "out"], stdout=subprocess.PIPE, text=True)
    try:
        assert first.stdout.readline() == "held\n"
        assert f"process {first.pid}" in refused("fleet", tmp_path, "--vehicle", "xgd24d", "-o", tmp_path / "out")
    finally:
        first.send_signal(signal.SIGKILL)
        first.communicate()
    assert wait_for(lambda: first.poll() is not None)
    with alone(tmp_path / "out"):
        pass

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The public commands, and the engine as processes of its own on loopback: what dies loses nothing and doubles nothing."""

import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from importlib.util import find_spec
from threading import Thread
from urllib.request import urlopen

import pytest
from waiting import wait_for

pytest.importorskip("distributed")
pytest.importorskip("fsspec")
pytest.importorskip("pyarrow")

from trackres_ros.diagnosis.report import pictures
from trackres_ros.tasks import diagnose as diagnosis
from trackres_ros.tools import engine as executor
from trackres_ros.tools.engine import dashboard, engine, failure_text, run_pieces
from trackres_ros.tools.fleet import periods
from trackres_ros.tools.fleet import run as fleet_run
from trackres_ros.tools.fleet.dataset import FleetDataset

SIX = {f"truck-0{v}/drive_000{n}.csv" for v in (1, 2) for n in (1, 2, 3)}


@pytest.fixture(autouse=True)
def bounded(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "5s")  # a scheduler idles so long if it calls a dead worker


def words(folder, *more):
    paths = [folder / "recordings", "--vehicles", folder / "fleet.yaml", "-o", folder / "out"]
    return ["fleet", *map(str, paths), "--period", "none", *more]


def urls(folder):
    return [row["url"].removeprefix(f"{folder}/recordings/") for row in FleetDataset(folder / "out").rows(["url", "status"])]


def begun(*arguments, cwd=None):
    command = [sys.executable, "-m", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd)


@contextmanager
def scheduler(folder, workers):
    """A scheduler and its workers as processes of their own; gives its address and the processes."""
    file, here = folder / "scheduler.json", ("--host", "127.0.0.1", "--no-dashboard")
    started = [begun("distributed.cli.dask_scheduler", *here, "--port", 0, "--scheduler-file", file)]
    try:
        assert wait_for(lambda: file.exists() and file.read_text(), working=started[0].pid)
        address = json.loads(file.read_text())["address"]
        for _ in range(workers):
            started.append(begun("distributed.cli.dask_worker", address, *here, "--no-nanny", "--nthreads", 1, cwd=folder))
        yield address, started
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.communicate()


def rows_there(folder):
    return list((folder / "out" / "rows").glob("*/*/*.parquet"))


@pytest.mark.long
def test_a_run_analyses_each_recording_and_a_rerun_only_new_ones(recordings, good, refused, in_this_process):
    (recordings / "recordings" / "truck-01" / "broken.csv").write_text("time_s,speed_mps\n")
    (recordings / "recordings" / "stranger.csv").write_text("time_s,speed_mps\n")
    first = json.loads(good(*words(recordings, "--workers", "1", "--json")))
    assert first["run"] == {"found": 8, "kept": 0, "good": 6, "broken": 2}
    assert sorted(urls(recordings)) == sorted({*SIX, "truck-01/broken.csv", "stranger.csv"})
    assert len(first["broken"]) == 2
    in_this_process(fleet_run)
    again = json.loads(good(*words(recordings, "--json")))
    assert again["run"] == {"found": 8, "kept": 6, "good": 0, "broken": 2}
    assert {key: again[key] for key in ("types", "vehicles")} == {key: first[key] for key in ("types", "vehicles")}
    # A file that is only touched is not computed again, a changed one is; neither has two rows.
    touched, changed = (recordings / "recordings" / "truck-02" / f"drive_000{n}.csv" for n in (1, 2))
    os.utime(touched, (1e9, 1e9))
    lines = changed.read_text().splitlines()
    changed.write_text("\n".join(lines[:-50]) + "\n")
    third = json.loads(good(*words(recordings, "--json")))
    assert third["run"] == {"found": 8, "kept": 5, "good": 1, "broken": 2}
    assert len(urls(recordings)) == 8
    trend = json.loads(good("trend", recordings / "out", "--json", "--limit", "bearing_friction=0.02"))
    assert set(trend["vehicles"]) == {"truck-01", "truck-02"}
    compared = json.loads(good("compare", f"{recordings}/out:truck-01", f"{recordings}/out:truck-02", "--json"))
    assert {q["parameter"] for q in compared["parameters"]} >= {"bearing_friction", "loss_modulus_scale"}
    same = json.loads(good("compare", f"{recordings}/out:truck-01", f"{recordings}/out:truck-01", "--json"))
    assert not any(q["differs"] or q["difference"] for q in same["parameters"])
    for given, part in (("out:nobody", "truck-01"), ("out@1999", "a day, month or year")):
        assert part in refused("compare", f"{recordings}/{given}", f"{recordings}/out")
    page = (recordings / "out" / "index.html").read_text()
    assert "truck-01" in page
    assert "http" not in page
    assert (recordings / "out" / "vehicles" / "truck-02.html").exists()


@pytest.mark.long
def test_each_vehicle_has_a_diagnosis_by_month_made_once(recordings, good, in_this_process, monkeypatch):
    by_month, asked, reports, diagnose = [*words(recordings), "--period", "month"], [], [], periods.diagnose_period

    def once(period):
        """The first one is made, the others are copies."""
        asked.append(period.place)
        reports[:] = reports or [diagnose(period)]
        return reports[0]

    monkeypatch.setattr(periods, "diagnose_period", once)
    monkeypatch.setattr(pictures, "draw_all", lambda *_: [])
    monkeypatch.setattr(diagnosis, "_plots", lambda _: "not drawn here")
    for module in (fleet_run, periods):
        in_this_process(module)
    good(*by_month)
    assert asked == ["truck-01/2025-06", "truck-02/2025-06"]
    for vehicle in ("truck-01", "truck-02"):
        report = json.loads((recordings / "out" / "diagnosis" / vehicle / "2025-06" / "report.json").read_text())
        assert len(report["recordings"]) == 3
        page = (recordings / "out" / "vehicles" / f"{vehicle}.html").read_text()
        assert f"diagnosis/{vehicle}/2025-06/report.html" in page
        assert report["verdict"]["sentence"][:30] in page
    good(*by_month)
    changed = recordings / "recordings" / "truck-02" / "drive_0002.csv"
    changed.write_text("\n".join(changed.read_text().splitlines()[:-50]) + "\n")
    good(*by_month)
    assert asked[2:] == ["truck-02/2025-06"]


@pytest.mark.long
def test_a_killed_worker_or_scheduler_loses_no_recording(recordings, good, in_this_process):
    with scheduler(recordings, workers=2) as (address, (head, first, second)):
        killer = Thread(target=lambda: wait_for(lambda: rows_there(recordings), working=first.pid) and first.kill())
        killer.start()
        assert "6 new" in good(*words(recordings, "--engine", address))
        killer.join()
        assert first.wait() == -signal.SIGKILL
        assert sorted(urls(recordings)) == sorted(SIX)
        shutil.rmtree(recordings / "out")
        run = begun("trackres_ros", *words(recordings, "--engine", address))
        assert wait_for(lambda: rows_there(recordings) or run.poll() is not None, working=second.pid)
        head.send_signal(signal.SIGKILL)
        assert wait_for(lambda: run.poll() is not None, working=run.pid, patience_s=120.0)
        _, err = run.communicate()
    assert run.returncode == 2
    assert "run the same command again" in err
    assert len(err.strip().splitlines()) == 1, err
    kept = len(rows_there(recordings))
    assert 0 < kept < len(SIX)
    in_this_process(fleet_run)
    after = json.loads(good(*words(recordings, "--json")))
    assert after["run"] == {"found": 6, "kept": kept, "good": 6 - kept, "broken": 0}
    assert sorted(urls(recordings)) == sorted(SIX)


@pytest.mark.long
def test_work_that_keeps_killing_workers_ends_and_others_finish(capfd, monkeypatch):
    monkeypatch.setattr(executor, "DEATHS", 1)  # a worker takes its time to start
    deadly = "__import__('os').kill(__import__('os').getpid(), 9)"
    with engine("local", 1) as client:
        found = dict(run_pieces(client, eval, ["1 + 1", deadly, "2 + 2"]))
    assert found["1 + 1"] == 2
    assert found["2 + 2"] == 4
    assert "1 workers died" in failure_text(found[deadly])
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.long
def test_a_worker_manages_memory_as_this_process_does(monkeypatch):
    for name in ("MALLOC_TRIM_THRESHOLD_", *executor.ONE_THREAD):
        monkeypatch.delenv(name, raising=False)
    asked = "dict(__import__('os').environ)"
    with engine("local", 1) as client:
        ((_, found),) = run_pieces(client, eval, [asked])
    assert "MALLOC_TRIM_THRESHOLD_" not in found
    assert {name: found[name] for name in executor.ONE_THREAD} == executor.ONE_THREAD


@pytest.mark.long
def test_a_cluster_that_cannot_be_closed_costs_no_result():
    program = """if __name__ == "__main__":
        from distributed.nanny import WorkerProcess
        from trackres_ros.tools.engine import run_pieces, engine
        async def fails(*_, **__):  # as Dask does where a worker that died starts again
            raise AssertionError("can only join a started process")
        WorkerProcess.kill = fails
        with engine("local", 1) as client:
            print(dict(run_pieces(client, eval, ["1 + 1"])))"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (0, "{'1 + 1': 2}\n", "")


@pytest.mark.long
def test_two_engines_run_on_one_machine_each_with_its_page(monkeypatch):
    monkeypatch.setattr(executor, "PAGE_S", 60.0)  # on a busy machine
    with engine("local", 1) as one, engine("local", 1) as other:
        for client in (one, other):
            assert dict(run_pieces(client, eval, ["1 + 1"])) == {"1 + 1": 2}
            if find_spec("bokeh"):
                with urlopen(dashboard(client)) as page:
                    assert page.status == 200


@pytest.mark.long
def test_an_interrupt_while_workers_start_leaves_no_traceback(recordings):
    program = """if __name__ == "__main__":
        import os, signal, sys
        from distributed import Nanny
        from trackres_ros.tasks.main import main
        start = Nanny.start_unsafe
        def interrupted(self):
            os.kill(os.getpid(), signal.SIGINT)
            return start(self)
        Nanny.start_unsafe = interrupted
        main(sys.argv[1:])"""
    run = subprocess.run([sys.executable, "-c", program, *words(recordings, "--workers", "1")], stderr=subprocess.PIPE, text=True)
    assert run.returncode == 130
    # Where a worker starts while this process ends, Python's resource tracker warns of its semaphores.
    lines = [line for line in run.stderr.splitlines() if line and "resource_tracker" not in line]
    assert [line[:22] for line in lines] == ["trackres: interrupted;"]


@pytest.mark.parametrize(("address", "part"), [("tcp://127.0.0.1:1", "no scheduler answers"), ("somewhere", "tcp://HOST:PORT")])
def test_an_engine_that_is_not_there_is_one_line(recordings, refused, monkeypatch, address, part):
    monkeypatch.setattr(executor, "CONNECT_S", 0.3)
    assert part in refused(*words(recordings, "--engine", address))


@pytest.mark.parametrize(
    ("given", "part"),
    [
        (("--vehicle", "xgd24d"), "both"),
        (("--topics", "sample"), "--topics with --vehicle alone"),
        (("--hide", "gradde"), "did you mean grade"),
        (("--hide", "speed"), "--hide"),  # nothing is left to compare
        (("--engine",), "requires an argument"),
    ],
)
def test_bad_options_are_one_line(recordings, refused, given, part):
    assert part in refused(*words(recordings, *given))


def test_a_limit_of_no_parameter_is_refused_before_the_work(tmp_path, refused):
    (tmp_path / "fleet.yaml").write_text("vehicles: {a: {file: xgd24d, limits: {bearing_frictoin: 0.012}}}")
    shown = refused(*words(tmp_path))
    assert all(part in shown for part in ("limits of a", "torque_offset.offset", "did you mean bearing_friction"))
    assert not (tmp_path / "out").exists()


def test_a_vehicle_file_that_the_run_would_replace_is_refused(tmp_path, refused):
    place = tmp_path / "out" / "diagnosis" / "a" / "2025-06"
    place.mkdir(parents=True)
    (place / "vehicle.yaml").write_text("schema: 1\n")
    (tmp_path / "fleet.yaml").write_text("vehicles: {a: out/../out/diagnosis/a/2025-06/vehicle.yaml}")
    assert "copy its folder" in refused(*words(tmp_path, "--period", "month"))
    assert "copy its folder" not in refused(*words(tmp_path))


def test_nothing_that_can_be_used_ends_with_two(tmp_path, refused):
    (tmp_path / "recordings").mkdir()
    (tmp_path / "fleet.yaml").write_text("vehicles: {a: xgd24d}")
    assert "a folder without a recording" in refused(*words(tmp_path))


@pytest.mark.parametrize(
    "command", [("trend", "nowhere"), ("compare", "nowhere", "xgd24d"), ("compare", "nowhere:v@2026", "xgd24d")]
)
def test_what_is_not_there_is_one_line(refused, command, tmp_path):
    said = refused(*command, cwd=tmp_path)
    assert "nowhere" in said
    assert "trackres fleet" in said or command[1] != "nowhere"


def test_the_live_node_imports_none_of_it():
    program = (
        "import sys, trackres_ros.node.application, trackres_ros.estimator.estimator, trackres_ros.tasks.live; "
        "print([m for m in sys.modules if m.startswith(('trackres_ros.tools', 'dask', 'distributed', 'fsspec', 'pyarrow'))])"
    )
    assert subprocess.check_output([sys.executable, "-c", program], text=True).strip() == "[]"

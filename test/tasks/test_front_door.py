# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`import trackres_ros as tr`: its content, available at once, and the only interface of the command line."""

import ast
import copy
import importlib
import inspect
import json
import math
import pickle
import pkgutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.estimator.kernel import COMPILED, INTERPRETED
from trackres_ros.files.resources import config_dir, shipped_road_vehicles
from trackres_ros.learning.columns import columns_of
from trackres_ros.learning.parameters import learnables
from trackres_ros.output.table import unit_of
from trackres_ros.tasks.arguments import LIMITS, as_paths, as_recordings
from trackres_ros.tasks.main import COMMANDS, cli

PACKAGE = Path(tr.__file__).parent
DRIVE = "time_s,speed_kmh,ambient_degc\n" + "".join(f"{i * 0.1:.1f},{min(i, 100) * 0.2:.2f},10\n" for i in range(400))

EXPORTED = {
    "load_vehicle", "check_vehicle", "record_sample", "read", "recover", "replay", "simulate", "explain", "diagnose", "coastdown",
    "effects",
    "Estimator", "Vehicle", "Recording", "Recovered", "InputError", "MissingExtraError",
    "Sample", "ReplayResult", "SimulationResult", "OperatingPoint", "VehicleCheck", "DiagnosisResult", "CoastdownResult",
    "OwnModel",
    "__version__",
}  # fmt: skip

PRINTING = {"tasks", "text", "files", "errors", "units", "progress"}
STARTED = {
    "layouts": {"output.layouts"},
    "live": {"node.application", "node.parameters", "node.process", "node.record", "node.status", "node.ros.estimator",
             "node.dds.node"},
    "play": {"node.dds.player"},
    "recordings": {"recording.topics_files"},
    "simulate": {"estimator.energy"},
    "vehicle": {"effects"},
}  # fmt: skip
"""What commands use of other rooms: an application or a text of their own."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("front")


@pytest.fixture(scope="module")
def sample(folder):
    return tr.record_sample(folder / "lap.mcap", laps=1, speed_kmh=30)


@pytest.fixture(scope="module")
def drive(folder):
    path = folder / "drive.csv"
    path.write_text(DRIVE)
    return path


@pytest.fixture(scope="module")
def replayed(drive, xgd24d):
    return tr.replay(drive, xgd24d)


@pytest.fixture(scope="module")
def printed(good):
    return lambda *words: json.loads(good(*words, "--json"))


def test_what_is_exported():
    assert set(tr.__all__) == EXPORTED
    assert len(tr.__all__) == len(EXPORTED)
    assert dir(tr) == sorted(tr.__all__)
    for name in tr.__all__:
        assert getattr(tr, name) is not None
        assert name == "__version__" or getattr(tr, name).__doc__
    assert (PACKAGE / "py.typed").exists()


def test_what_is_declared_for_editors_is_what_is_there():
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    (declared,) = [node for node in tree.body if isinstance(node, ast.If)]
    names = {alias.name for node in declared.body for alias in node.names}
    assert names | {"__version__"} == EXPORTED
    for node in declared.body:
        for alias in node.names:
            home = importlib.import_module(node.module)
            assert getattr(home, alias.name) is getattr(tr, alias.name)


def test_no_module_hides_what_is_exported():
    modules = {result.name for result in pkgutil.iter_modules(tr.__path__)}
    assert modules & set(tr.__all__) == {"effects"}
    assert tr.effects is sys.modules["trackres_ros.effects"]


def test_a_name_that_is_not_there_is_no_attribute():
    with pytest.raises(AttributeError, match="replai"):
        tr.replai  # noqa: B018


def test_it_is_imported_at_once_and_loads_nothing():
    program = (
        "import sys, time; before = set(sys.modules); began = time.perf_counter(); import trackres_ros as tr; "
        "took = time.perf_counter() - began; new = set(sys.modules) - before; tr.InputError; "
        "late = {'numpy', 'scipy', 'yaml'} & set(sys.modules); "
        "print(took, *(name for name in new if name.startswith('trackres_ros.')), *late)"
    )
    texts = [subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout.split() for _ in range(5)]
    assert all(words[1:] == ["trackres_ros.version"] for words in texts)
    assert min(float(words[0]) for words in texts) < 0.030


def commands_of(path):
    """The functions of a module that click calls, by name, and the modules of the names that the module imports."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    homes = {
        alias.asname or alias.name: (node.module or "").removeprefix("trackres_ros.")
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("trackres_ros")
        for alias in node.names
    }
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    return {node.name: node for node in functions if any("command(" in ast.unparse(item) for item in node.decorator_list)}, homes


def test_the_command_line_calls_nothing_else():
    """Commands print: what they compute is a function of the front door."""
    used = {}
    for path in sorted((PACKAGE / "tasks").glob("*.py")):
        commands, homes = commands_of(path)
        names = {node.id for command in commands.values() for node in ast.walk(command) if isinstance(node, ast.Name)}
        others = {homes[name] for name in names & homes.keys() if homes[name].split(".")[0] not in PRINTING}
        used |= {path.stem: others} if others else {}
    assert used == STARTED


@pytest.mark.parametrize("name", ["diagnose", "explain", "record_sample", "recover", "replay", "simulate"])
def test_a_task_is_called_by_its_command(name):
    commands, _ = commands_of(Path(sys.modules[getattr(tr, name).__module__].__file__))
    calls = {ast.unparse(node.func) for node in ast.walk(commands[f"{name}_command"]) if isinstance(node, ast.Call)}
    assert name in calls


@pytest.mark.parametrize("name", COMMANDS)
def test_a_list_shows_the_first_sentence_of_each_command(name):
    command = cli.get_command(None, name)
    assert COMMANDS[name][1] == command.get_short_help_str(limit=1000)


def test_a_list_of_commands_loads_none_of_them():
    program = "import sys; from trackres_ros.tasks.main import main\ntry: main(['--help'])\nfinally: print(*sys.modules)"
    text = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout
    loaded = set(text.splitlines()[-1].split())
    assert not loaded & {"numpy", "yaml", *(f"trackres_ros.tasks.{module}" for module, _ in COMMANDS.values())}
    assert all(f"\n  {name} " in text for name in COMMANDS)


@pytest.mark.parametrize("given", [str, Path, lambda path: [path]], ids=["text", "path", "list"])
def test_read_takes_a_path_as_it_comes(drive, given):
    recording = tr.read(given(drive))
    assert recording.roles == ("ambient", "speed")
    assert recording.series["speed"].value[-1] == pytest.approx(20 / 3.6)
    assert recording.paths == (drive,)


def test_topics_are_a_file_or_what_stands_in_one(folder, drive):
    path = folder / "topics.yaml"
    path.write_text("speed: {column: speed_kmh, scale: 0.5}\n")
    by_file, by_mapping = tr.read(drive, topics=path), tr.read(drive, topics={"speed": {"column": "speed_kmh", "scale": 0.5}})
    assert by_file.series["speed"].value[-1] == by_mapping.series["speed"].value[-1] == pytest.approx(10.0)
    with pytest.raises(tr.InputError, match="did you mean speed"):
        tr.read(drive, topics={"sped": {"column": "speed_kmh"}})


def test_a_recording_gives_its_samples_in_reading_order(sample, drive):
    from trackres_ros.recording.bindings import Topics
    from trackres_ros.recording.opening import open_source

    for path, topics in ((sample.path, sample.topics), (drive, None)):
        source = open_source([path], Topics.load(topics) if topics else None)
        result_before = list(source.blocks(1000))
        repetition = list(tr.read(path, topics=topics).blocks(777))
        for field in ("role", "stamp_ns", "arrival_ns", "value"):
            item, other = (np.concatenate([getattr(block, field) for block in blocks]) for blocks in (result_before, repetition))
            assert np.array_equal(item, other), field


@pytest.mark.parametrize(
    ("times", "swapped"), [(1, {}), (2, {}), (1, {"ambient": 1}), (1, {"speed": 1}), (1, {"ambient": 3, "speed": 0})]
)
def test_a_recording_made_by_hand_is_replayed_with_speed_last(xgd24d, times, swapped):
    """Also where its time begins anew without one role, and where two neighbours of a role arrived in the wrong order."""
    from trackres_ros.recording.samples import Series

    when = np.tile(np.arange(6) * 1_000_000_000, times)
    value = np.arange(6.0 * times)
    arrived = {role: when.copy() for role in ("speed", "ambient")}
    for role, first in swapped.items():
        arrived[role][[first, first + 1]] = when[[first + 1, first]]
    series = {role: Series(when, arrived[role], value + 10.0 * (role == "ambient")) for role in arrived}
    recording = tr.Recording("by hand", series | {"load": Series(when[:2], when[:2], value[:2])}, zero_is_unset=False)
    (block,) = recording.blocks()
    role, given_values = block.role[block.role < 2], block.value[block.role < 2]
    assert role.tolist() == [1, 0] * 6 * times
    assert given_values[::2].tolist() == (10.0 + value).tolist()
    assert given_values[1::2].tolist() == value.tolist()
    assert recording.aligned()["ambient"] == pytest.approx(10.0 + value, abs=float(bool(swapped)))  # by log time


def test_a_replay_of_what_was_read_is_that_of_the_file(sample, xgd24d):
    read = tr.replay(tr.read(sample.path, topics=sample.topics), xgd24d)
    from_file = tr.replay(str(sample.path), "xgd24d", topics=sample.topics)
    assert repr(read) == repr(from_file)
    assert read.columns == from_file.columns
    for column in read:
        assert np.array_equal(read[column], from_file[column], equal_nan=True), column


def test_results_are_copied_and_pickled_whole(drive, sample, replayed, xgd24d):
    recording = tr.read(drive)
    simulated = tr.simulate(xgd24d, speed_kmh=20, duration_s=5)
    road = tr.load_vehicle(next(iter(shipped_road_vehicles())))
    point = tr.explain(xgd24d, speed_kmh=20, belt_degc=15)
    results = sample, recording, replayed, simulated, point, tr.check_vehicle(xgd24d)
    for item in (xgd24d, road, *results, *(tr.Estimator(xgd24d, entries=e) for e in (COMPILED, INTERPRETED))):
        for repetition in (copy.copy(item), copy.deepcopy(item), pickle.loads(pickle.dumps(item))):
            assert type(repetition) is type(item)
            assert repr(repetition) == repr(item)
    repetition = pickle.loads(pickle.dumps(recording))
    assert repetition.report() == recording.report()
    assert all(np.array_equal(repetition.series[role].value, samples.value) for role, samples in recording.series.items())
    with pytest.raises(TypeError):
        repetition.series["speed"] = None


def test_results_are_compared_and_hashed_by_identity(drive, replayed, xgd24d):
    others = tr.replay(drive, xgd24d), tr.simulate(xgd24d, speed_kmh=20, duration_s=5), tr.read(drive), tr.read(drive)
    assert len({replayed, *others, *others}) == 5
    assert all((item == other_item) == (item is other_item) for item in others for other_item in others)


def test_an_error_is_the_same_in_another_process():
    for item in (tr.InputError("a", 1, "b", "c"), tr.MissingExtraError("to_pandas", "pandas", "notebook", "now")):
        repetition = pickle.loads(pickle.dumps(item))
        assert type(repetition) is type(item)
        assert (str(repetition), repetition.as_dict()) == (str(item), item.as_dict())


def test_arrays_of_results_are_the_callers_own(drive, replayed, xgd24d):
    for result in (replayed, tr.simulate(xgd24d, speed_kmh=20, duration_s=5)):
        for name in result:
            result_before = result[name].copy()
            result[name][:] = 99
            assert np.array_equal(result[name], result_before, equal_nan=True), name
    recording = tr.read(drive)
    for series in recording.aligned().values():
        series[:] = 0.0
    assert recording.series["ambient"].value[0] == 10.0
    for samples in recording.series.values():
        for array in (samples.stamp_ns, samples.arrival_ns, samples.value):
            with pytest.raises(ValueError, match="read-only"):
                array[:] = 99


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "mcap"])
def test_what_is_saved_is_what_the_command_writes(drive, replayed, folder, suffix, printed):
    saved = replayed.save(folder / f"saved.{suffix}")
    written = folder / f"written.{suffix}"
    printed("replay", drive, "--vehicle", "xgd24d", "-o", written)
    assert saved.read_bytes() == written.read_bytes()


def test_a_replay_says_what_the_command_says(drive, replayed, folder, printed):
    statement = printed("replay", drive, "--vehicle", "xgd24d", "-o", folder / "told.csv")
    assert statement.pop("written") == [str(folder / "told.csv"), str(folder / "told.png")]
    assert statement == json.loads(json.dumps(replayed.as_dict()))
    assert (folder / "told.png").read_bytes() == replayed.plot()._repr_png_()


def test_a_replay_into_a_file_does_not_keep_its_rows(drive, replayed, xgd24d, folder):
    seen = []
    result = tr.replay(drive, xgd24d, output=folder / "streamed.csv", progress=seen.append)
    assert sum(seen) == result.messages == 800
    assert (folder / "streamed.csv").read_bytes() == replayed.save(folder / "kept.csv").read_bytes()
    assert repr(result) == repr(replayed)
    for ask in (lambda: result["speed_mps"], lambda: result.save(folder / "more.csv"), result.to_pandas):
        with pytest.raises(tr.InputError, match=r"streamed\.csv"):
            ask()
    assert "resistance" in result._repr_html_()
    assert "speed_mps" in result
    assert "nothing" not in result


def test_a_replay_takes_parameters_and_goes_on_from_a_state(folder, xgd24d, replayed):
    lines = DRIVE.splitlines()
    (folder / "one.csv").write_text("\n".join(lines[:200]) + "\n")
    (folder / "two.csv").write_text("\n".join([lines[0], *lines[200:]]) + "\n")
    tr.replay(folder / "one.csv", xgd24d, save_state=folder / "state.json")
    rest = tr.replay(folder / "two.csv", xgd24d, resume=folder / "state.json")
    torque = replayed["resistance_torque_nm"]
    assert np.array_equal(rest["resistance_torque_nm"], torque[-len(rest["time_s"]) :])
    none = tr.replay(folder / "two.csv", xgd24d, params={"feedforward_parts": []})
    assert not none["feedforward_torque_nm"].any()
    assert rest["feedforward_torque_nm"].any()
    with pytest.raises(tr.InputError, match="gap_s"):
        tr.replay(folder / "two.csv", xgd24d, params={"gap_s": -1})


def test_a_replay_has_no_unknown_column(replayed):
    assert "time_s" in replayed
    with pytest.raises(KeyError):
        replayed["nothing"]


def test_pandas_has_every_column_with_its_unit(replayed, folder):
    pd = pytest.importorskip("pandas")
    frame = replayed.to_pandas()
    saved = pd.read_csv(replayed.save(folder / "frame.csv"), index_col="time_s")
    assert list(frame) == list(saved)
    pd.testing.assert_frame_equal(frame, saved, check_dtype=False, rtol=1e-12)
    assert frame.index.name == "time_s"
    units = frame.attrs["units"]
    assert units["resistance_torque_nm"] == "N m"
    assert units["belt_degc/front_left"] == "degC"
    assert [name for name, unit in units.items() if not unit] == ["reasons"]
    for learnable in learnables(tr.load_vehicle("ztbus_hess19")):
        assert [unit_of(name) for name in columns_of(learnable)[:2]] == 2 * [
            {"1": "", "Nm": "N m"}.get(learnable.unit, learnable.unit)
        ]


def test_xarray_has_an_axis_of_assemblies(replayed):
    pytest.importorskip("xarray")
    data = replayed.to_xarray()
    assert data["belt_degc"].dims == ("time_s", "assembly")
    assert list(data["assembly"].values) == list(replayed.estimator.assemblies)
    assert data["belt_degc"].attrs["units"] == "degC"
    assert data.attrs["vehicle"] == "xgd24d"
    for place in replayed.estimator.assemblies:
        assert np.array_equal(data["belt_degc"].sel(assembly=place), replayed[f"belt_degc/{place}"])
    of_all = data["assembly_resistance_torque_nm"].sum("assembly")
    np.testing.assert_allclose(of_all, data["resistance_torque_nm"], atol=1e-9)


def test_results_are_shown(replayed, xgd24d, drive):
    point = tr.explain(xgd24d, speed_kmh=30, belt_degc=20)
    driven = tr.simulate(xgd24d, speed_kmh=30, duration_s=60)
    for shown in (replayed, point, driven, tr.read(drive), tr.check_vehicle("agri3t", points=10)):
        page = shown._repr_html_()
        assert page.startswith("<div")
        assert page.endswith("</div>")
        assert "nan" not in page
        assert len(repr(shown).splitlines()) >= 3
    assert "xgd24d" in repr(xgd24d)
    assert len(repr(xgd24d)) < 200
    assert f"{driven.points()[-1]['resistance_torque_nm']:.0f}" in repr(driven)


def test_a_file_name_is_no_markup(folder, drive):
    odd = folder / "a<b>&c.csv"
    odd.write_text(f"{DRIVE}99,5,10\n")
    page = tr.read(odd)._repr_html_()
    assert "1 gap longer than" in page
    assert "<b>&c" not in page
    assert "a&lt;b&gt;&amp;c.csv" in page


def test_simulate_is_the_command(folder, printed):
    driven = tr.simulate("agri3t", speed_kmh=12, duration_s=60, ambient_degc=5, dt=0.5, output=folder / "s1.csv")
    options = ("--speed-kmh", 12, "--duration-s", 60, "--ambient-degc", 5, "--dt", 0.5)
    statement = printed("simulate", "--vehicle", "agri3t", *options, "-o", folder / "s2.csv")
    assert statement.pop("output") == str(folder / "s2.csv")
    assert statement == driven.as_dict()
    assert (folder / "s1.csv").read_bytes() == (folder / "s2.csv").read_bytes()


def test_simulate_and_explain_remark_on_inactive_effects(folder):
    content = yaml.safe_load((config_dir() / "agri3t.yaml").read_text())
    curve = {"x1": 0.5, "x2": 1.0, "x3": 1.5, "y1": 0.0, "y2": 5.0, "y3": 15.0}
    files = [folder / name for name in ("curve.yaml", "turns.yaml")]
    for file, effects in zip(files, ({"curve_of_speed": curve}, {"turning_scrub": {"friction": 0.5}}), strict=True):
        file.write_text(yaml.safe_dump({**content, "effects": effects}))
    remarks = [tr.simulate(file, speed_kmh=10, duration_s=20, dt=1.0).remarks for file in files]
    assert [len(remark) for remark in remarks] == [1, 1]
    assert "outside the range it was fitted on" in remarks[0][0]
    assert "an effect is inactive" in remarks[1][0]
    points = [tr.explain(file, speed_kmh=10, belt_degc=20) for file in files]
    assert [len(point["remarks"]) for point in points] == [1, 0]
    assert "curve_of_speed is outside the range" in repr(points[0])
    assert "turning_scrub: inactive" in repr(points[1])


def test_a_profile_is_a_table_or_what_was_read_of_it(drive, xgd24d):
    recording = tr.read(drive)
    by_path, read = tr.simulate(xgd24d, profile=str(drive)), tr.simulate(xgd24d, profile=recording)
    for column in by_path:
        assert np.array_equal(by_path[column], read[column]), column
    stamp_ns, value = recording.series["speed"].stamp_ns, recording.series["speed"].value
    orders = (replace(recording.series["ambient"], stamp_ns=stamp_ns[::by], value=value[::by]) for by in (1, -1))
    mixed = [replace(recording, order=None, series={**recording.series, "ambient": item}) for item in orders]
    assert np.array_equal(*(tr.simulate(xgd24d, profile=item)["ambient_degc"] for item in mixed))
    hot = replace(recording.series["ambient"], value=np.inf * np.ones(len(recording.series["ambient"])))
    with pytest.raises(tr.InputError, match="ambient: given inf; allowed: finite"):
        tr.simulate(xgd24d, profile=replace(recording, order=None, series={**recording.series, "ambient": hot}))


def test_explain_and_check_are_the_commands(printed):
    point = tr.explain(tr.load_vehicle("agri3t", method="rainflow"), speed_kmh=10, belt_degc=30, weight_kn=25)
    options = ("--speed-kmh", 10, "--belt-degc", 30, "--weight-kn", 25, "--method", "rainflow")
    assert printed("explain", "--vehicle", "agri3t", *options) == json.loads(json.dumps(point.as_dict()))
    checked = json.loads(json.dumps(tr.check_vehicle("agri3t", points=20).as_dict()))
    statement = printed("vehicle", "check", "agri3t", "--points", 20)
    for result in (checked, statement):
        for track in result["tracks"].values():
            assert track["table"].pop("seconds") < 60
    assert checked == statement


def test_a_name_alone_is_one_name(drive, monkeypatch):
    options = []
    monkeypatch.setattr("trackres_ros.diagnosis.diagnose", lambda *given: options.append(given[-1]) or 1 / 0)
    for given in ("grade", ["grade"], ("grade",)):
        with pytest.raises(ZeroDivisionError):
            tr.diagnose(drive, "agri3t", hide=given, holdout=given)
    assert [(tuple(option.hide), tuple(option.holdout)) for option in options] == [(("grade",), ("grade",))] * 3


@pytest.mark.parametrize(
    ("call", "where"),
    [
        (lambda d, f: tr.simulate("agri3t"), "speed_kmh, profile"),
        (lambda d, f: tr.simulate("agri3t", speed_kmh=math.nan), "speed_kmh"),
        (lambda d, f: tr.simulate("agri3t", profile=d, duration_s=5), "duration_s"),
        (lambda d, f: tr.simulate("agri3t", profile=d, ramp_s=5), "ramp_s"),
        (lambda d, f: tr.simulate("xgd24d", profile=d, ambient_degc=5), "ambient_degc"),
        (lambda d, f: tr.simulate("agri3t", speed_kmh=5, output=f / "x.txt"), "output"),
        (lambda d, f: tr.explain("agri3t", speed_kmh=5, belt_degc=5, weight_kn=1), "weight_kn"),
        (lambda d, f: tr.explain("agri3t", speed_kmh=5), "belt_degc"),
        (lambda d, f: tr.load_vehicle("agri3t", method="exact"), "method"),
        (lambda d, f: tr.load_vehicle("nobody"), "vehicle"),
        (lambda d, f: tr.replay(d, "agri3t", output=d), "output"),
        (lambda d, f: tr.replay(d, "agri3t", save_state=f / "no" / "state"), "save_state"),
        (lambda d, f: tr.replay(tr.read(d), "agri3t", topics={"speed": {"column": "speed_kmh"}}), "topics"),
        (lambda d, f: tr.replay(5, "agri3t"), "recording"),
        (lambda d, f: tr.replay(d, 5), "vehicle"),
        (lambda d, f: tr.diagnose([], "agri3t"), "recordings"),
        (lambda d, f: tr.diagnose(d, "agri3t", hide=["gradient"]), "hide"),
        (lambda d, f: tr.diagnose(d, "agri3t", hide="gradient"), "hide"),
        (lambda d, f: tr.record_sample(f / "lap.csv"), "path"),
    ],
)
def test_bad_input_names_the_argument(drive, folder, call, where):
    with pytest.raises(tr.InputError) as error_info:
        call(drive, folder)
    assert error_info.value.where == where
    assert error_info.value.allowed


def test_the_command_names_the_option_instead(drive, folder, refused):
    for words, option in (
        (("simulate", "--vehicle", "agri3t", "-o", folder / "x.csv"), "--speed-kmh, --profile"),
        (("replay", drive, "--vehicle", "agri3t", "-o", folder / "x.txt"), "-o"),
        (("replay", drive, "--vehicle", "nobody", "-o", folder / "x.csv"), "--vehicle"),
        (("diagnose", drive, "--vehicle", "agri3t", "--hide", "gradient", "-o", folder / "x"), "--hide"),
    ):
        assert refused(*words).startswith(f"trackres: error: {option}: given")


def test_what_is_allowed_is_said_for_programs_and_commands():
    """The command renames the place of an error alone: no other part has an argument."""
    names = {q for name in tr.__all__ if callable(f := getattr(tr, name)) for q in inspect.signature(f).parameters if "_" in q}
    calls = [
        (path.name, node)
        for path in sorted((PACKAGE / "tasks").glob("*.py"))
        for function in ast.parse(path.read_text()).body
        if isinstance(function, ast.FunctionDef) and (function.name in tr.__all__ or path.stem == "arguments")
        for node in ast.walk(function)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "InputError"
    ]
    assert len(calls) > 10
    for file, call in calls:
        text = " ".join(n.value for part in call.args[2:] for n in ast.walk(part) if isinstance(n, ast.Constant))
        assert "=" not in text, file
        assert not names & set(text.replace(";", " ").replace(",", " ").split()), file


@pytest.mark.parametrize("name", shipped_road_vehicles())
def test_a_vehicle_without_belts_can_be_simulated_and_explained(name):
    vehicle = tr.load_vehicle(name)
    speed_kmh = min(4.0, 3.6 * vehicle.chassis.max_speed)
    drive = tr.simulate(vehicle, speed_kmh=speed_kmh, duration_s=120)
    assert not [column for column in drive.columns if "belt" in column or "hysteresis" in column]
    assert "belt" not in repr(drive)
    point = tr.explain(vehicle, speed_kmh=speed_kmh)
    assert drive["resistance_torque_nm"][-1] == pytest.approx(point["torque_nm"]["resistance"], rel=1e-9)
    assert sum(point["torque_nm"][part] for part in ("rolling", "wind", "effects")) == point["torque_nm"]["resistance"]
    assert "belt" not in repr(point) + point._repr_html_()
    assert drive.drive["energy_mj"] > 0.0
    assert "belts" not in drive._repr_html_()
    checked = tr.check_vehicle(vehicle)
    assert [item["resistance_std_nm"] > 0.0 for item in checked["level_ground"]] == [True] * 3
    assert "base model road_load" in repr(checked)


@pytest.mark.parametrize(
    "ask",
    [
        lambda vehicle: tr.explain(vehicle, speed_kmh=4, belt_degc=20),
        lambda vehicle: tr.simulate(vehicle, speed_kmh=4, initial_degc=20),
        lambda vehicle: tr.load_vehicle(vehicle.source, thermal="lumped"),
        lambda vehicle: tr.coastdown("drive.csv", vehicle, method="spectral"),
    ],
)
def test_of_a_vehicle_without_belts_nothing_of_belts_is_taken(ask):
    with pytest.raises(tr.InputError, match="road_load has no belts"):
        ask(tr.load_vehicle("husky"))


@pytest.mark.parametrize(
    ("module", "ask"), [("pandas", "to_pandas"), ("xarray", "to_xarray"), ("matplotlib", "plot")], ids=lambda v: v
)
def test_a_library_that_is_missing_says_how_to_install_itself(replayed, monkeypatch, module, ask):
    monkeypatch.setitem(sys.modules, module, None)
    for name in [name for name in sys.modules if name.startswith(f"{module}.") or name == "trackres_ros.output.figures"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(tr.MissingExtraError, match=f"pip install {module}"):
        getattr(replayed, ask)()


USABLE = {
    "simulate": {"vehicle": "agri3t", "speed_kmh": 5.0, "duration_s": 1.0},
    "explain": {"vehicle": "agri3t", "speed_kmh": 5.0, "belt_degc": 20.0},
    "record_sample": {"path": "x.mcap"},
    "check_vehicle": {"vehicle": "agri3t"},
    "coastdown": {"recordings": "drive.csv", "vehicle": "agri3t"},
    "diagnose": {"recordings": "drive.csv", "vehicle": "agri3t"},
    "load_vehicle": {"vehicle": "agri3t"},
    "read": {"recording": "drive.csv"},
    "recover": {"recording": "drive.csv", "output": "x.mcap"},
    "replay": {"recording": "drive.csv", "vehicle": "agri3t"},
}
NUMERIC = [
    (function, name)
    for function in sorted(name for name in EXPORTED if inspect.isfunction(getattr(tr, name)))
    for name, about in inspect.signature(getattr(tr, function)).parameters.items()
    if {"int", "float"} & set(str(about.annotation).split(" | "))
]


OTHER = [
    (function, name)
    for function in sorted({function for function, _ in NUMERIC} | {"load_vehicle", "read", "recover", "replay"})
    for name, about in inspect.signature(getattr(tr, function)).parameters.items()
    if (function, name) not in NUMERIC and about.annotation != "bool"
]


@pytest.mark.parametrize(("function", "name"), OTHER)
def test_an_argument_of_another_type_is_refused_by_its_name(drive, function, name, monkeypatch):
    monkeypatch.chdir(drive.parent)
    usable = {**USABLE.get(function, {}), **({"speed_kmh": None, "duration_s": None} if name == "profile" else {})}
    optional = inspect.signature(getattr(tr, function)).parameters[name].default is None
    for bad in (3.5, object(), b"x", np.ones(2), "x\0y", [object()], *(() if optional else (None,))):
        with pytest.raises(tr.InputError) as error_info:
            getattr(tr, function)(**{**usable, name: bad})
        assert error_info.value.where == name


@pytest.mark.parametrize(
    ("function", "name"), [item for item in OTHER if item[1] in ("recording", "recordings", "profile") and item[0] != "recover"]
)
def test_data_in_memory_are_to_be_written_to_a_file(drive, function, name, monkeypatch):
    monkeypatch.chdir(drive.parent)
    table = tr.simulate("agri3t", speed_kmh=5, duration_s=5).to_pandas()
    usable = {**USABLE.get(function, {}), **({"speed_kmh": None, "duration_s": None} if name == "profile" else {})}
    for data in (table, table["speed_mps"], table.to_numpy(), table.to_dict("list")):
        with pytest.raises(tr.InputError, match=rf"^{name}: given 'a {type(data).__name__}'.*write the data to a file first"):
            getattr(tr, function)(**{**usable, name: data})


def test_paths_that_numpy_or_pandas_hold_are_paths(drive):
    pandas = pytest.importorskip("pandas")
    for held in (np.str_(drive), [np.str_(drive)], np.sort([str(drive)]), pandas.Series([str(drive)]), np.array([drive])):
        assert as_paths(held) == [drive]
        assert as_recordings(held) == [drive]


def test_a_path_of_another_type_is_refused(replayed):
    for bad in (3.5, b"x", [], "x\0.csv"):
        for ask in (replayed.save, replayed.plot, tr.effects.catalogue):
            with pytest.raises(tr.InputError, match=r"^(path|effects)"):
                ask(bad)


@pytest.mark.parametrize(("function", "name"), NUMERIC)
def test_a_numeric_argument_refuses_what_is_no_such_number(tmp_path, monkeypatch, function, name):
    monkeypatch.chdir(tmp_path)
    no_numbers = ("",) if name == "holdout" else ("30", "", [1.0])  # which takes names too
    if inspect.signature(getattr(tr, function)).parameters[name].default is not None:
        no_numbers += (None,)
    for bad in (math.nan, math.inf, -math.inf, True, 1e300, 10**400, np.float32("nan"), np.int64(-(2**60)), *no_numbers):
        with pytest.raises(tr.InputError) as error_info:
            getattr(tr, function)(**{**USABLE[function], name: bad})
        assert name == error_info.value.where
    assert not list(tmp_path.iterdir())


def test_numeric_arguments_and_options_have_the_same_limits():
    assert {pair for pair in NUMERIC if pair[0] not in ("coastdown", "diagnose")} == {(f, n) for f in LIMITS for n in LIMITS[f]}
    commands = {"check_vehicle": cli.get_command(None, "vehicle").commands["check"]}
    for function, limits in LIMITS.items():
        command = commands.get(function) or cli.get_command(None, function.replace("_", "-"))
        of_options = {option.name: (option.type.min, option.type.max) for option in command.params if option.name in limits}
        assert of_options == {name: (low, high) for name, (low, high, _) in limits.items()}


def test_numbers_of_numpy_are_numbers():
    plain = tr.simulate("agri3t", speed_kmh=5, duration_s=2, dt=0.5)
    other = tr.simulate("agri3t", speed_kmh=np.int64(5), duration_s=np.float32(2.0), dt=np.float64(0.5))
    assert all(np.array_equal(plain[name], other[name]) for name in plain)


@pytest.mark.parametrize("share", [0.01, 0.09, 2.6, 300.0])
def test_a_weight_that_a_profile_refuses_is_refused(xgd24d, tmp_path, share):
    file, weight = tmp_path / "profile.csv", share * xgd24d.weight
    file.write_text(f"time_s,speed_mps,weight_n\n0,1,{weight}\n1,1,{weight}\n")
    for item in ({"profile": file}, {"speed_kmh": 3.6, "duration_s": 1.0, "weight_kn": weight / 1e3}):
        with pytest.raises(tr.InputError, match=r"load|weight_kn"):
            tr.simulate(xgd24d, **item)


@pytest.mark.parametrize(("duration_s", "dt"), [(15.0, 10.0), (14.9, 10.0), (0.5, 0.3), (1.0, 0.1), (2.0, 0.4), (7.0, 0.7)])
def test_a_simulation_lasts_as_long_as_was_asked(xgd24d, duration_s, dt):
    time_s = tr.simulate(xgd24d, speed_kmh=5.0, duration_s=duration_s, dt=dt)["time_s"]
    assert duration_s - dt < time_s[-1] <= duration_s * (1.0 + 1e-9)
    assert len(time_s) == math.floor(duration_s / dt + 1e-9) + 1


@pytest.mark.parametrize("name", ["x.pdf", "x.csv", "x", "", "x.svg", "new/x.PNG", "new/x.SVG"])
def test_a_picture_is_of_the_kind_that_its_name_says(replayed, tmp_path, name):
    pytest.importorskip("matplotlib")
    (tmp_path / "x").mkdir()
    if not name.lower().endswith(("png", "svg")):
        with pytest.raises(tr.InputError, match=r"\.png"):
            replayed.plot(tmp_path / name)
        return
    replayed.plot(tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(b"<?xml" if "svg" in name.lower() else b"\x89PNG")


def test_a_missing_state_is_not_to_be_deleted(xgd24d, drive):
    with pytest.raises(tr.InputError, match="missing") as error_info:
        tr.replay(drive, xgd24d, resume="missing.json")
    assert not error_info.value.remedy

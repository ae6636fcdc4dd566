# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a diagnosis leaves: a vehicle file, the surroundings beside it, and lines for the topics file."""

import json
import shutil

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.synthetic import drives, write_recordings
from trackres_ros.effects import Active, catalogue
from trackres_ros.errors import InputError
from trackres_ros.estimator import snapshot
from trackres_ros.estimator.constants import spread
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.recording.bindings import TopicBinding, Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.tasks.main import cli
from trackres_ros.vehicle import load, load_any, with_surroundings
from trackres_ros.vehicle.writing.changes import FileChanges, Interval
from trackres_ros.vehicle.writing.sensor_lines import sensor_lines

FITTED = {"loss_modulus_scale", "bearing_friction", "drag_coefficient", "heat_capacity", "film_offset", "film_slope"}
DRIVE = "time_s,speed_mps,heading_rad\n" + "".join(f"{i * 0.1:.1f},{5.0 if i < 100 else 0.0},0.0\n" for i in range(200))


def kept_of(base, effects, share=0.98, half=0.03):
    """Values a little off, known to a few percent; effects known to a tenth."""
    values = {q.name: share * q.nominal for q in base.parameters}
    wide = {q.name: half * max(abs(values[q.name]), 1e-3 * (q.high - q.low)) for q in base.parameters}
    intervals = {("", name): Interval(v - wide[name], v + wide[name], False) for name, v in values.items()}
    for active in effects:
        for name, v in active.values.items():
            intervals[active.effect.name, name] = Interval(min(0.9 * v, 1.1 * v), max(0.9 * v, 1.1 * v), False)
    return FileChanges(values, tuple(effects), intervals)


@pytest.fixture
def left(tmp_path, loaded, own):
    """A folder as a diagnosis with effects of all three kinds, one of the user's own among them, leaves it."""
    known = catalogue(own, size=loaded.base.facts.weight * loaded.base.facts.radius)
    effects = [Active(known[name], known[name].values()) for name in ("stribeck", "squeak", "grade_profile", "torque_gain")]
    folder = tmp_path / "left"
    folder.mkdir()
    text = "What it is.\nWritten by trackres diagnose from x."
    files = loaded.base.write(folder / "vehicle.yaml", kept_of(loaded.base, effects), text)
    assert [path.name for path in files[:2]] == ["vehicle.yaml", "surroundings.yaml"]
    assert set(files) == {path for path in folder.rglob("*") if path.is_file()}
    return folder


def test_only_what_was_fitted_changes_in_the_text(left, loaded):
    result_before, result_after = (path.read_text().splitlines() for path in (loaded.base.vehicle.source, left / "vehicle.yaml"))
    lost = [line for line in result_before if line not in result_after]
    assert {line.split(":")[0].strip() for line in lost} == FITTED
    new = [line for line in result_after if line not in result_before]
    assert new[:2] == ["# What it is.", "# Written by trackres diagnose from x."]
    assert {line.split(":")[0].strip() for line in new[2:] if line} == {*FITTED, "effects", "stribeck", "squeak", "effect_files"}
    order = [result_before.index(line) for line in result_after if line.strip() and line in result_before]
    assert order == sorted(order)


def test_the_vehicles_effects_are_in_its_file_and_no_others(left):
    vehicle = load(left / "vehicle.yaml")
    assert [a.effect.name for a in vehicle.effects] == ["stribeck", "squeak"]
    around = with_surroundings(vehicle, left / "surroundings.yaml").surroundings
    assert [a.effect.name for a in around] == ["grade_profile"]
    for active in (*vehicle.effects, *around):
        for name, value in active.values.items():
            q = next(q for q in active.effect.parameters if q.name == name)
            assert active.ranges[name] == pytest.approx((max(0.9 * value, q.low), min(1.1 * value, q.high)), rel=1e-5)


def test_intervals_become_ranges_and_shrink_the_estimates_std(left):
    result_before, result_after = load("xgd24d"), load(left / "vehicle.yaml")
    for name in ("chassis.bearing_friction", "chassis.drag_coefficient", "rubber.loss_modulus_scale"):
        q, was = result_after.parameters[name], result_before.parameters[name]
        fit_result = 0.98 * was.value
        assert (q.low, q.value, q.high) == pytest.approx((0.97 * fit_result, fit_result, 1.03 * fit_result), rel=1e-5)
        assert q.flag == "F"
        assert "re-fitted by trackres diagnose" in q.reason
        assert was.reason in q.reason
    loss, cooling, capacity, radius = spread(result_after, "triangular").relative
    assert loss == pytest.approx(0.015, rel=0.05)  # a quarter of the range of +-3 %
    assert max(cooling, capacity) < 0.02 < 0.1 < spread(result_before, "triangular").relative[1]
    assert radius < 1e-3
    shares = []
    for vehicle in (result_before, result_after):
        estimator = Estimator(vehicle)
        inputs = estimator.inputs(10.0, ambient=15.0)
        _, estimate = estimator.step(estimator.cold_start(inputs, belt_degc=40.0, belt_std_k=0.5), inputs, 0.1)
        shares.append(estimate.resistance_std_nm / estimate.resistance_torque_nm)
    assert shares[0] > 0.15
    assert shares[1] < 0.1 * 0.5


def test_a_second_diagnosis_starts_surer_within_the_same_bounds(left, loaded):
    repetition = load_base(left / "vehicle.yaml")
    for first, second in zip(loaded.base.parameters, repetition.base.parameters, strict=True):
        assert second.std < first.std
        as_factor = second.nominal / first.nominal if first.nominal == 1.0 and second.nominal == 1.0 else 1.0
        assert second.low <= 1.05 * first.low * as_factor
        assert second.high >= 0.95 * first.high * as_factor
    assert {"stribeck", "squeak"} <= set(repetition.base.includes)
    assert "grade_profile" not in repetition.base.includes
    assert "grade_profile" in load_base(left / "vehicle.yaml", surroundings=left / "surroundings.yaml").base.includes


def test_whatever_is_fitted_loads_again(loaded, tmp_path):
    for end in ("low", "high"):
        values = {q.name: getattr(q, end) for q in loaded.base.parameters}
        intervals = {("", q.name): Interval(q.low, q.high, True) for q in loaded.base.parameters}
        loaded.base.write(tmp_path / f"{end}.yaml", FileChanges(values, (), intervals), "at a bound")
        repetition = load(tmp_path / f"{end}.yaml")
        assert repetition.chassis.bearing_friction == pytest.approx(values["bearing_friction"])


@pytest.mark.parametrize("name", ["xgd24d", "emps"])
def test_an_effect_at_its_bounds_loads_again(tmp_path, name):
    base = load_base(name).base
    known = catalogue(size=base.vehicle.size, on_tyres=not base.has_belt)
    suited = [e for e in known.values() if e.belongs_to == "vehicle" and not e.unsuited(base.vehicle.kind)]
    for end in ("low", "high"):
        active = tuple(Active(e, {q.name: getattr(q, end) for q in e.parameters}) for e in suited)
        base.write(tmp_path / "v.yaml", FileChanges(None, active, {}), "at a bound")
        repetitions = {a.effect.name: a.values for a in load_any(tmp_path / "v.yaml").effects}
        assert repetitions.keys() == {a.effect.name for a in active}
        for item in active:
            assert repetitions[item.effect.name] == pytest.approx(item.values, rel=1e-5)


def test_nothing_kept_leaves_the_file_as_it_was(loaded, tmp_path):
    loaded.base.write(tmp_path / "vehicle.yaml", FileChanges(None, (), {}), "nothing")
    assert (tmp_path / "vehicle.yaml").read_text() == "# nothing\n" + loaded.base.vehicle.source.read_text()
    assert not (tmp_path / "surroundings.yaml").exists()


def test_a_moved_folder_still_works_with_every_command(good, left, own, tmp_path, monkeypatch):
    moved = tmp_path / "elsewhere" / "vehicle"
    moved.parent.mkdir()
    shutil.move(left, moved)
    shutil.rmtree(own)
    monkeypatch.chdir(tmp_path / "elsewhere")
    drive = tmp_path / "drive.csv"
    drive.write_text(DRIVE)
    around = ("--surroundings", "vehicle/surroundings.yaml")
    checked = good("vehicle", "check", "vehicle/vehicle.yaml", "--points", 10, "--json")
    assert set(json.loads(checked)["effects"]) == {"stribeck", "squeak"}
    good("explain", "--vehicle", "vehicle/vehicle.yaml", "--speed-kmh", 20, "--belt-degc", 20)
    good("simulate", "--vehicle", "vehicle/vehicle.yaml", *around, "--speed-kmh", 20, "--duration-s", 60, "-o", "s.csv")
    assert "surroundings" in good("replay", drive, "--vehicle", "vehicle/vehicle.yaml", *around, "-o", "r.csv")
    assert load_base("vehicle/vehicle.yaml").base.includes == ("stribeck", "squeak")


def test_at_standstill_no_surroundings_are_fed_forward(good, left, tmp_path):
    drive = tmp_path / "drive.csv"
    drive.write_text(DRIVE)
    rows = {}
    for name, around in (("without", ()), ("with", ("--surroundings", left / "surroundings.yaml"))):
        good("replay", drive, "--vehicle", left / "vehicle.yaml", *around, "-o", tmp_path / "r.csv")
        rows[name] = np.genfromtxt(tmp_path / "r.csv", delimiter=",", names=True)
        assert rows[name]["feedforward_torque_nm"][-1] == 0.0
    assert rows["with"]["effects_nm"][-1] > 900.0  # the slope of the plane is there, measured or not
    assert rows["without"]["effects_nm"][-1] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(*(rows[name]["feedforward_torque_nm"] for name in rows), rtol=1e-3, atol=0.5)


def test_a_state_is_of_a_vehicle_in_its_surroundings(left):
    vehicle = load(left / "vehicle.yaml")
    around = with_surroundings(vehicle, left / "surroundings.yaml")
    assert snapshot.key(Estimator(vehicle)) != snapshot.key(Estimator(around))


def test_commands_refuse_a_vehicle_file_with_foreign_effects(tmp_path):
    drive = tmp_path / "drive.csv"
    drive.write_text(DRIVE)
    source = load("xgd24d").source
    for effect, text_here in (("grade: {grade: 0.02}", "--surroundings"), ("torque_gain: {error: 0.02}", "topics file")):
        text = source.read_text().replace("rubber/nr", f"{source.parent}/rubber/nr")
        (tmp_path / "v.yaml").write_text(f"{text}\neffects: {{{effect}}}\n")
        command = ["replay", str(drive), "--vehicle", str(tmp_path / "v.yaml"), "-o", str(tmp_path / "o.csv")]
        outcome = CliRunner().invoke(cli, command)
        assert isinstance(outcome.exception, InputError)
        assert text_here in str(outcome.exception)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"schema": 2}, "schema"),
        ({"vehicle": "agri3t"}, "agri3t"),
        ({"effects": {"warmup": {"torque": 1.0, "time_constant": 100.0, "cooling": 1000.0}}}, "vehicle file"),
        ({"effects": {"grade": {"grade": 7.0}}}, "-0.3 to 0.3"),
        ({"effect_files": "a.py"}, "a list"),
        ({"effect_files": ["nowhere.py"]}, "relative to this file"),
        ({"more": 1}, "one of schema"),
    ],
    ids=str,
)
def test_a_file_of_surroundings_is_checked(content, said, tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(yaml.safe_dump({"schema": 1, "vehicle": "xgd24d", "effects": {"grade": {"grade": 0.02}}, **content}))
    with pytest.raises(InputError, match=said):
        with_surroundings(load("xgd24d"), path)


def test_the_surroundings_of_an_earlier_diagnosis_do_not_stay(left, loaded):
    loaded.base.write(left / "vehicle.yaml", FileChanges(None, (), {}), "Nothing.\nWritten by trackres diagnose from y.")
    assert not (left / "surroundings.yaml").exists()


def test_from_a_written_file_it_goes_on(left, tmp_path):
    repetition = load_base(left / "vehicle.yaml", surroundings=left / "surroundings.yaml").base
    warm = Active(catalogue()["warmup"], catalogue()["warmup"].values())
    for folder in (tmp_path / "other", left):  # elsewhere, and over itself
        folder.mkdir(exist_ok=True)
        repetition.write(folder / "vehicle.yaml", kept_of(repetition, [warm]), "More.\nWritten by trackres diagnose from y.")
        vehicle = with_surroundings(load(folder / "vehicle.yaml"), folder / "surroundings.yaml")
        assert [a.effect.name for a in vehicle.active] == ["stribeck", "squeak", "warmup", "grade_profile"]
        text = (folder / "vehicle.yaml").read_text()
        assert text.count("Written by trackres diagnose") == 1
        assert text.count("# The reference vehicle") == 1


@pytest.mark.parametrize("acting", [(), ("squeak",), ("squeak", "hum")], ids=len)
def test_effect_files_go_along_whether_they_act_or_not(acting, own, tmp_path):
    (own / "hum.py").write_text((own / "squeak.py").read_text().replace("squeak", "hum"))
    content = yaml.safe_load(load_any("husky").source.read_text())
    content |= {"effect_files": ["squeak.py", "hum.py"], "effects": {name: {"torque": 5.0} for name in acting}}
    (own / "v.yaml").write_text(yaml.safe_dump(content))
    written = load_base(own / "v.yaml").base.write(tmp_path / "new" / "v.yaml", FileChanges(None, (), {}), "Nothing.")
    shutil.rmtree(own)
    assert {a.effect.name for a in load_any(tmp_path / "new" / "v.yaml").effects} == set(acting)
    assert [path.name for path in written] == ["v.yaml", "squeak.py", "hum.py"]


def test_a_road_load_file_too(tmp_path, own):
    first = load_base("husky").base
    known = catalogue(own, size=first.facts.weight * first.facts.radius, on_tyres=True)
    effects = [Active(known[name], known[name].values()) for name in ("stribeck", "squeak", "grade")]
    first.write(tmp_path / "v.yaml", kept_of(first, effects), "Road.")
    second = load_base(tmp_path / "v.yaml", surroundings=tmp_path / "surroundings.yaml").base
    assert {"stribeck", "squeak", "grade"} <= set(second.includes)
    by_name = {q.name: q for q in second.parameters}
    for q in first.parameters:
        assert by_name[q.name].nominal == pytest.approx(0.98 * q.nominal, rel=1e-5)
        assert (by_name[q.name].low, by_name[q.name].high) == (q.low, q.high)
    text = (tmp_path / "v.yaml").read_text()
    assert "# A small skid-steered robot" in text
    (session,) = drives(first, 1.5, 1, 2.0, np.random.default_rng(1))
    torques = [base.predict([session], first.nominal, active)[0].torque for base, active in ((first, effects), (second, ()))]
    np.testing.assert_allclose(*torques, rtol=1e-4, atol=1e-3)


SENSORS = [{"torque_gain": 0.04}, {"torque_offset": 300.0}, {"speed_scale": 0.03}, {"delay": 0.4}]
SENSORS += [{"torque_gain": -0.05, "torque_offset": -150.0}]


@pytest.mark.parametrize("wrong", SENSORS, ids=lambda wrong: "+".join(wrong))
def test_with_the_line_that_is_printed_a_sensor_shows_what_is_so(wrong, loaded, tmp_path):
    known = catalogue()
    active = [Active(known[name], {known[name].parameters[0].name: value}) for name, value in wrong.items()]
    (session,) = drives(loaded.base, loaded.known.max_speed, 1, 3.0, np.random.default_rng(2))
    (shown,) = write_recordings(loaded.base, tmp_path, [session], active, np.random.default_rng(3))
    (tmp_path / "true").mkdir()
    (true,) = write_recordings(loaded.base, tmp_path / "true", [session], [], np.random.default_rng(3))
    lines = sensor_lines(active, {"drive.csv": open_source([shown]).bindings}, 1.0)
    role = "speed" if "speed_scale" in wrong else "torque"
    assert set(lines) == {role}
    topics = Topics.parse(yaml.safe_load("\n".join(lines.values())))
    if role == "speed" or "delay" in wrong:  # of what these do to a recording see test_topics
        binding = topics[role]
        assert (binding.scale, binding.delay_s) == pytest.approx((1.0, 0.4) if "delay" in wrong else (1.03, 0.0))
        return
    corrected, right = (Recording.from_source(open_source([path], t)) for path, t in ((shown, topics), (true, None)))
    corrected, right = (
        np.interp(np.arange(20.0, 160.0, 0.2), r.time_s("torque"), r.series["torque"].value) for r in (corrected, right)
    )
    np.testing.assert_allclose(corrected, right, rtol=1e-4, atol=15.0)  # the noise came behind the sensor's error


@pytest.mark.parametrize("wrong", [w for w in SENSORS if "speed_scale" not in w], ids=lambda wrong: "+".join(wrong))
def test_lines_of_two_sides_correct_the_sum_of_their_torques(wrong):
    known, raw = catalogue(), {"torque/left": 700.0, "torque/right": -90.0}
    active = [Active(known[name], {known[name].parameters[0].name: value}) for name, value in wrong.items()]
    given_valuess = {"torque/left": {"column": "l", "scale": 2.0, "offset": 5.0}, "torque/right": {"column": "r", "delay_s": 0.1}}
    result_before = Topics.parse(given_valuess)
    recorded = {"a.csv": {role: result_before[role] for role in given_valuess}, "b.csv": {"torque": TopicBinding(column="m")}}
    lines, other = (sensor_lines(active, {name: values}, 0.3) for name, values in recorded.items())
    each = [("a.csv", *line) for line in lines.items()] + [("b.csv", *line) for line in other.items()]
    assert sensor_lines(active, recorded, 0.3) == {f"{role} of {name}": f"{line}  # {name}" for name, role, line in each}
    assert sensor_lines(active, {"a.csv": recorded["a.csv"], "c.csv": recorded["a.csv"]}, 0.3) == lines
    assert lines.keys() == given_valuess.keys()
    result_after = Topics.parse(yaml.safe_load("\n".join(lines.values())))
    measured, corrected = (
        sum(values[role].scale * x + values[role].offset for role, x in raw.items()) for values in (result_before, result_after)
    )
    gain, offset = 1.0 + wrong.get("torque_gain", 0.0), wrong.get("torque_offset", 0.0)
    assert corrected == pytest.approx((measured - 0.3 * offset) / gain, rel=1e-5)  # the sensor shows 0.3 times the torque
    for role in given_valuess:
        assert result_after[role].delay_s == pytest.approx(result_before[role].delay_s + wrong.get("delay", 0.0))


@pytest.mark.parametrize("says", ["at.direction / 0", "at.direction * float('nan')", "(1.0 if at.speed < 2.0 else p.nothing)"])
def test_a_failing_user_effect_ends_the_fit_with_its_name(says, loaded, own):
    own_file = own / "squeak.py"
    own_file.write_text(own_file.read_text().replace("p.torque * at.direction", says))
    squeak = catalogue(own)["squeak"]
    (session,) = drives(loaded.base, loaded.known.max_speed, 1, 1.0, np.random.default_rng(1))
    with np.errstate(all="ignore"), pytest.raises(InputError, match=r"squeak\.py: effect squeak"):
        loaded.base.predict([session], loaded.base.nominal, [Active(squeak, squeak.values())])


def test_a_hidden_slope_is_never_pushed_against_at_a_standstill(good, run, loaded, effects, tmp_path):
    rng = np.random.default_rng(4)
    sessions = drives(loaded.base, loaded.known.max_speed, 2, 6.0, rng)
    tilted = Active(effects["grade_profile"], {"rise_ahead": 0.02, "rise_left": 0.0})
    paths = write_recordings(loaded.base, tmp_path, sessions, [tilted], rng)
    output = tmp_path / "report"
    process = run(paths, output, page=True)
    result = json.loads((output / "report.json").read_text())
    assert result["effects"][0]["belongs_to"] == "surroundings"
    assert result["kept"] == {"vehicle": [], "surroundings": ["grade_profile"], "sensor": []}
    assert "surroundings.yaml" in process.output
    assert "surroundings.yaml" in (output / "report.html").read_text()
    assert not load(output / "vehicle.yaml").effects
    drive = tmp_path / "drive.csv"
    drive.write_text(DRIVE)
    for around in ((), ("--surroundings", output / "surroundings.yaml")):
        good("replay", drive, "--vehicle", output / "vehicle.yaml", *around, "-o", tmp_path / "r.csv")
        row = np.genfromtxt(tmp_path / "r.csv", delimiter=",", names=True)[-1]
        assert row["feedforward_torque_nm"] == 0.0
        assert (abs(row["effects_nm"]) > 1500.0) == bool(around)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The commands as a user types them: what they print, what they write, and how they refuse."""

import csv
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from scipy.integrate import trapezoid

from trackres_ros.estimator.energy import drive_text
from trackres_ros.tasks.options import vehicles_to_complete
from trackres_ros.vehicle import load


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("commands")


def table(path):
    with path.open() as lines:
        rows = list(csv.DictReader(lines))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def no_signed_zero(text):
    return re.findall(r"(?<![\w.+-])-0(?:\.0*)?(?![\d.])", text) == []


@pytest.fixture(scope="module")
def sample(folder, good):
    good("record-sample", "--laps", 1, "--speed-kmh", 30, "-o", folder / "lap.mcap")
    return folder / "lap.mcap"


def test_help_teaches_every_command(good):
    top = good("--help")
    for command in ("simulate", "replay", "explain", "record-sample"):
        assert command in top
        text = good(command, "--help")
        assert "trackres " + command in text
    assert "trackres vehicle check" in good("vehicle", "check", "--help")


@pytest.mark.usefixtures("undrawn")
def test_an_unnamed_replay_writes_a_table_smaller_than_the_bag(folder, good, sample, monkeypatch):
    monkeypatch.chdir(folder)
    shown = good("replay", sample, "--vehicle", "xgd24d")
    assert "Written: lap_replay.parquet, lap_replay.png" in shown
    assert (folder / "lap_replay.parquet").stat().st_size < sample.stat().st_size


def test_simulate_writes_the_columns_of_the_issue(folder, good):
    drive = ("--speed-kmh", 50, "--ramp-s", 50, "--duration-s", 300, "--ambient-degc", 15, "--weight-kn", 300, "--dt", 0.5)
    outcome = json.loads(good("simulate", "--vehicle", "xgd24d", *drive, "-o", folder / "s.csv", "--json"))
    columns = table(folder / "s.csv")
    conditions = ["time_s", "speed_mps", "weight_n", "ambient_degc", "belt_degc"]
    torques = ["resistance_torque_nm", "hysteresis_nm", "bearing_nm", "wind_nm", "effects_nm", "inertia_nm", "drive_torque_nm"]
    assert list(columns) == [*conditions, *torques]
    assert len(columns["time_s"]) == outcome["rows"] == 601
    assert columns["weight_n"] == pytest.approx(300e3)
    assert columns["inertia_nm"][50] > 1000 > abs(columns["inertia_nm"][-1])
    force = columns["resistance_torque_nm"] / load("xgd24d").tracks["triangular"].sprocket_radius
    joules, metres = (np.sum(0.5 * (columns["speed_mps"] * item)[1:]) for item in (force, np.ones(601)))
    assert outcome["drive"]["kwh_per_km"] == pytest.approx(joules / 3.6e6 / (metres / 1000.0), rel=1e-4)


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "parquet", "mcap"])
def test_simulate_takes_a_profile_and_writes_every_format(folder, suffix, good):
    profile = folder / "profile.csv"
    profile.write_text("time_s,speed_kmh\n0,0\n20,36\n60,36\n")
    output = folder / f"p.{suffix}"
    outcome = json.loads(
        good("simulate", "--vehicle", "xgd24d", "--profile", profile, "--initial-degc", 40, "-o", output, "--json")
    )
    assert output.stat().st_size > 1000
    assert outcome["points"][-1]["speed_mps"] == pytest.approx(10.0)
    assert 39 < outcome["points"][0]["belt_degc"] < 43


def test_a_profile_sets_weight_weather_and_slope(folder, good):
    def run(text, *options):
        profile, output = folder / "profile.csv", folder / "conditions.csv"
        profile.write_text(text)
        good("simulate", "--vehicle", "xgd24d", "--profile", profile, "-o", output, *options)
        return table(output)

    flat = run("time_s,speed_mps\n0,0\n10,5\n60,5\n")
    columns = run("time_s,speed_mps,weight_n,ambient_degc,grade\n0,0,300000,-10,0\n10,5,300000,-10,0\n60,5,,,0.05\n")
    assert flat["time_s"][[0, -1]] == pytest.approx([0.0, 60.0])
    assert flat["speed_mps"] == pytest.approx(np.minimum(flat["time_s"] / 2.0, 5.0))
    assert columns["weight_n"] == pytest.approx(300e3)
    assert columns["ambient_degc"] == pytest.approx(-10.0)
    assert columns["belt_degc"][0] == pytest.approx(-10.0)
    assert columns["grade_nm"][100] == pytest.approx(0.0)
    assert np.all(np.diff(columns["grade_nm"][101:]) > 0.0)
    assert columns["grade_nm"][-1] > 1000.0
    assert columns["drive_torque_nm"] == pytest.approx(
        columns["resistance_torque_nm"] + columns["grade_nm"] + columns["inertia_nm"]
    )
    assert "grade_nm" not in flat


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("time_s,speed_mps,belt_degc\n0,0,20\n10,5,20\n", (), "belt"),
        ("time_s,speed_mps,accel_mps2\n0,0,1\n10,5,1\n", (), "accel"),
        ("time_s,speed_mps,ambient_degc\n0,0,288\n10,5,288\n", (), "-60 to 60 degC"),
        ("time_s,speed_mps,weight_n\n0,0,27700\n10,5,1\n", (), "load"),
        ("time_s,speed_mps,grade\n0,0,inf\n10,5,0\n", (), "grade"),
        ("time_s,speed_mps,ambient_degc\n0,0,10\n10,5,10\n", ("--ambient-degc", "5"), "--ambient-degc"),
    ],
)
def test_a_profile_with_what_cannot_count_is_refused(folder, refused, text, options, said):
    profile = folder / "refused.csv"
    profile.write_text(text)
    assert said in refused("simulate", "--vehicle", "xgd24d", "--profile", profile, "-o", folder / "x.csv", *options)


def test_methods_differ_as_the_model_says(folder, good):
    torque = {}
    for method in ("spectral", "rainflow"):
        drive = ("--speed-kmh", 10, "--duration-s", 60, "--method", method, "--thermal", "core_surface")
        outcome = json.loads(good("simulate", "--vehicle", "xgd24d", *drive, "-o", folder / f"{method}.csv", "--json"))
        assert (outcome["method"], outcome["thermal"]) == (method, "core_surface")
        torque[method] = outcome["points"][-1]["hysteresis_nm"]
    assert 1.4 < torque["spectral"] / torque["rainflow"] < 2.2


def test_explain_says_what_the_issue_asks(good):
    result = json.loads(good("explain", "--vehicle", "xgd24d", "--speed-kmh", 50, "--belt-degc", 15, "--json"))
    explained = {"wheel_loads_n", "contact", "tension_n", "loss_force_n", "torque_nm", "heat_w", "cooling_w", "rainflow"}
    assert explained <= result.keys()
    assert set(result["contact"][0]) == {"half_length_m", "max_strain", "frequency_hz", "modulus_mpa"}
    assert set(result["loss_force_n"]) == {"indentation", "bending", "tension", "drive", "total"}
    assert {"hysteresis", "bearing", "wind", "effects", "inertia", "resistance"} == result["torque_nm"].keys()
    assert result["heat_w"] == pytest.approx(4 * result["loss_force_n"]["total"] * 50 / 3.6)
    assert {row[3] for row in result["rainflow"]} == {"through", "along"}
    assert "Torque at the sprockets" in good("explain", "--vehicle", "agri3t", "--speed-kmh", -5, "--belt-degc", 15)


def test_vehicle_check_prints_what_follows_with_units(good):
    text = good("vehicle", "check", "xgd24d", "--points", 50)
    for word in ("wheel loads", "17000", "belt mass", "kg", "heat capacity", "kJ/K", "tension", "loss table", "%"):
        assert word in text
    checked = json.loads(good("vehicle", "check", "agri3t", "--points", 50, "--json"))
    assert checked["tracks"]["low"]["table"]["largest_error"] < 0.003


@pytest.mark.usefixtures("undrawn")
def test_a_replay_of_refused_speeds_does_not_say_it_stood(folder, good):
    """A share of one in ten is a remark, here of a speed in km/h that is read as m/s."""
    for driving, text_here in ((300, True), (10, False)):
        speeds = [0.0] * 100 + [3.6 * 12.0] * driving
        rows = "\n".join(f"{0.1 * i:.1f},{speed}" for i, speed in enumerate(speeds))
        (folder / "fast.csv").write_text(f"time_s,speed_mps\n{rows}\n")
        text = good("replay", folder / "fast.csv", "--vehicle", "husky", "-o", folder / "out.csv")
        remark = f"! {driving} of {100 + driving} speeds refused as too fast for this vehicle: wrong unit?"
        assert (remark in text) == text_here
        assert "The vehicle stood the whole time in the accepted samples" in text


@pytest.mark.usefixtures("undrawn")
def test_a_drive_without_steps_has_no_totals(folder, good):
    for rows in ("0,1\n", "0,1\n60,1\n120,1\n"):
        (folder / "one.csv").write_text(f"time_s,speed_mps\n{rows}")
        shown_text = good("replay", folder / "one.csv", "--vehicle", "husky", "-o", folder / "one_out.csv")
        assert "The drive has no totals: no two rows without a long gap between them" in shown_text
        assert "stood" not in shown_text


def test_a_small_drive_has_two_figures_of_everything():
    item = {
        "distance_m": 4.2,
        "under_way_s": 21.0,
        "mean_resistance_nm": 0.31,
        "largest_resistance_nm": 9.4,
        "energy_mj": 0.00123,
    }
    text = drive_text({**item, "kwh_per_km": 0.0813})
    assert text == (
        "The drive: 0.0042 km, 0.35 min of driving; mean resistance 0.31 Nm, at most 9.4 Nm; 0.0012 MJ (0.081 kWh/km)"
    )


def test_replay_of_a_bag_with_a_topics_file(folder, sample, repository, good):
    output = folder / "estimate.csv"
    topics = repository / "config" / "topics" / "sample.yaml"
    outcome = json.loads(good("replay", sample, "--vehicle", "xgd24d", "--topics", topics, "-o", output, "--json"))
    assert outcome["written"] == [str(output), str(folder / "estimate.png")]
    columns = table(output)
    assert len(columns["time_s"]) == outcome["steps"] == outcome["counters"]["speed"]["accepted"]
    assert 2700 < outcome["resistance_torque_nm"]["largest"] < 3500
    assert columns["belt_degc/front_left"][-1] > columns["belt_degc/front_left"][0]
    drive, speed, torque = outcome["drive"], columns["speed_mps"], columns["resistance_torque_nm"]
    assert drive["distance_m"] == pytest.approx(trapezoid(np.abs(speed), columns["time_s"]), rel=0.02)
    assert drive["mean_resistance_nm"] == pytest.approx(np.mean(torque[np.abs(speed) > 0.1]), rel=0.05)
    assert 0.0 < drive["under_way_s"] <= columns["time_s"][-1]
    assert drive["coldest_belt_degc"] < drive["warmest_belt_degc"]
    assert drive["kwh_per_km"] == pytest.approx(drive["energy_mj"] / 3.6 / (drive["distance_m"] / 1000.0))
    assert (folder / "estimate.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


AGAIN = """
import sys
from trackres_ros.tasks.main import main
for suffix in ("csv", "mcap"):
    try:
        main(["replay", sys.argv[1], "--vehicle", "xgd24d", "-o", f"two.{suffix}"])
    except SystemExit as ended:
        assert not ended.code
"""


def test_replay_gives_the_same_bytes_in_another_process(folder, good):
    drive = folder / "drive.csv"
    good("simulate", "--vehicle", "xgd24d", "--speed-kmh", 30, "--duration-s", 60, "-o", drive)
    subprocess.run([sys.executable, "-c", AGAIN, drive], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    for suffix in ("csv", "mcap"):
        good("replay", drive, "--vehicle", "xgd24d", "-o", folder / f"one.{suffix}")
    for suffix in ("csv", "mcap", "png"):
        assert (folder / f"one.{suffix}").read_bytes() == (folder / f"two.{suffix}").read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_replay_stopped_and_resumed_gives_the_same_rows(folder, good):
    time = np.arange(0, 60, 0.1)
    lines = [f"{t:.1f},{8 + np.sin(t):.4f},{15 + t / 60:.3f}" for t in time]
    head = "time_s,speed_mps,ambient_degc"
    (folder / "whole.csv").write_text("\n".join([head, *lines]))
    (folder / "first.csv").write_text("\n".join([head, *lines[:250]]))
    (folder / "second.csv").write_text("\n".join([head, *lines[250:]]))
    for name, extra in (
        ("whole", ()),
        ("first", ("--save-state", folder / "state.json")),
        ("second", ("--resume", folder / "state.json")),
    ):
        good("replay", folder / f"{name}.csv", "--vehicle", "xgd24d", "-o", folder / f"{name}-out.csv", *extra)
    total, first, second = (table(folder / f"{name}-out.csv") for name in ("whole", "first", "second"))
    for name in total:
        if name != "time_s":
            assert np.array_equal(total[name], np.concatenate([first[name], second[name]]), equal_nan=True), name


def test_a_recording_with_torque_gives_a_residual(folder, good):
    rows = [f"{t},10,300000,{3000 + t},20" for t in range(100)]
    (folder / "torque.csv").write_text("\n".join(["time_s,speed_mps,weight_n,torque_nm,ambient_degc", *rows]))
    good("replay", folder / "torque.csv", "--vehicle", "xgd24d", "-o", folder / "torque-out.csv")
    columns = table(folder / "torque-out.csv")
    assert columns["residual_nm"] == pytest.approx(columns["measured_torque_nm"] - columns["drive_torque_nm"])


BAD = [
    (("simulate", "--vehicle", "nope", "--speed-kmh", "50", "-o", "x.csv"), "xgd24d"),
    (("simulate", "--vehicle", "xgd24d", "--speed-kmh", "fast", "-o", "x.csv"), "fast"),
    (("simulate", "--vehicle", "xgd24d", "--speed-kmh", "nan", "-o", "x.csv"), "nan"),
    (("simulate", "--vehicle", "xgd24d", "--speed-kmh", "99", "-o", "x.csv"), "max_speed"),
    (("simulate", "--vehicle", "xgd24d", "-o", "x.csv"), "--profile"),
    (("simulate", "--vehicle", "xgd24d", "--speed-kmh", "5", "-o", "x.txt"), ".parquet"),
    (("simulate", "--vehicle", "xgd24d", "--speed-kmh", "5", "-o", "no/such/x.csv"), "mkdir"),
    (("simulate", "--vehicle", "xgd24d", "--profile", "none.csv", "-o", "x.csv"), "none.csv"),
    (("replay", "none.mcap", "--vehicle", "xgd24d", "-o", "x.csv"), "none.mcap"),
    (("replay", "--vehicle", "xgd24d", "-o", "x.csv"), "RECORDING"),
    (("replay", "notes.txt", "--vehicle", "xgd24d", "-o", "x.csv"), ".mcap"),
    (("replay", "empty.csv", "--vehicle", "xgd24d", "-o", "x.csv"), "empty.csv"),
    (("replay", "good.csv", "--vehicle", "xgd24d", "--params", "params.yaml", "-o", "x.csv"), "gap_s"),
    (("replay", "good.csv", "--vehicle", "xgd24d", "--resume", "none.json", "-o", "x.csv"), "none.json"),
    (("replay", "good.csv", "--vehicle", "xgd24d", "--save-state", "no/such.json", "-o", "x.csv"), "--save-state"),
    (("replay", "good.csv", "--vehicle", "xgd24d", "--save-state", "/dev/null", "-o", "x.csv"), "--save-state"),
    (("replay", "kmh.csv", "--vehicle", "xgd24d", "-o", "x.csv"), "unit"),
    (("replay", "good.csv", "--vehicle", "xgd24d", "-o", "good.csv"), "overwrite"),
    (("explain", "--vehicle", "xgd24d", "--speed-kmh", "5"), "--belt-degc"),
    (("explain", "--vehicle", "xgd24d", "--speed-kmh", "5", "--belt-degc", "20", "--weight-kn", "1"), "--weight-kn"),
    (("vehicle", "check", "broken.yaml"), "thickness"),
    (("fly",), "fly"),
]


@pytest.mark.parametrize(("arguments", "named"), BAD, ids=[" ".join(a)[:60] for a, _ in BAD])
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, repository, refused, arguments, named):
    (tmp_path / "notes.txt").write_text("nothing")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "good.csv").write_text("time_s,speed_mps\n0,1\n1,2\n")
    (tmp_path / "kmh.csv").write_text("time_s,speed_mps\n0,50\n1,51\n")
    (tmp_path / "params.yaml").write_text("gap_s: -1\n")
    config = repository / "config"
    broken = (config / "xgd24d.yaml").read_text().replace("thickness: {value: 0.035", "thickness: {value: 0.35")
    (tmp_path / "broken.yaml").write_text(broken.replace("rubber/nr", f"{config}/rubber/nr"))
    result_before = sorted(tmp_path.iterdir())
    assert named in refused(*arguments, cwd=tmp_path)
    assert sorted(tmp_path.iterdir()) == result_before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("repaly",), "did you mean replay?"),
        (("vehicle", "chek"), "did you mean check?"),
        (("compound", "fti"), "did you mean fit?"),
        (("xyz",), "record-sample"),
    ],
)
def test_an_unknown_command_suggests_the_closest_one(refused, words, said):
    assert said in refused(*words)


def test_a_shell_completes_vehicles_and_files():
    result = vehicles_to_complete(None, None, "xg")
    assert [(item.type, item.value) for item in result] == [("plain", "xgd24d"), ("file", "xg")]


@pytest.mark.usefixtures("undrawn")
def test_no_zero_that_is_shown_has_a_sign(folder, good):
    assert no_signed_zero("wind 0, inertia -1, -0.4")
    assert not no_signed_zero("wind -0, inertia 1")
    assert not no_signed_zero("speed,-0.0,1")
    item = ("--vehicle", "xgd24d", "--speed-kmh", -0.001)
    assert no_signed_zero(good("explain", *item, "--belt-degc", 0))
    drive, repetition = folder / "slow.csv", folder / "again.csv"
    assert no_signed_zero(good("simulate", *item, "--duration-s", 60, "--ambient-degc", 0, "-o", drive))
    assert no_signed_zero(drive.read_text())
    assert no_signed_zero(good("replay", drive, "--vehicle", "xgd24d", "-o", repetition))
    assert no_signed_zero(repetition.read_text())

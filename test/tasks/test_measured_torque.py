# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A replay compares measured with expected torque, and a torque at the motor measures as one at the sprockets."""

import json
import re

import numpy as np
import pytest

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.guards import at_sprockets
from trackres_ros.estimator.settings import Settings
from trackres_ros.files.resources import config_dir
from trackres_ros.node.measured_torque import MismatchSettings
from trackres_ros.tasks.replay_comparison import LIKE
from trackres_ros.vehicle import load
from trackres_ros.vehicle.gears import Gears

RATIO, EFFICIENCY = 30.0, 0.9  # of agri3t
MOTOR = "{column: torque_nm, at: motor}"
GAIN, NOISE_NM = 1.05, 10.0
RATIO_LINE = '  motor_ratio: {value: 30.0, unit: "1", flag: A, range: [29.0, 31.0], reason: "test"}\n'
EFFICIENCY_LINE = '  motor_efficiency: {value: 0.9, unit: "1", flag: A, range: [0.8, 0.97], reason: "test"}\n'


def course():
    """Times [s] and speeds [m/s] of drives forward and in reverse, which brake hard."""
    time = np.arange(0.0, 600.0, 0.2)
    speed = np.zeros(len(time))
    for begin, end, most in ((20, 150, 3.0), (180, 300, 2.0), (330, 430, -2.0), (460, 570, 4.0)):
        inside = (time >= begin) & (time < end)
        speed[inside] = np.copysign(np.minimum(np.minimum(time[inside] - begin, end - time[inside]), abs(most)), most)
    return time, speed


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("torque")


def write(path, **columns):
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.12g")
    return path


@pytest.fixture(scope="module")
def torque(folder):
    """A torque at the sprockets of agri3t, somewhat above the expected one."""
    time, speed = course()
    expected = tr.replay(write(folder / "speed.csv", time_s=time, speed_mps=speed), "agri3t")["drive_torque_nm"]
    return GAIN * expected + np.random.default_rng(1).normal(0.0, NOISE_NM, len(time))


def at_motor(torque, speed, ratio=RATIO, efficiency=EFFICIENCY):
    """The torque at the motor: more than at the sprockets by the loss where it drives, less where it brakes."""
    return torque / ratio / efficiency ** np.sign(torque * speed)


@pytest.fixture(scope="module")
def recording(folder, torque):
    """Writes a recording with some function of torque and speed as its column `torque_nm`."""
    time, speed = course()

    def made(name, of=lambda torque, speed: torque):
        return write(folder / f"{name}.csv", time_s=time, speed_mps=speed, torque_nm=of(torque, speed))

    return made


@pytest.fixture
def topics(tmp_path):
    """Writes a topics file of a line for the torque."""

    def made(line):
        path = tmp_path / "topics.yaml"
        path.write_text(f"torque: {line}\nspeed: {{column: speed_mps}}\n")
        return path

    return made


def replayed(good, path, topics=None, vehicle="agri3t"):
    words = ("replay", path, "--vehicle", vehicle, "-o", path.parent / "out.csv", *(("--topics", topics) if topics else ()))
    return json.loads(good(*words, "--json"))["measured_torque"], good(*words)


@pytest.mark.usefixtures("undrawn")
def test_replay_gives_the_means_over_steady_driving(good, recording):
    path = recording("sprockets")
    found, shown = replayed(good, path)
    result = tr.replay(path, "agri3t")
    speed, accel, m, e = (result[name] for name in ("speed_mps", "accel_mps2", "measured_torque_nm", "drive_torque_nm"))
    used = MismatchSettings().compares(speed, accel) & np.isfinite(m)
    m, e = (np.sign(speed) * x for x in (m, e))
    assert found["minutes"] == pytest.approx(0.2 * used.sum() / 60.0)
    assert found["measured_nm"] == pytest.approx(m[used].mean())
    assert found["expected_nm"] == pytest.approx(e[used].mean())
    assert found["difference_nm"] == pytest.approx((m - e)[used].mean())
    assert found["difference_percent"] == pytest.approx(100.0 * (m - e)[used].mean() / np.abs(e[used]).mean())
    assert found["scatter_nm"] == pytest.approx((m - e)[used].std())
    assert 3.0 < found["difference_percent"] < 7.0
    assert found["finding"] == ""
    assert found["text"] in shown.splitlines()
    assert re.search(r"mean \d+ Nm, expected \d+ Nm, difference \+\d+ Nm \(\+5 %\), scatter 1\d Nm, over 7\.\d min", shown)
    assert result.measured_torque.as_dict() == found


@pytest.mark.usefixtures("undrawn")
def test_settings_of_the_comparison_hold_in_a_replay(recording):
    path = recording("sprockets")
    faster = tr.replay(path, "agri3t", params={"mismatch_min_speed_mps": 3.5}).measured_torque
    assert 0.0 < faster.minutes < 0.4 * tr.replay(path, "agri3t").measured_torque.minutes


def test_without_a_torque_nothing_is_compared(folder):
    time, speed = course()
    alone = tr.replay(write(folder / "alone.csv", time_s=time, speed_mps=speed), "agri3t")
    assert alone.measured_torque is None
    assert "measured_torque" not in alone.as_dict()
    time = np.arange(0.0, 60.0, 0.5)
    path = write(folder / "crawl.csv", time_s=time, speed_mps=np.full(len(time), 0.5), torque_nm=np.full(len(time), 200.0))
    result = tr.replay(path, "agri3t")
    assert result.as_dict()["measured_torque"]["difference_nm"] is None
    assert "Measured torque: not compared" in repr(result)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("name", "of", "words"),
    [
        ("motor", at_motor, "it is at the motor"),
        ("reversed", lambda torque, speed: -torque, "its sign is reversed"),
        ("motor_reversed", lambda torque, speed: -at_motor(torque, speed), "it is at the motor and its sign is reversed"),
        ("side", lambda torque, speed: 0.5 * torque, "it is one of 2 equal parts"),
        ("kilo", lambda torque, speed: 1e-3 * torque, "it is in kNm"),
    ],
)
def test_a_finding_gives_the_line_that_ends_it(good, recording, topics, name, of, words):
    path = recording(name, of)
    found, shown = replayed(good, path)
    assert f"If {words}, " in found["finding"]
    assert f"  ! {found['finding']}\n" in shown
    line = re.search(r"torque: (\{.*\})$", found["finding"])[1]
    corrected, _ = replayed(good, path, topics(line))
    assert corrected["finding"] == ""
    assert LIKE[0] < corrected["measured_nm"] / corrected["expected_nm"] < LIKE[1]


@pytest.mark.parametrize(
    "of", [lambda torque, speed: torque - 150.0, lambda torque, speed: 0.0 * torque, lambda *_: at_motor(*_)[::-1]]
)
def test_another_fault_of_the_torque_has_no_finding(recording, of):
    assert tr.replay(recording("fault", of), "agri3t").measured_torque.finding == ""


def test_a_gear_that_the_vehicle_file_lacks_is_estimated(tmp_path, recording):
    path = tmp_path / "mine.yaml"
    lines = (config_dir() / "agri3t.yaml").read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if "motor_" not in line))
    finding = tr.replay(recording("m", at_motor), path).measured_torque.finding
    estimate = float(re.search(r"behind a gear of about (\d+), give motor_ratio in the vehicle file", finding)[1])
    assert estimate == pytest.approx(RATIO * EFFICIENCY / GAIN, rel=0.05)
    assert finding.endswith("torque: {column: torque_nm, at: motor}")


def test_a_torque_at_the_sprockets_named_motor_is_found(recording, topics):
    finding = tr.replay(recording("sprockets"), "agri3t", topics=topics(MOTOR)).measured_torque.finding
    assert (
        "If it is at the sprockets, its line in the topics file should be torque: {column: torque_nm, at: sprockets}" in finding
    )


def test_a_torque_at_the_motor_measures_as_at_sprockets(recording, topics):
    sprockets, motor = (
        tr.replay(recording("sprockets"), "agri3t", learning="watch"),
        tr.replay(recording("m", at_motor), "agri3t", topics=topics(MOTOR), learning="watch"),
    )
    first = sprockets["measured_torque_nm"]
    ahead = np.sign(sprockets["speed_mps"])
    assert (first * ahead).max() > 100.0 > -100.0 > (first * ahead).min()  # it drives and brakes
    assert any("delay" in name for name in sprockets.columns)
    for name in sprockets.columns:
        assert motor[name] == pytest.approx(sprockets[name], rel=1e-6, abs=1e-6, nan_ok=True), name


def test_a_diagnosis_has_the_torque_at_the_sprockets_too(recording, topics):
    results = [
        tr.diagnose(recording(name, of), "agri3t", topics=topics(line), quick=True).as_dict()
        for name, of, line in (("s", lambda torque, speed: torque, "{column: torque_nm}"), ("m", at_motor, MOTOR))
    ]
    first, second = (
        {name: value for name, value in found["residual_sources"].items() if isinstance(value, float)} for found in results
    )
    assert first["total"] > 0.0
    assert second == pytest.approx(first, rel=1e-3)


def test_gears_and_their_twin_in_the_estimator_agree():
    gears, constants = Gears(RATIO, EFFICIENCY), Estimator(load("agri3t"), Settings(torque_at="motor")).constants
    for torque in (-20.0, 0.0, 7.0):
        for speed in (-2.0, 0.0, 3.0):
            expected = float(gears.at_sprockets(np.array([torque]), np.array([speed]))[0])
            assert at_sprockets(constants, torque, speed) == expected
            assert float(at_motor(np.array([expected]), np.array([speed]))[0]) == pytest.approx(torque)


def test_a_correction_of_a_torque_at_the_motor_is_in_its_units(recording, topics):
    offset_nm = 2.0  # of the sensor at the motor
    path = recording("offset", lambda torque, speed: at_motor(torque, speed) + offset_nm)
    notes = tr.diagnose(path, "agri3t", topics=topics(MOTOR), quick=True).as_dict()["warnings"]
    lines = [re.search(r"torque: (\{.*\})$", note)[1] for note in notes if "alike in" in note]
    (line,) = lines
    assert re.search(r"at: motor", line)
    assert float(re.search(r"offset: ([-\d.]+)", line)[1]) == pytest.approx(-offset_nm, rel=0.05)


@pytest.mark.parametrize(
    ("vehicle", "section", "lines"), [("xgd24d", "chassis", [RATIO_LINE, EFFICIENCY_LINE]), ("bmw_i3", "road_load", [RATIO_LINE])]
)
def test_without_a_ratio_the_error_gives_the_lines(tmp_path, recording, topics, vehicle, section, lines):
    path = recording("m", at_motor)
    with pytest.raises(InputError) as caught:
        tr.replay(path, vehicle, topics=topics(MOTOR))
    assert f"add under {section}, with your values: motor_ratio: " in str(caught.value)
    assert ("motor_efficiency" in str(caught.value)) is (len(lines) == 2)
    with pytest.raises(InputError, match="a vehicle file without motor_ratio"):
        tr.diagnose(path, vehicle, topics=topics(MOTOR))
    text = (config_dir() / f"{vehicle}.yaml").read_text()
    written = config_dir() / f"{vehicle}.yaml"
    (tmp_path / written.name).write_text(text.replace(f"\n{section}:\n", f"\n{section}:\n{''.join(lines)}"))
    result = tr.replay(path, tmp_path / written.name, topics=topics(MOTOR))
    efficiency = EFFICIENCY if len(lines) == 2 else 1.0  # a road load has the loss in the expected torque
    drives = result["speed_mps"] > 1.0
    raw = np.loadtxt(path, delimiter=",", skiprows=1)[:, 2]
    assert result["measured_torque_nm"][drives] == pytest.approx(
        np.where(raw > 0.0, RATIO * efficiency * raw, RATIO / efficiency * raw)[: len(drives)][drives]
    )


def test_at_is_a_key_of_a_torque_alone(recording, topics):
    with pytest.raises(InputError, match="at only for torque"):
        tr.replay(recording("sprockets"), "agri3t", topics={"speed": {"column": "speed_mps", "at": "motor"}})
    with pytest.raises(InputError, match="sprockets, motor"):
        tr.replay(recording("sprockets"), "agri3t", topics=topics("{column: torque_nm, at: wheel}"))

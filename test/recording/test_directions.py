# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A speed without a sign gets it from a direction, and a validity drops values: in every kind of recording."""

import json
import math

import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.recording.combining import HOLD_S, Companion
from trackres_ros.recording.roles import STANDARDS, named_ways, standard_of

TIMES = np.arange(120) * 0.1
TRUE = np.round(4.0 * np.sin(TIMES / 12.0 * 2.0 * math.pi), 2)  # forward for six seconds, then backwards
BACK = (TRUE < 0.0).astype(int)
# ISO 11783-7 has 0 for reverse, SAE J1939-71 has 1: the two speeds below are of one vehicle.
DBC = """VERSION ""
BU_: Vector__XXX
BO_ 2365475056 WBSD: 8 Vector__XXX
 SG_ WheelBasedMachineSpeed : 0|16@1+ (0.001,0) [0|64.255] "m/s" Vector__XXX
 SG_ MachineDirection : 56|2@1+ (1,0) [0|3] "" Vector__XXX
BO_ 2365484270 TCO1: 8 Vector__XXX
 SG_ TachographVehicleSpeed : 48|16@1+ (0.00390625,0) [0|250.996] "km/h" Vector__XXX
 SG_ DirectionIndicator : 30|2@1+ (1,0) [0|3] "" Vector__XXX
BO_ 256 Own: 8 Vector__XXX
 SG_ OwnSpeed : 0|16@1+ (0.001,0) [0|65] "m/s" Vector__XXX
 SG_ Lever : 16|8@1+ (1,0) [0|255] "" Vector__XXX
 SG_ SpeedValid : 24|1@1+ (1,0) [0|1] "" Vector__XXX
BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_ "VFrameFormat" BO_ 2365475056 3;
BA_ "VFrameFormat" BO_ 2365484270 3;
VAL_ 256 Lever 7 "Reverse gear" 8 "Neutral" 9 "Forward" ;
"""
LEVER = np.where(BACK, 7, 9)


def frames(directions=None, valid=None):
    """A log of the three messages: the speed has no sign in any."""
    iso = 1 - BACK if directions is None else directions
    for row, (at_s, speed) in enumerate(zip(TIMES, np.abs(TRUE), strict=True)):
        millis, counts = round(1000.0 * speed), round(3.6 * speed * 256)
        wbsd = millis.to_bytes(2, "little") + bytes(5) + bytes([int(iso[row])])
        tco1 = bytes(3) + bytes([int(BACK[row]) << 6]) + bytes(2) + counts.to_bytes(2, "little")
        own = millis.to_bytes(2, "little") + bytes([int(LEVER[row]), 1 if valid is None else int(valid[row])]) + bytes(4)
        for number, data in (("0CFE48F0", wbsd), ("0CFE6CEE", tco1), ("100", own)):
            yield f"({at_s:.6f}) can0 {number}#{data.hex().upper()}\n"


@pytest.fixture
def can_log(tmp_path):
    pytest.importorskip("cantools")

    def written(**given):
        (tmp_path / "bus.dbc").write_text(DBC)
        (tmp_path / "drive.log").write_text("".join(frames(**given)))
        return tmp_path / "drive.log"

    return written


def read(path, **lines):
    if path.suffix == ".log":
        lines["dbc"] = str(path.with_name("bus.dbc"))
    return tr.read(path, topics=lines)


def assert_true(recording, within=1e-3):
    np.testing.assert_allclose(recording.series["speed"].value, TRUE, atol=within)


@pytest.mark.parametrize(
    ("speed", "direction"),
    [("WheelBasedMachineSpeed", "MachineDirection"), ("TachographVehicleSpeed", "DirectionIndicator"), ("OwnSpeed", "Lever")],
)
def test_standards_and_named_values_need_no_values_in_a_file(can_log, speed, direction):
    recording = read(can_log(), speed={"channel": speed}, direction={"channel": direction})
    assert_true(recording, within=2e-3)
    assert set(np.unique(recording.series["direction"].value)) == {-1.0, 1.0}


def test_a_guess_takes_speed_and_direction_of_one_message(can_log, good):
    path = can_log()
    text = good("topics", "guess", path, "--dbc", path.with_name("bus.dbc"))
    assert "speed: {channel: TachographVehicleSpeed" in text
    assert "direction: {channel: DirectionIndicator, values: j1939}" in text
    kept = path.with_name("topics.yaml")
    kept.write_text(text)
    assert_true(tr.read(path, topics=kept), within=2e-3)
    assert_true(tr.read(path, topics={"dbc": path.with_name("bus.dbc")}), within=2e-3)


def test_a_message_without_a_direction_gives_no_speed(can_log):
    """Its direction is an error: that of the message before is not taken for it."""
    broken = np.arange(len(TRUE)) % 3 == 0
    recording = read(
        can_log(directions=np.where(broken, 2, 1 - BACK)),
        speed={"channel": "WheelBasedMachineSpeed"},
        direction={"channel": "MachineDirection"},
    )
    keep = ~broken | (np.abs(TRUE) < 1e-9)
    np.testing.assert_allclose(recording.series["speed"].value, TRUE[keep], atol=1e-3)
    assert ("no_direction", int(np.sum(~keep))) in {(finding.kind, finding.count) for finding in recording.findings}


@pytest.mark.parametrize("suffix", ["csv", "log", "mf4"])
def test_what_a_validity_refuses_gives_no_sample_and_is_counted(can_log, tmp_path, suffix):
    valid = np.arange(len(TRUE)) % 4 != 1
    if suffix == "csv":
        path = table(tmp_path, speed_mps=np.abs(TRUE), ok=valid.astype(int), reverse=BACK)
        lines = {"speed": {"column": "speed_mps", "valid": {"column": "ok"}}}
    elif suffix == "log":
        path = can_log(valid=valid)
        lines = {"speed": {"channel": "OwnSpeed", "valid": {"channel": "SpeedValid"}}, "direction": {"channel": "Lever"}}
    else:
        path = mdf(tmp_path, v=np.abs(TRUE), ok=np.where(valid, 5, 0), back=BACK)
        ways = {"forward": [0], "reverse": [1]}
        lines = {"speed": {"channel": "v", "unit": "m/s", "valid": {"channel": "ok", "values": [5]}}}
        lines["direction"] = {"channel": "back", "values": ways}
    recording = read(path, **lines)
    np.testing.assert_allclose(recording.series["speed"].value, TRUE[valid], atol=1e-3)
    assert ("invalid", int(np.sum(~valid))) in {(finding.kind, finding.count) for finding in recording.findings}


def table(folder, **columns):
    names = ["time_s", *columns]
    rows = zip(TIMES, *columns.values(), strict=True)
    path = folder / "drive.csv"
    path.write_text("\n".join([",".join(names), *(",".join(f"{cell:g}" for cell in row) for row in rows)]) + "\n")
    return path


def mdf(folder, **channels):
    asammdf = pytest.importorskip("asammdf")
    path = folder / "drive.mf4"
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(samples=values, timestamps=TIMES, name=name) for name, values in channels.items()])
        file.save(path)
    return path


def test_an_enumeration_of_an_mdf_file_says_what_its_values_mean(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    named = {"val_0": 4, "text_0": b"Driving forward", "val_1": 6, "text_1": b"Backwards", "default": b""}
    with asammdf.MDF(version="4.10") as file:
        speed = asammdf.Signal(samples=np.abs(TRUE), timestamps=TIMES, name="v", unit="m/s")
        way = asammdf.Signal(samples=np.where(BACK, 6, 4).astype(np.uint8), timestamps=TIMES, name="Way", conversion=named)
        file.append([speed, way])
        file.save(tmp_path / "drive.mf4")
    assert_true(read(tmp_path / "drive.mf4", speed={"channel": "v"}, direction={"channel": "Way"}))


def test_a_column_reverse_of_words_is_left_alone(tmp_path):
    path = tmp_path / "drive.csv"
    rows = [f"{at_s:g},{abs(v):g},{'yes' if back else 'no'}" for at_s, v, back in zip(TIMES, TRUE, BACK, strict=True)]
    path.write_text("\n".join(["time_s,speed_mps,reverse", *rows]) + "\n")
    recording = tr.read(path)
    assert "direction" not in recording.series
    assert "unsigned" in {finding.kind for finding in recording.findings}


# The public command, on the case of the specification


def test_a_column_reverse_makes_a_replay_drive_backwards(tmp_path, good):
    rows = {}
    for name, columns in {"signed": {"speed_mps": TRUE}, "flagged": {"speed_mps": np.abs(TRUE), "reverse": BACK}}.items():
        path = table(tmp_path, **columns)
        good("replay", path, "--vehicle", "xgd24d", "-o", tmp_path / f"{name}.csv")
        rows[name] = np.genfromtxt(tmp_path / f"{name}.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(rows["flagged"]["feedforward_torque_nm"], rows["signed"]["feedforward_torque_nm"])
    assert rows["flagged"]["feedforward_torque_nm"].min() < -2000.0
    assert rows["flagged"]["feedforward_torque_nm"].max() > 2000.0


def test_a_speed_never_negative_beside_reverse_is_a_finding(tmp_path, good):
    path = table(tmp_path, v=np.abs(TRUE), ReverseGearEngagedSignal=BACK)
    (tmp_path / "t.yaml").write_text("speed: {column: v}\n")
    report = json.loads(
        good("replay", path, "--topics", tmp_path / "t.yaml", "--vehicle", "xgd24d", "-o", tmp_path / "o.csv", "--json")
    )
    results = [finding for finding in tr.read(path, topics=tmp_path / "t.yaml").findings if finding.kind == "unsigned"]
    assert len(results) == 1
    assert "direction: {channel: ReverseGearEngagedSignal" in results[0].text
    assert "never negative" in json.dumps(report)
    path = table(tmp_path, v=TRUE, ReverseGearEngagedSignal=BACK)
    assert "unsigned" not in {finding.kind for finding in tr.read(path, topics=tmp_path / "t.yaml").findings}


# Rules


def test_neutral_keeps_the_way_and_a_negative_speed_its_sign(tmp_path):
    speed, lever = np.ones(len(TIMES)), np.zeros(len(TIMES))
    speed[50:60] = -2.0
    lever[:20], lever[20:100], lever[100:] = -1.0, 0.0, 1.0
    recording = tr.read(table(tmp_path, speed_mps=speed, travel_direction=lever))
    expectation = np.where(TIMES < 9.95, -np.abs(speed), speed)
    np.testing.assert_array_equal(recording.series["speed"].value, expectation)


def test_a_direction_in_another_message_expires_and_is_said(tmp_path):
    cells = [f"{at_s:g},3,{1 if at_s < 2.0 else ''}" for at_s in TIMES]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(["time_s,speed_mps,back", *cells]) + "\n")
    line = {"column": "back", "values": {"forward": [0], "reverse": [1]}}
    recording = tr.read(path, topics={"speed": {"column": "speed_mps"}, "direction": line})
    last = 1.9 + HOLD_S
    np.testing.assert_array_equal(recording.series["speed"].value, np.full(np.sum(last + 1e-9 >= TIMES), -3.0))
    longer = tr.read(path, topics={"speed": {"column": "speed_mps"}, "direction": {**line, "max_age_s": 100.0}})
    assert len(longer.series["speed"]) == len(TIMES)


def test_a_companion_of_one_message_is_not_timed_apart():
    apart, together = Companion(1.0, shares_message=False), Companion(1.0, shares_message=True)
    for item in (apart, together):
        item.take_sample(10**9, -1.0)
    assert (apart.value_at(15 * 10**8), together.value_at(10**9)) == (-1.0, -1.0)
    assert math.isnan(together.value_at(10**9 + 1))
    assert math.isnan(apart.value_at(2 * 10**9 + 1))
    assert math.isnan(apart.value_at(10**9 - 1))


def test_the_two_standards_are_opposite_and_known_by_name():
    assert standard_of("WheelBasedMachineDirection") == standard_of("GroundBasedMachineDirection") == "iso_11783"
    assert standard_of("DirectionIndicator") == standard_of("TransmissionReverseDirectionSwitch") == "j1939"
    assert standard_of("TransmissionCurrentGear") == "gear"
    assert not standard_of("WindDirection")
    assert not standard_of("ReverseOsmosisPump")
    for name, numbers in {"iso_11783": [1, 0, 2, 3], "j1939": [0, 1, 2, 3], "gear": [3, -1, math.nan, math.nan]}.items():
        np.testing.assert_array_equal(STANDARDS[name].directions(np.array(numbers, float)), [1.0, -1.0, math.nan, math.nan])
    assert named_ways([(0.0, "Off"), (1.0, "Reverse")]) is None


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ({"channel": "Lever7"}, "values that mean forward and reverse"),
        ({"channel": "Lever7", "values": {"forward": [1]}}, "iso_11783, j1939, gear"),
        ({"channel": "Lever7", "values": "iso"}, "iso_11783"),
        ({"channel": "Lever7", "values": {"forward": [1], "reverse": [1]}}, "each value once"),
        ({"topic": "/gear", "type": "std_msgs/msg/UInt8", "field": "data"}, "values that mean forward and reverse"),
    ],
)
def test_a_direction_without_a_meaning_is_refused_with_a_remedy(tmp_path, line, said):
    path = table(tmp_path, speed_mps=np.abs(TRUE), Lever7=BACK)
    with pytest.raises(InputError, match=said):
        tr.read(path, topics={"speed": {"column": "speed_mps"}, "direction": line})


FLAGS = {
    "reverse_gear": (0, 1), "Is Reversing [-]": (0, 1), "driving_backwards": (0, 1), "Reverse": ("false", "true"),
    "forward": (1, 0), "direction": (1, -1), "gear": (3, -1), "MachineDirection": (1, 0),
}  # fmt: skip
"""By the name of a column: its cells forward and backwards."""


@pytest.mark.parametrize("name", FLAGS)
def test_the_printed_line_for_a_missing_sign_gives_it(tmp_path, name):
    rows = zip(TIMES, np.abs(TRUE), BACK, strict=True)
    path = tmp_path / "drive.csv"
    path.write_text(f"time_s,speed_mps,{name}\n" + "".join(f"{t:g},{v:g},{FLAGS[name][back]}\n" for t, v, back in rows))
    (text,) = [one.text for one in tr.read(path).findings if one.kind == "unsigned"]
    line = yaml.safe_load(text.partition("with the values that it has: ")[2])
    assert_true(tr.read(path, topics=line))


@pytest.mark.parametrize("words", [("false", "true"), ("FALSE", "TRUE"), ("0", "1")])
def test_a_validity_in_a_table_may_be_true_or_false(tmp_path, words):
    valid = np.arange(len(TRUE)) % 4 != 1
    path = tmp_path / "drive.csv"
    rows = zip(TIMES, TRUE, valid, strict=True)
    path.write_text("time_s,speed_mps,ok\n" + "".join(f"{t:g},{v:g},{words[int(ok)]}\n" for t, v, ok in rows))
    found = read(path, speed={"column": "speed_mps", "valid": {"column": "ok"}})
    np.testing.assert_allclose(found.series["speed"].value, TRUE[valid])
    assert ("invalid", int(np.sum(~valid))) in {(one.kind, one.count) for one in found.findings}

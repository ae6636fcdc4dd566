# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Logs of VBOX, LabVIEW and PX4 as their programs write them; the way out for a file that is not read."""

from __future__ import annotations

import csv
import math
import os
import shlex
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from trackres_ros.errors import InputError
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import CONVERSIONS, open_source, suffixes
from trackres_ros.recording.recording import Recording

VBOX = """File created on {created}

[header]
satellites
time
latitude
longitude
velocity {unit}
heading
height
vertical velocity m/s
Motor Torque

[channel units]
Nm

[comments]
(c) 2001 2003 Racelogic
Log Rate (Hz) : 10.00
Security Code : %//+$%00"0/0+

[laptiming]
Start   -00690.1    +02886.0    -00690.2    +02886.1 Start / Finish

[column names]
sats time lat long velocity heading height vert-vel Motor_Torque

[data]
{rows}
"""


def write_vbox(
    path: Path, times: list[str], created: str = "31/07/2006 at 09:55:20 ", unit: str = "kmh", mark: str = "."
) -> Path:
    rows = [
        f"137 {time} +03119.09973 -00058.49277 {row:07.3f} 321.85 +00152.58 -00000.030 +1.0000{row:02d}E+03"
        for row, time in enumerate(times)
    ]
    text = VBOX.format(created=created, unit=unit, rows="\n".join(rows).replace(".", mark))
    path.write_bytes(text.replace("\n", "\r\n").encode("latin-1"))
    return path


def read(path: Path) -> Recording:
    return Recording.from_source(open_source([path]))


CLOCK = [f"0955{second:02d}.{tenth}0" for second in range(58, 60) for tenth in range(10)]
CLOCK += [f"0956{second:02d}.{tenth}0" for second in range(2) for tenth in range(10)]


@pytest.mark.parametrize("mark", [".", ","])
@pytest.mark.parametrize("created", ["31/07/2006 at 09:55:20", "31/07/2006 @ 09:55", "31/07/2006 09:55:20"])
def test_vbox_times_are_of_the_day_in_its_first_line(tmp_path, created, mark):
    speed = read(write_vbox(tmp_path / "run.vbo", CLOCK, created, mark=mark)).series["speed"]
    assert speed.stamp_ns[0] == np.datetime64("2006-07-31T09:55:58").astype("datetime64[ns]").astype(int)
    np.testing.assert_array_equal(np.diff(speed.stamp_ns), 100_000_000)


@pytest.mark.parametrize(("unit", "mps"), [("kmh", 1 / 3.6), ("knots", 1852 / 3600), ("mph", 0.44704)])
def test_vbox_units_are_those_of_the_header(tmp_path, unit, mps):
    recording = read(write_vbox(tmp_path / "run.vbo", CLOCK, unit=unit))
    np.testing.assert_allclose(recording.series["speed"].value, mps * np.arange(40), rtol=1e-6)


def test_vbox_positions_are_in_minutes_and_positive_east(tmp_path):
    series = read(write_vbox(tmp_path / "run.vbo", CLOCK)).series
    np.testing.assert_allclose(np.degrees(series["latitude"].value), 3119.09973 / 60)
    np.testing.assert_allclose(np.degrees(series["longitude"].value), 58.49277 / 60)


def test_a_vbox_drive_goes_on_after_midnight(tmp_path):
    times = [f"2359{58 + row // 10}.{row % 10}0" for row in range(20)] + [f"00000{row // 10}.{row % 10}0" for row in range(20)]
    speed = read(write_vbox(tmp_path / "run.vbo", times)).series["speed"]
    np.testing.assert_array_equal(np.diff(speed.stamp_ns), 100_000_000)


def test_vbox_times_that_are_no_time_of_day_are_seconds(tmp_path):
    recording = read(write_vbox(tmp_path / "run.vbo", [f"{93750 + row:09.2f}" for row in range(40)]))
    np.testing.assert_array_equal(np.diff(recording.series["speed"].stamp_ns), 10**9)
    assert any("seconds, as 093761.00 is no time of day" in note for note in recording.notes)


def test_a_word_for_a_vbox_time_is_refused_with_its_line(tmp_path):
    with pytest.raises(InputError, match=r"line 34, column time: given 'morning'; allowed: a time of day as hhmmss\.ss"):
        read(write_vbox(tmp_path / "run.vbo", [*CLOCK[:5], "morning", *CLOCK[6:]]))


LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
X_Columns\t{columns}
Time_Pref\tAbsolute
***End_of_Header***\t
\t
Channels\t1\t
Date\t2026/11/23\t
Time\t10:00:00.5000000000000000000\t
Y_Unit_Label\tkm/h\t
X_Dimension\tTime\t
X0\t0.0000000000000000E+0\t
Delta_X\t0.100000\t
***End_of_Header***\t\t
{names}
"""


@pytest.mark.parametrize("columns", ["One", "No"])
def test_labview_times_are_a_column_or_an_interval(tmp_path, columns):
    rows = [f"{row / 10 if columns == 'One' else ''}\t{row}" + "\tbrake" * (row == 7) for row in range(40)]
    head = LABVIEW.format(columns=columns, names="X_Value\tSpeed\tComment")
    (tmp_path / "run.lvm").write_text(head + "\n".join(rows) + "\n")
    speed = read(tmp_path / "run.lvm").series["speed"]
    np.testing.assert_allclose(speed.value, np.arange(40) / 3.6)
    assert speed.stamp_ns[0] == np.datetime64("2026-11-23T10:00:00.5").astype("datetime64[ns]").astype(int)
    np.testing.assert_array_equal(np.diff(speed.stamp_ns), 100_000_000)


def test_labview_columns_of_several_times_are_refused(tmp_path):
    head = LABVIEW.format(columns="Multi", names="X_Value\tSpeed\tX_Value\tTorque\tComment")
    (tmp_path / "run.lvm").write_text(head + "0.0\t1.0\t0.0\t2.0\n" * 5)
    with pytest.raises(InputError, match=r"several columns X_Value.*One Column Only"):
        read(tmp_path / "run.lvm")


def write_ulog(path: Path, end: bytes = b"") -> Path:
    """Two instances of a topic, of which the first has values that are no number, and two dropouts."""
    data = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))

    def add(kind: bytes, content: bytes) -> None:
        data.extend(struct.pack("<H", len(content)) + kind + content)

    add(b"B", bytes(40))
    add(b"F", b"wheels:uint64_t timestamp;float[2] speed_kmh;bool on;uint8_t[3] spare;")
    for instance in range(2):
        add(b"A", struct.pack("<BH", instance, instance) + b"wheels")
    for row in range(50):
        for instance in range(2):
            speed = math.nan if instance == 0 and row % 10 == 9 else row + 0.5 * instance
            add(b"D", struct.pack("<HQff?3x", instance, 10**6 + row * 100_000, 0.0, speed, True))
    for _ in range(2):
        add(b"O", struct.pack("<H", 250))
    path.write_bytes(data + end)
    return path


@pytest.mark.parametrize(("group", "count", "kinds"), [("wheels", 45, {"missing", "absent"}), ("wheels_1", 50, {"missing"})])
def test_each_instance_of_a_ulog_topic_is_a_group(tmp_path, group, count, kinds):
    pytest.importorskip("pyulog")
    topics = Topics.parse({"speed": {"channel": f"{group}/speed_kmh[1]", "unit": "km/h"}}, "topics.yaml")
    recording = Recording.from_source(open_source([write_ulog(tmp_path / "run.ulg")], topics))
    speed = recording.series["speed"]
    assert len(speed) == count
    np.testing.assert_allclose(speed.value[:9] * 3.6, np.arange(9) + (0.5 if group == "wheels_1" else 0.0), rtol=1e-6)
    assert (speed.stamp_ns[0], speed.stamp_ns[8]) == (10**9, 1_800_000_000)
    assert {finding.kind for finding in recording.findings} >= kinds
    assert any("dropped messages 2 times, for 0.5 s in all" in finding.text for finding in recording.findings)


@pytest.mark.parametrize("end", [b"\x15\0D\0\0", b"\x03\0\x80abc"], ids=["cut", "unknown type"])
def test_what_a_ulog_lost_is_a_finding(tmp_path, end):
    pytest.importorskip("pyulog")
    topics = Topics.parse({"speed": {"channel": "wheels/speed_kmh[1]", "unit": "km/h"}}, "topics.yaml")
    whole, damaged = (Recording.from_source(open_source([write_ulog(tmp_path / "run.ulg", rest)], topics)) for rest in (b"", end))
    assert "structure" not in {finding.kind for finding in whole.findings}
    assert "structure" in {finding.kind for finding in damaged.findings}


NAMES = [end if end[0] != "." else f"drive 1{end}" for ends, _, _ in CONVERSIONS for end in ends]


@pytest.mark.parametrize("name", [*NAMES, "RUN.TDMS", "route--0--rlog.zst"])
def test_every_known_suffix_has_a_way_out_in_one_line(tmp_path, name):
    (tmp_path / name).write_bytes(b"something")
    with pytest.raises(InputError) as refused:
        open_source([tmp_path / name])
    assert refused.value.remedy
    assert "\n" not in str(refused.value)
    assert refused.value.allowed.endswith(f"or {suffixes()[-1]}")
    if " -c " in refused.value.remedy:
        code = shlex.split(refused.value.remedy.partition("python -c ")[2])
        compile(code[0], "remedy", "exec")
        assert code[1] == str(tmp_path / name)


@pytest.mark.parametrize("name", ["run.xyz", "run"])
def test_a_file_of_no_suffix_is_known_by_its_content(tmp_path, name):
    (tmp_path / name).write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    with pytest.raises(InputError, match=r"an MCAP bag by its content.*; name it \.mcap$"):
        open_source([tmp_path / name])
    (tmp_path / name).write_bytes(b"anything")
    with pytest.raises(InputError, match=r"; export it as a CSV table from the program that wrote it$"):
        open_source([tmp_path / name])


def test_a_text_under_another_suffix_is_read_as_the_remedy_says(tmp_path):
    (tmp_path / "drive 1.txt").write_text("time_s\tspeed_mps\n" + "".join(f"{row / 10}\t{row}\n" for row in range(20)))
    with pytest.raises(InputError) as refused:
        open_source([tmp_path / "drive 1.txt"])
    subprocess.run(shlex.split(refused.value.remedy.partition("CSV: ")[2]), check=True)
    assert len(read(tmp_path / "drive 1.csv").series["speed"]) == 20


STAND_INS = {
    "nptdms": """
class TdmsFile:
    def read(path):
        return TdmsFile()
    def as_dataframe(self, time_index):
        return self
    def to_csv(self, path, index_label):
        open(path, "w").write(index_label + ",speed_mps\\n" + "".join(f"{row},{row}\\n" for row in range(20)))
""",
    "fitdecode": """
from datetime import datetime, timezone
class FitDataMessage:
    name = "record"
    def __init__(self, row):
        self.fields = {"timestamp": datetime.fromtimestamp(1.7e9 + row, timezone.utc), "speed": float(row)}
    def get_value(self, name, fallback=None):
        return self.fields.get(name, fallback)
def FitReader(path):
    return [object(), *map(FitDataMessage, range(20))]
""",
    "openpilot.tools.lib.logreader": """
class Event:
    class carState:
        pass
    def __init__(self, row):
        self.logMonoTime = row * 10**9
        self.carState = type("State", (), {"vEgo": float(row)})
    def which(self):
        return "carState"
def LogReader(path):
    return map(Event, range(20))
""",
}
"""The parts of other programs that the remedies use, as their own documentation has them."""


@pytest.mark.parametrize(("name", "module"), [*zip(("a.tdms", "a.fit", "rlog"), STAND_INS, strict=True)])
def test_what_a_printed_program_writes_is_read(tmp_path, name, module):
    place = tmp_path.joinpath(*module.split(".")).with_suffix(".py")
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(STAND_INS[module])
    (tmp_path / name).write_bytes(b"something")
    with pytest.raises(InputError) as refused:
        open_source([tmp_path / name])
    code = shlex.split(refused.value.remedy.partition("python -c ")[2])
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    subprocess.run([sys.executable, "-c", *code], cwd=tmp_path, env=environment, check=True)
    with (tmp_path / "drive.csv").open() as file:
        assert len(list(csv.reader(file))) == 21
    np.testing.assert_allclose(np.diff(read(tmp_path / "drive.csv").series["speed"].stamp_ns), 1e9)

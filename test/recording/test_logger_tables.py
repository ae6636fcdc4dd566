# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables as loggers write them need no help: names, units, times, missing values; and clocks that begin anew."""

from __future__ import annotations

import json
from datetime import UTC, datetime, time, timedelta
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.recording.text_table import NO_VALUE
from trackres_ros.recording.wrapping import WrappingClock

BEGIN = datetime(2021, 9, 2, 9, 37, tzinfo=UTC)
COUNT = 40
KMH = [0.5 * i for i in range(COUNT)]
TORQUE = [50 + i % 7 for i in range(COUNT)]
ABOVE = (
    ("no line",), ("lines of a logger", "Format,of a logger,,,Workbook,", "Log Time,10:00:00", "Rate,10.0,Hz", "", ""),
    ("properties", "Serial = 12", "Driver: A, B", "[data]"), ("comments", "# of A, B, C", "// started 2021", "% in May"),
    ("as many cells", "Logger,X,a", "Gear,5,", *(f"P{i},{i},-" for i in range(12))),
)  # fmt: skip
HEADERS = (
    ("in the names", "Time [s],Speed (OBD)(km/h),Torque(Nm)"), ("in words", "Time (sec),Speed (km/hr),Torque [Newton meters]"),
    ("below", "Time,Ground Speed,Drive Torque", "s,km/h,Nm"), ("in brackets below", "Time,Velocity,Torque", "[s],[km/h],[Nm]"),
    ("with kinds", "time,vehicle_speed,torque", "f8,f8,f8", "s,km/h,Nm"),
    ("with texts", "Time,Speed,Torque", "s,km/h,Nm", "elapsed,of GNSS,at the sprockets"),
    ("German", "Zeit [s],Geschwindigkeit [km/h],Drehmoment [Nm]"), ("French", "Temps (s),Vitesse (km/h),Couple (N.m)"),
    ("Spanish", "Tiempo [s],Velocidad [km/h],Par [Nm]"), ("Italian", "Tempo,Velocità,Coppia", "s,km/h,Nm"),
    ("symbols", "t [s],v [km/h],M [Nm]"), ("at the end", "time_s,v_kmh,torque_nm"),
)  # fmt: skip


def written(folder: Path, lines: list[str], separator: str = ",", coding: str = "utf-8") -> Path:
    path = folder / "run.csv"
    path.write_text("\n".join(line.replace(",", separator) for line in lines) + "\n", coding)
    return path


def rows(times: list[str]) -> list[str]:
    return [f"{when},{speed},{torque}" for when, speed, torque in zip(times, KMH, TORQUE, strict=True)]


@pytest.mark.parametrize("above", ABOVE, ids=[name for name, *_ in ABOVE])
@pytest.mark.parametrize("header", HEADERS, ids=[name for name, *_ in HEADERS])
def test_a_logger_s_table_needs_no_topics_file(tmp_path, good, header, above):
    first = ["sep=;"] if above[0] == "no line" else []
    data = rows([f"{i / 10}" for i in range(COUNT)])
    lines = [*first, *above[1:], *header[1:], "", *data[:20], ",,", "# paused, here", *data[20:]]
    path = written(tmp_path, lines, ";" if first else ",")
    found = tr.read(path)
    np.testing.assert_allclose(found.series["speed"].value, np.array(KMH) / 3.6)
    assert found.series["torque"].value.tolist() == TORQUE
    np.testing.assert_allclose(found.time_s("speed"), np.arange(COUNT) / 10)
    if above is ABOVE[0]:
        (tmp_path / "topics.yaml").write_text(good("topics", "guess", path))
        again = tr.read(path, topics=tmp_path / "topics.yaml")
        assert again.series["speed"].value.tolist() == found.series["speed"].value.tolist()


def test_a_sheet_and_a_text_of_one_table_are_alike(tmp_path):
    book = pytest.importorskip("openpyxl").Workbook()
    tokens = ["NA", "null", "#N/A", "NaN", "---"]
    cells = [[i / 10, KMH[i] if i % 5 else tokens[i // 5 % 5], TORQUE[i]] for i in range(COUNT)]
    lines = [["of a logger", None, None], ["Time", "Ground Speed", "Drive Torque"], ["s", "km/h", "Nm"], *cells[:9]]
    lines += [["Time", "Ground Speed", "Drive Torque"], ["# paused", None, None], *cells[9:]]
    for line in lines:
        book.active.append(line)
    book.save(tmp_path / "run.xlsx")
    text = written(tmp_path, [",".join("" if cell is None else str(cell) for cell in line) for line in lines])
    sheet, table = tr.read(tmp_path / "run.xlsx"), tr.read(text)
    for role in ("speed", "torque"):
        assert sheet.series[role].value.tolist() == table.series[role].value.tolist()
        assert sheet.series[role].stamp_ns.tolist() == table.series[role].stamp_ns.tolist()
    assert len(table.series["speed"]) == COUNT - COUNT // 5


def test_each_word_for_no_value_is_one_in_any_case(tmp_path, reader):
    words = sorted({form(word) for word in NO_VALUE for form in (str, str.lower, str.upper, str.title)} - {","})
    lines = [f"{i},7,{word}" for i, word in enumerate(words)]
    found = tr.read(written(tmp_path, ["time_s,speed_mps,torque_nm", *lines, f"{len(words)},7,1"]))
    assert found.series["torque"].value.tolist() == [1.0]
    assert len(found.series["speed"]) == len(words) + 1


FORMS = (
    "%d-%b-%Y %H:%M:%S.%f", "%d %B %Y %H:%M:%S.%f", "%b %d, %Y %H:%M:%S.%f", "%a %b %d %H:%M:%S.%f GMT+00:00 %Y",
    "%a, %d %b %Y %H:%M:%S.%f GMT", "%Y-%b-%d %H:%M:%S.%f", "%d.%m.%y %H:%M:%S.%f", "%d%b%Y:%H:%M:%S.%f", "%Y.%m.%d %H:%M:%S,%f",
    "%d-%b-%Y %I:%M:%S.%f %p", "%d.%m.%Y %I:%M:%S.%f %p",
)  # fmt: skip


@given(
    begin=st.datetimes(datetime(1980, 1, 1), datetime(2060, 1, 1)),
    steps=st.lists(st.integers(1, 10**11), min_size=1, max_size=5),
    form=st.sampled_from(FORMS),
)
def test_a_date_of_a_logger_is_read_as_written(tmp_path_factory, begin, steps, form):
    times = [begin + timedelta(microseconds=sum(steps[:count])) for count in range(len(steps) + 1)]
    path = written(tmp_path_factory.mktemp("t"), ["Device Time;speed_mps", *(f"{when.strftime(form)};1" for when in times)], ",")
    found = tr.read(path).series["speed"].stamp_ns
    assert found.tolist() == [(when - datetime(1970, 1, 1)) // timedelta(microseconds=1) * 1000 for when in times]


@pytest.mark.parametrize("name", ["März", "mar", "MARS", "marzo", "Mrz", "march"])
def test_a_month_has_names_in_several_languages(tmp_path, name):
    path = written(tmp_path, ["Zeit;speed_mps", f"2. {name} 2021 09:37:00;1", f"2. {name} 2021 09:37:01;1"], ",")
    assert tr.read(path).start_ns == round(datetime(2021, 3, 2, 9, 37, tzinfo=UTC).timestamp()) * 10**9


@pytest.mark.parametrize("name", ["Time", "Datenum [d]", "Timestamp"])
@pytest.mark.parametrize("day", [719529, 25569])
def test_numbers_of_days_show_their_epoch(tmp_path, good, name, day):
    """The number of the first day of 1970, in MATLAB and in Excel."""
    days = [day + (BEGIN.timestamp() + i / 10) / 86400 for i in range(COUNT)]
    path = written(tmp_path, [f"{name};Speed [km/h];x", *rows([f"{when:.9f}" for when in days])], ";")
    found = tr.read(path)
    assert found.series["speed"].stamp_ns / 1e9 == pytest.approx(BEGIN.timestamp() + np.arange(COUNT) / 10, abs=1e-3)
    (tmp_path / "topics.yaml").write_text(good("topics", "guess", path))
    again = tr.read(path, topics=tmp_path / "topics.yaml")
    assert again.series["speed"].stamp_ns.tolist() == found.series["speed"].stamp_ns.tolist()


def test_the_finer_of_two_times_is_guessed(tmp_path):
    times = [BEGIN + timedelta(milliseconds=100 * i) for i in range(COUNT)]
    lines = [f"{when:%a %b %d %H:%M:%S} GMT+00:00 2021,{when:%d-%b-%Y %H:%M:%S.%f},{i}" for i, when in enumerate(times)]
    found = tr.read(written(tmp_path, ["GPS Time,Device Time, GPS Speed (Meters/second)", *lines]))
    assert found.time_s("speed").tolist() == pytest.approx([i / 10 for i in range(COUNT)])
    assert any(note.startswith("time: {channel: Device Time}  # guessed; also possible: GPS Time") for note in found.notes)


REFUSED = (
    "Time;Speed [km/h];x", "Time;Speed;x", "Zeit;v;x", "time_s;Fahrt, v (x);x", "when: it;Speed [km/h];x",
    "Time [s];speed: of it;Torque [kmh]",
)  # fmt: skip


@pytest.mark.parametrize("names", REFUSED)
def test_each_printed_line_of_a_topics_file_reads_when_followed(tmp_path, names):
    path = written(tmp_path, [names, *(row.replace(",", ";") for row in rows([str(i / 10) for i in range(COUNT)]))], ",")
    topics: dict[str, object] = {}
    for _ in range(3):
        try:
            found = tr.read(path, topics=topics or None)
            break
        except InputError as refused:
            text = str(refused).partition("topics file: ")[2]
            line = text[: text.index("}") + 1].replace("NAME", json.dumps(names.split(";")["speed" in text[:6]]))
            topics |= yaml.safe_load(line)
    assert found.series["speed"].value == pytest.approx(np.array(KMH) / 3.6)
    assert found.time_s("speed") == pytest.approx(np.arange(COUNT) / 10)


# --- clocks that begin anew

CLOCKS = {
    "a day": 86400.0,
    "a week of GPS": 604800.0,
    "16 bits [ms]": 65.536,
    "32 bits [ms]": 4294967.296,
    "32 bits [us]": 4294.967296,
}


def clocked(folder: Path, seconds: np.ndarray, name: str = "time_s", form: str = "{:.3f}", scale: float = 1.0) -> tr.Recording:
    lines = [f"{form.format(round(when / scale, 4))},{10 + i % 5}" for i, when in enumerate(seconds)]
    return tr.read(written(folder, [f"{name},speed_kmh", *lines]))


@given(
    kind=st.sampled_from([*CLOCKS]),
    step=st.sampled_from([0.01, 0.1, 1.0]),
    before=st.integers(1, 300),
    extra=st.integers(20, 300),
    lost=st.integers(0, 2),
)
def test_a_clock_that_wraps_is_one_drive(tmp_path_factory, kind, step, before, extra, lost):
    period, scale, name = CLOCKS[kind], {"[ms]": 1e-3, "[us]": 1e-6}.get(kind[-4:], 1.0), {"[ms]": "time_ms", "[us]": "time_us"}
    row = np.arange(before + extra) + lost * (np.arange(before + extra) >= before)
    truth = np.round(period - before * step, 3) + step * row
    found = clocked(
        tmp_path_factory.mktemp("t"), truth % period, name.get(kind[-4:], "time_s"), "{:.0f}" if scale < 1.0 else "{:.3f}", scale
    )
    if before < 3:
        return
    assert found.time_s("speed") == pytest.approx(truth - truth[0], abs=2e-3)
    wraps = sum(finding.count for finding in found.findings if finding.kind == "new_turn")
    assert wraps == int(truth[-1] // period) - int(truth[0] // period)
    assert not [finding for finding in found.findings if finding.kind == "backward_stamp"]


@pytest.mark.parametrize("form", ["text", "sheet"])
def test_a_clock_of_hours_passes_midnight(tmp_path, form):
    truth = 86398 + np.arange(COUNT) / 10
    clocks = [(datetime(2021, 9, 2) + timedelta(seconds=round(when, 3))).time() for when in truth]
    path = tmp_path / "run.xlsx"
    if form == "text":
        path = written(tmp_path, ["Time,speed_kmh", *(f"{when:%H:%M:%S.%f},{10 + i % 5}" for i, when in enumerate(clocks))])
    else:
        book = pytest.importorskip("openpyxl").Workbook()
        for line in [["Time", "speed_kmh"], *([when, 10 + i % 5] for i, when in enumerate(clocks))]:
            book.active.append(line)
        book.save(path)
    assert isinstance(clocks[0], time)
    found = tr.read(path)
    assert found.time_s("speed") == pytest.approx(truth - truth[0], abs=1e-3)


@given(
    begin=st.floats(20000.0, 80000.0),
    drive=st.integers(50, 400),
    pause=st.floats(100.0, 40000.0),
    again=st.floats(100.0, 86000.0),
)
def test_a_pause_keeps_its_length_over_midnight(begin, drive, pause, again):
    del again
    truth = np.concatenate([begin + np.arange(drive), begin + drive + pause + np.arange(drive)])
    found = WrappingClock(1.0).continued(truth % 86400.0)
    at_night = truth[drive] % 86400.0
    if truth[drive] > 86400.0 > truth[drive - 1] and at_night > 60.0 and abs(at_night - begin) > 60.0:
        assert found == pytest.approx(truth)
    if truth[-1] < 86400.0:
        assert found.tolist() == truth.tolist()


@given(begin=st.floats(100.0, 40000.0), drive=st.integers(50, 400), back=st.floats(1.0, 43000.0))
def test_a_clock_that_was_set_back_stays_a_finding(begin, drive, back):
    first = begin + back + np.arange(drive)
    times = np.concatenate([first, first[-1] - back + np.arange(drive)])
    if times[:drive].max() < 86400.0 - drive and abs(back - 3600.0) > 10.0:
        assert WrappingClock(1.0).continued(times).tolist() == times.tolist()


@pytest.mark.parametrize("drive_s", [3000, 50000, 80000])
def test_a_logger_that_starts_again_at_zero_is_no_midnight(drive_s):
    times = np.concatenate([np.arange(0.0, drive_s, 10.0), np.arange(0.0, 500.0, 10.0)])
    clock = WrappingClock(1.0)
    assert clock.continued(times).tolist() == times.tolist()
    assert not list(clock.findings())


@given(cuts=st.lists(st.integers(1, 998), max_size=6, unique=True))
def test_blocks_do_not_matter_to_a_clock(cuts):
    times = (86350.0 + 0.1 * np.arange(1000)) % 86400.0
    clock = WrappingClock(1.0)
    parts = [clock.continued(part) for part in np.split(times, sorted(cuts))]
    if min(np.diff([0, *sorted(cuts), 1000])) > 1:
        assert np.concatenate(parts).tolist() == pytest.approx(86350.0 + 0.1 * np.arange(1000))

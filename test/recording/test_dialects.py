# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tables as other programs write them: separators, decimal marks, dates with times, line ends, Excel."""

from __future__ import annotations

import gzip
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.errors import InputError
from trackres_ros.recording.text_table import NO_VALUE

WHEN = datetime(2026, 11, 23, 10, tzinfo=UTC)
ENDS = ("\n", "\r\n", "\r")


def written(folder: Path, text: str, name: str = "run.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path


def table(names: str, *rows: str) -> str:
    return "\n".join([names, *rows, ""])


ROWS = [f"{i / 10},{i},{50 + i},x" for i in range(12)]
FORMS_OF_TABLES = {
    "names first": table("Time,Speed,Torque,Note", *ROWS),
    "a row of units": table("Time,Speed,Torque,Note", "s,km/h,Nm,", *ROWS),
    "lines about the test": table(
        '"Format","of a logger"', "Venue,Track,,", "Rate,10.0,Hz", "", "Time,Speed,Torque,Note", "", *ROWS
    ),
    "names and values above": table("Vehicle,a", "Gear,5", "Axles,2", "Time,Speed,Torque,Note", "s,km/h,Nm,-", *ROWS),
    "comments": table("# of a logger", "Time,Speed,Torque,Note", *ROWS[:5], "# stopped, then went on", "! once more", *ROWS[5:]),
    "names in a comment": table("% of a logger", "% Time,Speed,Torque,Note", *ROWS),
    "names again": table(
        "Time,Speed,Torque,Note", "s,km/h,Nm,", *ROWS[:5], "", "Time,Speed,Torque,Note", "s,km/h,Nm,", *ROWS[5:]
    ),
    "separator in a line": table("sep=;", "Time;Speed;Torque;Note", *(row.replace(",", ";") for row in ROWS)),
    "spaces": table("Time  Speed Torque Note", *(row.replace(",", "   ") for row in ROWS)),
    "names between tabs": table("Time\tSpeed\tTorque\tNote of it", *(row.replace(",", "  ") for row in ROWS)),
    "empty cells behind the rows": table("Time,Speed,Torque,Note", *(f"{row},," for row in ROWS)),
}


@pytest.mark.parametrize("coding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("form", FORMS_OF_TABLES)
def test_every_form_of_a_table_has_the_same_samples(tmp_path, reader, form, coding):
    for name, pack in (("run.csv", bytes), ("run.csv.gz", gzip.compress)):
        path = tmp_path / name
        path.write_bytes(pack(FORMS_OF_TABLES[form].encode(coding)))
        result = tr.read(
            path,
            topics={"time": {"column": "Time"}, "speed": {"column": "Speed", "unit": "km/h"}, "torque": {"column": "Torque"}},
        )
        assert result.series["speed"].value.tolist() == pytest.approx([i / 3.6 for i in range(12)])
        assert result.series["torque"].value.tolist() == [50.0 + i for i in range(12)]
        assert result.time_s("speed").tolist() == [i / 10 for i in range(12)]
        skipped = {"comments": 2, "names again": 2}.get(form)
        assert [finding.count for finding in result.findings if finding.kind == "comment"] == ([skipped] if skipped else [])


def test_a_sheet_has_lines_above_its_names_too(tmp_path):
    rows = [
        ["of a logger"],
        ["Vehicle", "a"],
        ["Gear", 5],
        [],
        ["Time", "Speed"],
        ["s", "km/h"],
        *([i, 3.6 * i] for i in range(9)),
    ]
    path = workbook(tmp_path / "run.xlsx", ("drive", rows))
    result = tr.read(path, topics={"speed": {"column": "Speed"}})
    assert result.series["speed"].value.tolist() == pytest.approx(list(range(9)))


def test_a_cell_without_a_value_gives_no_sample(tmp_path, reader):
    tokens = sorted(NO_VALUE)
    rows = [f"{i},{'7' if i % 2 else tokens[i // 2]}" for i in range(2 * len(tokens))]
    for text in (table("time_s,speed_mps", *rows), table("time_s;speed_mps", *(row.replace(",", ";") for row in rows))):
        assert tr.read(written(tmp_path, text)).series["speed"].value.tolist() == [7.0] * len(tokens)


def test_a_german_export_reads_as_its_author_means_it(tmp_path, reader):
    rows = [f"23.11.2026 10:00:0{i},25;{i},5;1.23{i},5;{i}" for i in range(6)]
    path = written(tmp_path, table("Zeit;Geschw [km/h];Drehmoment [Nm];Nr", *rows))
    topics = {"time": {"column": "Zeit"}, "speed": {"column": "Geschw [km/h]"}, "torque": {"column": "Drehmoment [Nm]"}}
    result = tr.read(path, topics=topics)
    assert result.series["torque"].value.tolist() == [1230.5 + i for i in range(6)]
    assert result.series["speed"].value.tolist() == pytest.approx([(i + 0.5) / 3.6 for i in range(6)])
    assert result.start_ns == round(WHEN.timestamp()) * 10**9 + 250_000_000
    assert result.notes[:3] == (
        "cells are separated by semicolons",
        "decimal comma in Drehmoment [Nm], Geschw [km/h]",
        "time: column Zeit, dd.mm.yyyy hh:mm:ss, without a time zone: treated as UTC",
    )


@pytest.mark.parametrize(
    ("line", "values"),
    [
        ("speed: {column: 'v [km/h]'}", [0, 1, 2]),
        ("speed: {column: 'Speed (OBD)(km/h)'}", [0, 1, 2]),
        ("speed: {column: v_kmh, offset: 3.6}", [1, 2, 3]),
        ("speed: {column: 'v (mph)'}", [0, 1.609344, 2 * 1.609344]),
        ("speed: {column: 's [km]', derivative: true}", [1000, 1000, 1000]),
        ("speed: {column: 'GPS Speed (Meters/second)'}", [0, 3.6, 7.2]),
        ("torque: {sum: [{column: 'a [kNm]'}, {column: 'b [Nm]'}]}", [0, 3603.6, 7207.2]),
        ("torque: {sum: [{column: 'a [kNm]'}, {column: 'b [kNm]'}], scale: 1000.0}", [0, 7200, 14400]),
        ("speed: {sum: [{column: 'l [km/h]'}, {column: 'r [km/h]'}], scale: 0.5}", [0, 1, 2]),
        ("speed: {column: 'v [km/h]', unit: km/h}", [0, 1, 2]),
        ("speed: {column: 'v [km/h]', scale: 0.277778}", [0, 1, 2]),
        ("speed: {column: 'v [km/h]', scale: 1.0}", [0, 3.6, 7.2]),
        ("belt: {column: 'T [K]', offset: -273.15}", [-273.15, -269.55, -265.95]),
        ("belt: {column: front_f}", [0, 3.6, 7.2]),
        ("torque: {column: left_kmh}", [0, 3.6, 7.2]),
    ],
)
def test_a_unit_in_a_name_is_used_once(tmp_path, line, values):
    topics = yaml.safe_load(line)
    ((role, source),) = topics.items()
    names = [part["column"] for part in source.get("sum", [source])] + ["speed_mps"] * (role != "speed")
    rows = [",".join([f"{i * 3.6}"] * len(names)) for i in range(3)]
    path = written(tmp_path, table(",".join(["time_s", *names]), *(f"{3.6 * i},{row}" for i, row in enumerate(rows))))
    read_values = tr.read(path, topics=topics).series[role].value
    assert read_values == pytest.approx(values, abs=1e-4)


def test_a_foreign_unit_in_a_name_is_refused_until_given(tmp_path):
    path = written(tmp_path, table("time_s,speed_mps,Kraft [N]", "0,1,7", "1,1,8"))
    with pytest.raises(InputError) as error_info:
        tr.read(path, topics={"torque": {"column": "Kraft [N]"}})
    line = str(error_info.value).partition("topics file: ")[2]
    assert tr.read(path, topics=yaml.safe_load(line)).series["torque"].value.tolist() == [7.0, 8.0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1,234", "1,234, a number whose mark may be a decimal or a thousands separator"),
        ("1.234", "1.234, a number whose mark may be a decimal or a thousands separator"),
        ("0,5|0.5", "0.5 with a decimal point and 0,5 with a decimal comma"),
        ("1.23,4", "a number, or an empty cell"),
        ("0,5|1.5.6", "a number, or an empty cell"),
    ],
)
def test_a_number_with_two_readings_is_refused(tmp_path, reader, text, says):
    path = written(tmp_path, table("time_s;speed_mps", *(f"{i};{cell}" for i, cell in enumerate(text.split("|")))))
    with pytest.raises(InputError) as error_info:
        tr.read(path)
    assert says in str(error_info.value)


def test_other_columns_or_the_topics_file_decide_a_mark(tmp_path, reader):
    path = written(tmp_path, table("time_s;speed_mps", "0,5;1,234", "1,5;2,345"))
    assert tr.read(path).series["speed"].value.tolist() == [1.234, 2.345]
    path = written(tmp_path, table("time_s;speed_mps", "1;1,234", "2;2,345"))
    for mark, value in ((",", 1.234), (".", 1234.0)):
        given_mark = {"speed": {"column": "speed_mps", "decimal": mark}}
        assert tr.read(path, topics=given_mark).series["speed"].value[0] == value
        shared = {"speed": {"column": "speed_mps"}, "wheel_speed/front": given_mark["speed"]}  # one line gives it for both
        assert tr.read(path, topics=shared).series["wheel_speed/front"].value[0] == value


def test_the_mark_may_show_late(tmp_path, reader):
    rows = [f"{i};0" for i in range(20_000)]
    path = written(tmp_path, table("time_s;speed_mps", *rows, "20000;1,234", "20001;0,5"))
    assert tr.read(path).series["speed"].value[-2:].tolist() == [1.234, 0.5]


@given(
    numbers=st.lists(st.integers(-9_999_999, 9_999_999), min_size=1, max_size=4),
    places=st.integers(0, 4),
    comma=st.booleans(),
    grouped=st.booleans(),
    separator=st.sampled_from(",;\t"),
)
def test_a_number_is_read_as_written_or_refused(tmp_path_factory, numbers, places, comma, grouped, separator):
    values = [number / 10**places for number in numbers]
    cells = [f"{value:{',' if grouped else ''}.{places}f}" for value in values]
    cells = [cell.translate(str.maketrans(",.", ".,")) if comma else cell for cell in cells]
    if separator == ",":
        cells = [f'"{cell}"' if "," in cell else cell for cell in cells]
    text = table(f"time_s{separator}speed_mps", *(f"{i}{separator}{c}" for i, c in enumerate(cells)))
    path = written(tmp_path_factory.mktemp("t"), text)
    try:
        result = tr.read(path).series["speed"].value
    except InputError as refusal:
        assert "thousands" in str(refusal) or "allowed: a number" in str(refusal)  # noqa: PT017
    else:
        if not (separator == "," and comma and grouped and not places):  # points between thousands, commas between cells
            np.testing.assert_array_equal(result, values)


FORMS = (
    ("%Y-%m-%dT%H:%M:%S.%f", True), ("%Y-%m-%d %H:%M:%S,%f", True), ("%Y%m%dT%H%M%S.%f", True), ("%Y/%m/%d %H:%M:%S.%f", True),
    ("%d.%m.%Y %H:%M:%S.%f", True), ("%d/%m/%Y %H:%M:%S.%f", False), ("%m/%d/%Y %H:%M:%S.%f", False),
    ("%d-%m-%Y %H:%M:%S.%f", False),
)  # fmt: skip
ZONES = {"": 0, "Z": 0, "+01:00": 60, "-0330": -210, "+05": 300}


@given(
    begin=st.datetimes(datetime(1980, 1, 1), datetime(2100, 1, 1)),
    steps=st.lists(st.integers(1, 10**13), max_size=4),
    form=st.sampled_from(FORMS),
    zone=st.sampled_from(list(ZONES)),
)
def test_a_time_is_read_as_written_or_refused(tmp_path_factory, begin, steps, form, zone):
    times = [begin]
    for step in steps:
        if times[-1].year < 2110:
            times.append(times[-1] + timedelta(microseconds=step))
    pattern, sure = form
    path = written(tmp_path_factory.mktemp("t"), table("timestamp;speed_mps", *(f"{t.strftime(pattern)}{zone};1" for t in times)))
    try:
        result = tr.read(path).series["speed"].stamp_ns
    except InputError as refusal:
        assert not sure
        assert "the order of day and month is ambiguous" in str(refusal)  # noqa: PT017
        assert all(t.day <= 12 for t in times)
        order = "dmy" if pattern[1] == "d" else "mdy"
        result = tr.read(path, topics={"time": {"column": "timestamp", "order": order}}).series["speed"].stamp_ns
    epoch = datetime(1970, 1, 1) + timedelta(minutes=ZONES[zone])
    assert result.tolist() == [(t - epoch) // timedelta(microseconds=1) * 1000 for t in times]


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (["2026-11-23T10:00:00Z;1", "2026-11-23T10:00:01;1"], "an existing date and time, as in the other rows"),
        (["2026-02-29T10:00:00;1"], "an existing date and time, as in the other rows"),
        (["2026-11-23T24:00:01;1"], "an existing date and time, as in the other rows"),
        (["13/11/2026 10:00;1", "11/14/2026 10:00;1"], "dates in one order"),
        (["0;1", "1;1"], "timestamp: given 'numbers of an unknown unit'"),
        (["2026-11-23T10:00:00;1", ";1"], "a time in seconds"),
    ],
)
def test_a_time_that_is_none_is_refused(tmp_path, reader, rows, says):
    with pytest.raises(InputError) as error_info:
        tr.read(written(tmp_path, table("timestamp;speed_mps", *rows)))
    assert says in str(error_info.value)


NO_TIMES = ("2026-10-25", "2026-10-25 02:59:59 CET", "02:59", "25-Mix-2026 02:59:59")


@pytest.mark.parametrize("topics", [None, {"time": {"column": "Time"}}])
@pytest.mark.parametrize("cell", NO_TIMES)
def test_a_cell_that_is_no_time_is_shown_with_the_forms(tmp_path, cell, topics):
    paths = [workbook(tmp_path / "run.xlsx", ("s", [["Time", "speed_mps"], [cell, 1.0]]))]
    paths += [written(tmp_path, table("Time;speed_mps", f"{cell};1"))]
    for path in paths:
        with pytest.raises(InputError) as error_info:
            tr.read(path, topics=topics)
        assert f"Time: given '{cell}'; allowed: " in str(error_info.value)
        assert ("numbers, or dates" in str(error_info.value)) == bool(topics)
        assert "write date and time in one column as 2026-11-23T10:00:00" in str(error_info.value)


def test_an_offset_moves_dates_and_a_scale_is_refused(tmp_path, reader):
    path = written(tmp_path, table("t,speed_mps", "2026-11-23 11:00:00,1", "2026-11-23 11:00:01,1"))
    assert tr.read(path, topics={"time": {"column": "t", "offset": -3600}}).start_ns == round(WHEN.timestamp()) * 10**9
    with pytest.raises(InputError, match="no scale for dates"):
        tr.read(path, topics={"time": {"column": "t", "scale": 0.001}})


@given(st.sampled_from(ENDS), st.booleans(), st.booleans(), st.sampled_from([",", ";", "\t"]), st.booleans())
def test_line_ends_and_marks_of_editors_change_nothing(tmp_path_factory, end, mark, last, separator, quoted):
    cell = '"{}"' if quoted else "{}"
    lines = [separator.join(cell.format(x) for x in row) for row in (["time_s", "speed_mps"], [0.5, 1.25], [1.5, 2.5])]
    text = ("\ufeff" if mark else "") + end.join(lines) + (end if last else "")
    recording = tr.read(written(tmp_path_factory.mktemp("t"), text))
    assert recording.series["speed"].value.tolist() == [1.25, 2.5]
    assert [finding.kind for finding in recording.findings] == ([] if last else ["cut"])


def test_timestamps_of_parquet_are_times(tmp_path):
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    for zone, note in ((None, "without a time zone"), ("Europe/Berlin", "with a time zone")):
        stamps = pa.array([WHEN.replace(tzinfo=None) + timedelta(milliseconds=i) for i in range(3)], pa.timestamp("us", zone))
        parquet.write_table(pa.table({"timestamp": stamps, "speed_mps": [1.0, 2.0, 3.0]}), tmp_path / "run.parquet")
        result = tr.read(tmp_path / "run.parquet")
        assert (result.series["speed"].stamp_ns - round(WHEN.timestamp()) * 10**9).tolist() == [0, 10**6, 2 * 10**6]
        assert any(note in item for item in result.notes)


# --- sums


SUM = {"torque": {"sum": [{"column": "left_nm"}, {"column": "right_knm", "scale": 1000.0}], "offset": 1.0}}


def test_left_and_right_are_added_where_both_are_there(tmp_path, reader):
    path = written(
        tmp_path, table("time_s,speed_mps,left_nm,right_knm", "0,1,100,0.2", "1,1,,0.2", "2,1,50,", "3,1,100,0.3", "4,1,,")
    )
    result = tr.read(path, topics=SUM)
    assert result.series["torque"].value.tolist() == [301.0, 401.0]
    assert result.time_s("torque").tolist() == [0.0, 3.0]
    assert [(finding.role, finding.kind, finding.count) for finding in result.findings] == [("torque", "part", 2)]
    assert "torque: sum of the columns left_nm, right_knm, where a row has them all" in result.notes


# --- what may be the torque


def test_no_torque_names_what_may_hold_it(tmp_path, trackres):
    names = "time_s;speed_mps;M links [Nm];M rechts [Nm];torque_note;cmd_torque;Drehzahl"
    path = written(tmp_path, table(names, *(f"{i};5,5;1,5;2,5;x;1;3" for i in range(300))))
    likely = "M links [Nm], M rechts [Nm]"
    assert f"no torque channel is in use; candidates: {likely}" in tr.read(path).notes
    outcome = trackres("diagnose", path, "--vehicle", "xgd24d", "-o", tmp_path / "report")
    assert outcome.returncode == 2
    assert f"it may be in {likely}: give it in a topics file: torque: {{column: NAME, unit: Nm}}" in outcome.stderr
    assert "sum of left and right" in outcome.stderr


# --- Excel


def workbook(path: Path, *sheets: tuple[str, list[list[object]]]) -> Path:
    book = pytest.importorskip("openpyxl").Workbook()
    book.remove(book.active)
    for title, rows in sheets:
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


@pytest.mark.usefixtures("undrawn")
def test_a_workbook_reads_like_the_table_it_shows(tmp_path, good):
    begin = WHEN.replace(tzinfo=None)
    rows = [[begin + timedelta(milliseconds=500 * i), 18.0 + i, "1.234,5" if i else None, "x"] for i in range(9)]
    cover = ("cover", [["a drive"], ["of November"]])
    path = workbook(tmp_path / "run.xlsx", cover, ("drive", [[], ["Zeit", "speed_kmh", "torque_nm", "note"], *rows, [None] * 4]))
    result = tr.read(path, topics={"time": {"column": "Zeit"}})
    assert result.series["speed"].value.tolist() == [(18.0 + i) * (1 / 3.6) for i in range(9)]
    assert result.series["torque"].value.tolist() == [1234.5] * 8
    assert result.start_ns == round(WHEN.timestamp()) * 10**9
    for note in ("sheet drive", "time: column Zeit, dates of Excel, without a time zone", "decimal comma in torque_nm"):
        assert any(item.startswith(note) for item in result.notes)
    written(tmp_path, "time: {column: Zeit}\n", "topics.yaml")
    assert "sheet drive" in good(
        "replay", path, "--vehicle", "xgd24d", "--topics", tmp_path / "topics.yaml", "-o", tmp_path / "o.csv"
    )


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([[0, 1], ["x", 2]], "row 3, time_s"),
        ([[0, 1], [1, "fast"]], "row 3, speed_mps"),
        ([[0, 1], [None, 2]], "a time in seconds"),
        ([[datetime(2026, 1, 1), 1], [5, 2]], "row 3, time_s: given '5'; allowed: a date with a time"),
        ([[datetime(9999, 1, 1), 1]], "a date with a time"),
        ([["1/2/2026 10:00", 1]], "the order of day and month is ambiguous"),
        ([], "at least one row"),
    ],
)
def test_a_cell_of_a_workbook_that_is_none_is_refused(tmp_path, rows, says):
    with pytest.raises(InputError) as error_info:
        tr.read(workbook(tmp_path / "run.xlsx", ("s", [["time_s", "speed_mps"], *rows])))
    assert says in str(error_info.value)


def test_a_row_of_units_below_the_names_counts(tmp_path):
    sheet = [["Time", "VehSpd", "weight_kn", "note"], ["ms", "km/h", "kN", None], [0, 36, 90, "x"], [500, 72, 91, "y"]]
    result = tr.read(workbook(tmp_path / "run.xlsx", ("s", sheet)), topics={"speed": {"column": "VehSpd"}})
    assert result.series["speed"].value.tolist() == pytest.approx([10.0, 20.0])
    assert result.series["load"].value.tolist() == [90e3, 91e3]
    assert result.time_s("speed").tolist() == [0.0, 0.5]
    assert {"time: Time is in ms according to the file", "speed: VehSpd is in km/h according to the file"} <= set(result.notes)


def test_two_sheets_that_fit_are_both_named(tmp_path):
    rows = [["time_s", "speed_mps"], [0, 1], [1, 2]]
    result = tr.read(workbook(tmp_path / "run.xlsx", ("a", rows), ("b", rows)))
    assert any(note.startswith("also possible: ") and note.endswith("sheet b") for note in result.notes)

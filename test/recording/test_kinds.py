# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every kind of file: the same drive gives the same replay, in memory that does not grow, and a new kind is one file."""

from __future__ import annotations

import re
import shutil
import sys
import time
from copy import deepcopy
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from drive_files import DBC, KINDS, Drive, mat_73, write
from hypothesis import given
from hypothesis import strategies as st

import trackres_ros as tr
from trackres_ros.errors import DISTRIBUTIONS, InputError, MissingExtraError
from trackres_ros.recording.bindings import TIME, Topics
from trackres_ros.recording.can_signals import is_unavailable
from trackres_ros.recording.channel_file import Channel, ChannelFile
from trackres_ros.recording.channel_source import _in_order
from trackres_ros.recording.choosing import COLUMNS, TIME_S, choose
from trackres_ros.recording.opening import open_source, shipped_kinds, suffixes
from trackres_ros.recording.recording import Recording, topics_in_use
from trackres_ros.recording.roles import ROLES, UNITS, conversion

LIBRARIES = ("asammdf", "can", "cantools", "h5py", "openpyxl", "pyarrow", "pyulog", "rosbags")
asammdf, can, *_ = map(pytest.importorskip, LIBRARIES)
MDF, Signal = asammdf.MDF, asammdf.Signal
LONGEST = 12


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Path and topics of the drive by kind."""
    folder = tmp_path_factory.mktemp("drives")
    known = folder / "known.csv"
    rows = [[*row, None if row[3] is None else 40.0, row[1]] for row in Drive().rows()]
    lines = [",".join("" if cell is None else repr(cell) for cell in row) for row in rows]
    names = "time_s,speed_kmh,weight_n,ambient_degc,torque_nm,belt_degc/rear_left,wheel_speed_mps/axle 2: left #1"
    known.write_text("\n".join([names, *lines, ""]))
    return {kind: write(kind, folder) for kind in KINDS} | {"known names": (known, Topics({}))}


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "CSV"])
def test_one_drive_gives_the_same_replay(files, kind):
    wanted, result = (tr.replay(files[item][0], "xgd24d", topics=files[item][1]) for item in ("CSV", kind))
    assert len(result.time_s) == len(wanted.time_s) == 1000
    for name in ("speed_mps", "weight_n", "ambient_degc", "resistance_torque_nm", "belt_degc/rear_left"):
        np.testing.assert_allclose(result[name], wanted[name], rtol=1e-9, err_msg=name)
    # The residual holds the inertia: a stamp in seconds since 1970, as bus logging has it, moves an acceleration by 1e-5.
    np.testing.assert_allclose(result["residual_nm"], wanted["residual_nm"], rtol=0.0, atol=0.1)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "bag"])
def test_one_channel_may_serve_several_roles(files, kind):
    path, topics = files[kind]
    load = topics["load"]
    shares = {f"load/{axle}": replace(load, scale=scale * load.scale) for axle, scale in (("front", 0.25), ("rear", 0.75))}
    shared = replace(topics, bindings=MappingProxyType({"speed": topics["speed"], **shares}))
    (total, parts) = (Recording.from_source(open_source([path], item)).series for item in (topics, shared))
    for role, binding in shares.items():
        np.testing.assert_array_equal(parts[role].stamp_ns, total["load"].stamp_ns)
        np.testing.assert_allclose(parts[role].value, binding.scale / load.scale * total["load"].value, rtol=1e-15)


@given(
    st.lists(st.lists(st.integers(-5, 5).map(lambda s: s * 10**9), max_size=LONGEST), min_size=2, max_size=4),
    st.sampled_from([1, 3, LONGEST]),
)
def test_merged_streams_keep_every_row_in_order(times, at_once):
    streams = []
    for number, stamps in enumerate(times):
        cells = np.array([[number, place] for place in range(len(stamps))], float).reshape(-1, 2)
        rows = [
            (
                np.array(stamps[start : start + at_once], np.int64),
                cells[start : start + at_once],
                cells[start : start + at_once] >= 0,
            )
            for start in range(0, len(stamps), at_once)
        ]
        streams.append(iter(rows))
    merged = list(_in_order(streams))
    stamps = np.concatenate([rows[0] for rows in merged]) if merged else np.empty(0)
    cells = np.concatenate([rows[1] for rows in merged]) if merged else np.empty((0, 2))
    for number, wanted in enumerate(times):
        mine = cells[:, 0] == number
        assert stamps[mine].tolist() == wanted
        assert cells[mine, 1].tolist() == list(range(len(wanted)))
    if all(sorted(wanted) == wanted for wanted in times):
        assert stamps.tolist() == sorted(stamps.tolist())
        if at_once == LONGEST:
            assert cells[:, 0].tolist() == [
                number for _, number in sorted((t, n) for n, value in enumerate(times) for t in value)
            ]


def test_every_unit_of_a_role_is_known_in_any_spelling():
    for role, about in ROLES.items():
        assert conversion(about.unit, about.unit) == (1.0, 0.0), role
        for unit in about.columns.values():
            assert conversion(unit, about.unit), role
    for given_, inside, same in (
        ("N·m", "Nm", "Nm"), ("°C", "degC", "degC"), ("KM/H", "m/s", "km/h"), ("m/s^2", "m/s2", "m/s2"), ("kn", "m/s", "knots"),
        ("kn", "N", "kN"), ("lb", "N", "lbf"), ("hPa", "Pa", "mbar"), ("µs", "s", "us"), ("[‰]", "1", "‰"),
    ):  # fmt: skip
        assert conversion(given_, inside) == UNITS[inside][same]
    assert conversion("degF", "degC") == pytest.approx((5 / 9, -17.7777777777))
    for wrong, inside in (("rpm", "m/s"), ("Nm", "N"), ("km/h", "Nm")):
        assert conversion(wrong, inside) is None


SETTINGS = {
    "load": {},
    "torque": {"max_age_s": 0.05},
    "belt/rear_left": {"std_k": 0.5},
    "enable": {},
    "passengers": {"kg_each": 1},
}


@pytest.mark.parametrize("kept", [{"speed", "ambient"}, set()], ids=["some lines are used", "no line is used"])
@pytest.mark.parametrize("kind", [*KINDS, "known names"])
def test_an_unused_line_is_noted_and_changes_nothing(files, kind, kept):
    path, topics = files[kind]
    if not kept and kind not in ("bag", "MF4", "BLF", "known names"):
        return  # of the others no speed is guessed
    used = {role: topics[role] for role in topics if role in kept}
    source = {"sum": [{"column": "a"}, {"column": "b"}]} if kind == "bag" else {"topic": "/a", "type": "a/msg/A", "field": "a"}
    other = Topics.parse({role: {**source, **line} for role, line in SETTINGS.items()}).bindings
    plain = replace(topics, bindings=used)
    strange = replace(plain, bindings={**used, **other})
    lines = {*other, *([] if topics.dbc else ["dbc"]), *(["time"] if kind in ("bag", "MF4", "BLF", "ASC") else [])}
    strange = replace(strange, time=files["CSV"][1]["speed"]) if "time" in lines else strange
    strange = strange.with_databases([path]) if "dbc" in lines else strange
    wanted, result = (tr.replay(path, "xgd24d", topics=item if item.bindings or item.dbc else None) for item in (plain, strange))
    noted = [note for note in result.notes if " is not used, as this source has " in note]
    assert {note.split(": ")[1] for note in noted} == lines
    assert not any(" is not used" in note for note in wanted.notes)
    for name in wanted.columns:
        np.testing.assert_array_equal(result[name], wanted[name], err_msg=name)
    read = tr.read(path, topics=strange)
    assert topics_in_use([read, tr.read(path)] if kind == "known names" else [read]).bindings == used


class _Channels(ChannelFile):
    """A file of channels that is never read."""

    name = "file"

    def __init__(self, *channels: Channel) -> None:
        self.channels = channels


SAID = st.fixed_dictionaries(
    {}, optional={"scale": st.sampled_from([1.0, 0.5]), "offset": st.sampled_from([2.0, -273.15]), "unit": st.just("")}
)


@given(role=st.sampled_from(["speed", "distance", "ambient", "time"]), said=SAID, data=st.data())
def test_a_value_is_scale_and_offset_then_the_unit(role, said, data):
    inside = "s" if role == "time" else ROLES[role].unit
    if role == "distance":  # whose change is the speed
        role, said = "speed", {"derivative": True, **said}
    of_file, of_line = (data.draw(st.sampled_from(list(UNITS[inside]))) for _ in range(2))
    line = {"column": "X", **said} | ({"unit": of_line} if "unit" in said else {})
    file = _Channels(Channel("X", of_file), *([] if role == "speed" else [Channel("speed_mps")]))
    file.has_times = role != "time"
    choice = choose(file, Topics.parse({role: line}))
    binding = next(item for item in (choice.time, *choice.channels) if item and item.role == role).binding
    unit = UNITS[inside][line.get("unit", inside if "scale" in line else of_file)]
    if line.keys() - {"derivative"} == {"column", "offset"} and line["offset"] == unit.offset:
        unit = UNITS[inside][inside]  # it is the conversion of kelvin
    value = unit.scale * (line.get("scale", 1.0) * 7.0 + line.get("offset", 0.0)) + unit.offset
    assert binding.scale * 7.0 + binding.offset == pytest.approx(value)
    differs = {"scale", "unit"} & set(line) and (binding.scale, binding.offset) != UNITS[inside][of_file]
    assert any("uses another conversion" in note for note in choice.notes) == bool(differs)


@pytest.mark.parametrize("name", [*COLUMNS, TIME_S])
def test_the_unit_of_a_file_fits_a_known_name_or_is_refused(name):
    role, unit = COLUMNS.get(name, (TIME, "s"))
    inside = "s" if role == TIME else ROLES[role].unit

    def bound(of_file, topics=None):
        file = _Channels(Channel(name, of_file), *([] if role == "speed" else [Channel("speed_mps", "m/s")]))
        file.has_times = role != TIME
        choice = choose(file, topics)
        return next(item.binding for item in (choice.time, *choice.channels) if item and item.role == role), choice.notes

    wanted = bound("")
    assert all(bound(spelled) == wanted for spelled in (unit, f"[{unit}]", "-", "bool"))
    known, notes = bound("on/off")
    assert known == wanted[0]
    assert role == TIME or notes == [f"{role}: {name} is in on/off according to the file: no known unit, so its name decides"]
    for other_item in {other_item for units in UNITS.values() for other_item in units} - {unit, "1"}:
        if unit == "1" and other_item in UNITS["1"]:
            noted = [f"{role}: {name} is in {other_item} according to the file"]
            assert (bound(other_item)[0].scale, bound(other_item)[1]) == (UNITS["1"][other_item].scale, noted)
            continue
        with pytest.raises(
            InputError, match=f"unit of {name}: given '{other_item}'; allowed: {unit}; .*{role}: {{channel: {name}"
        ):
            bound(other_item)
        if other_item in UNITS[inside]:  # the line that the error shows
            result, _ = bound(other_item, Topics.parse({role: {"channel": name, "unit": other_item}}))
            assert (result.scale, result.offset) == UNITS[inside][other_item]


def test_parts_with_other_times_are_added_between_samples(tmp_path):
    path, remainder, right = tmp_path / "sum.mf4", np.arange(0, 10, 0.1), np.arange(0.03, 10, 0.05)
    with MDF() as mdf:
        mdf.append(
            [Signal(10.0 * remainder, remainder, name="Trq", unit="kNm"), Signal(remainder, remainder, name="speed_mps")],
            acq_name="left",
        )
        mdf.append([Signal(5.0 * right, right, name="Trq", unit="kNm")], acq_name="right")
        mdf.save(path)
    parts = [{"channel": "left/Trq"}, {"channel": "right/Trq"}]
    result = tr.read(path, topics={"torque": {"sum": parts}})
    torque = result.series["torque"]
    assert {f"torque: {side}/Trq is in kNm according to the file" for side in ("left", "right")} <= set(result.notes)
    assert "torque: sum of the columns left/Trq, right/Trq" in result.notes
    np.testing.assert_allclose(torque.value, 15e3 * (torque.stamp_ns - torque.stamp_ns[0] + 1e8) / 1e9, rtol=1e-9)
    assert len(torque) == len(remainder) - 1  # before the first sample of the right one there is none
    with pytest.raises(InputError, match=r"2 columns Trq.*left/Trq, right/Trq"):
        tr.read(path, topics={"torque": {"channel": "Trq"}})


def test_a_speed_of_two_groups_is_refused_with_both_names(tmp_path):
    path, t = tmp_path / "two.mf4", np.arange(20) / 10.0
    with MDF() as mdf:
        for group in ("ecu1", "ecu2"):
            mdf.append([Signal(t.copy(), t, name="VehSpd", unit="km/h")], acq_name=group)
        mdf.save(path)
    with pytest.raises(InputError, match=r"ecu1/VehSpd, ecu2/VehSpd'; allowed: .* whose name a single group has"):
        tr.read(path)
    assert len(tr.read(path, topics={"speed": {"channel": "ecu2/VehSpd"}}).series["speed"]) == 20


@given(st.sampled_from(["error", "Fault", "invalid"]), st.sampled_from(" _-"), st.sampled_from(["", "Signal"]))
def test_a_value_without_an_error_is_available(word, mark, before):
    assert is_unavailable(f"{before}{mark}{word}")
    assert is_unavailable(f"{word}{mark}in no state")
    assert not is_unavailable(f"{before}{mark}No{mark}{word}")
    assert not is_unavailable(f"{before}{mark}{word}{mark}free")


def test_marked_and_unfinished_records_of_mdf(tmp_path):
    path, t = tmp_path / "run.mf4", np.arange(0, 10, 0.5)
    invalid = t > 7.9
    with MDF() as mdf:
        mdf.append([Signal(t.copy(), t, name="Speed", unit="km/h", invalidation_bits=invalid)])
        mdf.save(path)
    assert len(tr.read(path).series["speed"]) == np.count_nonzero(~invalid)
    data = bytearray(path.read_bytes())
    data[:8], data[60:62] = b"UnFinMF ", (1).to_bytes(2, "little")  # counters of records are not up to date
    path.write_bytes(data)
    assert len(tr.read(path).series["speed"]) == np.count_nonzero(~invalid)
    assert path.read_bytes() == data


@pytest.mark.parametrize("zone", [None, UTC, timezone(timedelta(hours=2))])
def test_the_zone_of_this_machine_moves_no_start(tmp_path, monkeypatch, zone):
    path, t, start = tmp_path / "run.mf4", np.arange(10.0), datetime(2026, 7, 1, 12, tzinfo=zone)
    with MDF() as mdf:
        mdf.header.start_time = start
        mdf.append([Signal(t, t, name="speed_mps", unit="m/s")])
        mdf.save(path)
    for name in ("America/New_York", "UTC"):
        with monkeypatch.context() as machine:
            machine.setenv("TZ", name)
            time.tzset()
            read = tr.read(path)
        time.tzset()
        assert read.start_ns == int((start if zone else start.replace(tzinfo=UTC)).timestamp()) * 1_000_000_000
        assert any("treated as UTC" in note for note in read.notes) == (zone is None)


TEXT = {"val_0": 3, "text_0": "zu hoch", "val_1": 2, "text_1": "Signal_SNA"}
SCALED = {"a": 2.0, "b": 1.0}
TABLES = {
    ("Nm", "only texts"): (TEXT, [0.0, 1.0]),
    ("Nm", "the rest is scaled"): ({**TEXT, "default_addr": SCALED}, [1.0, 3.0]),
    ("Nm", "the rest is in another table"): ({"val_0": 0, "text_0": SCALED, "default_addr": TEXT}, [1.0]),
    ("", "a part is scaled"): ({"lower_0": 0, "upper_0": 1, "text_0": SCALED, "lower_1": 2, "upper_1": 3, "text_1": "5"}, [1, 3]),
    ("", "an enumeration"): (TEXT, [0.0, 1.0, 3.0]),
    ("", "an enumeration of a bus"): ({**TEXT, "default_addr": {"a": 1.0, "b": 0.0}}, [0.0, 1.0, 3.0]),
    ("Nm", "an enumeration of all values"): ({**TEXT, "default_addr": "invalid"}, [3.0]),
}
"""By unit and what it is: a conversion of the raw values 0 to 3, and the values that are numbers."""


@pytest.mark.parametrize("count", [20, 400])  # asammdf converts many values in another way than few
def test_a_text_of_mdf_is_a_number_only_in_an_enumeration(tmp_path, count):
    path, t, raw = tmp_path / "run.mf4", np.arange(count) / 10.0, np.arange(count, dtype=np.uint8) % 4
    with MDF() as mdf:
        for place, ((unit, _), (table, _)) in enumerate(TABLES.items()):
            mdf.append([Signal(raw, t, name=f"t{place}", unit=unit, conversion=deepcopy(table))])
        mdf.append([Signal(t, t, name="speed_mps")])
        mdf.save(path)
    result = tr.read(path, topics={f"torque/t{place}": {"channel": f"t{place}", "unit": "Nm"} for place in range(len(TABLES))})
    for place, (what, (_, wanted)) in enumerate(TABLES.items()):
        values = result.series[f"torque/t{place}"].value
        assert sorted(set(values)) == wanted, what
        assert len(values) == count // 4 * len(wanted), what
    lost = sum(count // 4 * (4 - len(wanted)) for _, wanted in TABLES.values())
    assert sum(finding.count for finding in result.findings if finding.kind == "absent") == lost


@pytest.mark.parametrize(("sync", "what"), [(1, ""), (2, "an angle"), (3, "a distance"), (4, "an index"), (None, "no master")])
def test_channels_of_mdf_without_times_are_not_read(tmp_path, sync, what):
    path, t = tmp_path / "run.mf4", np.arange(50) / 10.0
    with MDF(version="4.20") as mdf:
        for name, kind in (("Spd", 1), ("Trq", sync or 1), ("speed_mps", 1)):
            mdf.append([Signal(t, 2.0 * t, name=name, unit="Nm" * (name == "Trq"), master_metadata=("x", kind))], acq_name=name)
        third = mdf.groups[2].channel_group  # its master is that of the second group
        third.flags, third.cg_master_index, third.cg_master_addr = 1 << 3, 1, 0
        third.block_len, third.links_nr = third.block_len + 8, third.links_nr + 1
        for group in mdf.groups[1 + (sync is not None) :]:
            group.channels[0].channel_type = group.channels[0].sync_type = 0
        mdf.save(path)
    speed = {"speed": {"channel": "Spd", "unit": "m/s"}}
    if sync == 1:
        result = tr.read(path, topics={"torque": {"channel": "Trq"}})
        assert all(result.time_s(role).tolist() == pytest.approx((2.0 * t).tolist()) for role in ("speed", "torque"))
        return
    with pytest.raises(InputError, match=rf"'columns Spd; not read, as .*{what}: .*Trq, .*speed_mps'"):
        tr.read(path)
    result = tr.read(path, topics=speed)
    assert list(result.series) == ["speed"]
    assert any(note.startswith("not read, as ") and what in note for note in result.notes)
    for name in ("Trq", "Trq/Trq"):
        with pytest.raises(InputError, match=rf"torque: column: given '{name}'; allowed: a channel that can be read; .*{what}"):
            tr.read(path, topics={**speed, "torque": {"channel": name}})


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the timer may hit a callback, and comes again
@pytest.mark.parametrize("kind", ["MF4", "MF4 of a bus"])
@pytest.mark.parametrize("listed", [b"##DG", b"##CG", b"##CN"])
def test_a_list_of_mdf_that_never_ends_is_refused(files, tmp_path, monkeypatch, kind, listed):
    source, topics = files[kind]
    data = bytearray(Path(source).read_bytes())
    block = data.rindex(listed + bytes(4))
    data[block + 24 : block + 32] = block.to_bytes(8, "little")  # its first link, to the next block of the list
    path = tmp_path / source.name
    path.write_bytes(data)
    monkeypatch.setattr("trackres_ros.recording.reading.LEAST_S", 0.5)
    with pytest.raises(InputError, match=r"drive.mf4: .*content that takes more than 0.5 s|bus.mf4: .*more than 0.5 s"):
        tr.read(path, topics=topics)


def test_frames_that_say_nothing_are_counted(files):
    results = {finding.kind: finding.count for finding in tr.read(files["BLF"][0], topics=files["BLF"][1]).findings}
    assert (results["unknown_topic"], results["other_source"], results["absent"], results["unlisted"]) == (120, 20, 20, 20)
    assert "malformed" not in results


@pytest.mark.parametrize("kind", ["MF4 of a bus", "BLF", "ASC", "candump"])
def test_without_a_database_frames_are_refused(files, kind):
    with pytest.raises(InputError, match=r"--dbc bus\.dbc"):
        open_source([files[kind][0]])


def test_a_database_counts_for_its_bus_alone(files, tmp_path):
    (tmp_path / "bus.dbc").write_text(DBC)
    path, _ = files["BLF"]
    here, elsewhere = (
        open_source([path], Topics.parse({"speed": {"channel": "VehicleSpeed"}, "dbc": {bus: "bus.dbc"}}, "t.yaml", tmp_path))
        for bus in (1, 2)
    )
    assert sum(map(len, here.blocks())) == 1000
    with pytest.raises(InputError, match="no sample of any channel"):
        list(elsewhere.blocks())


@pytest.mark.parametrize("kind", ["MF4 of a bus", "BLF", "ASC", "candump"])
def test_frames_of_another_bus_change_no_series(kind, tmp_path):
    drive = Drive(2.0)
    path, topics = write(kind, tmp_path, drive)
    wanted = tr.read(path, topics=topics)
    with can.Logger(path) as log:
        for frame in drive.frames():
            log(frame)
            frame.channel, frame.data = 1, bytearray(8)
            log(frame)
    result = tr.read(path, topics=topics)
    for role, series in wanted.series.items():
        np.testing.assert_array_equal(result.series[role].value, series.value)
        assert np.abs(result.series[role].stamp_ns - series.stamp_ns).max() < 1000
    of_buses = {finding.text for finding in result.findings if finding.kind == "other_bus"}
    assert any(text.startswith("100 frames") and "Motion" in text and "bus.dbc}" in text for text in of_buses)


def test_a_message_that_hides_another_one_is_named(files, tmp_path):
    (tmp_path / "bus.dbc").write_text(DBC)
    (tmp_path / "more.dbc").write_text(DBC.replace("Motion", "Brake").replace("VehicleSpeed", "BrakeSpeed"))
    lines = {"speed": {"channel": "BrakeSpeed"}, "dbc": ["bus.dbc", "more.dbc"]}
    reason = r"BrakeSpeed in more.dbc: no sample, as .*read as Motion in bus.dbc.*\{1: bus.dbc, 2: more.dbc\}"
    with pytest.raises(InputError, match=reason):
        Recording.from_source(open_source([files["BLF"][0]], Topics.parse(lines, "t.yaml", tmp_path)))
    lines |= {"load": {"channel": "Motion/GrossLoad"}}
    result = Recording.from_source(open_source([files["BLF"][0]], Topics.parse(lines, "t.yaml", tmp_path)))
    assert [finding.kind for finding in result.findings if re.match(reason, finding.text)] == ["empty"]


def test_times_since_the_line_before_give_the_same_stamps(files, tmp_path):
    path, topics = files["ASC"]
    lines = path.read_text().replace("timestamps absolute", "timestamps relative").splitlines(keepends=True)
    last = Decimal()
    for place, line in enumerate(lines):
        place_here = line.split()[0] if line.strip() else ""
        if re.fullmatch(r"\d+\.\d+", place_here):
            lines[place], last = line.replace(place_here, str(Decimal(place_here) - last), 1), Decimal(place_here)
    frames = [place for place, line in enumerate(lines) if " Rx " in line]
    half = lines[frames[100]].split()[0]  # another event shares the time until the frame
    lines[frames[100]] = f"  {half} 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.2%\n" + lines[frames[100]].replace(half, "0.0", 1)
    relative = tmp_path / "relative.asc"
    relative.write_text("".join(lines))
    wanted, result = (tr.read(item, topics=topics).series for item in (path, relative))
    for role, series in wanted.items():
        np.testing.assert_array_equal(result[role].stamp_ns, series.stamp_ns)


@pytest.mark.parametrize("kind", ["ASC", "candump"])
def test_a_log_cut_anywhere_is_read_to_its_last_whole_line(files, tmp_path, kind):
    path, topics = files[kind]
    *lines, last = path.read_bytes().splitlines(keepends=True)[:20]
    cut = tmp_path / path.name
    cut.write_bytes(b"".join(lines))
    wanted = tr.read(cut, topics=topics)
    for length in range(1, len(last), 2):
        cut.write_bytes(b"".join([*lines, last[:length]]))
        result = tr.read(cut, topics=topics)
        assert {role: len(value) for role, value in result.series.items()} == {
            role: len(value) for role, value in wanted.series.items()
        }
        assert [value.count for value in result.findings if value.kind == "cut"] == [1]


@pytest.mark.parametrize("kind", ["ASC", "candump"])
def test_lines_that_are_no_frames_are_counted_alone(files, tmp_path, kind):
    path, topics = files[kind]
    lines = path.read_text().splitlines(keepends=True)
    odd = tmp_path / path.name
    wrong = (
        [" 0.1 1  100 Rx d\n", " 0.1 1  1g0 Rx d 1 00\n"]
        if kind == "ASC"
        else ["# begun\n", "(1.0) can0 100##\n", "(1.0) can0 1\n"]
    )
    for place in (20, 30, 31):
        lines[place:place] = wrong
    odd.write_text("".join(lines))
    wanted, result = tr.read(path, topics=topics), tr.read(odd, topics=topics)
    for role, series in wanted.series.items():
        np.testing.assert_array_equal(result.series[role].value, series.value)
    result_before, result_after = (
        sum(finding.count for finding in read.findings if finding.kind == "unusable") for read in (wanted, result)
    )
    assert result_after - result_before == 3 * len(wrong)


@pytest.mark.usefixtures("undrawn")
def test_guessed_lines_are_a_topics_file(files, good, tmp_path):
    kept, dbc = tmp_path / "topics.yaml", shutil.copy(files["BLF"][0].with_name("bus.dbc"), tmp_path / "bus #2, new.dbc")
    for kind in ("bag", "MF4", "MF4 of a bus", "BLF", "known names"):
        path, of_a_bus = files[kind][0], kind in ("MF4 of a bus", "BLF")
        kept.write_text(good("topics", "guess", path, *(("--dbc", dbc) if of_a_bus else ())))
        guessed, read = (tr.replay(path, "xgd24d", topics=item) for item in ({"dbc": dbc} if of_a_bus else None, kept))
        for name in guessed.columns:
            np.testing.assert_array_equal(read[name], guessed[name], err_msg=f"{kind}: {name}")
        assert len(read.time_s) == 1000
    outcome = good("replay", files["ASC"][0], "--dbc", files["ASC"][0].with_name("bus.dbc"), "--vehicle", "xgd24d", cwd=tmp_path)
    assert "speed: {channel: VehicleSpeed, unit: km/h}  # guessed" in outcome


def test_without_a_unit_nothing_is_guessed(files):
    with pytest.raises(InputError, match=r"speed: \{channel: run.VehicleSpeed.VehicleSpeed, unit: km/h\}"):
        open_source([files["MATLAB 5"][0]])


def test_a_replay_as_mdf_holds_what_parquet_does(files, tmp_path):
    from pyarrow import parquet

    path, topics = files["MF4"]
    for suffix in ("mf4", "parquet"):
        tr.replay(path, "xgd24d", topics=topics, output=tmp_path / f"out.{suffix}")
    wanted = parquet.read_table(tmp_path / "out.parquet")
    with MDF(tmp_path / "out.mf4") as result:
        units = {channel.name: channel.unit for channel in result.groups[0].channels}
        for name in wanted.column_names[1:]:
            signal = result.get(name)
            np.testing.assert_array_equal(signal.samples.astype(float), wanted[name].to_numpy().astype(float), err_msg=name)
            np.testing.assert_array_equal(signal.timestamps, wanted["time_s"].to_numpy())
    assert (units["resistance_torque_nm"], units["speed_mps"], units["belt_degc/rear_left"]) == ("N m", "m/s", "degC")
    (tmp_path / "drive.csv").write_text("time_s,speed_mps\n-1,0\n0,1\n1,1\n")
    for suffix in ("mf4", "mcap"):  # before 1970
        with pytest.raises(InputError, match=r"-1000000000; .* offset: 100"):
            tr.replay(tmp_path / "drive.csv", "xgd24d", output=tmp_path / f"early.{suffix}")
        topics = {"time": {"column": "time_s", "offset": 100.0}}
        assert tr.replay(tmp_path / "drive.csv", "xgd24d", topics=topics, output=tmp_path / f"late.{suffix}").steps == 3
    assert not [file for file in tmp_path.iterdir() if file.name.startswith((".", "early"))]


def _saved(path, version, content):
    """A MATLAB file of a struct `run` and its notation of matrices."""
    from scipy.io import savemat

    if version == 5:
        savemat(path, {"run": content})
        return path
    with mat_73(path) as file:
        for name, value in content.items():
            file[f"run/{name}"] = np.atleast_2d(np.asarray(value)).T
    return path


@pytest.mark.parametrize("version", [5, 7.3])
def test_all_of_a_matlab_file_is_read_or_named(tmp_path, version):
    t = np.arange(2000) / 10.0
    others = {"belt_degc": np.ones((2000, 2)), "turning": t + 1j, "torque_nm": 1.0, "enable": True, "wheel_count": 7}
    content = {"time_s": t, "speed_mps": 5.0 + np.sin(t), "weight_n": 340e3, "stood_s": 600.0, **others}
    path = _saved(tmp_path / "run.mat", version, content)
    result = tr.read(path)
    named = {begin: set(rest.split(", ")) for begin, _, rest in (note.partition(": ") for note in result.notes)}
    assert named["one number for the whole recording"] == {"run.weight_n", "run.stood_s"}
    assert named["not read (no vectors)"] == {f"run.{name}" for name in others}
    assert result.series["stood"].value[0] == 600.0
    assert set(tr.replay(path, "xgd24d")["weight_n"]) == {340e3}
    by_topics = tr.read(path, topics={"passengers": {"channel": "run.wheel_count"}, "time": {"channel": "run.time_s"}})
    assert not any("is not used" in note for note in by_topics.notes)
    assert set(by_topics.series["passengers"].value) == {7.0}


@pytest.mark.parametrize("version", [5, 7.3])
def test_a_number_for_a_role_with_a_vector_is_not_read(tmp_path, version):
    t = np.arange(20) / 10.0
    path = _saved(tmp_path / "run.mat", version, {"t": t, "speed_mps": t, "weight_n": 1e5 + t, "weight_kn": 340.0})
    result = tr.read(path)
    assert result.series["load"].value.tolist() == (1e5 + t).tolist()
    assert "not read (no vectors): run.weight_kn" in result.notes


def test_a_time_that_is_none_is_refused_as_given(tmp_path):
    for first in (1764e9, np.nan, np.inf):
        path = _saved(tmp_path / "run.mat", 5, {"time": [first, 1765e9], "speed_mps": [1.0, 2.0]})
        with pytest.raises(InputError, match=rf"row 1 below the header: given {first!s}".replace("+", r"\+")):
            tr.read(path)


@pytest.mark.parametrize(
    ("kind", "block", "rows", "short_s"),
    [
        ("MF4", "readers.mdf.BLOCK_ROWS", 8192, 4000.0),
        ("MATLAB 7.3", "readers.matlab.BLOCK_ROWS", 128, 400.0),
        ("BLF", "can_signals.CHUNK_ROWS", 128, 60.0),
    ],
)
def test_memory_does_not_grow_with_the_file(tmp_path, monkeypatch, peak_of, kind, block, rows, short_s):
    """Blocks are smaller here. The short file fills one; the peak of a shorter file would still grow."""
    monkeypatch.setattr(f"trackres_ros.recording.{block}", rows)
    counts, peaks = [], []
    for times in (1, 4):
        path, topics = write(kind, tmp_path, Drive(times * short_s))
        source = open_source([path], topics)
        count, peak = peak_of(lambda source=source: sum(map(len, source.blocks(rows))))
        counts.append(count)
        peaks.append(peak)
    assert counts[1] == pytest.approx(4 * counts[0], rel=0.01)
    assert peaks[1] < 1.3 * peaks[0], peaks


def test_a_missing_library_says_how_to_install_it(files, monkeypatch):
    kinds = {"MF4": "asammdf", "BLF": "can", "ASC": "cantools", "MATLAB 7.3": "h5py", "Excel": "openpyxl", "Parquet": "pyarrow"}
    kinds |= {"ULog": "pyulog"}
    for kind, module in kinds.items():
        with monkeypatch.context() as without:
            without.setitem(sys.modules, module, None)
            with pytest.raises(MissingExtraError, match=rf"pip install {DISTRIBUTIONS.get(module, module)} .*\[\w+\]"):
                open_source([files[kind][0]], files[kind][1])


def test_suffixes_are_of_one_kind_each():
    results = [suffix for kind in shipped_kinds() for suffix in kind.suffixes]
    assert sorted(results) == sorted(set(results))
    assert set(results) <= set(suffixes())

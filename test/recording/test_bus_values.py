# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A value of a bus is what MDF and the database say it is: conversions, limits, names, and frames that end early."""

import re

import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.errors import InputError

asammdf, cantools = pytest.importorskip("asammdf"), pytest.importorskip("cantools")
MDF, Signal = asammdf.MDF, asammdf.Signal
N = 300
TIMES = np.arange(N) * 0.1
SPEED_KMH = np.minimum(20.0, 0.1 * np.arange(N))
RAW = np.rint(SPEED_KMH * 256).astype(int)
CCVS = 0x18FEF100
J1939_DBC = """VERSION ""
BU_: Vector__XXX
BO_ 2566844672 CCVS1: {length} Vector__XXX
 SG_ WheelBasedVehicleSpeed : {start}|16@1+ (0.00390625,0) [0|250.996] "km/h" Vector__XXX
"""
CODES = [*range(9), 12, 16, 20, 24, 32, 48, 64]
"""Bytes of a frame by its data length code: ISO 11898-1."""


def bus_logging(path, size, changed=None, start=1, **numbers):
    """An MDF file of frames with a speed from byte `start`; `changed(channels)` edits the description of its channels."""
    payloads = np.full((N, size), 0xFF, np.uint8)
    payloads[:, start], payloads[:, start + 1] = RAW & 0xFF, RAW >> 8
    parts = {"BusChannel": np.full(N, 1, "u1"), "ID": np.full(N, CCVS, "<u4"), "IDE": np.ones(N, "u1"), **numbers}
    kinds = [(f"CAN_DataFrame.{name}", values.dtype) for name, values in parts.items()]
    records = np.rec.fromarrays([*parts.values(), payloads], dtype=np.dtype([*kinds, ("CAN_DataFrame.DataBytes", "u1", (size,))]))
    with MDF(version="4.11") as mdf:
        mdf.append([Signal(records, TIMES, name="CAN_DataFrame")])
        if changed:
            changed({channel.name.partition(".")[2]: channel for channel in mdf.groups[0].channels})
        mdf.save(path, overwrite=True)
    dbc = path.with_name("bus.dbc")
    dbc.write_text(J1939_DBC.format(length=size, start=8 * start))
    return tr.read(path, topics={"dbc": dbc})


def table_of_codes(channels):
    numbers = {f"raw_{code}": code for code in range(16)} | {f"phys_{code}": size for code, size in enumerate(CODES)}
    channels["DataLength"].conversion = conversion(conversion_type=5, val_param_nr=32, **numbers)


def conversion(**given):
    from asammdf.blocks.v4_blocks import ChannelConversion

    return ChannelConversion(**given)


def virtual_bus(channels):
    for name in ("BusChannel", "IDE"):
        channel = channels[name]
        channel.channel_type, channel.data_type, channel.bit_count = 6, 0, 0
        channel.conversion = conversion(conversion_type=1, a=0.0, b=1.0)


EIGHT, FIFTEEN = np.full(N, 8, "u1"), np.full(N, 15, "u1")
FRAMES = {
    "plain": (8, None, 1, {"DataLength": EIGHT}),
    "a virtual bus": (8, virtual_bus, 1, {"DataLength": EIGHT}),
    "a length that is a table of the code": (64, table_of_codes, 60, {"DataLength": FIFTEEN}),
    "a code without a length": (64, None, 60, {"DLC": FIFTEEN}),
    "neither": (64, None, 60, {}),
}


@pytest.mark.parametrize("rows", [7, 2**16])
@pytest.mark.parametrize("kind", FRAMES)
def test_frames_in_mdf_are_read_by_their_conversions(tmp_path, monkeypatch, kind, rows):
    monkeypatch.setattr("trackres_ros.recording.readers.mdf.BLOCK_ROWS", rows)
    size, changed, start, numbers = FRAMES[kind]
    found = bus_logging(tmp_path / "bus.mf4", size, changed, start, **numbers)
    np.testing.assert_allclose(found.series["speed"].value, RAW / 256 / 3.6)
    assert not [one for one in found.findings if one.kind in ("other_bus", "short", "malformed", "unusable")]


@pytest.mark.parametrize("rows", [7, 2**16])
def test_a_virtual_channel_is_its_conversion_of_the_index(tmp_path, monkeypatch, rows):
    monkeypatch.setattr("trackres_ros.recording.readers.mdf.BLOCK_ROWS", rows)
    path, virtual = tmp_path / "run.mf4", Signal.Flags.virtual_master
    with MDF(version="4.11") as mdf:
        speed = Signal(SPEED_KMH, TIMES, name="Spd", unit="km/h", flags=virtual, virtual_master_conversion={"a": 0.1, "b": 0.0})
        way = {"flags": virtual | Signal.Flags.virtual, "virtual_conversion": {"a": 0.5, "b": 3.0}}
        mdf.append([speed, Signal(np.arange(N), TIMES, name="Way", unit="m", **way)])
        mdf.save(path)
    found = tr.read(path, topics={"speed": {"channel": "Spd"}, "distance": {"channel": "Way"}})
    np.testing.assert_allclose(found.series["distance"].value, 3.0 + 0.5 * np.arange(N))
    np.testing.assert_allclose(found.time_s("distance"), TIMES, atol=1e-9)


def candump(folder, *payloads_by_id, dbc):
    """A log of frames by their identifiers, all at the same times, and its database."""
    lines = [
        f"({at_s:.6f}) can0 {identifier}#{payloads[row].hex().upper()}\n"
        for row, at_s in enumerate(TIMES)
        for identifier, payloads in payloads_by_id
    ]
    (folder / "run.log").write_text("".join(lines))
    (folder / "bus.dbc").write_text(f'VERSION ""\nBU_: Vector__XXX\n{dbc}')
    return folder / "run.log"


def read(path, **lines):
    return tr.read(path, topics={"dbc": str(path.with_name("bus.dbc")), **lines})


def counts(recording):
    return {finding.kind: finding.count for finding in recording.findings}


CENTI = np.rint(100 * SPEED_KMH).astype(int)


@pytest.mark.parametrize(
    ("limits", "low", "high"), [("[0|15]", 0, 15), ("[5|15.004]", 5, 15), ("[0|0]", -1, 999), ("[9|9]", -1, 999)]
)
def test_values_outside_of_the_limits_give_no_sample(tmp_path, limits, low, high):
    dbc = f'BO_ 256 Veh: 2 Vector__XXX\n SG_ Spd : 0|16@1+ (0.01,0) {limits} "km/h" Vector__XXX\n'
    path = candump(tmp_path, ("100", [int(raw).to_bytes(2, "little") for raw in CENTI]), dbc=dbc)
    found = read(path)
    inside = np.isin(CENTI, range(100 * low, 100 * high + 1))
    np.testing.assert_allclose(found.series["speed"].value, CENTI[inside] / 360)
    assert counts(found).get("out_of_range", 0) == np.count_nonzero(~inside)
    assert not any(limits not in one.text for one in found.findings if one.kind == "out_of_range")
    (tmp_path / "bus.dbc").write_text((tmp_path / "bus.dbc").read_text().replace(limits, "[0|0]"))  # as the finding says
    assert len(read(path).series["speed"]) == N


@pytest.mark.parametrize(
    "name", ["SNA", "not available", "Error", "SpeedInvalid", "Signal_not_valid", "Unavailable", "ungueltig"]
)
def test_named_missing_values_give_no_sample_in_limits_too(tmp_path, name):
    dbc = 'BO_ 256 Veh: 2 Vector__XXX\n SG_ Spd : 0|16@1+ (0.01,0) [0|10] "km/h" Vector__XXX\n'
    dbc += f'VAL_ 256 Spd 500 "{name}" 2000 "at the limiter" ;\n'
    found = read(candump(tmp_path, ("100", [int(raw).to_bytes(2, "little") for raw in CENTI]), dbc=dbc))
    kept = ((CENTI <= 1000) & (CENTI != 500)) | (CENTI == 2000)  # a named value is one, outside of limits too
    np.testing.assert_allclose(found.series["speed"].value, CENTI[kept] / 360)
    assert (counts(found)["absent"], counts(found)["out_of_range"]) == (1, np.count_nonzero(~kept) - 1)


@pytest.mark.parametrize("length", range(9))
def test_a_short_frame_gives_the_signals_that_it_holds(tmp_path, length):
    signals = {"Spd": (1, "km/h"), "Trq": (3, "Nm"), "Weight": (6, "N")}  # first byte of two
    dbc = "BO_ 256 Veh: 8 Vector__XXX\n" + "".join(
        f' SG_ {name} : {8 * first}|16@1+ (1,0) [0|0] "{unit}" Vector__XXX\n' for name, (first, unit) in signals.items()
    )
    payloads = [bytes([0, 1, 0, 2, 0, 0, 3, 0])[: 8 if row % 2 else length] for row in range(N)]
    lines = {role: {"channel": name} for role, name in zip(("speed", "torque", "load"), signals, strict=True)}
    found = read(candump(tmp_path, ("100", payloads), dbc=dbc), **lines)
    held = {role: first + 2 <= length for role, (first, _) in zip(lines, signals.values(), strict=True)}
    assert {role: len(series) for role, series in found.series.items()} == {
        role: N if is_held else N // 2 for role, is_held in held.items()
    }
    short = [one for one in found.findings if one.kind == "short"]
    assert [one.count for one in short] == ([] if all(held.values()) else [N // 2])
    for role, is_held in held.items():
        assert not short or (lines[role]["channel"] in short[0].text) is not is_held


TWINS = "".join(
    f"BO_ {number} gnss: 5 Vector__XXX\n"
    ' SG_ Ok : 0|1@1+ (1,0) [0|1] "" Vector__XXX\n SG_ Speed : 8|16@1+ (0.01,0) [0|0] "km/h" Vector__XXX\n'
    for number in (7, 23, 2147483655)
)
"""Two messages of 11 bits, and one of 29 bits with the number of the first."""


@pytest.fixture
def twins(tmp_path):
    payloads = [b"\x01" + int(raw).to_bytes(2, "little") + bytes(2) for raw in CENTI]
    frames = [("007", payloads), ("017", payloads[::-1]), ("00000007", [bytes(5)] * N)]
    return candump(tmp_path, *frames, dbc=TWINS)


def test_messages_of_one_name_are_chosen_as_the_error_says(twins):
    with pytest.raises(InputError, match=r"topics: speed: column: given '3 columns gnss/Speed'.*before it: (.*)") as refusal:
        read(twins, speed={"channel": "gnss/Speed"})
    names = re.findall(r"gnss#0x\w+/Speed", str(refusal.value))
    wanted = (CENTI, CENTI[::-1], 0 * CENTI)
    for name, raw in zip(names, wanted, strict=True):
        validity = {"channel": name.replace("Speed", "Ok")}
        found = read(twins, speed={"channel": name, "valid": validity} if raw.any() else {"channel": name})
        np.testing.assert_allclose(found.series["speed"].value, raw / 360)


def test_the_line_that_an_error_prints_is_read(twins):
    with pytest.raises(InputError, match="gnss#0x7/Speed") as refusal:
        read(twins)
    line = yaml.safe_load(str(refusal.value).rpartition("in a topics file: ")[2])
    assert len(read(twins, **line).series["speed"]) == N


def test_cantools_logs_nothing(twins, caplog, capfd):
    read(twins, speed={"channel": "gnss#0x7/Speed"})
    assert not caplog.records
    assert capfd.readouterr() == ("", "")


def test_one_message_in_two_databases_is_the_first(twins):
    both = {"dbc": [str(twins.with_name("bus.dbc"))] * 2, "speed": {"channel": "gnss#0x17/Speed"}}
    np.testing.assert_allclose(tr.read(twins, topics=both).series["speed"].value, CENTI[::-1] / 360)


def test_the_error_of_a_sum_names_the_part_that_failed(twins):
    for wrong, why in (("gnss#0x7/Spd", "column"), ("gnss/Speed", "column"), ("gnss#0x7/Speed", "unit of")):
        parts = [{"channel": "gnss#0x7/Ok", "unit": "Nm"}, {"channel": wrong}]
        with pytest.raises(InputError, match=rf"torque: sum: part 2: {why}"):
            read(twins, speed={"channel": "gnss#0x7/Speed"}, torque={"sum": parts})


def test_a_sum_names_the_part_that_has_no_sample(twins):
    parts = [{"channel": "gnss#0x7/Ok", "unit": "Nm"}, {"channel": "gnss#0x17/Ok", "unit": "Nm"}]
    text = twins.read_text().replace("can0 017#", "can0 018#")
    twins.write_text(text)
    found = read(twins, speed={"channel": "gnss#0x7/Speed"}, torque={"sum": parts})
    assert any("part 2 (gnss#0x17/Ok) never has one" in one.text for one in found.findings if one.kind == "part")

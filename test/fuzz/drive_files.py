# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One drive in every kind of file that is read, written by the libraries of the formats."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.recording.bindings import Topics

START_S = 1_700_000_000
DBC = """VERSION ""
BS_:
BU_: Ecu
BO_ 256 Motion: 8 Ecu
 SG_ VehicleSpeed : 0|16@1+ (0.01,0) [0|655] "km/h" Ecu
 SG_ Mode M : 16|2@1+ (1,0) [0|3] "" Ecu
 SG_ GrossLoad m1 : 24|24@1+ (1,0) [0|16777215] "N" Ecu
 SG_ BeltTemp m2 : 24|8@1+ (1,-40) [-40|210] "degC" Ecu
BO_ 2566845950 Ambient: 8 Ecu
 SG_ AmbientTemp : 24|16@1+ (0.03125,-273) [-273|1735] "degC" Ecu
BO_ 2566897687 Drive: 17 Ecu
 SG_ DriveTorque : 104|24@1+ (0.5,-1000000) [-1000000|7000000] "Nm" Ecu
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566845950 3;
BA_ "VFrameFormat" BO_ 2566897687 3;
"""
"""A speed, a multiplexed load; of J1939 an air temperature (PGN 65269, any control unit) and a torque in 17 bytes (PGN 65472)."""
TOPICS: dict[str, Any] = {
    "speed": {"channel": "VehicleSpeed", "unit": "km/h"},
    "load": {"channel": "GrossLoad", "unit": "N"},
    "ambient": {"channel": "AmbientTemp", "unit": "degC"},
    "torque": {"channel": "DriveTorque", "unit": "Nm"},
}
AMBIENT_ID = 0x0CFEF517  # another priority and control unit than the database has
ADDRESS = AMBIENT_ID & 0xFF


def packets(group: int, content: bytes, sender: int, receiver: int = 0xFF) -> list[tuple[int, bytes]]:
    """Identifiers and data of the frames in which J1939 sends a long message: broadcast, or with the answers of a receiver."""
    number, count = group.to_bytes(3, "little"), -(-len(content) // 7)
    size = len(content).to_bytes(2, "little")
    begin, data = 0x1CEC0000 | receiver << 8 | sender, 0x1CEB0000 | receiver << 8 | sender
    parts = [(data, bytes([1 + part]) + content[7 * part : 7 * part + 7].ljust(7, b"\xff")) for part in range(count)]
    if receiver == 0xFF:
        return [(begin, bytes([32, *size, count, 0xFF]) + number), *parts]
    answer = 0x1CEC0000 | sender << 8 | receiver
    return [
        (begin, bytes([16, *size, count, 0xFF]) + number),
        (answer, bytes([17, count, 1, 0xFF, 0xFF]) + number),
        *parts,
        (answer, bytes([19, *size, count, 0xFF]) + number),
    ]


class Drive:
    """Speeds at 50 Hz, loads at 10 Hz, air temperatures at 1 Hz, torques at 5 Hz, all of which every format holds exactly."""

    def __init__(self, duration_s: float = 20.0) -> None:
        self.speed_s = np.arange(0, round(duration_s * 50)) / 50.0
        self.load_s = self.speed_s[::5]
        self.ambient_s = self.speed_s[::50]
        self.torque_s = self.speed_s[5::10]
        self.speed_kmh = np.round(10.0 + 8.0 * np.sin(self.speed_s / 3.0), 2)
        self.load_n = np.round(95e3 + 1e3 * np.cos(self.load_s))
        self.torque_nm = np.round(2000.0 + 500.0 * np.sin(self.torque_s))
        self.ambient_degc = 12.0 + 0.03125 * np.arange(len(self.ambient_s)) % 5

    @property
    def channels(self) -> dict[str, tuple[np.ndarray, np.ndarray, str]]:
        """Times, values and unit by channel."""
        return {
            "VehicleSpeed": (self.speed_s, self.speed_kmh, "km/h"),
            "GrossLoad": (self.load_s, self.load_n, "N"),
            "AmbientTemp": (self.ambient_s, self.ambient_degc, "degC"),
            "DriveTorque": (self.torque_s, self.torque_nm, "Nm"),
        }

    def rows(self) -> list[list[float | None]]:
        """The rows of a table: time, speed, load, air temperature, torque, None where there is none."""
        others = [dict(zip(at_s, values, strict=True)) for at_s, values, _ in list(self.channels.values())[1:]]
        return [
            [float(t), float(v), *(None if t not in of else float(of[t]) for of in others)]
            for t, v in zip(self.speed_s, self.speed_kmh, strict=True)
        ]

    def frames(self) -> list[Any]:
        """CAN frames, and in between some that say nothing: of other identifiers, not available, of another control unit;
        with a multiplexer value that the database does not list.
        """
        import can

        def frame(at_s: float, identifier: int, data: bytes, extended: bool = False) -> Any:
            return can.Message(
                timestamp=START_S + float(at_s), arbitration_id=identifier, data=data, is_extended_id=extended, channel=0
            )

        found = []
        for row, (t, v, load, ambient, torque) in enumerate(self.rows()):
            if ambient is not None:
                raw = round((ambient + 273.0) / 0.03125)
                found.append(frame(t, AMBIENT_ID, b"\xff\xff\xff" + raw.to_bytes(2, "little") + b"\xff\xff\xff", True))
                found.append(frame(t, AMBIENT_ID, b"\xff" * 8, True))  # not available
                found.append(frame(t, AMBIENT_ID + 1, bytes(8), True))  # another control unit
            if torque is not None:  # of two control units by turns, the packets of one between those of the other
                content = bytes(13) + round((torque + 1e6) * 2).to_bytes(3, "little") + b"\0"
                mine = packets(0xFFC0, content, ADDRESS, 0xFF if row % 20 == 5 else 0x21)
                other = packets(0xFFC0, bytes(17), ADDRESS + 1)
                last = max(place for place, (number, _) in enumerate(mine) if number >> 16 & 0xFF == 0xEB)
                for place, (number, data) in enumerate(mine):
                    at_s = t + min(place - last, 0) * 1e-3
                    if place < len(other):
                        found.append(frame(at_s, *other[place], True))
                    found.append(frame(at_s, number, data, True))
            mode, rest = (2, b"\x50") if load is None else (1, round(load).to_bytes(3, "little"))
            mode = 3 if row % 50 == 9 else mode
            found.append(frame(t, 256, round(v * 100).to_bytes(2, "little") + bytes([mode]) + rest.ljust(5, b"\0")))
            if row % 50 == 7:
                found.append(frame(t, 0x7FF, bytes(8)))
        return found


def _write_mf4(drive: Drive, path: Path, compression: int = 2) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as mdf:
        for name, (seconds, values, unit) in drive.channels.items():
            mdf.append(
                [Signal(values, seconds, name=name, unit=unit, comment=f"{name} of the drive")], acq_name=f"raster of {name}"
            )
        mdf.save(path, overwrite=True, compression=compression)


def _write_can(drive: Drive, path: Path) -> None:
    import can

    with can.Logger(path) as log:
        for message in drive.frames():
            log(message)


def _write_mat(drive: Drive, path: Path) -> None:
    from scipy.io import savemat

    parts = {name: {"t": seconds, name: values} for name, (seconds, values, _) in drive.channels.items()}
    savemat(path, {"run": parts}, do_compression=True)


def _write_mat_4(drive: Drive, path: Path) -> None:
    from scipy.io import savemat

    vectors = drive.channels.items()
    times = {f"{name}_t": seconds for name, (seconds, _, _) in vectors}
    savemat(path, {name: values for name, (_, values, _) in vectors} | times, format="4")


def _write_ulog(drive: Drive, path: Path) -> None:
    """By the description of the format: docs.px4.io, ULog File Format."""
    data = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))

    def add(kind: bytes, content: bytes) -> None:
        data.extend(struct.pack("<H", len(content)) + kind + content)

    add(b"B", bytes(40))
    for name in drive.channels:
        add(b"F", f"{name.lower()}:uint64_t timestamp;double {name};uint8_t[3] spare;".encode())
    for number, name in enumerate(drive.channels):
        add(b"A", struct.pack("<BH", 0, number) + name.lower().encode())
    for number, (seconds, values, _) in enumerate(drive.channels.values()):
        for second, value in zip(seconds, values, strict=True):
            add(b"D", struct.pack("<HQd3x", number, round(START_S * 1e6 + second * 1e6), value))
    path.write_bytes(data)


def _write_vbox(drive: Drive, path: Path) -> None:
    """Over midnight; an empty cell is no cell between spaces."""
    lines = ["File created on 14/11/2023 at 23:59:55", "", "[header]", "time", "velocity kmh", *list(drive.channels)[1:], ""]
    lines += ["[channel units]", *(unit for _, _, unit in list(drive.channels.values())[1:]), ""]
    lines += ["[comments]", "(c) 2001 a logger", "Log Rate (Hz) : 50.00", "", "[laptiming]", "Start +02886.1 -00690.1 +02886.2"]
    lines += ["", "[column names]", " ".join(["time", *drive.channels]), "", "[data]"]
    for second, *values in drive.rows():
        hundredths = (8639500 + round(second * 100)) % 8640000
        minutes, rest = divmod(hundredths, 6000)
        clock = f"{minutes // 60:02d}{minutes % 60:02d}{rest // 100:02d}.{rest % 100:02d}"
        lines.append(" ".join([clock, *("NA" if value is None else f"{value:+.5f}" for value in values)]))
    path.write_text("\r\n".join([*lines, ""]))


def _write_labview(drive: Drive, path: Path) -> None:
    names, units = [*drive.channels], [unit for _, _, unit in drive.channels.values()]
    keys = {"Writer_Version": "2", "Separator": "Tab", "Decimal_Separator": ",", "Multi_Headings": "No", "X_Columns": "One"}
    lines = ["LabVIEW Measurement\t", *(f"{key}\t{value}" for key, value in keys.items()), "***End_of_Header***\t", "\t"]
    per_channel = {
        "Channels": ["4"], "Samples": ["1000"] * 4, "Date": ["2023/11/14"] * 4, "Time": ["22:13:20,0000000"] * 4,
        "Y_Unit_Label": units, "X_Dimension": ["Time"] * 4, "X0": ["0,0000000000000000E+0"] * 4, "Delta_X": ["0,020000"] * 4,
    }  # fmt: skip
    lines += ["\t".join([key, *cells, ""]) for key, cells in per_channel.items()]
    lines += ["***End_of_Header***\t\t\t\t\t", "\t".join(["X_Value", *names, "Comment"])]
    for row, (second, *values) in enumerate(drive.rows()):
        cells = [f"{second:.6f}", *("" if value is None else f"{value:.6f}" for value in values)]
        lines.append("\t".join(cells).replace(".", ",") + "\tthe first row" * (row == 0))
    path.write_text("\r\n".join([*lines, ""]))


@contextmanager
def mat_73(path: Path) -> Iterator[Any]:
    """An HDF5 file to be filled, with the header of MATLAB."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        yield file
    with path.open("r+b") as header:
        header.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def _write_mat_73(drive: Drive, path: Path) -> None:
    with mat_73(path) as file:
        for name, (seconds, values, _) in drive.channels.items():
            for part, numbers in (("t", seconds), (name, values)):
                data = file.create_dataset(
                    f"run/{name}/{part}", data=numbers[None, :], chunks=(1, min(len(numbers), 1024)), compression=4
                )
                data.attrs["MATLAB_class"] = np.bytes_("double")


def _write_xlsx(drive: Drive, path: Path) -> None:
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    sheet = book.create_sheet("drive")
    sheet.append(["time_s", *drive.channels])
    for row in drive.rows():
        sheet.append(row)
    book.save(path)


def _write_csv(drive: Drive, path: Path) -> None:
    lines = [",".join("" if cell is None else repr(cell) for cell in row) for row in drive.rows()]
    path.write_text("\n".join([f"time_s,{','.join(drive.channels)}", *lines, ""]))


def _write_parquet(drive: Drive, path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table(dict(zip(("time_s", *drive.channels), zip(*drive.rows(), strict=True), strict=True))), path)


def _write_bag(drive: Drive, path: Path) -> None:
    from trackres_ros.output.mcap import BagWriter

    with BagWriter(path) as bag:
        kind = "std_msgs/msg/Float64"
        topics = [bag.topic(f"/{name}", kind) for name in drive.channels]
        number = bag.typestore.types[kind]
        for t, v, *others in drive.rows():
            at_ns = START_S * 10**9 + round(t * 1e9)
            for topic, value in zip(reversed(topics), (*reversed(others), v), strict=True):
                if value is not None:
                    bag.write(topic, number(value), at_ns, at_ns)


KINDS: dict[str, tuple[str, Callable[[Drive, Path], None]]] = {
    "CSV": ("drive.csv", _write_csv),
    "bag": ("drive.mcap", _write_bag),
    "MF4": ("drive.mf4", _write_mf4),
    "MF4 of a bus": ("bus.mf4", _write_can),
    "BLF": ("bus.blf", _write_can),
    "ASC": ("bus.asc", _write_can),
    "candump": ("bus.log", _write_can),
    "MATLAB 4": ("oldest.mat", _write_mat_4),
    "MATLAB 5": ("old.mat", _write_mat),
    "MATLAB 7.3": ("new.mat", _write_mat_73),
    "Excel": ("drive.xlsx", _write_xlsx),
    "Parquet": ("drive.parquet", _write_parquet),
    "ULog": ("drive.ulg", _write_ulog),
    "VBOX": ("drive.vbo", _write_vbox),
    "LabVIEW": ("drive.lvm", _write_labview),
}
"""File and writer by kind."""


def topics_of(kind: str) -> dict[str, Any]:
    """Content of the topics file of a kind; the database of a bus is in the same folder."""
    if kind == "bag":
        message = {"type": "std_msgs/msg/Float64", "field": "data"}
        return {role: {"topic": f"/{line['channel']}", "unit": line["unit"], **message} for role, line in TOPICS.items()}
    if kind in ("MATLAB 5", "MATLAB 7.3"):
        return {role: {**line, "channel": f"run.{line['channel']}.{line['channel']}"} for role, line in TOPICS.items()}
    return {**TOPICS, "dbc": "bus.dbc"} if KINDS[kind][0].startswith("bus") else TOPICS


def write(kind: str, folder: Path, drive: Drive | None = None) -> tuple[Path, Topics]:
    """Write a drive as a kind of file; its path, and its topics file."""
    name, writer = KINDS[kind]
    path = folder / name
    writer(drive or Drive(), path)
    (folder / "bus.dbc").write_text(DBC)
    return path, Topics.parse(topics_of(kind), "topics.yaml", folder)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A guess looks at values: a channel whose values are all missing, impossible or the same is no guess."""

import math
import struct

import numpy as np
import pytest
import yaml

import trackres_ros as tr
from trackres_ros.errors import InputError

N = 200
TIMES = np.arange(N) * 0.1
TRUE = np.round(3.0 * np.sin(TIMES / 3.0), 2)
FAULTS = {
    "missing": (np.full(N, math.nan), "it has no value that is available"),
    "constant": (np.full(N, 1.5), "it is always 1.5 m/s"),
    "impossible": (150.0 + TRUE, "are impossible"),
}
DBC = """VERSION ""
BU_: Vector__XXX
BO_ 256 Better: 4 Vector__XXX
 SG_ VehicleSpeed : 0|32@1- (1,0) [0|0] "m/s" Vector__XXX
BO_ 257 Other: 4 Vector__XXX
 SG_ GroundSpeed : 0|32@1- (1,0) [0|0] "m/s" Vector__XXX
SIG_VALTYPE_ 256 VehicleSpeed : 1;
SIG_VALTYPE_ 257 GroundSpeed : 1;
"""


def can_log(folder, better, other):
    pytest.importorskip("cantools")
    (folder / "bus.dbc").write_text(DBC)
    lines = [
        f"({at_s:.6f}) can0 {number}#{struct.pack('<f', values[row]).hex().upper()}\n"
        for row, at_s in enumerate(TIMES)
        for number, values in (("100", better), ("101", other))
    ]
    (folder / "run.log").write_text("".join(lines))
    return folder / "run.log", {"dbc": str(folder / "bus.dbc")}, ("VehicleSpeed", "GroundSpeed")


def mdf(folder, better, other):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF() as file:
        for name, values in (("VehicleSpeed", better), ("GroundSpeed", other)):
            file.append([asammdf.Signal(values, TIMES, name=name, unit="m/s")], acq_name=name)
        file.save(folder / "run.mf4", overwrite=True)
    return folder / "run.mf4", None, ("VehicleSpeed", "GroundSpeed")


def bag(folder, better, other):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    kind = "std_msgs/msg/Float64"
    folder = folder / f"bag{len(list(folder.iterdir()))}"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = [writer.add_connection(name, kind, typestore=store) for name in ("/speed", "/speed_of_ground")]
        for row, at_s in enumerate(TIMES):
            for topic, values in zip(topics, (better, other), strict=True):
                data = store.serialize_cdr(store.types[kind](data=float(values[row])), kind)
                writer.write(topic, 10**18 + round(at_s * 1e9), data)
    return folder, None, ("/speed", "/speed_of_ground")


@pytest.mark.parametrize("write", [can_log, mdf, bag])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_guess_with_faulty_values_gives_way_to_another(tmp_path, write, fault):
    values, reason = FAULTS[fault]
    path, topics, (better, other) = write(tmp_path, values, TRUE)
    found = tr.read(path, topics=topics)
    np.testing.assert_allclose(found.series["speed"].value, TRUE, rtol=1e-6)
    assert any(note.startswith(f"speed: not guessed from {better}: ") and note.endswith(reason) for note in found.notes)
    path, topics, _ = write(tmp_path, TRUE, values)
    found = tr.read(path, topics=topics)
    np.testing.assert_allclose(found.series["speed"].value, TRUE, rtol=1e-6)
    assert not any("not guessed from" in note for note in found.notes)
    path, topics, _ = write(tmp_path, values, values)
    with pytest.raises(InputError) as refusal:
        tr.read(path, topics=topics)
    for name in (better, other):
        assert f"{name}: " in str(refusal.value)
    assert reason in str(refusal.value)


@pytest.mark.parametrize("write", [can_log, mdf])
def test_a_line_for_a_refused_channel_is_read(tmp_path, write):
    path, topics, (better, _) = write(tmp_path, FAULTS["constant"][0], FAULTS["missing"][0])
    found = tr.read(path, topics={**(topics or {}), "speed": {"channel": better}})
    assert set(found.series["speed"].value) == {1.5}


@pytest.mark.parametrize(("speed", "way", "wanted"), [(None, 3, "no sign"), (0xFFFF, None, "signed"), (None, None, "signed")])
def test_a_kept_guess_reads_what_the_guess_reads(tmp_path, good, speed, way, wanted):
    """Wheel-based speed and direction of a tractor, each perhaps "not available"; the ground-based speed is there."""
    pytest.importorskip("cantools")
    dbc = tmp_path / "bus.dbc"
    dbc.write_text(
        'VERSION ""\nBU_: Vector__XXX\nBO_ 2365475056 WBSD: 8 Vector__XXX\n'
        ' SG_ WheelBasedMachineSpeed : 0|16@1+ (0.001,0) [0|64.255] "m/s" Vector__XXX\n'
        ' SG_ MachineDirection : 56|2@1+ (1,0) [0|3] "" Vector__XXX\n'
        "BO_ 2365475312 GBSD: 8 Vector__XXX\n"
        ' SG_ GroundBasedMachineSpeed : 0|16@1+ (0.001,0) [0|64.255] "m/s" Vector__XXX\n'
        'BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
        'BA_ "VFrameFormat" BO_ 2365475056 3;\nBA_ "VFrameFormat" BO_ 2365475312 3;\n'
    )
    lines = []
    for at_s, true in zip(TIMES, TRUE, strict=True):
        millis = round(1000 * abs(true))
        wheel = (millis if speed is None else speed).to_bytes(2, "little") + bytes([255] * 5)
        wheel += bytes([int(true >= 0.0) if way is None else way])
        ground = millis.to_bytes(2, "little") + bytes([255] * 6)
        lines += [f"({at_s:.6f}) can0 0CFE48F0#{wheel.hex()}\n", f"({at_s:.6f}) can0 0CFE49F0#{ground.hex()}\n"]
    path, kept = tmp_path / "run.log", tmp_path / "topics.yaml"
    path.write_text("".join(lines).upper().replace("CAN0", "can0"))
    kept.write_text(good("topics", "guess", path, "--dbc", dbc))
    for topics in (kept, {"dbc": str(dbc)}):
        found = tr.read(path, topics=topics).series["speed"].value
        np.testing.assert_allclose(found, TRUE if wanted == "signed" else np.abs(TRUE), atol=1e-3)
    assert ("direction" in yaml.safe_load(kept.read_text())) == (wanted == "signed")

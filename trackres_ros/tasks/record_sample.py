# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes a sample recording: the paper's lap test as a vehicle bus would log it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from trackres_ros.estimator.drives import LAP_HZ, SimulatedDrive, lap_drive
from trackres_ros.files.output_files import BAG_SUFFIX, output_file
from trackres_ros.files.resources import find_topics
from trackres_ros.output.mcap import BagWriter
from trackres_ros.tasks import options
from trackres_ros.tasks.arguments import AMBIENT, StrPath, VehicleGiven, as_track_vehicle, limited
from trackres_ros.tasks.terminal import Command, emit, watch
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import Vehicle

LOAD_HZ, AMBIENT_HZ = 10, 1
SPEED_STEP = 1.0 / KMH_PER_MPS  # resolution of a bus
SPEED_NOISE = 0.1 / KMH_PER_MPS
LOAD_NOISE_SHARE = 0.004
START_NS = 1_700_000_000_000_000_000
SEED = 20230514


@dataclass(frozen=True, slots=True)
class Sample:
    """A sample recording.

    Attributes
    ----------
    path, topics
        Its file, and the topics file that fits it.
    duration_s, distance_m
        Duration [s] and distance [m].
    """

    path: Path
    topics: Path
    duration_s: float
    distance_m: float


@limited(speed_kmh=(1.0, 50.0, "km/h"), laps=(1, 1000, ""), ambient_degc=AMBIENT)
def record_sample(
    path: StrPath, *, vehicle: VehicleGiven = "xgd24d", speed_kmh: float = 10.0, laps: int = 3, ambient_degc: float = 15.0
) -> Sample:
    """Make a sample recording: the paper's lap test as a vehicle bus would log it.

    Speed comes in steps of 1 km/h at 50 Hz, load at 10 Hz and air temperature at 1 Hz, all with noise.

    Parameters
    ----------
    path
        The `.mcap` file to write.
    vehicle
        Vehicle whose weight is recorded.
    speed_kmh
        Speed on the lap [km/h].
    laps
        Laps of a circle of 100 m radius, with a stop after each.
    ambient_degc
        Air temperature [degC].

    Returns
    -------
    Sample
        Its `path`, and the file of its `topics`; equal calls give equal bytes.

    Raises
    ------
    InputError
        Another suffix, no such folder, or a number out of its range.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> sample = tr.record_sample("lap.mcap", laps=1)
    >>> tr.read(sample.path, topics=sample.topics).roles
    ('load', 'ambient', 'speed')
    """
    file = output_file(path, (BAG_SUFFIX,), "path")
    drive = write_sample(file, as_track_vehicle(vehicle), speed_kmh, laps, ambient_degc)
    distance = float((drive.speed[1:] * (drive.time_s[1] - drive.time_s[0])).sum())
    return Sample(file, find_topics("sample"), float(drive.time_s[-1]), distance)


def write_sample(
    path: Path, vehicle: Vehicle, speed_kmh: float = 10.0, laps_driven: int = 3, ambient_degc: float = 15.0
) -> SimulatedDrive:
    """Write an MCAP file with speed (TwistStamped, steps of 1 km/h), load (Float64 in kN) and air temperature.

    The topics are those of config/topics/sample.yaml. Noise is drawn from a fixed seed, so equal calls give equal files.
    """
    drive = lap_drive(speed_kmh, laps_driven)
    random = np.random.default_rng(SEED)
    noisy_speed = drive.speed + random.normal(0.0, SPEED_NOISE, len(drive.speed)) * (drive.speed > 0)
    speed = np.maximum(np.round(noisy_speed / SPEED_STEP), 0.0) * SPEED_STEP
    load_stride, ambient_stride = LAP_HZ // LOAD_HZ, LAP_HZ // AMBIENT_HZ
    stamps = START_NS + np.round(drive.time_s * 1e9).astype(np.int64)
    load_kn = vehicle.weight * (1.0 + random.normal(0.0, LOAD_NOISE_SHARE, len(stamps[::load_stride]))) / 1e3
    ambient = np.full(len(stamps[::ambient_stride]), ambient_degc)
    with BagWriter(path) as bag:
        types = bag.typestore.types
        vector, header = types["geometry_msgs/msg/Vector3"], types["std_msgs/msg/Header"]
        time = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        zero = vector(x=0.0, y=0.0, z=0.0)
        twist = types["geometry_msgs/msg/TwistStamped"](
            header=header(stamp=time, frame_id="base_link"), twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
        )
        air = types["sensor_msgs/msg/Temperature"](header=header(stamp=time, frame_id="outside"), temperature=0.0, variance=0.25)
        speeds = bag.topic("/vehicle/speed", "geometry_msgs/msg/TwistStamped", twist, ("twist.linear.x",))
        loads = bag.topic("/vehicle/weight_kn", "std_msgs/msg/Float64", types["std_msgs/msg/Float64"](data=0.0), ("data",))
        airs = bag.topic("/vehicle/ambient", "sensor_msgs/msg/Temperature", air, ("temperature",))

        def write(topic: object, times: NDArray[np.int64], values: NDArray[np.float64]) -> None:
            bag.write_block(topic, times, times, values[:, np.newaxis])  # type: ignore[arg-type]

        for start in range(0, len(stamps), 4096):  # in runs, so that the file is in the order of time
            block = slice(start, start + 4096)
            write(airs, stamps[::ambient_stride][_share(block, ambient_stride)], ambient[_share(block, ambient_stride)])
            write(loads, stamps[::load_stride][_share(block, load_stride)], load_kn[_share(block, load_stride)])
            write(speeds, stamps[block], speed[block])
    return drive


def _share(block: slice, stride: int) -> slice:
    """The samples of a slower series that fall into a block of the fastest."""
    return slice(-(-block.start // stride), -(-block.stop // stride))


@click.command("record-sample", cls=Command)
@options.argument_option(record_sample, "vehicle", "Vehicle whose weight is recorded.", click.STRING, metavar="FILE|NAME")
@options.argument_option(record_sample, "speed_kmh", "Speed on the lap [km/h].")
@options.argument_option(record_sample, "laps", "Laps of a circle of 100 m radius, with a stop after each.")
@options.argument_option(record_sample, "ambient_degc", "Air temperature [degC].")
@click.option("-o", "--output", "path", type=options.PATH, required=True, help="File to write, .mcap.")
@options.json
def record_sample_command(vehicle: str, path: Path, as_json: bool, **drive: Any) -> None:
    """Make a recording like a vehicle bus log: the paper's lap test, speed in steps of 1 km/h, load, air temperature.

    \b
    trackres record-sample -o lap.mcap
    """
    watch(path)
    sample = record_sample(path, vehicle=vehicle, **drive)
    result = {
        "written": str(sample.path),
        "duration_s": sample.duration_s,
        "distance_m": sample.distance_m,
        "topics": str(sample.topics),
    }
    emit(
        result,
        as_json,
        lambda: (
            f"{path}: {sample.duration_s:.0f} s, {sample.distance_m:.0f} m\n"
            f"Try: trackres replay {path} --vehicle {vehicle} --topics {sample.topics} -o out.csv"
        ),
    )

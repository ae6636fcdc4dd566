# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes sample recordings, reads recordings and repairs unfinished ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trackres_ros.api.arguments import StrPath, TopicsGiven, VehicleGiven, as_paths, as_topics, as_track_vehicle, check_numbers
from trackres_ros.errors import InputError

if TYPE_CHECKING:
    from trackres_ros.offline.sample import Sample
    from trackres_ros.recording.mcap import Recovered
    from trackres_ros.recording.recording import Recording


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
    from trackres_ros.files.output_files import BAG_SUFFIX, output_file
    from trackres_ros.files.resources import find_topics
    from trackres_ros.offline.sample import Sample, write_sample

    check_numbers("record_sample", speed_kmh=speed_kmh, laps=laps, ambient_degc=ambient_degc)
    file = output_file(path, (BAG_SUFFIX,), "path")
    drive = write_sample(file, as_track_vehicle(vehicle), speed_kmh, laps, ambient_degc)
    distance = float((drive.speed[1:] * (drive.time_s[1] - drive.time_s[0])).sum())
    return Sample(file, find_topics("sample"), float(drive.time_s[-1]), distance)


def read(recording: StrPath | Sequence[StrPath], *, topics: TopicsGiven | None = None) -> Recording:
    """Read a recording into memory and check it.

    Parameters
    ----------
    recording
        A bag (rosbag2 folder, `.mcap`, `.db3`, `.bag`) or a table (`.csv`, `.csv.gz`, `.parquet`, `.xlsx`). Or an MDF file
        (`.mf4`), CAN log (`.blf`, `.asc`, `.log`) or MATLAB file (`.mat`). Several bags are read in sequence as one recording.
        An `.mcap` or `.mcap.part` that is unfinished is read up to its last complete block, with a finding.
    topics
        Which topic and field, or which column, feeds which role: a topics file, or its content as a mapping. Without it
        topics are guessed by message type, columns known by name, and channels of MDF files and CAN logs guessed by name
        and unit.

    Returns
    -------
    Recording
        Samples by role in SI units with their stamps; `findings` and `repr` list the defects.

    Raises
    ------
    InputError
        The file is missing, unreadable or without a speed; the remedy says what to do.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> from pathlib import Path
    >>> _ = Path("drive.csv").write_text("time_s,speed_kmh\\n0,0\\n1,4\\n2,8\\n3,8\\n30,8\\n")
    >>> tr.read("drive.csv")
    Recording drive.csv
      speed [m/s]: 5 samples at 1 Hz, 0 to 2.22222
    Notes
      speed: column speed_kmh
    Found
      speed: 1 gap longer than 10 s, the longest 27 s (first at 3.00 s)
    """
    from dataclasses import replace

    from trackres_ros.recording.opening import open_source
    from trackres_ros.recording.recording import Recording

    paths, mapping = as_paths(recording), as_topics(topics)
    source = open_source(paths, mapping)
    found = Recording.from_source(source)
    return replace(found, paths=tuple(paths), bindings=source.bindings, topics=source.topics)


def recover(recording: StrPath, *, output: StrPath) -> Recovered:
    """Repair an unfinished MCAP recording, so that every player opens it; the original file stays.

    Parameters
    ----------
    recording
        The `.mcap.part` that a killed `trackres live --record` leaves, or any truncated `.mcap`.
    output
        The `.mcap` file to write.

    Returns
    -------
    Recovered
        Its `path`, its number of messages, and the number of unusable bytes at the end.

    Raises
    ------
    InputError
        The file is not MCAP, is finished, or has no complete message; or the output cannot be written.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> lap = tr.record_sample("whole.mcap", laps=1).path.read_bytes()
    >>> from pathlib import Path
    >>> _ = Path("cut.mcap").write_bytes(lap[:-1000])
    >>> tr.recover("cut.mcap", output="again.mcap").messages
    15934
    """
    from trackres_ros import checks
    from trackres_ros.files.output_files import BAG_SUFFIX, not_an_input, output_file
    from trackres_ros.recording.mcap import Recovered, UnfinishedBag, is_unfinished
    from trackres_ros.recording.reading import check_file

    path, file = checks.path(recording, "recording"), output_file(output, (BAG_SUFFIX,), "output")
    check_file(path)
    if not is_unfinished(path):
        raise InputError("recording", str(path), "an MCAP file that was not finished", "a finished file needs no recovery")
    not_an_input(file, [path], "output")
    bag = UnfinishedBag(path)
    bag.write(file)
    return Recovered(file, bag.messages, bag.duration_s, bag.lost_bytes)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads recordings, repairs unfinished ones, and lists and guesses the topics files that describe them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click

from trackres_ros import checks
from trackres_ros.errors import InputError
from trackres_ros.files.output_files import BAG_SUFFIX, not_an_input, output_file
from trackres_ros.recording.mcap import Recovered, UnfinishedBag, is_unfinished
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.reading import check_file
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.topics_files import guessed_topics, shipped_files, shipped_text
from trackres_ros.tasks import options
from trackres_ros.tasks.arguments import StrPath, TopicsGiven, as_paths, as_topics
from trackres_ros.tasks.terminal import Command, Commands, emit, watch


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
    paths, mapping = as_paths(recording), as_topics(topics)
    source = open_source(paths, mapping)
    content = Recording.from_source(source)
    return replace(content, paths=tuple(paths), bindings=source.bindings, topics=source.topics)


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
    path, file = checks.path(recording, "recording"), output_file(output, (BAG_SUFFIX,), "output")
    check_file(path)
    if not is_unfinished(path):
        raise InputError("recording", str(path), "an MCAP file that was not finished", "a finished file needs no recovery")
    not_an_input(file, [path], "output")
    bag = UnfinishedBag(path)
    bag.write(file)
    return Recovered(file, bag.messages, bag.duration_s, bag.lost_bytes)


@click.command("recover", cls=Command)
@click.argument("recording", type=options.PATH)
@click.option("-o", "--output", type=options.PATH, required=True, help="File to write, .mcap.")
@options.json
def recover_command(recording: Path, output: Path, as_json: bool) -> None:
    """Repair an MCAP recording that a kill, a crash or a power cut left unfinished. The original file stays.

    RECORDING is the .mcap.part that `trackres live --record` left behind, or any truncated .mcap.

    \b
    trackres recover drive.mcap.part -o drive.mcap
    """
    watch(output)
    repair = recover(recording, output=output)
    result = {
        "written": str(repair.path),
        "messages": repair.messages,
        "duration_s": repair.duration_s,
        "lost_bytes": repair.lost_bytes,
    }
    note = f"; the last {repair.lost_bytes} bytes of {recording} are incomplete and dropped" if repair.lost_bytes else ""
    emit(result, as_json, lambda: f"{output}: {repair.messages} messages, {repair.duration_s:.1f} s{note}")


@click.group("topics", cls=Commands)
def topics_command() -> None:
    """Topics files: which topic or column feeds which role."""


@topics_command.command("list")
@options.json
def list_command(as_json: bool) -> None:
    """List the shipped topics files; commands accept their names instead of a path."""
    files = shipped_files()
    emit({"topics": files}, as_json, lambda: shipped_text(files))


@topics_command.command("guess", cls=Command)
@click.argument("recording", nargs=-1, required=True, type=options.PATH)
@options.dbc
@options.json
@click.pass_context
def guess_command(context: click.Context, recording: tuple[Path, ...], as_json: bool) -> None:
    """Print the guessed topics file of a recording, to check and save.

    \b
    trackres topics guess drive.mf4 > topics.yaml
    trackres topics guess bus.blf --dbc bus.dbc > topics.yaml
    """
    lines = guessed_topics(recording, options.with_databases(context, None, None))
    emit({"lines": lines}, as_json, lambda: "\n".join(lines))

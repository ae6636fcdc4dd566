# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Replays a recording through the estimator: torque and belt temperature over it, as live."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import Any

import click
import numpy as np

from trackres_ros import checks
from trackres_ros.errors import InputError, encodable, one_line
from trackres_ros.estimator import columns as at
from trackres_ros.estimator.energy import drive_text
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.records import Steps
from trackres_ros.estimator.settings import settings_for
from trackres_ros.estimator.snapshot import save, state_file
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.output_files import BAG_SUFFIX, no_two_alike, not_an_input, output_file
from trackres_ros.learning.columns import column_names, learning_values
from trackres_ros.learning.columns import lines as lines_of
from trackres_ros.learning.learner import MODES, OFF, Learner
from trackres_ros.learning.store import LearnedFile, continue_from, learner_content, write_learned
from trackres_ros.model.coverage import beyond
from trackres_ros.model.resistance import resistance_parts
from trackres_ros.node.parameters import make_parameters, read_parameters
from trackres_ros.output.preview import HEAD, picture_columns
from trackres_ros.recording.opening import open_source, stem
from trackres_ros.recording.recording import Recording
from trackres_ros.recording.samples import Finding
from trackres_ros.tasks import options
from trackres_ros.tasks.arguments import (
    StrPath,
    TopicsGiven,
    VehicleGiven,
    as_paths,
    as_topics,
    as_vehicle,
    input_files,
    load_vehicle,
)
from trackres_ros.tasks.replay_comparison import MeasuredTorque, TorqueTotals
from trackres_ros.tasks.replay_run import DisturbanceColumns, KeptSource, Replayed, result_writer, resumed
from trackres_ros.tasks.replay_run import replay as run
from trackres_ros.tasks.results import Array, SeriesResult
from trackres_ros.tasks.terminal import Command, emit, picture_beside, picture_if_possible, progress, watch
from trackres_ros.text import decimals, figures, listed, number_of, panel, paragraph
from trackres_ros.units import NANOSECOND
from trackres_ros.vehicle import AnyVehicle, files_of

MOST_UNFOLDED = 4
TIMES = ("time_s", "stamp_ns")
MANY_REFUSED = 0.1  # of the speeds: more are no faults of single samples
AFTER_TIME_OFF = (
    "its times begin before the end of the state, so it goes on as after {:g} s off. That is its standing time (stood), or 0 s "
    "without one"
)


def replay(
    recording: Recording | StrPath | Sequence[StrPath],
    vehicle: VehicleGiven,
    *,
    topics: TopicsGiven | None = None,
    params: StrPath | Mapping[str, object] | None = None,
    resume: StrPath | None = None,
    save_state: StrPath | None = None,
    learning: str = "off",
    save_vehicle: StrPath | None = None,
    both_sides: bool = False,
    output: StrPath | None = None,
    progress: Callable[[float], None] | None = None,
) -> ReplayResult:
    """Compute resistance torque [Nm] and belt temperature [degC] over a recording, as the live node would.

    Messages are processed in the order they were logged and by their own stamps, so the same recording always gives the same
    bits.

    Parameters
    ----------
    recording
        Result of `read`, or its argument.
    vehicle
        A vehicle, the path of its file, or the name of a shipped one.
    topics
        As in `read`, where paths are given.
    params
        Parameters of the estimator (config/trackres.yaml): a file, flat or as the live node reads it, or a mapping.
    resume, save_state
        State files: to continue from, and to write at the end. A recording whose times begin before the end of the state
        continues after time off: its standing time, or none.
    learning
        `off`; `watch` learns vehicle parameters from the measured torque without using them; `on` uses them, like the live
        node.
    save_vehicle
        Vehicle file to write at the end, with the learned parameters. Without any, none is written, and the result says why.
    both_sides
        Compute an unrecorded acceleration from the speeds before and after each moment, as `diagnose` does and no live node can.
        The result has the mean error [Nm] as `diagnose` compares it. The recording is held in memory.
    output
        File to write during the replay, in the format of `ReplayResult.save`. It replaces an older one at the end, together with
        the state and the vehicle file. Its rows are then not kept. With a bag, memory does
        not grow. With another file, up to ten million samples are kept to find their defects: 1.1 GB at most.
    progress
        Takes the number of messages of each block.

    Returns
    -------
    ReplayResult
        One row for each accepted speed: a mapping of column name to array, with `to_pandas`, `to_xarray`, `plot` and `save`.

    Raises
    ------
    InputError
        If the recording holds no usable speed, or something else cannot be used.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> from pathlib import Path
    >>> _ = Path("drive.csv").write_text("time_s,speed_kmh\\n0,0\\n10,36\\n60,36\\n")
    >>> result = tr.replay("drive.csv", "xgd24d")
    >>> len(result.to_pandas())
    3
    >>> print(f"{result['resistance_torque_nm'][-1]:.0f} Nm, belt {result['belt_degc/front_left'][-1]:.1f} degC")
    3319 Nm, belt 17.5 degC
    >>> result.save("out.csv").name
    'out.csv'
    """
    if progress is not None:
        checks.function(progress, "progress")
    file = None if output is None else output_file(output)
    resume_file = None if resume is None else checks.path(resume, "resume")
    state = None if save_state is None else state_file(save_state, "save_state")
    in_memory = recording if isinstance(recording, Recording) else None
    paths = in_memory.paths if in_memory else as_paths(recording)
    if in_memory and topics is not None:
        raise InputError("topics", "with a recording that is read", "topics with a path", "pass them to read")
    mapping = in_memory.topics if in_memory else as_topics(topics)
    entries = (
        params if isinstance(params, Mapping) else read_parameters(None if params is None else checks.path(params, "params"))
    )
    source_file = in_memory or open_source(paths, mapping)
    machine, comparison = as_vehicle(vehicle), None
    source = in_memory or KeptSource(source_file, keep=file is None or file.suffix.lower() != BAG_SUFFIX)
    if both_sides:
        from trackres_ros.tasks.both_sides import with_both_sides

        source, comparison = with_both_sides(in_memory or Recording.from_source(source_file), machine)
    parameters = make_parameters(entries)
    settings = settings_for(parameters.settings(), source_file.topics, source.roles)
    learned_file = None if save_vehicle is None else output_file(save_vehicle, (".yaml",), "save_vehicle")
    inputs = input_files(mapping, *paths, *files_of(machine), params)
    not_an_input(state, inputs, "save_state")  # it may replace the state to resume
    for argument, place in (("output", file), ("save_vehicle", learned_file)):
        not_an_input(place, [*inputs, resume_file], argument)
    no_two_alike({"output": file, "save_state": state, "save_vehicle": learned_file})
    learns = checks.one_of(learning, "learning", MODES) != OFF
    if learned_file is not None and not learns:
        raise InputError("save_vehicle", str(save_vehicle), "only with learning watch or on")
    blocks: list[Steps] = []
    with ExitStack() as stack:
        stack.enter_context(file_set())
        estimator = Estimator(machine, settings)
        learner = Learner(estimator, learning) if learns else None
        session = learned_before = off_s = None
        if resume_file is not None:
            session, off_s, learned_before, unlearned_s = resumed(source, estimator, resume_file)
            continue_from(resume_file, session, learner, learned_before, unlearned_s)
        write = blocks.append if file is None else stack.enter_context(result_writer(file, estimator, learner))
        write = write if comparison is None else comparison.writer(write)
        torques = TorqueTotals(parameters.mismatch()) if "torque" in source.roles else None
        run_result = run(source, estimator, write, session, progress, learner, torques)
        run_result = run_result if comparison is None else replace(run_result, comparison=comparison.as_dict())
        outputs = [finding for finding in (file, state) if finding is not None]
        if state is not None:
            saved_at = int(run_result.session.memory.times[at.SPEED, at.Times.last_arrival]) * NANOSECOND
            save(run_result.session, state, saved_at, learned_before if learner is None else learner_content(learner))
        if learned_file is not None and learner is not None:
            learned = write_learned(learner, estimator.vehicle, learned_file)
            run_result = replace(run_result, learned_file=learned)
            outputs += learned.written
    title = one_line(f"{', '.join(path.name for path in paths) or source.name}: {estimator.vehicle.title}")
    findings = source.all_findings() if isinstance(source, KeptSource) else source.findings
    findings = tuple(replace(finding, first_time_s=finding.first_time_s - run_result.late_s) for finding in findings)
    rows = blocks if file is None else None
    notes = source.notes if off_s is None else (*source.notes, AFTER_TIME_OFF.format(off_s))
    result = ReplayResult(run_result, rows, title, source.name, notes, findings, file, [*inputs, resume_file])
    if torques is not None:
        result.measured_torque = torques.result(source_file.bindings, estimator.vehicle.chassis.motor_ratio)
    result.written = tuple(outputs)
    return result


class ReplayResult(SeriesResult):
    """The estimate over a recording, one row for each accepted speed; see `trackres_ros.replay`.

    Attributes
    ----------
    name
        Of the recording.
    notes, findings
        Assumptions of the reader, and defects of the recording.
    messages, steps, duration_s
        Number of messages and of rows, and time of all steps [s]: without steps back, and without gaps too long to bridge.
    session
        The estimator's session at the end; its counters include those of a resumed state.
    output
        The file written during the replay; its rows are then not in memory.
    written
        All files that the replay wrote: `output`, the state, the vehicle file and the files copied for it.
    measured_torque
        Means of measured and expected torque [Nm], see `MeasuredTorque`; None without a torque.
    """

    def __init__(
        self,
        replayed: Replayed,
        blocks: Sequence[Steps] | None,
        title: str,
        name: str,
        notes: Sequence[str],
        findings: Sequence[Finding],
        output: Path | None = None,
        inputs: Sequence[str | PathLike[str] | None] = (),
    ) -> None:
        self.title, self.name, self.notes, self.findings, self.output = title, name, tuple(notes), tuple(findings), output
        self.session: Session = replayed.session
        self.messages, self.steps, self.duration_s = replayed.messages, replayed.steps, replayed.totals.duration_s
        self.written: tuple[Path, ...] = ()
        self.measured_torque: MeasuredTorque | None = None
        self._replayed, self._stored_blocks, self._inputs = replayed, blocks, inputs

    @property
    def estimator(self) -> Estimator:
        """The estimator of the replay."""
        return self.session.estimator

    @property
    def vehicle(self) -> AnyVehicle:
        """The vehicle of the replay."""
        return self.estimator.vehicle

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns, as in the table that `save` writes."""
        return (*TIMES, *self._of_rows, *DisturbanceColumns(self.vehicle).names)

    @property
    def learner(self) -> Learner | None:
        """The learner; None if learning was off."""
        return self._replayed.learner

    @property
    def learned_file(self) -> LearnedFile | None:
        """What the vehicle file of `save_vehicle` got, and why if nothing; None if none was asked for."""
        return self._replayed.learned_file

    @property
    def _of_rows(self) -> tuple[str, ...]:
        learned = () if self.learner is None else column_names(self.learner.learnables)
        return (*self.estimator.columns, *learned)

    @cached_property
    def _stamps(self) -> Array:
        return np.concatenate([steps.stamp_ns for steps in self._blocks()])

    @cached_property
    def _disturbance_columns(self) -> dict[str, Array]:
        """Watched disturbance, by column."""
        disturbance = DisturbanceColumns(self.vehicle)
        blocks = [disturbance.of(steps) for steps in self._blocks()]
        return {name: np.concatenate([block[i] for block in blocks]) for i, name in enumerate(disturbance.names)}

    def __getitem__(self, name: str) -> Array:
        if name == "stamp_ns":
            return self._stamps.copy()
        if name == "time_s":
            return np.asarray((self._stamps - self._stamps[0]) * NANOSECOND)
        if name in DisturbanceColumns(self.vehicle).names:
            return self._disturbance_columns[name].copy()
        if name not in self._of_rows:
            raise KeyError(name)
        column = self._of_rows.index(name)
        values = np.concatenate([steps.rows[:, column] for steps in self._blocks()])
        return values.astype(np.int64) if name == "reasons" else values

    def _blocks(self) -> Sequence[Steps]:
        if self._stored_blocks is None:
            allowed = "a replay without output, which holds its rows in memory"
            raise InputError("replay", f"output={str(self.output)!r}", allowed, "or read that file")
        return self._stored_blocks

    def _picture_series(self) -> Mapping[str, Array]:
        picture = self._replayed.picture
        return {"time_s": picture[:, 0], **picture_columns(self._of_rows, picture)}

    def _coverage(self) -> Array | None:
        return None if self.learner is None else self.learner.buckets.seconds

    def _attributes(self) -> dict[str, str]:
        return {"vehicle": self.vehicle.name, "recording": self.name}

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the rows to a file, with the same bytes as `trackres replay -o`.

        Parameters
        ----------
        path
            `.csv`, `.csv.gz`, `.parquet` or `.mf4` for a table; `.mcap` for topics of the live node. Only the table has the
            standard deviation of the resistance, and a disturbance.

        Returns
        -------
        Path
            Of the file.

        Raises
        ------
        InputError
            Another suffix, no such folder, an input of the replay, or rows that were not kept, as they went into an `output`.
        """
        file = output_file(path, argument="path")
        not_an_input(file, self._inputs, "path")
        blocks = self._blocks()
        with result_writer(file, self.estimator, self.learner) as write:
            for steps in blocks:
                write(steps)
        return file

    def as_dict(self) -> dict[str, Any]:
        """The summary of reading and estimate, ready for JSON.

        Returns
        -------
        dict
            Input, defects, and the last estimate.
        """
        measured = {} if self.measured_torque is None else {"measured_torque": self.measured_torque.as_dict()}
        return {**summary(self._replayed, self.name, self.notes, self.findings), **measured}

    def __repr__(self) -> str:
        return summary_text(self.as_dict())

    def _repr_html_(self) -> str:
        first, *lines = repr(self).splitlines()
        details = [line.strip() for line in lines if line.startswith("  ")]
        end = [line for line in lines if not line.startswith("  ")]
        details_html = listed("Inputs and findings", details, folded=len(details) > MOST_UNFOLDED)
        return panel(self.title, paragraph(first), self._table(), *map(paragraph, end), details_html)


def summary(result: Replayed, name: str, notes: Sequence[str], findings: Sequence[Finding]) -> dict[str, Any]:
    """The report as a dict ready for JSON: the recording's name, the notes of its reading, and its defects."""
    estimator = result.session.estimator
    last = {name: _finite(float(result.last[i])) for i, name in enumerate(estimator.columns) if name != "reasons"}
    learned = {} if result.learner is None else {"learning": {**_learned(result.learner), **_file_report(result.learned_file)}}
    torque = at.Results.resistance_torque_nm
    first_nm, last_nm = float(result.picture[0, HEAD + torque]), float(result.last[torque])
    drive = result.totals.as_dict()
    counters: dict[str, dict[str, int]] = {}
    for channel, count, number in result.counts:
        counters.setdefault(channel, {})[count.name.lower()] = number
    return {
        "vehicle": estimator.vehicle.name,
        "recording": name,
        "notes": list(notes),
        "findings": [
            {"role": f.role, "kind": f.kind, "count": f.count, "first_time_s": _finite(f.first_time_s), "text": f.text}
            for f in findings
        ],
        "messages": result.messages,
        "steps": result.steps,
        "duration_s": result.totals.duration_s,
        "counters": counters,
        "reasons": [
            {"reason": (reason.name or "").lower(), "text": at.REASON_TEXT[reason], "steps": number}
            for reason, number in sorted(result.reasons.items())
        ],
        "remarks": _remarks(result),
        "drive": drive,
        "resistance_torque_nm": {"first": first_nm, "largest": drive["largest_resistance_nm"], "last": last_nm},
        "last": last,
        **({} if result.comparison is None else {"comparison": dict(result.comparison)}),
        **learned,
    }


def _remarks(result: Replayed) -> list[str]:
    """Speeds that no such vehicle has, belts outside of the rubber data, loads outside of the table; of the picture's samples."""
    estimator = result.session.estimator
    return [*_speed_remarks(result), *beyond(estimator.vehicle, picture_columns(estimator.columns, result.picture))]


def _speed_remarks(result: Replayed) -> Iterator[str]:
    counts = {count: number for channel, count, number in result.counts if channel == "speed"}
    refusals = sum(counts.get(count, 0) for count in (at.Count.OUT_OF_RANGE, at.Count.IMPLAUSIBLE))
    total = sum(counts.get(count, 0) for count in (at.Count.ACCEPTED, *at.REFUSALS))
    if refusals > MANY_REFUSED * total:
        yield f"{refusals} of {total} speeds refused as too fast for this vehicle: wrong unit?"


def summary_text(report: dict[str, Any]) -> str:
    """The report for people."""
    last = report["last"]
    belts = {name.partition("/")[2]: value for name, value in last.items() if name.startswith("belt_degc/")}
    long_gaps = sum(item["steps"] for item in report["reasons"] if item["reason"] == "gap_unknown")
    left_out = f"; {number_of(long_gaps, 'long gap')} left out" if long_gaps else ""
    span = f"{number_of(report['steps'], 'step')} over {report['duration_s']:.1f} s{left_out}"
    lines = [f"{number_of(report['messages'], 'message')}, {span}"]
    lines += [f"  note: {note}" for note in report["notes"]]
    lines += [f"  found: {item['role'] and item['role'] + ': '}{item['text']}" for item in report["findings"]]
    for channel, counts in report["counters"].items():
        refusals = {name: number for name, number in counts.items() if name != "accepted"}
        if refusals:
            lines.append(f"  counted: {channel}: " + ", ".join(f"{name} {number}" for name, number in refusals.items()))
    lines += [f"  status: {item['text']} ({number_of(item['steps'], 'step')})" for item in report["reasons"]]
    lines += [f"  ! {remark}" for remark in report["remarks"]]
    stood = not report["drive"]["under_way_s"] and set(report["counters"].get("speed", ())) - {"accepted"}
    totals = drive_text(report["drive"]) + (" in the accepted samples" if stood else "")
    lines.append(totals if report["duration_s"] else "The drive has no totals: no two rows without a long gap between them")
    lines.append(
        f"At the end, at {decimals(last['speed_mps'] * 3.6, 1)} km/h: resistance "
        f"{decimals(last['resistance_torque_nm'])} +- {decimals(last['resistance_std_nm'])} Nm ("
        + ", ".join(f"{part} {decimals(last[column])}" for part, column in resistance_parts(bool(belts)).items())
        + ")"
    )
    if measured := report.get("measured_torque"):
        lines += [measured["text"], *([f"  ! {measured['finding']}"] if measured["finding"] else [])]
    if (comparison := report.get("comparison")) and comparison["steps"]:
        error, steps = decimals(comparison["mean_error_nm"], 3), number_of(comparison["steps"], "step")
        lines.append(
            f"Measured torque: mean error {error} Nm in means over {comparison['step_s']:g} s ({steps}, as a diagnosis compares)"
        )
    if "learning" in report:
        lines.append(f"Learning ({report['learning']['mode']}): {report['learning']['text']}")
        lines += [f"  {item['text']}" for item in report["learning"]["parameters"]]
        lines += _file_lines(report["learning"].get("vehicle_file"))
    if belts:
        lines.append("Belts: " + ", ".join(f"{name} {decimals(value, 1)} degC" for name, value in belts.items()))
    return "\n".join(map(one_line, lines))


def _learned(learner: Learner) -> dict[str, Any]:
    """Learned parameters at the end."""
    values = learning_values(learner)
    texts = lines_of(learner, values)
    return {
        "mode": learner.mode,
        "text": learner.text,
        "acts": learner.is_active,
        "coverage": values[0],
        "parameters": [{"name": name, "text": text, **dict(fields)} for name, text, fields in texts],
    }


def _file_report(file: LearnedFile | None) -> dict[str, Any]:
    """What the vehicle file got that the replay was asked to write."""
    if file is None:
        return {}
    changes = {name: {"before": old, "written": value} for name, (old, value) in file.changed.items()}
    return {"vehicle_file": {"path": str(file.path), "changed": changes, "kept": dict(file.kept), "why_not": file.why_not}}


def _file_lines(file: dict[str, Any] | None) -> list[str]:
    if file is None:
        return []
    if file["why_not"]:
        return [f"Not written: {file['path']}: {file['why_not']}"]
    lines = [f"In {file['path']}"]
    for name, change in file["changed"].items():
        old, value = (figures(x, 4) for x in (change["before"], change["written"]))
        lines.append(f"  {name} {old} -> {value}")
    return lines + [f"  {name} {figures(value, 4)} as before: not known well enough" for name, value in file["kept"].items()]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


@click.command("replay", cls=Command)
@click.argument("recording", nargs=-1, required=True, type=options.PATH)
@options.vehicle
@options.surroundings
@options.topics("which topic, field or column feeds which role; without it, guessed by message type, or by name and unit.")
@options.params
@options.methods
@click.option("--resume", type=options.PATH, metavar="STATE", help="Continue from a state saved by --save-state.")
@click.option("--save-state", type=options.PATH, metavar="STATE", help="Save the state at the end.")
@click.option(
    "--learning",
    default="off",
    metavar="off|watch|on",
    help="Learn vehicle parameters from the measured torque, as the live node does; on: use them.",
)
@click.option("--save-vehicle", type=options.PATH, metavar="V.yaml", help="Write a vehicle file with the learned parameters.")
@click.option(
    "--both-sides",
    is_flag=True,
    help="Compute an unrecorded acceleration from the speeds before and after, and give the error, as diagnose does.",
)
@click.option(
    "-o",
    "--output",
    type=options.PATH,
    help="Result: .parquet, .csv, .csv.gz or .mf4 as a table, .mcap as topics; with a picture, .png. Default: a table "
    "in this folder, named after the recording: Parquet, or .csv.gz without pyarrow.",
)
@options.json
def replay_command(
    recording: tuple[Path, ...],
    vehicle: str,
    surroundings: Path | None,
    method: str | None,
    thermal: str | None,
    output: Path | None,
    as_json: bool,
    **arguments: Any,
) -> None:
    """Compute resistance torque and belt temperature over a recording.

    RECORDING is a rosbag2 folder, .mcap, .db3, ROS 1 .bag (several are read in sequence), or one .csv, .csv.gz,
    .parquet or .xlsx with time_s and speed_mps (or speed_kmh), or with columns that the topics file names; or one .mf4, .blf,
    .asc, .log (candump), .mat, .ulg, .vbo or .lvm, whose channels are named there too or guessed.

    \b
    trackres replay lap.mcap --vehicle xgd24d --topics topics.yaml -o out.mcap
    trackres replay drive.csv --vehicle xgd24d

    Messages are processed in the order they were logged and by their own stamps, so the same recording always gives the same
    bits.
    """
    output = output or _table_of(recording[0])
    picture = picture_beside(output)
    no_two_alike({"output": picture, "save_state": arguments["save_state"]})
    watch(output, picture, arguments["save_state"], arguments["save_vehicle"])
    machine = load_vehicle(vehicle, method=method, thermal=thermal, surroundings=surroundings)
    with file_set():
        with progress("replaying", None) as advance:
            result = replay(recording, machine, output=output, progress=advance, **arguments)
        outputs = [str(path) for path in result.written]
        with picture_if_possible(picture):
            result.plot(picture)
            outputs.append(str(picture))
    emit(
        {**result.as_dict(), "written": outputs},
        as_json,
        lambda: "\n".join([repr(result), one_line(f"Written: {', '.join(outputs)}")]),
    )


def _table_of(recording: Path) -> Path:
    """The default table of a replay; bytes of the name that are no UTF-8 are escaped, for whoever prints it."""
    name = encodable(stem(recording)) or "recording"
    return Path(f"{name}_replay{'.parquet' if find_spec('pyarrow') else '.csv.gz'}")

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnoses recordings: finds the physics that the model lacks, and reports it."""

from __future__ import annotations

import atexit
import base64
import json
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
import yaml

from trackres_ros import checks
from trackres_ros.errors import InputError, MissingExtraError, one_line
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.output_files import not_an_input, output_folder
from trackres_ros.files.own_files import remove, write
from trackres_ros.recording.reading import check_there
from trackres_ros.recording.recording import Recording, topics_in_use
from trackres_ros.recording.roles import ROLES, base_role
from trackres_ros.tasks import options
from trackres_ros.tasks.arguments import (
    StrPath,
    TopicsGiven,
    VehicleGiven,
    as_names,
    as_paths,
    as_recordings,
    as_topics,
    input_files,
    paths_of,
)
from trackres_ros.tasks.recordings import read
from trackres_ros.tasks.terminal import Command, emit, print_warnings, stage_progress, watch
from trackres_ros.text import alike, figures, html_table, listed, panel, paragraph
from trackres_ros.vehicle import AnyVehicle, load_any
from trackres_ros.vehicle.writing.vehicle_file import SURROUNDINGS_FILE

if TYPE_CHECKING:  # at run time where it is used: it takes a second, and a help text needs none of it
    from trackres_ros.diagnosis.base.loading import LoadedBase
    from trackres_ros.diagnosis.base.own import OwnModel
    from trackres_ros.diagnosis.empirical.term import Term
    from trackres_ros.diagnosis.pipeline import Diagnosis
    from trackres_ros.diagnosis.prepare.checks import Refusal
    from trackres_ros.diagnosis.report.interactive import Interactive

MOST_HELD_OUT = 1_000_000
REPORT_FILE, VEHICLE_FILE, SETTINGS_FILE, PAGE_FILE = "report.json", "vehicle.yaml", "estimator.yaml", "report.html"
PICTURES = (
    "believed.svg", "before_after.svg", "where_*.svg", "effect_*.svg", "term_*.svg", "route.svg", "route_beside.svg",
    "held_out.svg", "noise.svg", "separability.svg",
)  # fmt: skip
"""Pictures of a page; those of an earlier diagnosis would look like this one's."""
REPLAYED = {
    "accel": "the acceleration from past speeds alone", "grade": "no slope from the altitude", "yaw_rate": "no yaw rate",
    "heading": "no heading",
}  # fmt: skip
"""What a replay computes of the channels that a diagnosis computes."""
MOST_WARNINGS = 10  # in the text for a terminal
DATA_FILES = (REPORT_FILE, VEHICLE_FILE, SURROUNDINGS_FILE, SETTINGS_FILE)
SETTINGS_ABOUT = (
    "# Settings of the live filter of the acceleration, from the speeds of these recordings.\n"
    "# They are for --params of trackres replay and trackres live, or parameters of the node.\n"
)


def diagnose(
    recordings: StrPath | Recording | Sequence[StrPath | Recording],
    vehicle: VehicleGiven | OwnModel,
    *,
    topics: TopicsGiven | None = None,
    surroundings: StrPath | None = None,
    hide: str | Sequence[str] = (),
    holdout: int | str | Sequence[str] | None = None,
    method: str | None = None,
    thermal: str | None = None,
    seed: int = 1,
    quick: bool = False,
    keep_suspected: bool = False,
    effects: StrPath | None = None,
    on_stage: Callable[[str], None] = lambda _: None,
) -> DiagnosisResult:
    """Find where measured and simulated torque [Nm] differ, which physics is missing, and a vehicle that includes it.

    Parameters
    ----------
    recordings
        Sessions: each a result of `read`, or a path that it accepts.
    vehicle
        A vehicle, the path of its file, or the name of a shipped one; also one of the base model ``road_load``, or an `OwnModel`.
    topics
        As in `read`, for the paths.
    surroundings
        File of the site, weather and ground during the drives.
    hide
        Channel or channels to ignore, such as ``grade`` or ``yaw_rate``.
    holdout
        How many of the last recordings or laps to hold out, or names of recordings, or of laps as a report lists them
        (``day2.mcap: 5``).
    method, thermal
        As in `load_vehicle`.
    seed
        Seed of all random draws: equal seeds give equal results.
    quick
        Fewer draws for thresholds.
    keep_suspected
        Also keep effects that fit but that laps left out do not confirm.
    effects
        Folder with your own effects, one Python file each.
    on_stage
        Takes the name of each stage as it begins.

    Returns
    -------
    DiagnosisResult
        `sentence`, `effects`, `vehicle`, and `report("folder")`, which writes the files of `trackres diagnose`.

    Raises
    ------
    InputError
        If the recordings cannot be used, with the reason.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> from pathlib import Path
    >>> _ = Path("drive.csv").write_text("time_s,speed_kmh\\n0,0\\n10,36\\n200,36\\n")
    >>> try:
    ...     tr.diagnose("drive.csv", "xgd24d")
    ... except tr.InputError as error:
    ...     print(error.allowed)
    a measured torque: without it there is nothing to compare
    """
    from trackres_ros.diagnosis import DiagnosisOptions
    from trackres_ros.diagnosis import diagnose as run
    from trackres_ros.diagnosis.base.loading import load_base
    from trackres_ros.diagnosis.prepare.checks import each_usable
    from trackres_ros.diagnosis.prepare.gate import in_order

    start_s = time.monotonic()
    checks.function(on_stage, "on_stage")
    channels = as_names(hide, "hide")
    for channel in channels:
        checks.one_of(base_role(channel), "hide", ROLES)
    checks.seed(seed)
    if isinstance(holdout, Iterable):
        holdout = as_names(holdout, "holdout")
    elif holdout is not None:
        checks.whole(holdout, "holdout", 0, MOST_HELD_OUT)
    if isinstance(effects, str) and not effects:
        raise InputError("effects", "", "a folder with Python files, or None")
    folder = None if effects is None else checks.path(effects, "effects")
    items = as_recordings(recordings)
    mapping = as_topics(topics)
    if mapping is None:
        mapping = next((item.topics for item in items if isinstance(item, Recording) and item.topics), None)
    base = load_base(vehicle, method, thermal, surroundings)
    for path in (path for item in items if not isinstance(item, Recording) for path in as_paths(item)):
        check_there(path)
    refusals: list[Refusal] = []
    sessions = in_order(
        each_usable(items, lambda item: item if isinstance(item, Recording) else read(item, topics=mapping), refusals, _name)
    )
    base = base.with_topics(topics_in_use(sessions))
    run_options = DiagnosisOptions(channels, holdout, seed, quick, folder, keep_suspected, on_stage, refusals)
    diagnosis = run(sessions, base, run_options)
    names = {session.name for session in diagnosis.sessions}
    paths = paths_of([session for session in sessions if session.name in names])
    inputs = input_files(mapping, *paths, base.source, surroundings)
    return DiagnosisResult(diagnosis, base, paths, time.monotonic() - start_s, inputs)


def _name(recording: StrPath | Recording) -> str:
    return str(recording) if isinstance(recording, str | PathLike) else recording.name


class DiagnosisResult:
    """Differences between measurement and simulation, and the missing physics; see `trackres_ros.diagnose`.

    Attributes
    ----------
    recordings
        Paths of the used recordings, in driving order; see `in_order`.
    diagnosis
        All intermediate results, step by step.
    written
        Files of the last `report`.
    """

    def __init__(
        self,
        diagnosis: Diagnosis,
        base: LoadedBase,
        recordings: Sequence[Path],
        seconds: float | None = None,
        inputs: Sequence[Path] = (),
    ) -> None:
        from trackres_ros.diagnosis.report.content import report

        self.diagnosis = diagnosis
        self.recordings = tuple(recordings)
        self.written: tuple[Path, ...] = ()
        self._base_file = base
        self._seconds = seconds
        self._inputs = inputs
        self._content = report(diagnosis, self.recordings)

    @property
    def sentence(self) -> str:
        """The verdict, in one or several sentences."""
        return self.diagnosis.verdict.sentence

    @property
    def status(self) -> str:
        """``none`` missing, ``named``, ``one_of`` several that look alike, ``described`` without a name, or ``unexplained``."""
        return self.diagnosis.verdict.status

    @property
    def grade(self) -> str:
        """Grade by laps left out of the fit: ``confirmed``, ``suspected`` or ``refuted``."""
        return self.diagnosis.verdict.grade

    @property
    def effects(self) -> tuple[Term, ...]:
        """Found effects, each with `name`, `values`, `intervals` and `grade`."""
        return self.diagnosis.found

    @property
    def described(self) -> tuple[Term, ...]:
        """Found terms without a name, each with `form`, `sentence`, `intervals` and `grade`."""
        return self.diagnosis.described

    @property
    def warnings(self) -> tuple[str, ...]:
        """Notes on the recordings to act on: a recording or a channel is not used, or two inputs contradict each other."""
        return tuple(map(one_line, self.diagnosis.gated.warnings))

    @property
    def to_do(self) -> tuple[str, ...]:
        """Next steps: use of the surroundings, and lines for the topics file if a sensor is wrong."""
        return (*self._content["to_do"], *self._content["topics_lines"].values())

    @cached_property
    def vehicle(self) -> AnyVehicle | OwnModel:
        """The vehicle with the confirmed effects; on the hold-out laps never worse than the given one.

        It is the vehicle file that `report` writes, in the given surroundings. Findings on site, weather and ground are
        excluded: `report` writes them to a separate file. Its `source` is a file that exists while the
        program runs.
        """
        from trackres_ros.diagnosis.base.own import OwnBase

        if isinstance(self.diagnosis.base, OwnBase):
            return self.diagnosis.base.with_kept(self.diagnosis.kept)
        folder = Path(tempfile.mkdtemp(prefix="trackres-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        self._write_vehicle(folder)
        return replace(load_any(folder / VEHICLE_FILE), surroundings=self._base_file.surroundings, route=self._base_file.route)

    def _write_vehicle(self, folder: Path) -> list[Path]:
        names = ", ".join(path.name for path in self.recordings)
        text = f"{self.sentence}\nWritten by trackres diagnose from {names}."
        return self._base_file.base.write(folder / VEHICLE_FILE, self.diagnosis.kept, text)

    def report(self, folder: str | PathLike[str], page: bool = True) -> Path:
        """Write the files of `trackres diagnose -o`: report.json, report.html with pictures, vehicle.yaml, and
        surroundings.yaml if an effect belongs to the surroundings.

        They replace those of an earlier report together, at the end: after any failure all files are still the earlier ones. Page
        and pictures that the new report does not have are removed. Without jinja2 or matplotlib there is no page, only a warning.

        Parameters
        ----------
        folder
            Created if needed.
        page
            Whether to write report.html and its pictures, which takes as long as a short diagnosis.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        InputError
            If a file of that folder is an input of the diagnosis.
        OSError
            If the files cannot be written, as on a full disk; those of an earlier report are then unchanged.
        """
        place = output_folder(folder, argument="folder")
        for name in DATA_FILES:
            not_an_input(place / name, self._inputs, "folder")
        with file_set():
            file = place / REPORT_FILE
            write(file, (json.dumps(self._content, indent=2, allow_nan=False) + "\n").encode())
            files = (file, *self._write_vehicle(place), *self._write_settings(place))
            if page:
                try:
                    files += self._write_page(place)
                except MissingExtraError as error:
                    warnings.warn(f"no page: {error}", stacklevel=2)
            page_file = place / PAGE_FILE
            if page_file.is_file() and "<title>Diagnosis of " in page_file.read_text(encoding="utf-8", errors="replace"):
                pictures = (picture for name in PICTURES for picture in place.glob(name))
                for old_file in {page_file, *place.glob(SETTINGS_FILE), *pictures}.difference(files):
                    remove(old_file)
        self.written = files
        return place

    @property
    def live_filter(self) -> dict[str, float]:
        """Settings of the live filter of the acceleration, by name, for `params` of `replay`; empty where it was recorded.

        They are medians over the recordings, from the noise and the jerk that make their speeds most likely.
        """
        from trackres_ros.diagnosis.base.own import OwnBase
        from trackres_ros.diagnosis.prepare.session import LiveFilter

        filters = [s.live_filter for s in self.diagnosis.gated.sessions if s.live_filter]
        if not filters or isinstance(self.diagnosis.base, OwnBase):  # a replay runs no model of the user's own
            return {}
        medians = np.median(np.array(filters), axis=0)
        return {name: float(figures(value, 3)) for name, value in zip(LiveFilter._fields, medians.tolist(), strict=True)}

    def _write_settings(self, place: Path) -> list[Path]:
        if not self.live_filter:
            return []
        file = place / SETTINGS_FILE
        write(file, (SETTINGS_ABOUT + yaml.safe_dump(self.live_filter, sort_keys=False)).encode())
        return [file]

    def _write_page(self, place: Path) -> tuple[Path, ...]:
        from trackres_ros.diagnosis.report.page import glance, provenance, write_page
        from trackres_ros.diagnosis.report.pictures import draw_all

        pictures = draw_all(self.diagnosis, place)
        vehicle = [self._base_file.source] if self._base_file.source else []
        made_of = provenance([*self.recordings, *vehicle], self._seconds)
        path, title = place / PAGE_FILE, f"Diagnosis of {self._base_file.title}"
        summary = glance(self.diagnosis, self._content["topics_lines"])
        write_page(path, self._content, summary, pictures, title, _plots(self.diagnosis), made_of)
        return path, *(picture.path for picture in pictures)

    def as_dict(self) -> dict[str, Any]:
        """All findings, ready for JSON: the content of report.json.

        Returns
        -------
        dict
            As its schema, `report.schema.json`, says.
        """
        return dict(self._content)

    def __repr__(self) -> str:
        reason = self.diagnosis.kept.text
        lines = [f"Warning: {text}" for text in self.warnings[:MOST_WARNINGS]]
        if len(self.warnings) > MOST_WARNINGS:
            lines.append(f"{len(self.warnings) - MOST_WARNINGS} more warnings are in {REPORT_FILE}.")
        return "\n".join([self.sentence, f"{reason[0].upper()}{reason[1:]}.", *self._worse_in_replay(), *lines, *self.to_do])

    def _worse_in_replay(self) -> list[str]:
        """Sentence on the inputs that the diagnosis computes from others, but a replay does not."""
        from trackres_ros.diagnosis.base.road_load import RoadBase
        from trackres_ros.diagnosis.base.track import TrackBase

        d = self.diagnosis
        if not isinstance(d.base, TrackBase | RoadBase):
            return []
        acting_effects = (*d.base.vehicle.active, *d.kept.effects)
        inputs = {"accel", "grade", *(need for active in acting_effects for need in active.effect.needs)}
        texts = [text for c, text in REPLAYED.items() if c in inputs and any(c in s.computed for s in d.gated.sessions)]
        if not texts:
            return []
        settings = f"--params {SETTINGS_FILE} fits its filter to these speeds; " if self.live_filter else ""
        advice = f" For the acceleration, {settings}--both-sides uses all speeds, as here." if REPLAYED["accel"] in texts else ""
        return [
            f"Not all inputs were recorded. A replay computes {', '.join(texts)}, so its error is larger than this one.{advice}"
        ]

    def _repr_html_(self) -> str:
        from trackres_ros.diagnosis.report.series import stages

        rows = []
        for effect in self.effects:
            units = {q.name: "" if q.unit == "1" else q.unit for q in effect.effect.parameters}
            names = effect.name if len(effect.members) <= 1 else " or ".join(effect.members)
            for name, value in effect.values.items():
                interval = effect.intervals[name]
                value_text, *ends = alike((value, interval.low, interval.high), interval.high - interval.low)
                interval_text = "only a bound" if interval.bound_only else " to ".join(ends)
                rows.append((names, name, value_text, interval_text, units[name], effect.grade))
        held_out = self.diagnosis.held_out
        errors = [
            (stage.label, figures(held_out.mae[stage.key]), figures(held_out.bias[stage.key])) for stage in stages(self.diagnosis)
        ]
        return panel(
            f"Diagnosis of {self._base_file.title}",
            paragraph(self.sentence),
            html_table(("effect", "parameter", "value", "95 % interval", "unit", "laps left out"), rows),
            html_table(("on hold-out laps", "mean error", "bias"), errors, ("", "Nm", "Nm")),
            listed("Warnings", self.warnings),
            listed("Next step", self.to_do),
            self._picture(),
        )

    def _picture(self) -> str:
        """Measured against simulated torque, if it can be drawn."""
        try:
            from trackres_ros.diagnosis.report.pictures import lap
            from trackres_ros.diagnosis.report.static import draw

            with tempfile.TemporaryDirectory() as folder:
                picture = draw(lap(self.diagnosis), Path(folder) / "before_after.png")
                data = base64.b64encode(picture.path.read_bytes()).decode()
        except MissingExtraError:
            return ""
        return f'<img src="data:image/png;base64,{data}" alt="{escape(picture.alternative)}" style="max-width: 100%">'


def _plots(diagnosis: Diagnosis) -> Interactive | str:
    """The page's interactive plots, or the reason for their absence."""
    from trackres_ros.diagnosis.report.interactive import interactive

    try:
        return interactive(diagnosis)
    except MissingExtraError as error:
        return str(error)


@click.command("diagnose", cls=Command)
@click.argument("recordings", nargs=-1, required=True, type=options.PATH)
@options.vehicle
@options.surroundings
@options.topics("which topic or column feeds which role.")
@click.option("--hide", multiple=True, metavar="CHANNEL", help="Ignore a channel, such as grade or yaw_rate; may be repeated.")
@click.option(
    "--holdout",
    metavar="N|NAMES",
    help="How many of the last recordings or laps to hold out, or names of recordings or laps (day2.mcap: 5) with commas.",
)
@options.methods
@options.argument_option(diagnose, "seed", "Seed of all random draws.", options.SEEDS)
@click.option("--quick", is_flag=True, help="Fewer draws for thresholds.")
@click.option("--keep-suspected", is_flag=True, help="Also write effects that fit but that laps left out do not confirm.")
@click.option("--effects", type=options.PATH, metavar="DIR", help="Folder with your own effects, one Python file each.")
@click.option("--no-page", is_flag=True, help="Write no report.html and no pictures, which take long; remove earlier ones.")
@options.folder("Folder for the report; created if needed.")
@options.json
def diagnose_command(
    recordings: tuple[Path, ...], holdout: str | None, no_page: bool, output: Path, as_json: bool, **arguments: Any
) -> None:
    """Find where measurement and simulation differ and which physics is missing; write a vehicle file with it.

    Each RECORDING with a measured torque is a session: a bag, a table, an MDF file, a CAN log or a MATLAB file
    (docs/recordings.md).

    \b
    trackres diagnose day1.mcap day2.mcap --vehicle xgd24d --topics topics.yaml -o report

    Writes report.json, report.html, vehicle.yaml and pictures, and prints the verdict. Effects of the site,
    the weather or the ground go to surroundings.yaml instead; sensor corrections are printed as lines for the topics file.
    The exit code is 0 for any verdict.
    """
    output_folder(output, names=DATA_FILES)  # before hours of work
    for name in DATA_FILES:
        not_an_input(output / name, [*recordings, arguments["vehicle"], arguments["surroundings"]], "output")
    watch(output)
    holdout_value = (
        None if holdout is None else int(holdout) if holdout.isdecimal() else [name.strip() for name in holdout.split(",")]
    )
    with stage_progress() as on_stage:
        result = diagnose(recordings, holdout=holdout_value, on_stage=on_stage, **arguments)
        on_stage("report")
        with print_warnings():
            result.report(output, page=not no_page)
    emit(
        result.as_dict(),
        as_json,
        lambda: f"{result!r}\n{output}: {', '.join(str(path.relative_to(output)) for path in result.written)}",
    )

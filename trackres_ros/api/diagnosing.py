# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnoses recordings: finds the physics that the model lacks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from typing import TYPE_CHECKING

from trackres_ros.api.arguments import (
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
from trackres_ros.api.recordings import read
from trackres_ros.errors import InputError

if TYPE_CHECKING:
    from trackres_ros.diagnosis.base.own import OwnModel
    from trackres_ros.recording.recording import Recording
    from trackres_ros.results.diagnosis import DiagnosisResult

MOST_HELD_OUT = 1_000_000


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
    from trackres_ros import checks
    from trackres_ros.diagnosis import DiagnosisOptions, diagnose
    from trackres_ros.diagnosis.base.loading import load_base
    from trackres_ros.diagnosis.prepare.checks import Refusal, each_usable
    from trackres_ros.diagnosis.prepare.gate import in_order
    from trackres_ros.recording.reading import check_there
    from trackres_ros.recording.recording import Recording, topics_in_use
    from trackres_ros.recording.roles import ROLES, base_role
    from trackres_ros.results.diagnosis import DiagnosisResult

    begun = time.monotonic()
    checks.function(on_stage, "on_stage")
    hidden = as_names(hide, "hide")
    for channel in hidden:
        checks.one_of(base_role(channel), "hide", ROLES)
    checks.seed(seed)
    if isinstance(holdout, Iterable):
        holdout = as_names(holdout, "holdout")
    elif holdout is not None:
        checks.whole(holdout, "holdout", 0, MOST_HELD_OUT)
    if isinstance(effects, str) and not effects:
        raise InputError("effects", "", "a folder with Python files, or None")
    folder = None if effects is None else checks.path(effects, "effects")
    listed = as_recordings(recordings)
    mapping = as_topics(topics)
    if mapping is None:
        mapping = next((r.topics for r in listed if isinstance(r, Recording) and r.topics), None)
    loaded = load_base(vehicle, method, thermal, surroundings)
    for path in (path for r in listed if not isinstance(r, Recording) for path in as_paths(r)):
        check_there(path)
    refused: list[Refusal] = []
    sessions = in_order(each_usable(listed, lambda r: r if isinstance(r, Recording) else read(r, topics=mapping), refused, _name))
    loaded = loaded.with_topics(topics_in_use(sessions))
    options = DiagnosisOptions(hidden, holdout, seed, quick, folder, keep_suspected, on_stage, refused)
    found = diagnose(sessions, loaded, options)
    used = {session.name for session in found.sessions}
    paths = paths_of([session for session in sessions if session.name in used])
    inputs = input_files(mapping, *paths, loaded.source, surroundings)
    return DiagnosisResult(found, loaded, paths, time.monotonic() - begun, inputs)


def _name(recording: StrPath | Recording) -> str:
    return str(recording) if isinstance(recording, str | PathLike) else recording.name

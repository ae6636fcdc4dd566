# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates resistance parameters from coast-downs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from trackres_ros.tasks.arguments import StrPath, TopicsGiven, as_recordings, as_topics, input_files, paths_of

if TYPE_CHECKING:
    from trackres_ros.recording.recording import Recording
    from trackres_ros.tools.coastdown.result import CoastdownResult
    from trackres_ros.vehicle import RoadVehicle, Vehicle


def coastdown(
    recordings: Recording | StrPath | Sequence[Recording | StrPath],
    vehicle: StrPath | Vehicle | RoadVehicle,
    *,
    topics: TopicsGiven | None = None,
    surroundings: StrPath | None = None,
    method: str | None = None,
    thermal: str | None = None,
    seed: int = 1,
) -> CoastdownResult:
    """Estimate parameters of a vehicle file from recorded coast-downs, with 95 % intervals.

    Parameters
    ----------
    recordings
        Recordings with a speed. With a recorded torque, only stretches without torque are used; else all stretches of free
        deceleration.
    vehicle
        A vehicle, the path of its file, or the name of a shipped one; also one with a `road_load` section. Its mass is fixed.
    topics
        As in `read`, where paths are given.
    surroundings
        File of the site, weather and ground during the drives.
    method, thermal
        Methods instead of the vehicle file's.
    seed
        Seed of all random draws.

    Returns
    -------
    CoastdownResult
        With `as_dict`, `plot` and `save_vehicle`.

    Raises
    ------
    InputError
        If there is no coast-down, or another input cannot be used.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> from pathlib import Path
    >>> _ = Path("drive.csv").write_text("time_s,speed_kmh\\n0,0\\n10,36\\n200,36\\n")
    >>> try:
    ...     tr.coastdown("drive.csv", "xgd24d")
    ... except tr.InputError as error:
    ...     print(error.remedy)
    let the vehicle coast down from its maximum speed, in both directions
    """
    from trackres_ros import checks
    from trackres_ros.diagnosis.base.loading import load_base
    from trackres_ros.recording.recording import Recording, topics_in_use
    from trackres_ros.tasks.recordings import read
    from trackres_ros.tools.coastdown.fitted import coastdown as run
    from trackres_ros.tools.coastdown.result import CoastdownResult
    from trackres_ros.tools.coastdown.stretches import in_driving_order

    items = as_recordings(recordings)
    checks.seed(seed)
    mapping = as_topics(topics)
    base = load_base(vehicle, method, thermal, surroundings)
    sessions = in_driving_order([item if isinstance(item, Recording) else read(item, topics=mapping) for item in items])
    base = base.with_topics(topics_in_use(sessions))
    inputs = input_files(mapping, base.source, surroundings)
    return CoastdownResult(run(sessions, base, seed), paths_of(sessions), inputs)

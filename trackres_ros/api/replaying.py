# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Replays a recording through the estimator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

from trackres_ros.api.arguments import StrPath, TopicsGiven, VehicleGiven, as_paths, as_topics, as_vehicle, input_files
from trackres_ros.errors import InputError, one_line

if TYPE_CHECKING:
    from trackres_ros.recording.recording import Recording
    from trackres_ros.results.replay import ReplayResult

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
        Parameters of the estimator (docs/settings.md): a file, flat or as the live node reads it, or a mapping of name to value.
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
    from trackres_ros import checks
    from trackres_ros.estimator import columns as at
    from trackres_ros.estimator.estimator import Estimator
    from trackres_ros.estimator.records import Steps
    from trackres_ros.estimator.settings import settings_for
    from trackres_ros.estimator.snapshot import save, state_file
    from trackres_ros.files.file_sets import file_set
    from trackres_ros.files.output_files import BAG_SUFFIX, no_two_alike, not_an_input, output_file
    from trackres_ros.learning.learner import MODES, OFF, Learner
    from trackres_ros.learning.store import go_on_from, stored, write_learned
    from trackres_ros.node.parameters import make_parameters, read_parameters
    from trackres_ros.offline.replay import replay as run
    from trackres_ros.offline.replay import result_writer, resumed
    from trackres_ros.offline.summary import KeptSource
    from trackres_ros.recording.opening import open_source
    from trackres_ros.recording.recording import Recording
    from trackres_ros.results.replay import ReplayResult
    from trackres_ros.units import NANOSECOND
    from trackres_ros.vehicle import files_of

    if progress is not None:
        checks.function(progress, "progress")
    file = None if output is None else output_file(output)
    before = None if resume is None else checks.path(resume, "resume")
    state = None if save_state is None else state_file(save_state, "save_state")
    in_memory = recording if isinstance(recording, Recording) else None
    paths = in_memory.paths if in_memory else as_paths(recording)
    if in_memory and topics is not None:
        raise InputError("topics", "with a recording that is read", "topics with a path", "pass them to read")
    mapping = in_memory.topics if in_memory else as_topics(topics)
    given = params if isinstance(params, Mapping) else read_parameters(None if params is None else checks.path(params, "params"))
    opened = in_memory or open_source(paths, mapping)
    described, comparison = as_vehicle(vehicle), None
    source = in_memory or KeptSource(opened, keep=file is None or file.suffix.lower() != BAG_SUFFIX)
    if both_sides:
        from trackres_ros.api.both_sides import with_both_sides

        source, comparison = with_both_sides(in_memory or Recording.from_source(opened), described)
    settings = settings_for(make_parameters(given).settings(), opened.topics, source.roles)
    learned_file = None if save_vehicle is None else output_file(save_vehicle, (".yaml",), "save_vehicle")
    inputs = input_files(mapping, *paths, *files_of(described), params)
    not_an_input(state, inputs, "save_state")  # it may replace the state to resume
    for where, place in (("output", file), ("save_vehicle", learned_file)):
        not_an_input(place, [*inputs, before], where)
    no_two_alike({"output": file, "save_state": state, "save_vehicle": learned_file})
    learns = checks.one_of(learning, "learning", MODES) != OFF
    if learned_file is not None and not learns:
        raise InputError("save_vehicle", str(save_vehicle), "only with learning watch or on")
    kept: list[Steps] = []
    with ExitStack() as stack:
        stack.enter_context(file_set())
        estimator = Estimator(described, settings)
        learner = Learner(estimator, learning) if learns else None
        session = learned_before = off_s = None
        if before is not None:
            session, off_s, learned_before, unlearned_s = resumed(source, estimator, before)
            go_on_from(before, session, learner, learned_before, unlearned_s)
        write = kept.append if file is None else stack.enter_context(result_writer(file, estimator, learner))
        done = run(source, estimator, write if comparison is None else comparison.writer(write), session, progress, learner)
        done = done if comparison is None else replace(done, comparison=comparison.as_dict())
        written = [one for one in (file, state) if one is not None]
        if state is not None:
            saved_at = int(done.session.memory.times[at.SPEED, at.Times.last_arrival]) * NANOSECOND
            save(done.session, state, saved_at, learned_before if learner is None else stored(learner))
        if learned_file is not None and learner is not None:
            saved = write_learned(learner, estimator.vehicle, learned_file)
            done = replace(done, learned_file=saved)
            written += saved.written
    title = one_line(f"{', '.join(path.name for path in paths) or source.name}: {estimator.vehicle.title}")
    findings = source.all_findings() if isinstance(source, KeptSource) else source.findings
    findings = tuple(replace(one, first_time_s=one.first_time_s - done.late_s) for one in findings)
    rows = kept if file is None else None
    notes = source.notes if off_s is None else (*source.notes, AFTER_TIME_OFF.format(off_s))
    result = ReplayResult(done, rows, title, source.name, notes, findings, file, [*inputs, before])
    result.written = tuple(written)
    return result

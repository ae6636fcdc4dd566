# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Prepares recordings for a vehicle: the gate, then clock, sign and unit of the torque against the vehicle file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.prepare.gate import Gated, gate
from trackres_ros.diagnosis.prepare.on_route import on_route
from trackres_ros.diagnosis.prepare.refuse import Refusal
from trackres_ros.diagnosis.prepare.session import Array, DriveSession
from trackres_ros.diagnosis.prepare.torque_checks import aligned_clock, check_torque, faulty_torques, inconsistent_scale_notes
from trackres_ros.recording.recording import Recording


def prepared(
    recordings: Sequence[Recording], vehicle: LoadedBase, hide: Sequence[str] = (), refused: Sequence[Refusal] = ()
) -> tuple[Gated, tuple[Array, ...], tuple[DriveSession, ...]]:
    """Sessions that passed the gate and the torque checks, their torque from the vehicle file [Nm], and the same sessions
    without values from a route.

    If only some recordings have a plainly wrong torque, these are dropped. The gate then runs again on the rest,
    because a recording also sets the belt temperature at the start of the next one.

    Raises
    ------
    InputError
        If no recording can be used, or all have a wrong torque.
    """

    def by_file(sessions: Sequence[DriveSession]) -> list[Array]:
        values = {q.name: q.nominal for q in vehicle.base.parameters}
        return [p.torque for p in vehicle.base.predict(sessions, values, ())]

    refused = list(refused)
    while True:
        passed = gate(recordings, vehicle.known, hide, refused)
        gated = on_route(passed, vehicle.route)
        expected = by_file(gated.sessions)
        moved = [aligned_clock(s, e) for s, e in zip(gated.sessions, expected, strict=True)]
        sessions = tuple(s for s, _ in moved)
        resisting = by_file([replace(s, accel=np.zeros(len(s))) for s in sessions])
        faulty = faulty_torques(sessions, expected, resisting, vehicle.known)
        if not faulty:
            break
        refused += faulty
    check_torque(sessions, expected, resisting, vehicle.known)
    notes = (*gated.notes, *(note for _, note in moved if note), *inconsistent_scale_notes(sessions, expected))
    return replace(gated, sessions=sessions, notes=notes), tuple(expected), passed.sessions

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Prepares recordings for a vehicle: the gate, then clock, sign and unit of the torque by what the vehicle file expects."""

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
    """What passed the gate and the checks of the torque, the torque that the vehicle file expects of it [Nm], and the sessions as
    recorded, without what a route says of their places.

    A recording whose torque is plainly wrong where that of others is not is left out. The gate then looks at the rest anew, as
    a recording also says how warm the next one begins.

    Raises
    ------
    InputError
        If no recording can be used, or the torque of all of them is wrong.
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

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings come in; sessions with numbered laps go out, split into fitted and hold-out laps, with the candidate effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.instrument import usual_offset
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.prepare.at_rest import seconds_without_torque
from trackres_ros.diagnosis.prepare.gate import Gated
from trackres_ros.diagnosis.prepare.session import DriveSession, Split
from trackres_ros.diagnosis.prepare.split import split
from trackres_ros.diagnosis.stages.options import DiagnosisOptions
from trackres_ros.diagnosis.stages.prepared import prepared
from trackres_ros.effects import catalogue
from trackres_ros.effects.effect import Effect
from trackres_ros.effects.sensor.torque_offset import TorqueOffset
from trackres_ros.effects.vehicle.rotating_inertia import RotatingInertia
from trackres_ros.recording.recording import Recording
from trackres_ros.text.numbers import figures

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PreparedSessions:
    """Sessions to diagnose, with their base and candidate effects.

    Attributes
    ----------
    gated, split
        Sessions that passed the gate, and the hold-out laps.
    nominal
        Torque of each session with the values of the vehicle file [Nm].
    recorded
        The sessions without values from a route.
    effects
        Candidate effects.
    """

    vehicle: LoadedBase
    gated: Gated
    split: Split
    nominal: tuple[Array, ...]
    recorded: tuple[DriveSession, ...]
    effects: Mapping[str, Effect]

    @property
    def base(self) -> Base:
        """The model of the vehicle."""
        return self.vehicle.base

    @property
    def sessions(self) -> tuple[DriveSession, ...]:
        """The sessions that passed the gate."""
        return self.gated.sessions


def prepare(recordings: Sequence[Recording], vehicle: LoadedBase, options: DiagnosisOptions) -> PreparedSessions:
    """Check, clean and split recordings."""
    base, facts = vehicle.base, vehicle.base.facts
    options.on_stage("checks: units, clocks, gaps")
    gated, nominal, recorded = prepared(recordings, vehicle, options.hide, options.unread)
    known = catalogue(options.effects_dir, facts.weight * facts.radius, on_tyres=not base.has_belt)
    effects = {
        name: effect.beside(base.rotating_mass_factor) if isinstance(effect, RotatingInertia) else effect
        for name, effect in known.items()
        if effect.only_of in ("", "rolls" if base.rolls else "slides")
    }
    gated, effects = without_an_offset(gated, base, effects)
    return PreparedSessions(vehicle, gated, split(gated.sessions, options.holdout), nominal, recorded, effects)


def without_an_offset(gated: Gated, base: Base, effects: Mapping[str, Effect]) -> tuple[Gated, dict[str, Effect]]:
    """Remove a sensor offset from the candidate effects if the torque sensor reads zero at rest for long; with a note."""
    none = usual_offset(base)
    seconds = seconds_without_torque(gated.sessions, none)
    if not seconds or TorqueOffset.name not in effects:
        return gated, dict(effects)
    note = f"the torque is 0 Nm at rest, within {figures(none)} Nm over {seconds:.0f} s: the sensor has no offset"
    return replace(gated, notes=(*gated.notes, note)), {n: e for n, e in effects.items() if n != TorqueOffset.name}

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole diagnosis: prepare, refit, search, judge, conclude. The result of each stage is frozen and can be looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.empirical.routes import Route
from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.findings.change_points import Change, changes
from trackres_ros.diagnosis.findings.locate import ThermalCheck, thermal_check
from trackres_ros.diagnosis.findings.next_drives import Advice
from trackres_ros.diagnosis.findings.residual_bins import RegimeMap, cumulative_periodogram
from trackres_ros.diagnosis.findings.spread import Spread
from trackres_ros.diagnosis.findings.verdict import NamedEffect, Told, Verdict
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.levels import for_tests
from trackres_ros.diagnosis.inference.noise import Noise
from trackres_ros.diagnosis.prepare.gate import Gated
from trackres_ros.diagnosis.prepare.order import in_order
from trackres_ros.diagnosis.prepare.session import DriveSession, Split
from trackres_ros.diagnosis.selection.confirm import Graded
from trackres_ros.diagnosis.selection.held_out import HeldOut, Improvement
from trackres_ros.diagnosis.selection.naming import Step
from trackres_ros.diagnosis.stages.conclude import conclude
from trackres_ros.diagnosis.stages.judge import bounds_of, judge
from trackres_ros.diagnosis.stages.options import BY_DEFAULT, DiagnosisOptions
from trackres_ros.diagnosis.stages.prepare import prepare
from trackres_ros.diagnosis.stages.refit import refit
from trackres_ros.diagnosis.stages.search import search
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.vehicle.writing.changes import FileChanges, Interval

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All that was found.

    Attributes
    ----------
    base, gated, split
        The base model, what passed the gate, and what was held out.
    nominal
        Torque of each session with the values of the vehicle file [Nm].
    refitted, final
        The base re-fitted, and with the effects found; values as by `levels.with_levels`.
    at_base, at_end
        Residual by regime of both.
    changes
        When the residual of the re-fitted base changes its level; None where that could not be looked for.
    periodogram_p
        Probability that the last whitened residual is white.
    thermal
        Measured against simulated belt temperature, with the base re-fitted; None where none was measured.
    alone, steps, found, refuted
        The round beside the base alone; of each term the round beside the others, last the one beside all of them; the effects
        found; and those that fit best and that laps left out do not confirm.
    shares
        Probability of each name, and of none of them.
    described, wanders, tracked
        Terms without a name that were found; how what is left wanders, where it does so by more than it should; and what held-out
        laps say of following that live.
    spread
        Where the torque shakes more than elsewhere; None where it does not.
    routes
        What goes by place, named or without a name: a slope, a torque, or a torque beside a slope.
    base_intervals
        Of the base's parameters in `final`.
    held_out, advice, verdict
        What it is worth, what to drive next, and what it comes to.
    kept
        What of it may be written.
    """

    base: Base
    gated: Gated
    split: Split
    nominal: tuple[Array, ...]
    refitted: Fit
    final: Fit
    at_base: RegimeMap
    at_end: RegimeMap
    changes: list[Change] | None
    periodogram_p: float
    thermal: ThermalCheck | None
    alone: Step
    steps: tuple[Step, ...]
    found: tuple[NamedEffect, ...]
    described: tuple[Told, ...]
    wanders: Described | None
    tracked: Improvement | None
    spread: Spread | None
    routes: tuple[Route, ...]
    refuted: tuple[Graded, ...]
    base_intervals: dict[str, Interval]
    held_out: HeldOut
    advice: tuple[Advice, ...]
    verdict: Verdict
    kept: FileChanges
    shares: Mapping[str, float]

    @property
    def noise(self) -> Noise:
        """What whitens the residual of the last fit as far as it goes."""
        return for_tests(self.final).noise

    @property
    def modelled(self) -> tuple[str, ...]:
        """Names of all that the last fit has and the re-fitted base has not."""
        return self.final.effect_names

    @property
    def sessions(self) -> tuple[DriveSession, ...]:
        """The recordings."""
        return self.final.problem.sessions


def read_recordings(paths: Sequence[Path], topics: Topics | None) -> list[Recording]:
    """Read recordings, each one session, in their order."""
    return in_order([Recording.from_source(open_source([path], topics)) for path in paths])


def diagnose(recordings: Sequence[Recording], vehicle: LoadedBase, options: DiagnosisOptions = BY_DEFAULT) -> Diagnosis:
    """Find where recordings differ from a base model, the missing effects, and the error of the improved model.

    Parameters
    ----------
    vehicle
        See `loading.load_base`.

    Raises
    ------
    InputError
        If the recordings cannot be used; says why.
    """
    rng = np.random.default_rng(options.seed)
    prepared = prepare(recordings, vehicle, options)
    base = refit(prepared, options, rng)
    chosen = search(prepared, base, options, rng)
    judged = judge(prepared, base, chosen, options, rng)
    concluded = conclude(prepared, base, chosen, judged, options)
    return Diagnosis(
        base=prepared.base,
        gated=prepared.gated,
        split=prepared.split,
        nominal=prepared.nominal,
        refitted=base.refitted,
        final=chosen.final,
        at_base=base.at_base,
        at_end=judged.at_end,
        changes=changes(for_tests(base.refitted)),
        periodogram_p=cumulative_periodogram(judged.tested_end),
        thermal=thermal_check(base.refitted),
        alone=chosen.alone,
        steps=(*chosen.steps.values(), chosen.last),
        found=judged.found,
        described=judged.terms,
        wanders=judged.wanders,
        tracked=judged.tracked,
        spread=judged.spread,
        routes=chosen.routes,
        refuted=chosen.refuted,
        base_intervals=bounds_of("", judged.bounds),
        held_out=judged.worth,
        advice=concluded.advice,
        verdict=judged.verdict,
        kept=concluded.kept,
        shares=chosen.shares,
    )

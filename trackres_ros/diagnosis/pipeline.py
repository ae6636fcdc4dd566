# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole diagnosis: prepare, refit, search, judge, conclude. Each stage returns a frozen result."""

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
from trackres_ros.diagnosis.findings.found import NamedEffect, UnnamedTerm
from trackres_ros.diagnosis.findings.locate import ThermalCheck, thermal_check
from trackres_ros.diagnosis.findings.next_drives import Advice
from trackres_ros.diagnosis.findings.residual_bins import RegimeMap, cumulative_periodogram
from trackres_ros.diagnosis.findings.spread import Spread
from trackres_ros.diagnosis.findings.verdict import Verdict
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
    """Result of a diagnosis.

    Attributes
    ----------
    base, gated, split
        The base model, the sessions that passed the gate, and the split into fitted and hold-out laps.
    nominal
        Torque of each session with the values of the vehicle file [Nm].
    refitted, final
        The re-fitted base, without and with the effects found; values from `levels.with_levels`.
    at_base, at_end
        Their residual by regime.
    changes
        Level changes in the residual of the re-fitted base; None where the search could not run.
    periodogram_p
        Probability that the final whitened residual is white.
    thermal
        Measured against simulated belt temperature, from the re-fitted base; None without a measured one.
    alone, steps, found, refuted
        The search round from the base alone; one round per term from the other terms, and a last one from all of them; the
        confirmed terms; and the best-fitting terms that cross-validation does not confirm.
    shares
        Probability of each name, and of no name.
    described, wanders, tracked
        Unnamed terms; the slow residual, where it is larger than expected; and the hold-out result of following
        it live.
    spread
        Conditions with a larger scatter of the torque; None if there are none.
    routes
        Terms by place, named or unnamed: a slope, a torque, or a torque in addition to a slope.
    base_intervals
        Intervals of the base's parameters in `final`.
    held_out, advice, verdict
        Hold-out errors, next drives, and the verdict.
    kept
        Changes that may be written.
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
    described: tuple[UnnamedTerm, ...]
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
        """Noise model that best whitens the residual of the last fit."""
        return for_tests(self.final).noise

    @property
    def modelled(self) -> tuple[str, ...]:
        """Names of the terms that the last fit adds to the re-fitted base."""
        return self.final.effect_names

    @property
    def sessions(self) -> tuple[DriveSession, ...]:
        """The recordings."""
        return self.final.problem.sessions


def read_recordings(paths: Sequence[Path], topics: Topics | None) -> list[Recording]:
    """Read recordings in the given order, one session each."""
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
        If the recordings cannot be used, with the reason.
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

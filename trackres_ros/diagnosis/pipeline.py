# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole diagnosis: prepare, refit, search, judge, conclude. Each stage returns a frozen result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from trackres_ros.diagnosis.base.base import Base
from trackres_ros.diagnosis.base.loading import LoadedBase
from trackres_ros.diagnosis.empirical.routes import Route
from trackres_ros.diagnosis.findings.change_points import Change, changes
from trackres_ros.diagnosis.findings.locate import ThermalCheck, thermal_check
from trackres_ros.diagnosis.findings.next_drives import Advice
from trackres_ros.diagnosis.findings.residual_bins import RegimeMap, cumulative_periodogram
from trackres_ros.diagnosis.inference.blas_threads import one_blas_thread
from trackres_ros.diagnosis.inference.failures import failures
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.inference.levels import for_tests
from trackres_ros.diagnosis.inference.noise import Noise
from trackres_ros.diagnosis.prepare.gate import Gated, in_order
from trackres_ros.diagnosis.prepare.session import Array, DriveSession, Split
from trackres_ros.diagnosis.selection.grade import Graded
from trackres_ros.diagnosis.selection.steps import Step
from trackres_ros.diagnosis.stages.conclude import conclude
from trackres_ros.diagnosis.stages.judge import Judgement, bounds_of, judge
from trackres_ros.diagnosis.stages.options import BY_DEFAULT, DiagnosisOptions
from trackres_ros.diagnosis.stages.prepare import prepare
from trackres_ros.diagnosis.stages.refit import refit, search
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.opening import open_source
from trackres_ros.recording.recording import Recording
from trackres_ros.vehicle.writing.changes import FileChanges, Interval


@dataclass(frozen=True, eq=False)
class Diagnosis(Judgement):
    """Result of a diagnosis.

    Attributes
    ----------
    base, gated, split
        The base model, the sessions that passed the gate, and the split into fitted and hold-out laps.
    nominal
        Torque of each session with the values of the vehicle file [Nm].
    refitted, at_base
        The re-fitted base, with values from `levels.with_levels`, and its residual by regime.
    final, shares
        The same with the effects found; and the probability of each name, and of no name.
    alone, steps, unconfirmed
        The search round from the base alone; one round per term from the other terms, and a last one from all of them; and the
        best-fitting terms that cross-validation does not confirm.
    routes
        Terms by place, named or unnamed: a slope, a torque, or a torque in addition to a slope.
    advice, kept
        Next drives, and changes that may be written.
    """

    base: Base
    gated: Gated
    split: Split
    nominal: tuple[Array, ...]
    refitted: Fit
    at_base: RegimeMap
    final: Fit
    shares: Mapping[str, float]
    alone: Step
    steps: tuple[Step, ...]
    unconfirmed: tuple[Graded, ...]
    routes: tuple[Route, ...]
    advice: tuple[Advice, ...]
    kept: FileChanges

    @cached_property
    def changes(self) -> list[Change]:
        """Level changes in the residual of the re-fitted base."""
        return changes(for_tests(self.refitted))

    @cached_property
    def periodogram_p(self) -> float:
        """Probability that the final whitened residual is white."""
        return cumulative_periodogram(self.tested_end)

    @cached_property
    def thermal(self) -> ThermalCheck | None:
        """Measured against simulated belt temperature, from the re-fitted base; None without a measured one."""
        return thermal_check(self.refitted)

    @property
    def base_intervals(self) -> dict[str, Interval]:
        """Intervals of the base's parameters in `final`."""
        return bounds_of("", self.bounds)

    @property
    def noise(self) -> Noise:
        """Noise model that best whitens the residual of the last fit."""
        return self.tested_end.noise

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
    sources = [open_source([path], topics) for path in paths]
    return in_order([replace(Recording.from_source(source), bindings=source.bindings) for source in sources])


@one_blas_thread()
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
    with failures() as failed:
        base = refit(prepared, options, rng)
        chosen = search(prepared, base, options)
        judged = judge(prepared, base, chosen, options, rng)
        advice, kept = conclude(prepared, base, chosen, judged, options)
    return Diagnosis(
        **vars(judged),
        base=prepared.base,
        gated=replace(prepared.gated, notes=(*prepared.gated.notes, *failed)),
        split=prepared.split,
        nominal=prepared.nominal,
        refitted=base.refitted,
        at_base=base.at_base,
        final=chosen.final,
        shares=chosen.shares,
        alone=chosen.alone,
        steps=(*chosen.steps.values(), chosen.last),
        unconfirmed=chosen.unconfirmed,
        routes=chosen.routes,
        advice=advice,
        kept=kept,
    )

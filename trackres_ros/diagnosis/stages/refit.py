# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sessions come in; the re-fitted base and the laps for comparing all further models go out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trackres_ros.diagnosis.empirical.routes import roads_of
from trackres_ros.diagnosis.findings.residual_bins import RegimeMap, regime_map
from trackres_ros.diagnosis.inference.fitting import Fit, Problem, fit
from trackres_ros.diagnosis.inference.levels import for_tests, with_levels
from trackres_ros.diagnosis.search.choice import Choice, Chosen
from trackres_ros.diagnosis.search.cross_validation import CrossValidation
from trackres_ros.diagnosis.search.explanations import Search
from trackres_ros.diagnosis.selection.as_used import AsUsed, inside_ranges
from trackres_ros.diagnosis.selection.held_out import HeldOutLaps
from trackres_ros.diagnosis.stages.options import DiagnosisOptions
from trackres_ros.diagnosis.stages.prepare import PreparedSessions
from trackres_ros.route.learned import SLOPE, TORQUE, of_kind


@dataclass(frozen=True, eq=False)
class Refitted:
    """The base re-fitted."""

    refitted: Fit  # with values by `levels.with_levels`
    compared: Fit  # what terms are added to: the same, or one with values further outside the file's ranges, if surely better
    laps: HeldOutLaps
    validation: CrossValidation  # over laps
    use: AsUsed  # evaluation of a file in use
    at_base: RegimeMap  # residual by regime


def refit(prepared: PreparedSessions, options: DiagnosisOptions, rng: np.random.Generator) -> Refitted:
    """Fit the base from the values of the vehicle file, and bin its residual by regime."""
    options.on_stage("re-fit of the base")
    sessions, split = prepared.sessions, prepared.split
    tested = fit(Problem(prepared.base, sessions, tuple(split.training_mask(s) for s in sessions)))
    held_out = [split.held_out_mask(s) for s in sessions]
    laps = HeldOutLaps(sessions, held_out, rng)
    use = AsUsed(prepared.base, sessions, prepared.recorded, laps)
    anywhere = with_levels(tested)
    refitted = inside_ranges(anywhere, use)
    validation = CrossValidation(refitted, held_out, rng)
    # A file that cannot describe the vehicle within its ranges would leave its error to the terms.
    better = validation.least_gain(validation.score(refitted), validation.score(anywhere)) > 0.0
    options.on_stage("residual by regime")
    at_base = regime_map(for_tests(refitted), rng)
    return Refitted(refitted, anywhere if better else refitted, laps, validation, use, at_base)


def search(prepared: PreparedSessions, base: Refitted, options: DiagnosisOptions) -> Chosen:
    """Search explanations, and choose one."""
    kinds = [kind for kind in (SLOPE, TORQUE) if of_kind(prepared.vehicle.route, kind) is None]
    roads = roads_of(prepared.sessions) if kinds else None
    found = Search(base.compared, prepared.effects, roads, kinds, base.validation, options.on_stage)
    found.run()
    options.on_stage("cross-validation over laps")
    chosen = Choice(found, base.refitted, base.laps, base.use).best(options.keep_suspected)
    if chosen.explanation.key:
        return chosen
    return replace(chosen, explanation=replace(chosen.explanation, fit=base.refitted))

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sessions come in; the re-fitted base and the laps for comparing all further models go out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trackres_ros.diagnosis.findings.residual_bins import RegimeMap, regime_map
from trackres_ros.diagnosis.inference.fitting import Fit, Problem, fit
from trackres_ros.diagnosis.inference.levels import for_tests, with_levels
from trackres_ros.diagnosis.search.left_out import LeaveLapsOut
from trackres_ros.diagnosis.selection.as_used import AsUsed, inside_ranges
from trackres_ros.diagnosis.selection.held_out import HeldOutLaps
from trackres_ros.diagnosis.stages.options import DiagnosisOptions
from trackres_ros.diagnosis.stages.prepare import PreparedSessions


@dataclass(frozen=True, eq=False)
class Refitted:
    """The base re-fitted.

    Attributes
    ----------
    tested, refitted
        Fits with the noise that best whitens the residual, and with values by `levels.with_levels`.
    laps, left_out, use
        The hold-out laps, the cross-validation over laps, and the evaluation of a file in use.
    at_base
        Residual by regime.
    """

    tested: Fit
    refitted: Fit
    laps: HeldOutLaps
    left_out: LeaveLapsOut
    use: AsUsed
    at_base: RegimeMap


def refit(prepared: PreparedSessions, options: DiagnosisOptions, rng: np.random.Generator) -> Refitted:
    """Fit the base, and bin its residual by regime."""
    options.on_stage("re-fit of the base")
    sessions, split = prepared.sessions, prepared.split
    tested = fit(Problem(prepared.base, sessions, tuple(split.training_mask(s) for s in sessions)))
    held_out = [split.held_out_mask(s) for s in sessions]
    laps = HeldOutLaps(sessions, held_out, rng)
    use = AsUsed(prepared.base, sessions, prepared.recorded, laps)
    refitted = inside_ranges(with_levels(tested), use)
    options.on_stage("residual by regime")
    return Refitted(tested, refitted, laps, LeaveLapsOut(refitted, held_out, rng), use, regime_map(for_tests(refitted), rng))

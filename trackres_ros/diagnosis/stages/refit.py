# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sessions come in; the base re-fitted to them goes out, and the laps on which all further models are compared with it."""

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
        With the noise that whitens what is left as far as it goes; and with values by which levels count.
    laps, left_out, use
        The held-out laps, all laps left out in turn, and what a file is worth as it is used.
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
    """Fit the base, and see where recordings part from it."""
    options.on_stage("re-fit of the base")
    sessions, split = prepared.sessions, prepared.split
    tested = fit(Problem(prepared.base, sessions, tuple(split.training_mask(s) for s in sessions)))
    held_out = [split.held_out_mask(s) for s in sessions]
    laps = HeldOutLaps(sessions, held_out, rng)
    use = AsUsed(prepared.base, sessions, prepared.recorded, laps)
    refitted = inside_ranges(with_levels(tested), use)
    options.on_stage("residual by regime")
    return Refitted(tested, refitted, laps, LeaveLapsOut(refitted, held_out, rng), use, regime_map(for_tests(refitted), rng))

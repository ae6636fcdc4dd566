# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The re-fitted base comes in; the best cross-validated explanation of its residual goes out, or none."""

from __future__ import annotations

import numpy as np

from trackres_ros.diagnosis.empirical.routes import roads_of
from trackres_ros.diagnosis.search.choice import Choice, Chosen
from trackres_ros.diagnosis.search.explanations import Search
from trackres_ros.diagnosis.selection.screening import QUICK_REPLICATES, REPLICATES
from trackres_ros.diagnosis.stages.options import DiagnosisOptions
from trackres_ros.diagnosis.stages.prepare import PreparedSessions
from trackres_ros.diagnosis.stages.refit import Refitted
from trackres_ros.route.learned import SLOPE, TORQUE, of_kind


def search(prepared: PreparedSessions, base: Refitted, options: DiagnosisOptions, rng: np.random.Generator) -> Chosen:
    """Search explanations, and choose one."""
    kinds = [kind for kind in (SLOPE, TORQUE) if of_kind(prepared.vehicle.route, kind) is None]
    roads = roads_of(prepared.sessions) if kinds else None
    replicates = QUICK_REPLICATES if options.quick else REPLICATES
    found = Search(base.tested, prepared.effects, roads, kinds, replicates, rng, options.on_stage)
    found.run()
    options.on_stage("cross-validation over laps")
    return Choice(found, base.refitted, base.left_out, base.laps, base.use).best(options.keep_suspected)

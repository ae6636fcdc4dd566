# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates the error of an effect's functional form, which may differ from the catalogue's."""

from __future__ import annotations

import numpy as np

from trackres_ros.diagnosis.base.variables import BY_NAME
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.prepare.session import Array

FORM_ERROR = 0.1  # of an effect's torque: standard deviation of its functional error
FOLLOWED = ("speed", "acceleration", "load", "belt temperature", "time since start")


def other_forms(fit: Fit) -> Array:
    """Changes of the effects of a fit for functional errors of `FORM_ERROR`.

    Each effect is scaled up for large values of a variable and down for small ones: for the variables of `FOLLOWED`, for
    the direction, and for its own size. The result has the shape (n, columns), for all segments concatenated.
    """
    masks, driven = fit.problem.masks, list(zip(fit.problem.sessions, fit.predicted, strict=True))
    found = []
    for active in fit.effects:
        adds = fit.contribution(active.effect.name)
        largest = max((float(np.abs(x[m]).max()) for x, m in zip(adds, masks, strict=True) if m.any()), default=0.0)
        if not largest > 0.0:
            continue
        shapes = [[BY_NAME[name].of(s, p) for s, p in driven] for name in FOLLOWED]
        shapes += [[turn(s.heading) for s, _ in driven] for turn in (np.cos, np.sin)]
        shapes += [[np.abs(x) / largest for x in adds]]
        for shape in shapes:
            over = np.concatenate([z[m] for z, m in zip(shape, masks, strict=True)])
            spread = float(over.std()) if np.isfinite(over).all() else 0.0
            if spread > 0.0:
                mean = float(over.mean())
                changes = [FORM_ERROR * x * (z - mean) / spread for x, z in zip(adds, shape, strict=True)]
                found.append(np.concatenate(fit.problem.of_torque(changes)))
    return np.column_stack(found) if found else np.empty((sum(len(g.measured) for g in fit.problem.segments), 0))

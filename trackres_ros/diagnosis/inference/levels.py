# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Values that respect levels: a fit under noise that is not a random walk.

Tests use the best whitening. On a road its autoregression comes near a unit root, and the whitened residual is nearly the
difference between seconds. Then a small misfit of the acceleration dominates, and a constant of hundreds of Nm hardly
matters. Asymmetric innovations shift the level further, because the whitening magnifies their mean. For predictive
values, the roots of the autoregression are bounded further inside; docs/diagnosis.md lists the trials.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from trackres_ros.diagnosis.inference.fitting import Fit, fit
from trackres_ros.diagnosis.inference.noise import SHORT_ROOT


def with_levels(found: Fit, without: Collection[str] = (), fixed: Mapping[tuple[str, str], float] | None = None) -> Fit:
    """The same model, `without` some effects and with parameters `fixed` at a value, with predictive values."""
    effects = [a.effect for a in found.effects if a.effect.name not in without]
    return fit(found.problem, effects, found.at, fixed=fixed, largest_root=SHORT_ROOT)


def for_tests(found: Fit) -> Fit:
    """The same values, with the noise that best whitens their residuals."""
    return replace(found, noises=found.problem.noises(found.residuals))

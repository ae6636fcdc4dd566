# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Values by which levels count: a fit under noise that is not taken for a random walk.

Tests whiten the residual as far as it goes. On a road its autoregression then comes near a unit root, and what is left is
differences from one second to the next: a small misfit of the acceleration decides, and a constant of hundreds of Nm counts
for next to nothing. Innovations that are not symmetric shift the level further, as the whitening magnifies their mean. For
values that predict, the roots of the autoregression are held further inside; docs/diagnosis.md has what was tried.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from trackres_ros.diagnosis.inference.fitting import Fit, fit

LARGEST_ROOT = 0.7


def with_levels(found: Fit, without: Collection[str] = (), fixed: Mapping[tuple[str, str], float] | None = None) -> Fit:
    """The same model, `without` some of its effects and with parameters `fixed` at a value, with values that predict."""
    effects = [a.effect for a in found.effects if a.effect.name not in without]
    return fit(found.problem, effects, found.at, fixed=fixed, largest_root=LARGEST_ROOT)


def for_tests(found: Fit) -> Fit:
    """The same values, with the noise that whitens their residuals as far as it goes."""
    return replace(found, noises=found.problem.noises(found.residuals))

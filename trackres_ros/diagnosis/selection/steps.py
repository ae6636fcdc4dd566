# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One round of the search, with its chosen term, that term's class, and its rivals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.selection.candidate import Candidate
from trackres_ros.diagnosis.selection.grade import Graded
from trackres_ros.diagnosis.selection.visibility import Separability


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the search: the candidates that were added to a fit."""

    before: Fit  # the initial fit
    separability: Separability
    candidates: tuple[Candidate, ...]  # the fitted ones, the best level score first
    cost: float = 0.0  # logarithm of the number of terms that they were chosen from
    chosen: Candidate | None = None
    members: tuple[str, ...] = ()  # the chosen one, and the names that it does not surely beat
    weights: Mapping[str, float] = field(default_factory=dict)  # probability of each
    stability: float = 0.0  # share of resampled laps won by the class
    worse: tuple[str, ...] = ()  # effects that predict the laps left out significantly worse
    graded: Mapping[str, Graded] = field(default_factory=dict)  # of the candidates that laps left out in turn have judged

    @property
    def hint(self) -> str:
        """The best name that gains more than the best of as many would by chance; empty without one, or if one was chosen."""
        if self.chosen is not None:
            return ""
        beyond = [c for c in self.candidates if c.is_name and c.matters and c.level > self.cost]
        return max(beyond, key=lambda c: c.level).name if beyond else ""

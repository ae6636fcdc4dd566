# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What was said of a case, by the diagnosis or by a simpler method, in one form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

SURE = ("named", "one_of")
BASELINES = {
    "naive": "regression of the residual on one effect",
    "aic": "AIC, not whitened",
    "sparse": "lasso on the residual",
    "trees": "boosted trees",
}


@dataclass(frozen=True)
class Answer:
    """A status as in the verdict, and the classes of effects that it stands by, one for each that it says is missing."""

    status: str
    classes: tuple[tuple[str, ...], ...]

    @property
    def first(self) -> str:
        """The name given first; without any the status."""
        return self.classes[0][0] if self.classes else self.status

    def holds(self, true: set[str]) -> int:
        """How many classes have a true effect in them."""
        return sum(bool(true & set(members)) for members in self.classes)


def of_report(report: dict[str, Any]) -> Answer:
    """What a report stands by: the name it gives first stands first in each class."""
    status = str(report["verdict"]["status"])
    if status not in SURE:
        return Answer(status, ())
    return Answer(status, tuple((e["name"], *(m for m in e["class"] if m != e["name"])) for e in report["effects"]))


def of_names(names: Sequence[str]) -> Answer:
    """What a method says that only gives names."""
    return Answer("named" if names else "none", tuple((name,) for name in names))

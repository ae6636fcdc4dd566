# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Puts the answers to a case, of the diagnosis or of a simpler method, into one form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from trackres_ros.diagnosis.empirical.term import FOLLOWED

SURE = ("named", "one_of")
DESCRIBED, CONFIRMED = "described", "confirmed"
ABOUT = ("variable", "gate", "memory")
EARLIER = "earlier"
BASELINES = {
    "naive": "regression of the residual on one effect",
    "aic": "AIC, not whitened",
    "sparse": "lasso on the residual",
    "trees": "boosted trees",
    EARLIER: "an earlier version of this tool",
}


@dataclass(frozen=True)
class Description:
    """A term with a form and no name: the form, and the words for its variable, its gate and its memory."""

    form: str
    about: str


@dataclass(frozen=True)
class Answer:
    """A status as in the verdict; the classes of named effects, one for each missing effect; the described terms
    without a name; and the confirmed classes.
    """

    status: str
    classes: tuple[tuple[str, ...], ...]
    described: tuple[Description, ...] = ()
    confirmed: tuple[tuple[str, ...], ...] = ()

    @property
    def first(self) -> str:
        """The name given first; without any the status."""
        return self.classes[0][0] if self.classes else self.status

    def holds(self, true: set[str]) -> int:
        """How many classes have a true effect in them."""
        return sum(bool(true & set(members)) for members in self.classes)

    def surely_wrong(self, allowed: set[str]) -> bool:
        """Whether a name is confirmed that is neither allowed nor in a class with an allowed one."""
        return any(not allowed & set(members) for members in self.confirmed)


def of_report(report: dict[str, Any]) -> Answer:
    """The answer of a report, with its first name at the head of each class."""
    status = str(report["verdict"]["status"])
    described = tuple(
        Description(str(term["form"]), " ".join(filter(None, (words(term.get(key)) for key in ABOUT))))
        for term in report.get("described", ())
    )
    if status not in SURE:
        return Answer(status, (), described)
    overall = report["verdict"].get("grade", CONFIRMED)
    classes = [(e["name"], *(m for m in e["class"] if m != e["name"])) for e in report["effects"]]
    sure = [c for c, e in zip(classes, report["effects"], strict=True) if e.get("grade", overall) == CONFIRMED]
    return Answer(status, tuple(classes), described, tuple(sure))


def words(value: Any) -> str:
    """The words in a part of a report; for a mapping the keys with a content, and the content."""
    if isinstance(value, dict):
        return " ".join(f"{key} {words(held)}" for key, held in value.items() if held not in (None, False))
    if isinstance(value, list):
        return " ".join(words(one) for one in value)
    return value.lower() if isinstance(value, str) else ""


def error_left(report: dict[str, Any]) -> float:
    """Mean absolute error on hold-out laps with all terms of the fit, or following a drift that is not refuted [Nm].

    The `heldout` of a term of the fit is of all laps, each held out in turn, so it does not compare with that of the base.
    """
    drifts = [term for term in report.get("described", ()) if term["form"] in FOLLOWED and term["grade"] != "refuted"]
    return float(drifts[-1]["heldout"]["mae"][1] if drifts else report["heldout"]["mae"]["with_effects"])


def of_names(names: Sequence[str]) -> Answer:
    """The answer of a method that only gives names."""
    classes = tuple((name,) for name in names)
    return Answer("named" if names else "none", classes, (), classes)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sentences on a machine that is no vehicle: without the words of vehicles, and without parts that only these have."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.findings.found import NamedEffect, UnnamedTerm
from trackres_ros.diagnosis.findings.verdict import Verdict

WORDS = (("vehicle files", "models"), ("vehicle file", "model"), ("vehicle", "machine"))
ONLY_OF_VEHICLES = re.compile(
    r"\b(belts?|wheels?|mud|snow|ground|springs|turns|passengers|goods|slope|bend|wind|guides?|rubber|steering|braking|driving)\b"
)
ANY_MACHINE = ("a part that rubs, binds or slips under these conditions",)


def of_machine(text: str) -> str:
    """A sentence on a vehicle as one on a machine; names of files and what else has no space around it stay."""
    for of_vehicles, general in WORDS:
        for word, instead in ((of_vehicles, general), (of_vehicles.capitalize(), general.capitalize())):
            text = re.sub(rf"(?<![\w./-]){word}(?![\w/-]|\.\w)", instead, text)
    return text


def term_of_machine(described: Described) -> Described:
    """An unnamed term with the mechanisms that a machine may have."""
    parts = tuple(of_machine(part) for part in described.mechanisms if not ONLY_OF_VEHICLES.search(part))
    return replace(described, sentence=of_machine(described.sentence), mechanisms=parts or ANY_MACHINE)


def terms_of_machine(terms: Sequence[UnnamedTerm]) -> list[UnnamedTerm]:
    """The same for each term."""
    return [replace(term, described=term_of_machine(term.described)) for term in terms]


def effects_of_machine(found: Sequence[NamedEffect]) -> list[NamedEffect]:
    """Named effects with the difference that they explain in words of machines."""
    return [replace(effect, seen=of_machine(effect.seen)) for effect in found]


def verdict_of_machine(verdict: Verdict) -> Verdict:
    """A verdict in words of machines."""
    return replace(verdict, sentence=of_machine(verdict.sentence), seen=of_machine(verdict.seen))

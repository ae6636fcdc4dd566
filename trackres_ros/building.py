# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the C of all kernels into a file, when the package is built: `python -m trackres_ros.building FILE`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType

from trackres_ros.effects.calls import EffectCalls, package_functions
from trackres_ros.kernels.compiler import load_module
from trackres_ros.kernels.extension import Extension
from trackres_ros.kernels.flow import translate_body
from trackres_ros.kernels.functions import Translator
from trackres_ros.kernels.marks import ENTRIES, NAME, sources_digest

MODULES = (
    "estimator.kernel", "diagnosis.base.own", "diagnosis.prepare.speed_smoothing", "diagnosis.prepare.sampling",
    "diagnosis.empirical.spells",
)  # fmt: skip
"""Modules with entries."""


def all_entries() -> dict[str, FunctionType]:
    """The kernels that Python calls, by their names in C."""
    for module in MODULES:
        import_module(f"trackres_ros.{module}")
    return ENTRIES


def source(name: str, entries: Mapping[str, FunctionType]) -> str:
    """The C of some kernels, of all effects if they call any, and of the module of that name that they are in."""
    translator = Translator(translate_body)
    translator.is_checked = False
    effects = EffectCalls(translator, others=True)
    extension = Extension(name, translator, entries, {"SOURCES": sources_digest()})
    if not effects.called:
        return extension.text()
    for function, number in package_functions().items():
        effects.add(function, number)
    return extension.text(effects.text(), effects.prototype, list(effects.functions.values()))


def built(entries: Mapping[str, FunctionType], *options: str) -> ModuleType | None:
    """A module with some kernels as C, compiled now, for tests and comparisons; None without a compiler."""
    name = f"of_{'_'.join(entries)}"
    return load_module(name, source(name, entries), *options)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(source(NAME.rpartition(".")[2], all_entries()), encoding="utf-8")

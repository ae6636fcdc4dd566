# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Translates the functions of effects to C."""

from __future__ import annotations

from types import FunctionType
from typing import Any

from trackres_ros.effects.effect import ANSWERS, FACTS, LOOKED_AT, Conditions, Effect, VehicleConstants, is_of_user
from trackres_ros.kernels.functions import Instance, Translator
from trackres_ros.kernels.kinds import REAL, ArrayOf


def effect_function(translator: Translator, kind: type[Effect], method: str, names: tuple[str, ...]) -> Instance:
    """`terms` or `lag` of an effect behind the signature that the step calls: numbers that it looks at, parameters, its answer.

    Raises
    ------
    InputError
        With file and line, if it cannot be written in C.
    """
    known = ", ".join(f"x[{i}]" for i in range(FACTS, LOOKED_AT))
    vehicle = ", ".join(f"x[{i}]" for i in range(FACTS))
    name, answered = f"{kind.__name__.lower()}_{method}", ANSWERS[method]
    lines = [
        f"def {name}(x, p, out):",
        f'    """{method} of {kind.__name__}"""',
        f"    found = run(None, Conditions(VehicleConstants({vehicle}), {known}), p)",
        *(f"    out[{i}] = found[{i}]" for i in range(answered)),
    ]
    text = "\n".join(lines)
    namespace: dict[str, Any] = {"Conditions": Conditions, "VehicleConstants": VehicleConstants, "run": getattr(kind, method)}
    exec(text, namespace)
    made: FunctionType = namespace[name]
    translator.add_text(made, text)
    kinds = [ArrayOf(REAL, (LOOKED_AT,)), ArrayOf(REAL, (len(names),), names), ArrayOf(REAL, (answered,))]
    before, translator.checked = translator.checked, is_of_user(kind)
    try:
        return translator.instance(made, kinds)
    finally:
        translator.checked = before

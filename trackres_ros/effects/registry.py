# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Finds effects: one file each in this package, and those of the user's own folder.

A user's file is loaded with the arithmetic of C. A division by 0, an overflow or a root of a negative number gives inf or nan
there, and no error: in plain Python so do numpy's numbers, with which `Effect.run` calls it, and the functions below. Other
errors stay: of `int`, `floor` and such where there is no whole number, and of places that a table lacks.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import keyword
import math
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from importlib.machinery import SourceFileLoader
from itertools import pairwise
from numbers import Real
from os import PathLike
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np

from trackres_ros import checks
from trackres_ros.effects.effect import (
    ACTS_ON,
    ALL_KNOWN,
    BELONGS_TO,
    REFERENCE_NM,
    Active,
    Conditions,
    Effect,
    Lag,
    Parameter,
    Terms,
    VehicleConstants,
    VehicleKind,
    conditions,
)
from trackres_ros.effects.learned import NAMES as LEARNED
from trackres_ros.effects.learned import EmpiricalEffect, learned_effect
from trackres_ros.errors import InputError, nearest
from trackres_ros.kernels.kinds import LARGEST_WHOLE

# Files of a user

OF_NUMPY = {"pow": "float_power", **{f"a{name}": f"arc{name}" for name in ("sin", "cos", "cosh", "tanh")}}


class Function:
    """A function of `math` or of Python. In C, `function` itself is called."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function


class Forgiving(Function):
    """It answers as numpy where Python raises an error."""

    def __call__(self, *arguments: Any) -> Any:
        """Call it."""
        try:
            return self.function(*arguments)
        except (ArithmeticError, ValueError):
            name = self.function.__name__
            return getattr(np, OF_NUMPY.get(name, name))(*arguments)


class Whole(Function):
    """It gives a whole number, with an error where C has no such number."""

    def __call__(self, *arguments: Any) -> Any:
        """Call it."""
        if not abs(number := self.function(*arguments)) < LARGEST_WHOLE:
            raise OverflowError
        return number


def _replace_functions(value: Any) -> Any:
    name = getattr(value, "__name__", "")
    if value in (int, math.floor, math.ceil, math.trunc):
        return Whole(value)
    return Forgiving(value) if isinstance(getattr(np, OF_NUMPY.get(name, name), None), np.ufunc) else value


MATH = ModuleType("math")
MATH.__dict__.update({name: _replace_functions(value) for name, value in vars(math).items()})
REPLACED = {
    id(math): MATH,
    id(int): _replace_functions(int),
    **{id(value): vars(MATH)[name] for name, value in vars(math).items()},
}


class AsItIs(SourceFileLoader):
    """Loads a file in its present version: cached bytecode is compared with its file only by whole seconds and size."""

    def get_code(self, fullname: str) -> CodeType:
        """Compile it."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)

    def exec_module(self, module: ModuleType) -> None:
        """Run the file, and replace what it knows of `math`."""
        super().exec_module(module)
        module.__dict__.update({name: REPLACED.get(id(value), value) for name, value in vars(module).items()})
        module.__dict__["int"] = REPLACED[id(int)]


# Catalogue

ONLY_OF = ("", "rolls", "slides")
CHANNELS = tuple(name for name in Conditions._fields if name != "facts")
NOWHERE = VehicleConstants(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
ELSEWHERE = {
    "vehicle": "list it under effects of the vehicle file",
    "surroundings": "move it to a file of the surroundings and give that with --surroundings where it applies",
    "sensor": "correct the sensor in the topics file, by scale, offset or delay_s of its line",
}


def catalogue(
    folder: str | PathLike[str] | None = None, size: float | None = None, on_tyres: bool = False, files: Sequence[Path] = ()
) -> dict[str, Effect]:
    """All effects by name: the shipped ones, and those in the Python files of a folder or in single files; for a vehicle with a
    weight times wheel radius [Nm], if given, on tracks or on tyres.

    Raises
    ------
    InputError
        If a folder or file holds no usable effect, or one whose name is in use.
    """
    packages = [importlib.import_module(f"{__package__}.{kind}") for kind in BELONGS_TO]
    modules = [
        importlib.import_module(f"{package.__name__}.{package_entry.name}")
        for package in packages
        for package_entry in pkgutil.iter_modules(package.__path__)
    ]
    instances = [kind() for module in modules for kind in _effects_in(module)]
    effects = {effect.name: effect for effect in sorted(instances, key=lambda effect: effect.name)}
    in_folder = [] if folder is None else _python_files(checks.path(folder, "effects"))
    for path in (*in_folder, *files):
        kinds = _effects_in(_module_of(path))
        if not kinds:
            raise InputError(str(path), "no class derived from trackres_ros.effects.Effect", "at least one in each file")
        for effect in (_make_own_effect(kind, path) for kind in kinds):
            if effect.name in effects or effect.name in LEARNED:
                raise InputError(f"{path}: name", effect.name, "a name that no other effect has")
            effects[effect.name] = effect
    return {name: effect.for_size(size, on_tyres) for name, effect in effects.items()} if size else effects


def check_effects(
    content: Any,
    place: str,
    effects_by_name: Mapping[str, Effect],
    belongs_to: str,
    size: float = REFERENCE_NM,
    kind: VehicleKind | None = None,
) -> tuple[Active, ...]:
    """Effects with their values, in the notation of a file: ``name: {parameter: value or {value: v, range: [low, high]}, ...}``.

    Parameters
    ----------
    effects_by_name
        Effects with a name; learned effects without one, see `learned.learned_effect`, may be listed too.
    size
        Weight times wheel radius of the vehicle [Nm].
    kind
        Kind of the vehicle; without one, effects of every kind are accepted.

    Raises
    ------
    InputError
        For an unknown effect or parameter, a missing one, a value or range out of its bounds, or an effect that belongs to
        another file or that the vehicle cannot have.
    """
    if not isinstance(content, Mapping):
        raise InputError(place, content, "a mapping of effects: name: {parameter: value}")
    active = []
    for name, values in content.items():
        if name not in effects_by_name and name not in LEARNED:
            allowed = f"one of {', '.join(effects_by_name)}, or one that a diagnosis has learned"
            raise InputError(f"{place}: effect", name, allowed, nearest(str(name), [*effects_by_name, *LEARNED]))
        effect = learned_effect(name, values, size) if name in LEARNED else effects_by_name[name]
        if effect.belongs_to != belongs_to:
            raise InputError(f"{place}: effect", name, f"effects of the {belongs_to}", ELSEWHERE[effect.belongs_to])
        if kind is not None and (reason := effect.unsuited(kind)):
            suited_names = [e.name for e in effects_by_name.values() if e.belongs_to == belongs_to and not e.unsuited(kind)]
            raise InputError(f"{place}: effect", name, f"one of {', '.join(suited_names)}", f"remove it: {reason}")
        parameters = {q.name: q for q in effect.parameters if not q.is_fixed}
        if not isinstance(values, Mapping) or set(values) != set(parameters):
            raise InputError(f"{place}.{name}", values, f"a value for each of {', '.join(parameters)}")
        by_key = {key: _with_range(value, f"{place}.{name}.{key}", parameters[key]) for key, value in values.items()}
        ranges = {key: span for key, (_, span) in by_key.items() if span is not None}
        constants = {q.name: q.start for q in effect.parameters if q.is_fixed}
        active.append(Active(effect, {**constants, **{key: value for key, (value, _) in by_key.items()}}, ranges))
        _check_knots(active[-1], f"{place}.{name}")
    return tuple(active)


def _check_knots(active: Active, place: str) -> None:
    """Refuse a learned effect whose knots do not rise."""
    if not isinstance(active.effect, EmpiricalEffect):
        return
    names = active.effect.rising
    x = [active.values[name] for name in names]
    if any(b <= a for a, b in pairwise(x)):
        raise InputError(f"{place}: {names[0]} to {names[-1]}", x, f"values of {', '.join(names)} that rise from one to the next")


def _with_range(content: Any, place: str, q: Parameter) -> tuple[float, tuple[float, float] | None]:
    """Value and range of a parameter: a plain number has none."""
    if not isinstance(content, Mapping):
        return checks.number(content, place, q.low, q.high, q.unit), None
    if set(content) != {"value", "range"}:
        raise InputError(place, dict(content), "a number, or {value: number, range: [low, high]}")
    low, high = checks.span(content["range"], f"{place}.range", q.low, q.high, q.unit)
    return checks.number(content["value"], f"{place}.value", low, high, q.unit), (low, high)


def _effects_in(module: ModuleType) -> list[type[Effect]]:
    return [
        cls
        for _, cls in inspect.getmembers(module, inspect.isclass)
        if issubclass(cls, Effect) and cls.__module__ == module.__name__ and not inspect.isabstract(cls)
    ]


def _make_own_effect(kind: type[Effect], path: Path) -> Effect:
    """An effect of a user's file. Raises InputError for any fault in it."""
    try:
        effect = kind()
        effect.source = path.resolve()
        _check(effect, path)
        hash(effect)  # its functions are kept by it
    except InputError:
        raise
    except Exception as error:  # of any kind, as the code is not ours
        problem = f"{type(error).__name__}: {error}"
        raise InputError(f"{path}: {kind.__name__}", problem, "an effect as in docs/own-effect.md") from error
    return effect


def _python_files(folder: Path) -> list[Path]:
    files = sorted(folder.glob("*.py")) if folder.is_dir() else []
    if not files:
        raise InputError("effects", str(folder), "a folder with Python files, each with an effect")
    return files


def _module_of(path: Path) -> ModuleType:
    name = f"own_effect_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=AsItIs(name, str(path)))
    if spec is None or spec.loader is None:
        raise InputError(str(path), "a file that Python does not know how to import", "a Python file, .py")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise InputError(str(path), f"{type(error).__name__}: {error}", "a Python file that can be imported") from error
    return module


def _check(effect: Effect, path: Path) -> None:
    for attribute in ("name", "acts_on", "belongs_to", "text", "parameters"):
        if not getattr(effect, attribute, None):
            members = "name, acts_on, belongs_to, text and parameters"
            remedy = f"one of {', '.join(BELONGS_TO)}" if attribute == "belongs_to" else ""
            raise InputError(f"{path}: {type(effect).__name__}", f"no {attribute}", members, remedy)
    if not isinstance(effect.name, str) or not isinstance(effect.text, str):
        raise InputError(f"{path}: name, text", (effect.name, effect.text), "two texts")
    for attribute, allowed in (("acts_on", ACTS_ON), ("belongs_to", BELONGS_TO), ("only_of", ONLY_OF)):
        checks.one_of(getattr(effect, attribute), f"{path}: {effect.name}.{attribute}", allowed)
    if (effect.acts_on == "sensor") != (effect.belongs_to == "sensor"):
        problem = f"acts_on {effect.acts_on}, belongs_to {effect.belongs_to}"
        raise InputError(f"{path}: {effect.name}", problem, "both sensor, or neither")
    checks.each_of(effect.needs, f"{path}: {effect.name}.needs", CHANNELS)
    _check_parameters(effect.parameters, f"{path}: {effect.name}.parameters")
    _check_functions(effect, f"{path}: {effect.name}")


def _check_parameters(parameters: Any, place: str) -> None:
    if not isinstance(parameters, list | tuple) or not all(isinstance(q, Parameter) for q in parameters):
        raise InputError(
            place, parameters, "a tuple of trackres_ros.effects.Parameter", "a tuple of one ends with a comma: (one,)"
        )
    for q in parameters:
        if not all(isinstance(text, str) for text in (q.name, q.unit, q.text)):
            raise InputError(place, (q.name, q.unit, q.text), "texts for name, unit and text")
        if not q.name.isidentifier() or keyword.iskeyword(q.name) or q.name.startswith("_"):
            raise InputError(place, q.name, "a name that Python can write as p.name")
        given_numbers = q.low, q.high, q.start, *(x for x in (q.off, q.on_tyres) if x is not None), *q.more_starts
        if not all(isinstance(value, Real) for value in given_numbers):
            raise InputError(f"{place}: {q.name}", given_numbers, "numbers")
        if not -math.inf < q.low <= q.start <= q.high < math.inf or (q.off is not None and not q.low <= q.off <= q.high):
            raise InputError(f"{place}: {q.name}", (q.low, q.start, q.high, q.off), "start and off within finite low and high")
    names = [q.name for q in parameters]
    if len(set(names)) < len(names):
        raise InputError(place, names, "each name once")
    if all(q.off is None for q in parameters):
        raise InputError(place, names, "one with a value without effect (off)")


def _check_functions(effect: Effect, place: str) -> None:
    """Run `lag` and `terms` once, where everything is known. Mistakes in the code raise."""
    if type(effect).terms is Effect.terms:
        raise InputError(place, "no terms", "a function terms(self, at, p) that returns trackres_ros.effects.Terms")
    instant, active = conditions(NOWHERE, **ALL_KNOWN), Active(effect, effect.values())
    try:
        lag = active.lag(instant)
        if not isinstance(lag, Lag | None):
            raise InputError(f"{place}.lag", lag, "trackres_ros.effects.Lag(target, time_constant, start), or None")
        terms = active.terms(instant, 0.0 if lag is None else lag.start)
        if not isinstance(terms, Terms):
            raise InputError(f"{place}.terms", terms, "trackres_ros.effects.Terms(...)")
        for value in (*terms, *(lag or ())):
            math.isfinite(value)  # refuses what is no number
    except InputError:
        raise
    except TypeError as error:
        if "indices must be" in str(error):  # as effects were written once
            raise InputError(place, 'p["name"]', "p.name for the value of a parameter") from error
        raise
    except (ArithmeticError, ValueError):  # a matter of values, which are other ones in a vehicle: reported at its use
        return

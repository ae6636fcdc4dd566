"""Finds effects: one file each in this package, and those of the user's own folder."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from trackres_ros.effects.effect import ACTS_ON, Active, Effect
from trackres_ros.errors import InputError
from trackres_ros.topics import nearest

HELPERS = ("effect", "facts", "registry")


def catalogue(folder: Path | None = None, size: float | None = None, on_tyres: bool = False) -> dict[str, Effect]:
    """All effects by name: the shipped ones, and those in the Python files of a folder; for a vehicle with a
    weight times wheel radius [Nm], where that is given, on tracks or on tyres.

    Raises
    ------
    InputError
        If the folder holds no usable effect, or one whose name is taken.
    """
    package = importlib.import_module("trackres_ros.effects")
    modules = [
        importlib.import_module(f"trackres_ros.effects.{found.name}")
        for found in pkgutil.iter_modules(package.__path__)
        if found.name not in HELPERS
    ]
    effects = {effect.name: effect for module in modules for effect in _effects_in(module)}
    for path in _python_files(folder):
        own = _effects_in(_module_of(path))
        if not own:
            raise InputError(str(path), "no class derived from trackres_ros.effects.Effect", "at least one in each file")
        for effect in own:
            _check(effect, path)
            if effect.name in effects:
                raise InputError(f"{path}: name", effect.name, "a name that no other effect has")
            effects[effect.name] = effect
    return {name: effect.for_size(size, on_tyres) for name, effect in effects.items()} if size else effects


def check_effects(given: Any, where: str, known: Mapping[str, Effect]) -> tuple[Active, ...]:
    """Effects with their values, as a vehicle file lists them: ``name: {parameter: value, ...}``.

    Raises
    ------
    InputError
        For an unknown effect or parameter, a missing one, or a value out of its bounds.
    """
    if not isinstance(given, Mapping):
        raise InputError(where, given, "a mapping of effects: name: {parameter: value}")
    active = []
    for name, values in given.items():
        if name not in known:
            raise InputError(f"{where}: effect", name, ", ".join(known), nearest(str(name), known))
        effect = known[name]
        wanted = {q.name: q for q in effect.parameters}
        if not isinstance(values, Mapping) or set(values) != set(wanted):
            raise InputError(f"{where}.{name}", values, f"a value for each of {', '.join(wanted)}")
        for key, value in values.items():
            q = wanted[key]
            if isinstance(value, bool) or not isinstance(value, int | float) or not q.low <= value <= q.high:
                raise InputError(f"{where}.{name}.{key}", value, f"a number from {q.low:g} to {q.high:g} {q.unit}")
        active.append(Active(effect, {key: float(value) for key, value in values.items()}))
    return tuple(active)


def _effects_in(module: ModuleType) -> list[Effect]:
    return [
        cls()
        for _, cls in inspect.getmembers(module, inspect.isclass)
        if issubclass(cls, Effect) and cls is not Effect and cls.__module__ == module.__name__
    ]


def _python_files(folder: Path | None) -> list[Path]:
    if folder is None:
        return []
    files = sorted(folder.glob("*.py")) if folder.is_dir() else []
    if not files:
        raise InputError("--effects", str(folder), "a folder with Python files, each with an effect")
    return files


def _module_of(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"own_effect_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(str(path), "a file that Python does not know how to import", "a Python file, .py")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(str(path), f"{type(error).__name__}: {error}", "a Python file that can be imported") from error
    return module


def _check(effect: Effect, path: Path) -> None:
    for attribute in ("name", "acts_on", "text", "parameters"):
        if not getattr(effect, attribute, None):
            raise InputError(f"{path}: {type(effect).__name__}", f"no {attribute}", "name, acts_on, text and parameters")
    if effect.acts_on not in ACTS_ON:
        raise InputError(f"{path}: acts_on", effect.acts_on, ", ".join(ACTS_ON))
    for q in effect.parameters:
        if not q.low <= q.start <= q.high or (q.off is not None and not q.low <= q.off <= q.high):
            raise InputError(f"{path}: {q.name}", (q.low, q.start, q.high, q.off), "start and off within low and high")
    if all(q.off is None for q in effect.parameters):
        raise InputError(f"{path}: parameters", [q.name for q in effect.parameters], "one with a value without effect (off)")

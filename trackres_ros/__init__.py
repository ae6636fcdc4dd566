# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rolling-resistance torque and temperature of rubber tracks, live and from recordings.

>>> import trackres_ros as tr
>>> vehicle = tr.load_vehicle("xgd24d")
>>> result = tr.replay("drive.mcap", vehicle)  # doctest: +SKIP
>>> found = tr.diagnose(["day1.mcap", "day2.mcap"], vehicle)  # doctest: +SKIP

Everything in `__all__` is loaded when it is first used; docs/api.md describes it.
"""

from __future__ import annotations

import copyreg
from importlib import import_module
from types import MappingProxyType

from trackres_ros.version import __version__

TYPE_CHECKING = False  # as in typing, which takes longer to import than all else here
if TYPE_CHECKING:
    from trackres_ros import effects
    from trackres_ros.diagnosis.base.own import OwnModel
    from trackres_ros.errors import InputError, MissingExtraError
    from trackres_ros.estimator.estimator import Estimator
    from trackres_ros.recording.mcap import Recovered
    from trackres_ros.recording.recording import Recording
    from trackres_ros.tasks.arguments import load_vehicle
    from trackres_ros.tasks.diagnose import DiagnosisResult, diagnose
    from trackres_ros.tasks.explain import OperatingPoint, explain
    from trackres_ros.tasks.record_sample import Sample, record_sample
    from trackres_ros.tasks.recordings import read, recover
    from trackres_ros.tasks.replay import ReplayResult, replay
    from trackres_ros.tasks.simulate import SimulationResult, simulate
    from trackres_ros.tasks.vehicle import VehicleCheck, check_vehicle
    from trackres_ros.tools.coastdown.result import CoastdownResult
    from trackres_ros.tools.coastdown.task import coastdown
    from trackres_ros.vehicle import Vehicle

__all__ = [
    "CoastdownResult",
    "DiagnosisResult",
    "Estimator",
    "InputError",
    "MissingExtraError",
    "OperatingPoint",
    "OwnModel",
    "Recording",
    "Recovered",
    "ReplayResult",
    "Sample",
    "SimulationResult",
    "Vehicle",
    "VehicleCheck",
    "__version__",
    "check_vehicle",
    "coastdown",
    "diagnose",
    "effects",
    "explain",
    "load_vehicle",
    "read",
    "record_sample",
    "recover",
    "replay",
    "simulate",
]

_HOMES = {
    "diagnosis.base.own": ("OwnModel",),
    "errors": ("InputError", "MissingExtraError"),
    "estimator.estimator": ("Estimator",),
    "recording.recording": ("Recording",),
    "recording.mcap": ("Recovered",),
    "tasks.arguments": ("load_vehicle",),
    "tasks.diagnose": ("DiagnosisResult", "diagnose"),
    "tasks.explain": ("OperatingPoint", "explain"),
    "tasks.record_sample": ("Sample", "record_sample"),
    "tasks.recordings": ("read", "recover"),
    "tasks.replay": ("ReplayResult", "replay"),
    "tasks.simulate": ("SimulationResult", "simulate"),
    "tasks.vehicle": ("VehicleCheck", "check_vehicle"),
    "tools.coastdown.result": ("CoastdownResult",),
    "tools.coastdown.task": ("coastdown",),
    "vehicle": ("Vehicle",),
}
"""The names at home in each module; `effects` is a package itself."""


def _read_only(content: dict[object, object]) -> MappingProxyType[object, object]:
    return MappingProxyType(content)


# Vehicles, recordings and results hold read-only mappings, which Python neither copies nor pickles by itself.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "effects":
        return import_module("trackres_ros.effects")
    home = next(module for module, names in _HOMES.items() if name in names)
    value: object = getattr(import_module(f"trackres_ros.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__

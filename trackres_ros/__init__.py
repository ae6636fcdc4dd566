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
    from trackres_ros.api.diagnosing import diagnose
    from trackres_ros.api.recordings import read, record_sample, recover
    from trackres_ros.api.replaying import replay
    from trackres_ros.api.simulating import explain, simulate
    from trackres_ros.api.vehicles import check_vehicle, load_vehicle
    from trackres_ros.diagnosis.base.own import OwnModel
    from trackres_ros.errors import InputError, MissingExtraError
    from trackres_ros.estimator.estimator import Estimator
    from trackres_ros.offline.sample import Sample
    from trackres_ros.recording.mcap import Recovered
    from trackres_ros.recording.recording import Recording
    from trackres_ros.results.diagnosis import DiagnosisResult
    from trackres_ros.results.operating_point import OperatingPoint
    from trackres_ros.results.replay import ReplayResult
    from trackres_ros.results.simulation import SimulationResult
    from trackres_ros.results.vehicle_check import VehicleCheck
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
    "CoastdownResult": "tools.coastdown.result",
    "DiagnosisResult": "results.diagnosis",
    "Estimator": "estimator.estimator",
    "InputError": "errors",
    "MissingExtraError": "errors",
    "OperatingPoint": "results.operating_point",
    "OwnModel": "diagnosis.base.own",
    "Recording": "recording.recording",
    "Recovered": "recording.mcap",
    "ReplayResult": "results.replay",
    "Sample": "offline.sample",
    "SimulationResult": "results.simulation",
    "Vehicle": "vehicle",
    "VehicleCheck": "results.vehicle_check",
    "check_vehicle": "api.vehicles",
    "coastdown": "tools.coastdown.task",
    "diagnose": "api.diagnosing",
    "explain": "api.simulating",
    "load_vehicle": "api.vehicles",
    "read": "api.recordings",
    "record_sample": "api.recordings",
    "recover": "api.recordings",
    "replay": "api.replaying",
    "simulate": "api.simulating",
}
"""The module where a name is at home; `effects` is a package itself."""


def _read_only(content: dict[object, object]) -> MappingProxyType[object, object]:
    return MappingProxyType(content)


# Vehicles, recordings and results hold read-only mappings, which Python neither copies nor pickles by itself.
copyreg.pickle(MappingProxyType, lambda mapping: (_read_only, (dict(mapping),)))


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "effects":
        return import_module("trackres_ros.effects")
    value: object = getattr(import_module(f"trackres_ros.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__

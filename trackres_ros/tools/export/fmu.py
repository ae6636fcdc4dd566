# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Packs the exported step as an FMU: FMI 3.0 for co-simulation, with its sources and a library for this machine."""

from __future__ import annotations

import io
import platform
import shutil
import subprocess
import tempfile
import uuid
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import trackres_ros as tr
from trackres_ros.effects import stepping
from trackres_ros.effects.effect import Active, Parameter, VehicleConstants
from trackres_ros.errors import InputError
from trackres_ros.estimator.columns import Motion
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.estimator.motion import LARGEST_QUANTUM
from trackres_ros.estimator.settings import Settings
from trackres_ros.files.dataclass_reader import limits_of
from trackres_ros.files.output_files import output_file
from trackres_ros.files.own_files import write
from trackres_ros.kernels.extension import fill_template
from trackres_ros.model.thermal import parting_resistance
from trackres_ros.tools.export.c_source import TEMPLATES, CSource, in_c
from trackres_ros.tools.export.exporting import Request, translated
from trackres_ros.vehicle.description import CHASSIS
from trackres_ros.vehicle.road import ROAD_LOAD, RoadVehicle, built_in, least_rolling

MODEL = "trackres"
SOURCES = ("trackres.c", "fmi3.c")
COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
TUNED = {
    "bearing_friction": ("1", "friction of the bearings, or of all that rolls, over the weight"),
    "drag_area": ("m2", "drag coefficient times frontal area"),
    "air_density": ("kg/m3", "density of the air"),
    "rotating_mass_factor": ("1", "mass with what rotates, over the mass"),
    "nominal_ambient": ("degC", "ambient temperature where none is given"),
    "feedforward_rate": ("N.m/s", "largest change of the feed-forward"),
    "feedforward_limit": ("N.m", "largest feed-forward"),
}
"""Numbers of the kernel that are parameters of an FMU: unit and meaning. Effects look at some of them in the work space."""
UNITS = {
    "1": {}, "m": {"m": "1"}, "m/s": {"m": "1", "s": "-1"}, "m/s2": {"m": "1", "s": "-2"}, "rad": {"rad": "1"},
    "rad/s": {"rad": "1", "s": "-1"}, "N": {"kg": "1", "m": "1", "s": "-2"}, "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "N.m/s": {"kg": "1", "m": "2", "s": "-3"}, "W": {"kg": "1", "m": "2", "s": "-3"}, "K": {"K": "1"},
    "degC": {"K": "1", "offset": "273.15"}, "m2": {"m": "2"}, "kg/m3": {"kg": "1", "m": "-3"}, "s": {"s": "1"},
}  # fmt: skip
"""Units by their exponents of SI."""
BY_SUFFIX = {
    "mps": "m/s", "mps2": "m/s2", "n": "N", "nm": "N.m", "degc": "degC", "k": "K", "w": "W", "radps": "rad/s", "rad": "rad",
    "m": "m",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of the FMU: its place in an instance as C expression, and its attributes in the model description."""

    name: str
    place: str
    causality: str
    unit: str = "1"  # empty for one that is not in UNITS
    text: str = ""
    start: float | None = None
    rows: int = 1
    stride: str = "0"
    also: str = "0"  # another place of the same number
    limits: tuple[float, float] | None = None  # lowest and highest value of a parameter


def export_fmu(request: Request, path: Path) -> Path:
    """Write an FMU.

    Raises
    ------
    InputError
        See `translated`; where there is no compiler for its library, and for numbers that are `float`.
    """
    file = output_file(path, (".fmu",))
    compiler = next((compiler_name for compiler_name in COMPILERS if shutil.which(compiler_name)), None)
    if compiler is None:
        raise InputError("export fmu", "no C compiler", f"one of {', '.join(COMPILERS)}", "install one: apt install gcc")
    source = translated(request, tuple(TUNED))
    variables = list(_variables(source))
    token = f"{{{uuid.uuid5(uuid.NAMESPACE_URL, f'trackres/{source.version()}/{len(variables)}')}}}"
    texts = {name: text for name, text in source.files().items() if name in ("trackres.c", "trackres.h")}
    texts["fmi3.c"] = fill_template((TEMPLATES / "fmi3.c").read_text(encoding="utf-8"), _places(source, variables, token))
    with tempfile.TemporaryDirectory() as folder:
        for name, text in texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        library = Path(folder) / f"{MODEL}.so"
        words = [compiler, *FLAGS, *SOURCES, "-o", library.name, "-lm"]
        process = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
        if process.returncode:
            raise InputError("export fmu", process.stderr[-200:], f"C that {compiler} takes", "report this with the vehicle file")
        description = _description(source, variables, token)
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as zip_file:
            zip_file.writestr("modelDescription.xml", description)
            zip_file.writestr("sources/buildDescription.xml", _build_description())
            for name, text in texts.items():
                zip_file.writestr(f"sources/{name}", text)
            zip_file.writestr(f"binaries/{platform.machine()}-linux/{MODEL}.so", library.read_bytes())
    write(file, archive.getvalue())
    return file


def _variables(source: CSource) -> Iterator[Variable]:
    """All variables, the time first; the index in this order is their value reference."""
    yield Variable("time", "offsetof(struct instance, time)", "independent", "s")
    for name in source.inputs.values():
        start = 0.0 if name == "speed_mps" else float("nan")
        yield Variable(f"inputs/{name}", f"offsetof(struct instance, inputs.{in_c(name)})", "input", _unit(name), "", start)
    for name in source.columns:
        yield Variable(name, f"offsetof(struct instance, outputs.{in_c(name)})", "output", _unit(name))
    limits = _limits(source.estimator)
    for i, (name, (unit, text)) in enumerate(TUNED.items()):
        start = float(getattr(source.estimator.constants.number, name))
        facts = VehicleConstants._fields
        condition_place = _in_state("conditions", facts.index(name)) if name in facts else "0"
        yield Variable(name, _in_state("tuned", i), "parameter", unit, text, start, also=condition_place, limits=limits[name])
    yield from _of_effects(source)


def _limits(estimator: Estimator) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each number of `TUNED`, as a vehicle file and settings take them."""
    vehicle = estimator.vehicle
    rate, share = (limits_of(Settings)[f"feedforward_{limit_name}"] for limit_name in ("rate", "share"))
    per_share = estimator.constants.number.feedforward_limit / estimator.settings.feedforward_share
    if isinstance(vehicle, RoadVehicle):
        limit_name, area = ROAD_LOAD, (ROAD_LOAD["drag_area"].low, ROAD_LOAD["drag_area"].high)
        friction = least_rolling(vehicle.values), ROAD_LOAD["rolling_coefficient"].high
    else:
        limit_name, drag, front = CHASSIS, CHASSIS["drag_coefficient"], CHASSIS["frontal_area"]
        area = drag.low * front.low, drag.high * front.high
        friction = CHASSIS["bearing_friction"].low, CHASSIS["bearing_friction"].high
    name_of_fact = {"air_density": "air_density", "rotating_mass_factor": "rotating_mass_factor", "nominal_ambient": "ambient"}
    return {name: (limit_name[key].low, limit_name[key].high) for name, key in name_of_fact.items()} | {
        "bearing_friction": friction,
        "drag_area": area,
        "feedforward_rate": (rate.low, rate.high),
        "feedforward_limit": (share.low * per_share, share.high * per_share),
    }


def _of_effects(source: CSource) -> Iterator[Variable]:
    """Parameters of effects: each is in the effect's row and in the following shifted rows for its variance."""
    k = source.estimator.constants
    width = k.effect_values.shape[1] if k.effect_values.ndim > 1 else 0
    states = k.effects[:, stepping.STATE].tolist()
    facts = source.estimator.facts
    vehicle = source.estimator.vehicle
    built_in_effects = built_in(vehicle.values) if isinstance(vehicle, RoadVehicle) else ()
    quantities = {effect: (arm, ROAD_LOAD[name]) for effect, _, name, arm in built_in_effects}
    for state, active in enumerate(source.parts.active):
        first_state, rows = states.index(state), states.count(state)
        for i, q in enumerate(active.effect.parameters):
            if q.is_fixed or _parts_belt(active, q, facts):  # the number of nodes follows from it
                continue
            place = _in_state("effect_values", first_state * width + i)
            arm, limits = quantities.get(active.effect, (1.0, q))
            unit, text = q.unit.replace("Nm", "N.m").replace("^", ""), f"{q.text} [{q.unit}]"
            yield Variable(
                f"effects/{active.effect.name}/{q.name}", place, "parameter", unit if unit in UNITS else "", text,
                float(active.values[q.name]), rows, f"{width} * sizeof(double)", limits=(arm * limits.low, arm * limits.high),
            )  # fmt: skip


def _in_state(array: str, index: int) -> str:
    return f"offsetof(struct instance, state.{array}) + {index} * sizeof(double)"


def _parts_belt(active: Active, q: Parameter, facts: VehicleConstants) -> bool:
    """Whether the resistance between the mean of a belt and its surface depends on a parameter."""
    ends = (replace(active, values={**active.values, q.name: value}) for value in (q.low, q.high))
    return len({parting_resistance((end,), facts) for end in ends}) > 1


def _unit(name: str) -> str:
    return BY_SUFFIX.get(name.partition("/")[0].rpartition("_")[2], "1")


def _places(source: CSource, variables: list[Variable], token: str) -> dict[str, str]:
    lines = []
    for v in variables:
        low, high = v.limits or (0.0, 0.0)
        values = f"{v.place}, {v.rows}, {v.stride}, {v.also}, {v.causality.upper()}, {low!r}, {high!r}"
        lines.append(f"    {{{values}}}, /* {v.name} */")
    counts = {"SMALLEST_STEP": Motion.quantum, "LARGEST_QUANTUM": LARGEST_QUANTUM}
    counts |= {"VARIABLE_COUNT": len(variables), "OF_REASONS": len(variables), "OF_LEVEL": len(variables) + 1}
    longest_age = repr(float(source.estimator.settings.speed_max_age_s))
    texts = {"TOKEN": token, "LONGEST_S": longest_age, "VARIABLES": "\n".join(lines)}
    return texts | {name: str(count) for name, count in counts.items()}


def _description(source: CSource, variables: list[Variable], token: str) -> bytes:
    vehicle = source.estimator.vehicle
    root = Xml.Element(
        "fmiModelDescription", fmiVersion="3.0", modelName=vehicle.name, instantiationToken=token, description=vehicle.title,
        generationTool=f"trackres_ros {tr.__version__}", variableNamingConvention="structured",
    )  # fmt: skip
    abilities = ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUState", "canSerializeFMUState")
    ability_flags: dict[str, Any] = dict.fromkeys(abilities, "true")
    Xml.SubElement(root, "CoSimulation", modelIdentifier=MODEL, **ability_flags)
    units = Xml.SubElement(root, "UnitDefinitions")
    for name in sorted({v.unit for v in variables if v.unit}):
        Xml.SubElement(Xml.SubElement(units, "Unit", name=name), "BaseUnit", UNITS[name])
    entries = Xml.SubElement(root, "ModelVariables")
    for reference, v in enumerate(variables):
        attributes: dict[str, Any] = {"description": v.text} if v.text else {}
        attributes |= {"unit": v.unit} if v.unit else {}
        attributes |= {} if v.start is None else {"start": "NaN" if v.start != v.start else repr(v.start)}
        attributes |= {} if v.limits is None else {"min": repr(v.limits[0]), "max": repr(v.limits[1])}
        variability = "tunable" if v.causality == "parameter" else "continuous"
        Xml.SubElement(
            entries, "Float64", name=".".join(map(in_c, v.name.split("/"))), valueReference=str(reference), causality=v.causality,
            variability=variability, **attributes,
        )  # fmt: skip
    outputs = [reference for reference, v in enumerate(variables) if v.causality == "output"]
    for reference, (kind, name) in enumerate((("UInt32", "reasons"), ("Int32", "level")), len(variables)):
        outputs.append(reference)
        Xml.SubElement(entries, kind, name=name, valueReference=str(reference), causality="output", variability="discrete")
    structure = Xml.SubElement(root, "ModelStructure")
    for element in ("Output", "InitialUnknown"):
        for reference in outputs:
            Xml.SubElement(structure, element, valueReference=str(reference))
    Xml.indent(root)
    return bytes(Xml.tostring(root, "utf-8", xml_declaration=True))


def _build_description() -> bytes:
    root = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    build = Xml.SubElement(root, "BuildConfiguration", modelIdentifier=MODEL)
    files = Xml.SubElement(build, "SourceFileSet", language="C99")
    for name in SOURCES:
        Xml.SubElement(files, "SourceFile", name=name)
    return bytes(Xml.tostring(root, "utf-8", xml_declaration=True))

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recognises the columns of a DMA file by the names and units that instruments use."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi

from trackres_ros.errors import InputError, nearest
from trackres_ros.units import ZERO_DEGC_K

TEMPERATURE, FREQUENCY, STORAGE, LOSS, TANGENT = "temperature", "frequency", "storage modulus", "loss modulus", "tan delta"
COMPLEX, ANGLE = "complex modulus", "loss angle"
MODULI = STORAGE, LOSS, COMPLEX
STANDS_FOR = {COMPLEX: STORAGE, ANGLE: TANGENT}
"""Quantities from which others are computed."""
UNUSED_WITH = {COMPLEX: {STORAGE}, ANGLE: {LOSS, TANGENT}}
"""Quantities that are not used beside these others."""
SHEAR_TO_TENSION = 3.0  # E = 2 (1 + nu) G with nu = 1/2: rubber keeps its volume

# By name, in lower case and with one kind of each quotation mark; the first match applies.
NAMES = (
    (COMPLEX, re.compile(r"^\|?\s*[eg]\s*\*|^[eg][ _]?star\b|complex.*\bmodul|komplex\w* .*modul|module .*complexe")),
    (
        ANGLE,
        re.compile(
            r"(loss|phase)[ _]*angle|verlustwinkel|phasenwinkel|angle de (perte|phase)|^phase\b|"
            r"^(delta|\u03b4)[ _]*([\[(/,\u00b0\d]|$|deg|rad)"
        ),
    ),
    (TANGENT, re.compile(r"tan\b|tan[_ (]*(d|\u03b4)|loss[ _]*(factor|tangent)|verlustfaktor|d\u00e4mpfung|damping")),
    (LOSS, re.compile(r"""^[eg]\s*(''|")|^[eg]2\b|^[eg][ _]?d(ouble)?[ _]?prime|loss|verlustmodul|module de perte""")),
    (STORAGE, re.compile(r"^[eg]\s*'|^[eg]1\b|^[eg][ _]?prime|storage|^[eg][ _]?stor\b|speichermodul|module de conservation")),
    (FREQUENCY, re.compile(r"freq|fr\u00e9q|^f\b|^f_|omega|\u03c9|kreisfrequenz")),
    (TEMPERATURE, re.compile(r"temp|^t\s*([\[(/,]|$)|^t[ _]*(deg|\u00b0|[kcf]\b)")),
)
SHEAR = re.compile(r"^g\b|^g['\"12_]|shear|schub|\bg['\"]")
ANGULAR = re.compile(r"omega|\u03c9|angular|kreis|puls", re.IGNORECASE)
LOGARITHM = re.compile(r"(?<![a-z])(log(?!g[ei])|l[gn](?![a-z]{2}))", re.IGNORECASE)  # none of a logger or the length
UNLIKE = re.compile(r"beta\b|viscos|complian|stiffness|strain|stress|force")
OF_OTHERS = re.compile(r"[tTfF]\s*[\[(/_ ]\s*[\[(]?(s|sec|min|h|N|mN)\b")  # a time, a force
QUOTES = str.maketrans(
    {"\u2032": "'", "\u2019": "'", "\u2018": "'", "\u00b4": "'", "`": "'", "\u2033": '"', "\u201d": '"', "\u201c": '"'}
)
PLACES_OF_UNITS = (  # "E' [MPa]", "E' (MPa)", "E' / MPa", "E_storage_MPa", "E' MPa"
    re.compile(r"\[([^\[\]]*)\]"),
    re.compile(r"\(([^()]*)\)"),
    re.compile(r"/\s*(.+)$"),
)
FREQUENCY_IN_NAME = re.compile(r"(?:^|[\s_@,(\[])(\d+(?:[.,p]\d+)?(?:e[+-]?\d+)?)\s*_?(hz|rad/s)\b", re.IGNORECASE)

# Unit, in normalised spelling: (factor to SI or degC, offset).
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    TEMPERATURE: {
        "degC": (1.0, 0.0), "\u00b0C": (1.0, 0.0), "\u2103": (1.0, 0.0), "C": (1.0, 0.0), "Celsius": (1.0, 0.0),
        "K": (1.0, -ZERO_DEGC_K), "Kelvin": (1.0, -ZERO_DEGC_K),
        "degF": (5.0 / 9.0, -160.0 / 9.0), "\u00b0F": (5.0 / 9.0, -160.0 / 9.0),
    },
    FREQUENCY: {
        "Hz": (1.0, 0.0), "1/s": (1.0, 0.0), "kHz": (1e3, 0.0), "mHz": (1e-3, 0.0),
        "rad/s": (0.5 / pi, 0.0), "rad/sec": (0.5 / pi, 0.0),
        "rad s-1": (0.5 / pi, 0.0), "rad*s-1": (0.5 / pi, 0.0), "rad s^-1": (0.5 / pi, 0.0),
    },
    STORAGE: {
        "Pa": (1.0, 0.0), "kPa": (1e3, 0.0), "MPa": (1e6, 0.0), "GPa": (1e9, 0.0), "N/mm^2": (1e6, 0.0), "N/mm2": (1e6, 0.0),
        "N/mm\u00b2": (1e6, 0.0), "dyn/cm^2": (0.1, 0.0), "dyn/cm2": (0.1, 0.0), "psi": (6894.757, 0.0),
    },
    TANGENT: {"1": (1.0, 0.0), "-": (1.0, 0.0), "%": (0.01, 0.0)},
    ANGLE: {
        "deg": (pi / 180.0, 0.0), "\u00b0": (pi / 180.0, 0.0), "degree": (pi / 180.0, 0.0), "degrees": (pi / 180.0, 0.0),
        "rad": (1.0, 0.0), "mrad": (1e-3, 0.0),
    },
}  # fmt: skip
UNITS[LOSS] = UNITS[COMPLEX] = UNITS[STORAGE]
SHOWN_UNITS = {
    TEMPERATURE: "degC, K or degF", FREQUENCY: "Hz, kHz, mHz or rad/s", STORAGE: "Pa, kPa, MPa, GPa, N/mm^2 or psi",
    LOSS: "Pa, kPa, MPa, GPa, N/mm^2 or psi", COMPLEX: "Pa, kPa, MPa, GPa, N/mm^2 or psi", TANGENT: "none, 1 or %",
    ANGLE: "deg, rad or mrad",
}  # fmt: skip
DISTINCT = {"mhz"}  # units that differ by upper and lower case alone from another one


@dataclass(frozen=True)
class DmaColumn:
    """A column of a file: its index, name and role, the factor and offset to SI (degC), whether in shear, the
    frequency [Hz] in its name if any, whether a column before it has the same name and unit, and the quantity that stands
    for its role (`STANDS_FOR`), if any.
    """

    place: int
    name: str
    role: str
    scale: float
    offset: float
    shear: bool = False
    frequency: float | None = None
    again: bool = False
    quantity: str = ""


def role_of(name: str) -> str | None:
    """Quantity of a column by its name."""
    plain_name = name.translate(QUOTES).replace("''", '"').strip().lower()
    if UNLIKE.search(plain_name):
        return None
    return next((role for role, pattern in NAMES if pattern.search(plain_name)), None)


def unit_of(text: str, role: str) -> tuple[float, float] | None:
    """Factor and offset of a unit; None if the unit does not fit the role."""
    unit_name = text.strip().replace("\u00b7", "*").strip("[]() ")
    known_units = UNITS[role]
    if unit_name in known_units:
        return known_units[unit_name]
    if unit_name.lower() in DISTINCT:
        return None
    return next((value for unit, value in known_units.items() if unit.lower() == unit_name.lower()), None)


def is_unit(text: str) -> bool:
    """Whether a cell holds a unit of any quantity."""
    cell = text.strip()
    return bool(cell) and any(unit_of(cell, role) is not None for role in UNITS)


def frequency_in(name: str) -> float | None:
    """The frequency [Hz] that a column's name ends with."""
    match = FREQUENCY_IN_NAME.search(name)
    if match is None:
        return None
    value = float(re.sub("[,p]", ".", match[1]))
    return value if match[2].lower() == "hz" else value / (2.0 * pi)


def columns_of(names: Sequence[str], units: Sequence[str] | None, where: str) -> list[DmaColumn]:
    """The columns in use, by their names and the line of units below them, if any.

    `names`, `units`: the cells of both lines; `where`: file and line of the names, for messages. Raises InputError for a unit
    that is missing or does not fit its quantity; a second column of a quantity with another name or unit; a quantity only as a
    logarithm; a modulus in shear beside one in tension.
    """
    column_list: list[DmaColumn] = []
    logarithms: dict[tuple[str, float | None], int] = {}  # place by role and frequency
    roles = [role_of(name) for name in names]
    unused = {quantity for quantity, others in UNUSED_WITH.items() if others & {*roles}}
    for place, (name, role) in enumerate(zip(names, roles, strict=True)):
        unit_cell = units[place] if units and place < len(units) else ""
        if role is None or role in unused or OF_OTHERS.match(f"{name} {unit_cell}"):
            continue
        frequency = frequency_in(name) if role in (*MODULI, TANGENT, ANGLE) else None
        if LOGARITHM.search(f"{name} {unit_cell}"):
            logarithms.setdefault((role, frequency), place)
            continue
        scale, offset = _unit(name, unit_cell, role, where)
        if role == FREQUENCY and ANGULAR.search(name) and re.search(r"1\s*/\s*s", f"{name} {unit_cell}"):
            scale = UNITS[FREQUENCY]["rad/s"][0]
        shear = role in MODULI and bool(SHEAR.search(name.translate(QUOTES).lower()))
        factor, kind, quantity = scale * (SHEAR_TO_TENSION if shear else 1.0), STANDS_FOR.get(role, role), role
        column = DmaColumn(place, name, kind, factor, offset, shear, frequency, quantity="" if kind == quantity else quantity)
        first_column = next((c for c in column_list if c.role == kind and c.frequency == frequency), None)
        if first_column is not None and replace(first_column, place=place) != column:
            raise another_column(column, first_column, where)
        column_list.append(column if first_column is None else replace(column, again=True))
    for (role, frequency), place in logarithms.items():
        role = STANDS_FOR.get(role, role)
        sufficient_roles = (LOSS, TANGENT) if role in (LOSS, TANGENT) else (role,)
        if not any(c.role in sufficient_roles and c.frequency == frequency for c in column_list):
            allowed = f"the {role} itself, not its logarithm"
            raise InputError(f"{where}, column {place + 1}", names[place].strip(), allowed, "convert the column, and rename it")
    moduli = {c.shear: c for c in column_list if c.role in MODULI}
    if len(moduli) > 1:
        given = f"{moduli[True].name.strip()} in shear, {moduli[False].name.strip()} in tension"
        raise InputError(where, given, "all moduli in shear, or all in tension", "rename the columns, or give tan delta alone")
    return column_list


def another_column(column: DmaColumn, first_column: DmaColumn, where: str) -> InputError:
    """Error of a second column of a quantity that does not repeat the first."""
    return InputError(
        f"{where}, column {column.place + 1}",
        column.name,
        f"one column of {column.role}: column {first_column.place + 1}, {first_column.name}, is one already",
        "delete or rename the other",
    )


def _unit(name: str, unit_cell: str, role: str, where: str) -> tuple[float, float]:
    if unit_cell.strip():
        unit_pair = unit_of(unit_cell, role)
        if unit_pair is None:
            raise InputError(
                f"{where}, unit of {name}", unit_cell.strip(), SHOWN_UNITS[role], nearest(unit_cell.strip(), UNITS[role])
            )
        return unit_pair
    name_rest = FREQUENCY_IN_NAME.sub("", name)
    texts = [text for pattern in PLACES_OF_UNITS for text in pattern.findall(name_rest)]
    words = [word for word in reversed(re.split(r"[_\s,]+", name_rest)) if word != name_rest.strip()]
    for text in filter(None, [*texts, *words]):
        if (unit_pair := unit_of(text, role)) is not None:
            return unit_pair
    if role == TANGENT:
        return 1.0, 0.0
    if texts:
        raise InputError(f"{where}, unit of {name}", texts[0], SHOWN_UNITS[role], nearest(texts[0], UNITS[role]))
    remedy = f"write it into the name, as {name.strip()} [{SHOWN_UNITS[role].split(',')[0]}], or on a line of units below"
    raise InputError(f"{where}, unit of {name}", "none", SHOWN_UNITS[role], remedy)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Converts the units in files to those of the roles."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from trackres_ros.units import DEGREE, GRAVITY, KMH_PER_MPS, ZERO_DEGC_K

# NIST SP 811, appendix B
POUND_FORCE_N, FOOT_M, MILE_M, SEA_MILE_M, PSI_PA = 4.4482216152605, 0.3048, 1609.344, 1852.0, 6894.757293168361


class Conversion(NamedTuple):
    """A value in the unit of the role is ``scale * value + offset``."""

    scale: float = 1.0
    offset: float = 0.0


_NUMBERS: dict[str, dict[str, tuple[float, ...]]] = {
    "m/s": {
        "m/s": (1.0,), "km/h": (1.0 / KMH_PER_MPS,), "mph": (MILE_M / 3600.0,), "knots": (SEA_MILE_M / 3600.0,),
        "ft/s": (FOOT_M,), "cm/s": (1e-2,), "mm/s": (1e-3,),
    },
    "N": {"N": (1.0,), "kN": (1e3,), "kg": (GRAVITY,), "t": (1e3 * GRAVITY,), "lbf": (POUND_FORCE_N,), "daN": (10.0,)},
    "Nm": {"Nm": (1.0,), "kNm": (1e3,), "lbf ft": (POUND_FORCE_N * FOOT_M,), "daNm": (10.0,)},
    "degC": {"degC": (1.0,), "K": (1.0, -ZERO_DEGC_K), "degF": (5.0 / 9.0, -160.0 / 9.0)},
    "m/s2": {"m/s2": (1.0,), "g": (GRAVITY,)},
    "1": {"1": (1.0,), "%": (0.01,), "‰": (1e-3,)},
    "rad/s": {"rad/s": (1.0,), "deg/s": (DEGREE,)},
    "rad": {"rad": (1.0,), "deg": (DEGREE,)},
    "m": {"m": (1.0,), "km": (1e3,), "cm": (1e-2,), "mm": (1e-3,), "ft": (FOOT_M,), "mi": (MILE_M,)},
    "s": {"s": (1.0,), "ms": (1e-3,), "us": (1e-6,), "ns": (1e-9,), "min": (60.0,), "h": (3600.0,)},
    "Pa": {"Pa": (1.0,), "kPa": (1e3,), "MPa": (1e6,), "bar": (1e5,), "mbar": (1e2,), "psi": (PSI_PA,)},
}  # fmt: skip
UNITS: Mapping[str, Mapping[str, Conversion]] = MappingProxyType(
    {inside: {name: Conversion(*numbers) for name, numbers in units.items()} for inside, units in _NUMBERS.items()}
)
"""By the unit inside the program: the units that are read, as a topics file writes them."""
SPELLINGS = {
    "kph": "km/h", "kmh": "km/h", "kmph": "km/h", "mps": "m/s", "c": "degC", "celsius": "degC", "f": "degF", "kelvin": "K",
    "m/s/s": "m/s2", "bool": "1", "ftlb": "lbfft", "lbft": "lbfft", "ftlbf": "lbfft", "degree": "deg",
    "degrees": "deg", "kgf": "kg", "ton": "t", "lb": "lbf", "lbs": "lbf", "percent": "%", "hpa": "mbar", "knot": "knots",
    "kt": "knots", "kts": "knots", "kn": "knots", "mile": "mi", "miles": "mi",
}  # fmt: skip
"""Other spellings, as `_plain` simplifies them, in lower case."""


def _plain(text: str) -> str:
    """A unit without marks that differ from tool to tool: ``N·m``, ``N*m`` and ``N m`` alike."""
    for mark, plain in (("°", "deg"), ("º", "deg"), ("²", "2"), ("µ", "u")):
        text = text.replace(mark, plain)
    plain = "".join(c for c in text if c.isalnum() or c in "/%‰")
    return plain or "1"


def conversion(text: str, inside: str) -> Conversion | None:
    """Conversion of a unit to that of the role; None if it does not fit.

    `text`: as written in a file; `inside`: the internal unit.
    """
    given = _plain(text)
    names = {_plain(name): one for name, one in UNITS[inside].items()}
    for spelt in (given, _plain(SPELLINGS.get(given.lower(), given))):  # kn is kN of a load, and knots of a speed
        folded = [one for name, one in names.items() if name.lower() == spelt.lower()]
        found = names.get(spelt) or (folded[0] if len(folded) == 1 else None)
        if found:
            return found
    return None


def is_quantity(text: str) -> bool:
    """Whether a text is the unit of a quantity: not of a share or a count."""
    return any(conversion(text, inside) for inside in UNITS if inside != "1")

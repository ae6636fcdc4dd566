# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The one table of roles: meaning, unit and known column names of each kind of input; conversions of units; ways of travel."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackres_ros.text import words
from trackres_ros.units import DEGREE, GRAVITY, KMH_PER_MPS, ZERO_DEGC_K

# NIST SP 811, appendix B
POUND_FORCE_N, FOOT_M, MILE_M, SEA_MILE_M, PSI_PA = 4.4482216152605, 0.3048, 1609.344, 1852.0, 6894.757293168361

DAY_S = 86400.0


class Conversion(NamedTuple):
    """A value in the unit of the role is ``scale * value + offset``."""

    scale: float = 1.0
    offset: float = 0.0


# datenum counts days as MATLAB does, excel_days as Excel does on Windows; both become seconds since 1970.
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
    "s": {"s": (1.0,), "ms": (1e-3,), "us": (1e-6,), "ns": (1e-9,), "min": (60.0,), "h": (3600.0,), "d": (DAY_S,),
          "datenum": (DAY_S, -719529.0 * DAY_S), "excel_days": (DAY_S, -25569.0 * DAY_S)},
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
"""Other spellings, as `_plain_form` simplifies them, in lower case."""
UNIT_WORDS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sek": "s", "sekunde": "s", "sekunden": "s", "seconde": "s",
    "secondes": "s", "segundos": "s", "msec": "ms", "millisecond": "ms", "milliseconds": "ms", "millisekunden": "ms",
    "usec": "us", "microseconds": "us", "minute": "min", "minutes": "min", "hr": "h", "hour": "h", "hours": "h", "hrs": "h",
    "day": "d", "days": "d", "tage": "d",
    **dict.fromkeys(("m/sec", "meter/s", "meters/s", "meter/second", "meters/second", "metres/second", "meter/sec", "meters/sec",
                     "meterspersecond", "metrespersecond", "meterpersecond"), "m/s"),
    **dict.fromkeys(("km/hr", "km/hour", "kilometer/hour", "kilometers/hour", "kilometres/hour", "kilometersperhour",
                     "kilometresperhour", "kmperhour", "kmhr"), "km/h"),
    **dict.fromkeys(("mi/h", "miles/hour", "mile/hour", "milesperhour"), "mph"), "ft/sec": "ft/s", "feet/second": "ft/s",
    **dict.fromkeys(("newtonmeter", "newtonmeters", "newtonmetre", "newtonmetres"), "Nm"), "newton": "N", "newtons": "N",
    "kilonewton": "kN", "tonne": "t", "tonnes": "t", "tons": "t", "kilogram": "kg", "kilograms": "kg", "kilogramm": "kg",
    "poundfoot": "lbfft", "footpounds": "lbfft", "fahrenheit": "degF", "gradc": "degC",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "kilometers": "km", "feet": "ft", "foot": "ft",
}  # fmt: skip
"""Units in words. The name of a channel may end with such a word without a meaning as a unit: ``torque_meter``."""


def _plain_form(text: str) -> str:
    """A unit without marks that differ from tool to tool: ``N·m``, ``N*m`` and ``N m`` alike."""
    for mark, replacement in (("°", "deg"), ("º", "deg"), ("²", "2"), ("µ", "u")):
        text = text.replace(mark, replacement)
    replacement = "".join(c for c in text if c.isalnum() or c in "/%‰")
    return replacement or "1"


def conversion(text: str, si_unit: str) -> Conversion | None:
    """Conversion of a unit to that of the role; None if it does not fit.

    `text`: as written in a file; `si_unit`: the internal unit.
    """
    plain_text = _plain_form(text)
    names = {_plain_form(name): factor for name, factor in UNITS[si_unit].items()}
    for spelt in (
        plain_text,
        _plain_form((SPELLINGS | UNIT_WORDS).get(plain_text.lower(), plain_text)),
    ):  # kn is kN of a load, and knots of a speed
        matches = [factor for name, factor in names.items() if name.lower() == spelt.lower()]
        result = names.get(spelt) or (matches[0] if len(matches) == 1 else None)
        if result:
            return result
    return None


def is_quantity(text: str) -> bool:
    """Whether a text is the unit of a quantity: not of a share or a count."""
    return any(conversion(text, si_unit) for si_unit in UNITS if si_unit != "1")


FORWARD, REVERSE, NEUTRAL = 1.0, -1.0, 0.0
WAYS = ("forward", "reverse", "neutral")


@dataclass(frozen=True, slots=True)
class Ways:
    """Values that mean each way; without any a gear, whose sign is the way: above 0 forward, below 0 reverse, 0 neutral."""

    forward: tuple[float, ...] = ()
    reverse: tuple[float, ...] = ()
    neutral: tuple[float, ...] = ()

    def directions(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """`FORWARD`, `REVERSE` or `NEUTRAL` for each number; nan for one without a meaning, such as that of an error."""
        if not self.forward and not self.reverse:
            return np.sign(numbers)
        number_groups = (self.forward, self.reverse, self.neutral)
        return np.select([np.isin(numbers, group) for group in number_groups], [FORWARD, REVERSE, NEUTRAL], np.nan)


STANDARDS: Mapping[str, Ways] = MappingProxyType(
    {
        "iso_11783": Ways(forward=(1.0,), reverse=(0.0,)),  # ISO 11783-7: direction of a machine; 2 is an error, 3 no value
        "j1939": Ways(forward=(0.0,), reverse=(1.0,)),  # SAE J1939-71: direction indicator (SPN 1619), reverse switch (SPN 767)
        "gear": Ways(),  # SAE J1939-71: transmission current and selected gear (SPN 523, 524), with their offset of -125
    }
)
"""By the word for `values` in a topics file. The first two are opposite: a bus is known by the names of its signals."""
KNOWN = {
    "iso_11783": re.compile(r"\bmachine (selected )?(speed )?direction\b"),
    "j1939": re.compile(r"\bdirection indicator\b|^(veh(icle)? )?(is )?(reverse|reversing)( (flag|switch|active|engaged))?$|"
        r"\breverse direction switch\b"),
    "gear": re.compile(r"\btrans(mission)? (current|selected) gear\b|^travel direction$"),
}  # fmt: skip
"""Words in the name of a signal or column that is of a standard."""
SAYS_REVERSE = re.compile(
    r"\brevers(e|ing)\b|\bbackwards?\b|\brueckw|\bdirection (indicator|of travel)\b|"
    r"\b(machine|driving|travel|drive) direction\b|^(is )?(direction|forward)$|\bgear\b"
)
"""Words in the name of a column that may say when a vehicle drives backwards."""
NAMED = {
    "forward": r"\b(forwards?|drive|vorwaerts)\b",
    "reverse": r"\b(revers(e|ing)|backwards?|rueckwaerts)\b",
    "neutral": r"\b(neutral|park)\b",
}
"""Words of the names that files give values."""


def standard_of(name: str) -> str:
    """The standard of a signal or column by its name; empty if it is none's."""
    name_words = words(name)
    return next((standard for standard, pattern in KNOWN.items() if pattern.search(name_words)), "")


def named_ways(named_numbers: Iterable[tuple[float, str]]) -> Ways | None:
    """The meaning of values by the names that a file gives them; None unless one is forward and one reverse."""
    numbers_by_way: dict[str, list[float]] = {way: [] for way in WAYS}
    for value, name in named_numbers:
        for way in WAYS:
            if re.search(NAMED[way], words(name)):
                numbers_by_way[way].append(value)
                break
    ways = Ways(*(tuple(numbers_by_way[way]) for way in WAYS))
    return ways if ways.forward and ways.reverse else None


def as_said(ways: Ways) -> str | dict[str, list[float]]:
    """`values` of a topics file for some ways."""
    standard = next((name for name, standard_ways in STANDARDS.items() if standard_ways == ways), "")
    return standard or {way: [float(value) for value in getattr(ways, way)] for way in WAYS if getattr(ways, way)}


def likely_values(name: str, value_names: Iterable[tuple[float, str]] = ()) -> str:
    """`values` of a topics file for a column that may say when a vehicle drives backwards, by its value names and its name."""
    ways, name_words = named_ways(value_names), words(name)
    if ways:
        numbers = {way: ", ".join(f"{number:g}" for number in getattr(ways, way)) for way in WAYS}
        return f"{{{', '.join(f'{way}: [{text}]' for way, text in numbers.items() if text)}}}"
    standard = standard_of(name)
    if "forward" in name_words or standard == "iso_11783":
        return "{forward: [1], reverse: [0]}"
    if not standard and "direction" in name_words:
        return "{forward: [1], reverse: [-1]}"
    is_gear = standard == "gear" or ("gear" in name_words and "revers" not in name_words)
    return "gear" if is_gear else "{forward: [0], reverse: [1]}"


def may_say_reverse(names: Iterable[str]) -> list[str]:
    """Those of some columns that may say when a vehicle drives backwards."""
    return [name for name in names if SAYS_REVERSE.search(words(name)) or standard_of(name)]


@dataclass(frozen=True, slots=True)
class Role:
    """Definition of a kind of input."""

    unit: str  # internal unit of its values, a key of `trackres_ros.recording.roles.UNITS`
    text: str
    parts: bool = False  # whether it may be given for each axle, assembly or wheel (``load/front``, ``wheel_speed/rear_left``)
    is_lively: bool = False  # whether a moving vehicle changes it all the time, so that a constant value means a stuck sensor
    columns: Mapping[str, str] = field(default_factory=dict)  # names of columns for it, and the unit of each
    # patterns that the words of a channel must and must not match for it to be guessed; never guessed without `words`
    words: str = ""
    not_words: str = r"(?!)"


NOT_VEHICLE = (
    r"rpm|\b(engine|motor|wind|fan|angular|yaw|cpu|moteur|motore|vent|viento|vento)\b|\bmotor(dreh)?mom|\bwindg|"
    r"^(?!.*\bveh(icle)? ?(speed|velocity|spd)\b).*\b(eng|e?mot)\d*\b"  # which may send the vehicle's speed too
)
"""Words for a speed, load or torque that is not that of the vehicle at its tracks."""
AMBIENT = r"\b(ambient|outside|outdoor|air|ambiante|exterieure?|ambiente|esterna)\b|\b(umgebung|aussen|luft)"
NOT_AMBIENT = (
    r"inlet|intake|outlet|manifold|charge|compress|cooler|exhaust|condition(er|ing|ed)|\bair ?cond(ition)?\b|\bac\b|"
    r"ansaug|innen|interior|inside|indoor|cargo|surface|\beng(ine)?\d*\b|^(?!.*\b(outside|outdoor)\b).*\bcab(in)?\d*\b"
)
"""Words for the air in a part of the vehicle, or the ground; ambient conditions are a group of J1939 that has both."""
OF_VEHICLE = r"veh(icle)? ?(speed|velocity|spd)"
SPEED = r"speed|velocity|\bspd\b|geschw|\bvitesse\b|\bvelocid|\bvelocit|\bsnelheid|\bhastighe|\bpredkosc"
"""Words for a speed in English, German, French, Spanish, Italian, Dutch, Swedish and Polish."""
CRUISE = (
    r"^(?=.*\bset\b).*\bcruise\b|"
    rf"^(?!.*(?<!cruise control )(?<!cruise ctrl )\b{OF_VEHICLE}).*"
    rf"\bcruise\b(?! (control|ctrl) {OF_VEHICLE}\d*( [km]\w*( [hs])?)?$)"
)
"""Words for a speed of the cruise control, in whose group of J1939 the vehicle's is too."""

ROLES: Mapping[str, Role] = MappingProxyType(
    {
        "speed": Role("m/s", "forward speed of the vehicle",
            is_lively=True, columns={"speed_mps": "m/s", "speed_kmh": "km/h"}, words=SPEED,
            not_words=NOT_VEHICLE + "|" + CRUISE + r"|\bsollgeschw|\bset ?(speed|spd)\b|\bforward veh|\bpreceding\b|"
            r"\brelative\b(?! to ground)"),
        "direction": Role("1", "the way a speed without a sign is driven: 1 forward, -1 backwards, 0 neutral",
            columns={"reverse": "1", "travel_direction": "1"}),
        "load": Role("N", "weight carried by the tracks, total or of an axle or assembly",
            parts=True, columns={"weight_n": "N", "weight_kn": "kN"}, words=r"\bload\b|weight|gewicht|\b(poids|peso)\b",
            not_words=NOT_VEHICLE + r"|leergew|nutzlast|zuladung|\bvide\b|pay ?load|cargo|trailer|"
            r"^(?!.*\bpowered veh).*combination|"
            r"\b(empty|tare|unladen|kerb|curb)\b"),
        "torque": Role("Nm", "measured torque at the sprockets, of the whole vehicle or of an assembly; or at the motor",
            parts=True, is_lively=True, columns={"torque_nm": "Nm"},
            words=r"torque|\btrq\b|drehmoment|antriebsmoment|\b(couple|coppia|koppel)\b",
            not_words=NOT_VEHICLE + r"|brak|brems|frein|kupplung|steer|lenk|retard|clutch|\bpto\b"),
        "ambient": Role("degC", "temperature of the air", columns={"ambient_degc": "degC"}, words=AMBIENT, not_words=NOT_AMBIENT),
        "belt": Role("degC", "measured temperature of the rubber belt",
            parts=True, columns={"belt_degc": "degC"}, words=r"\b(belt|track|rubber)\b", not_words=AMBIENT),
        "accel": Role("m/s2", "acceleration along the track, without gravity", is_lively=True, columns={"accel_mps2": "m/s2"}),
        "specific_force": Role("m/s2", "what an IMU measures along the track: acceleration and, on a slope, gravity",
            is_lively=True, columns={"specific_force_mps2": "m/s2"}),
        "grade": Role("1", "slope as rise over run, positive uphill", columns={"grade": "1"}),
        "yaw_rate": Role("rad/s", "turning rate about the upward axis",
            is_lively=True, columns={"yaw_rate_radps": "rad/s"}, words=r"\byaw ?rate\b"),
        "heading": Role("rad", "angle about the upward axis at which the vehicle points", columns={"heading_rad": "rad"}),
        "distance": Role("m", "distance travelled", columns={"distance_m": "m"}),
        "stood": Role("s", "standing time before the recording began; one value", columns={"stood_s": "s"}),
        "latitude": Role("rad", "latitude, positive north",
            columns={"latitude_deg": "deg", "latitude_rad": "rad"}, words=r"\blatitude\b|^(gps )?lat( deg)?$"),
        "longitude": Role("rad", "longitude, positive east",
            columns={"longitude_deg": "deg", "longitude_rad": "rad"}, words=r"\blongitude\b|^(gps )?(lon|long|lng)( deg)?$"),
        "altitude": Role("m", "height above a fixed level", columns={"altitude_m": "m"}, words=r"\baltitude\b"),
        "steering_angle": Role("rad", "angle of the steered wheels, positive to the left",
            columns={"steering_angle_rad": "rad"}, words=r"steering angle\b", not_words=r"\bwheel\b|ratio"),
        "passengers": Role("1", "people on board, added to the empty vehicle",
            columns={"passengers": "1"}, words=r"\bpassengers?\b"),
        "brake": Role("Pa", "pressure of the friction brakes, or a switch (0 or 1)",
            columns={"brake_pa": "Pa", "brake_on": "Pa"}, words=r"brake pressure", not_words=r"park|halt"),
        "wheel_speed": Role("m/s", "circumferential speed of a wheel", parts=True, columns={"wheel_speed_mps": "m/s"}),
        "enable": Role("1", "request for the feed-forward: 1 or 0, or a mode that `values` maps to them",
            columns={"enable": "1"}),
    }
)  # fmt: skip


PLAUSIBLE: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "speed": (-120.0, 120.0),  # the fastest vehicle file, and a fifth
        "load": (1e2, 1e8),
        "torque": (-1e6, 1e6),
        "ambient": (-60.0, 60.0),
        "belt": (-60.0, 180.0),
        "accel": (-15.0, 15.0),
        "grade": (-0.6, 0.6),
        "yaw_rate": (-5.0, 5.0),
        "heading": (-1e3, 1e3),
        "distance": (-1e9, 1e9),
        "passengers": (0.0, 1e3),
        "latitude": (-0.5 * math.pi, 0.5 * math.pi),
        "longitude": (-2.0 * math.pi, 2.0 * math.pi),
        "enable": (0.0, 1.0),
        "altitude": (-1e3, 1e4),
        "specific_force": (-30.0, 30.0),
    }
)
"""Limits outside of which a measurement is refused, and a guess, unless the vehicle file gives others: [low, high]."""
POSITION = ("latitude", "longitude")
GROUND = ("altitude", "specific_force")
"""Roles that show the rise of the ground, for learning from a measured torque; the estimate itself needs none of them."""
PASSENGER_KG = 70.0
"""Default mass of a passenger; assumed. UN regulation 107 has 68 kg in a city bus, 71 kg with luggage."""
BRAKE_ON_PA = 10e3
"""Default pressure from which a friction brake is on; assumed: springs hold its shoes off below."""


def base_role(role: str) -> str:
    """Return the role without its axle or assembly: ``load`` of ``load/front``."""
    return role.partition("/")[0]


def names_a_part(name: str) -> bool:
    """Whether a role may end in this name of an axle, assembly or wheel, in a topics file as in a table."""
    return bool(name) and name.isprintable()

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines inputs, state and results of a step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trackres_ros.arrays import Array, IntArray
from trackres_ros.effects.effect import VehicleConstants
from trackres_ros.effects.stepping import EffectScratch, new_effect_scratch
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as layout
from trackres_ros.text import decimals

# Inputs and state

NOT_NUMBERS = "MmcbSUV"  # kinds of dtypes that numpy would convert: dates, durations, complex, true and false, texts, records
DATES = "Mm"
IN_SECONDS = 'seconds of dates are (t - t[0]) / numpy.timedelta64(1, "s"), and of durations t / numpy.timedelta64(1, "s")'
LEAST_WEIGHT = 1e-3  # N
FEW = 16
LARGEST = 1e9  # of an input, in its unit: more than any vehicle has, and its powers do not overflow
LONGEST_STEP_S = 7 * 86400.0
"""Of a step: by then any belt is as warm as the air, as uncertain as it gets, and all that fades is gone. A longer time is the
difference of an unsigned clock that went back (2^32 ms are 50 days)."""
FARTHEST_NS = 1 << 62
"""146 years: two times that are nearer to 0 have a difference within 64 bits."""
FIRST_NS, LAST_NS = 1 - FARTHEST_NS, FARTHEST_NS - 1


class Inputs(NamedTuple):
    """Inputs of one step; nan where unknown. Loads and belt temperatures: one per assembly."""

    speed: float  # m/s
    load: Array  # N, own weight included
    ambient: float  # degC
    ambient_std: float  # K
    belt_measured: Array  # degC, nan without a new one
    acceleration: float = math.nan  # m/s^2 along the travel, commanded or measured without gravity
    grade: float = math.nan  # rise over run, positive uphill the way the vehicle points
    yaw_rate: float = math.nan  # rad/s
    heading: float = math.nan  # rad
    distance: float = math.nan  # m, driven; integrated from the speed if unknown
    measured_torque: float = math.nan  # Nm at the sprockets, whole vehicle
    slope_by_place: float = math.nan  # as `grade`, used where that is unknown: slope from the surroundings
    torque_by_place: float = math.nan  # Nm against travel, whole vehicle, from the surroundings
    torque_by_place_std: float = math.nan  # Nm
    reasons: int = 0  # columns.Reason found before the step
    fed: float = 1.0  # 0 for no feed-forward: it is not enabled, or the speed is not trusted
    load_std: float = 0.0  # N, of all loads together: they are old or doubted


MAYBE_UNKNOWN = Inputs._fields[5:-3]
FLOAT = np.dtype(float)
KINDS = (
    float,
    np.ndarray,
    float,
    float,
    np.ndarray,
    *(float for _ in MAYBE_UNKNOWN),
    int,
    float,
    float,
)  # of Inputs, as compiled


class State(NamedTuple):
    """State carried from one step to the next; not to be changed but by the kernel. `columns` describes the numbers."""

    belts: Annotated[Array, (None, 2, layout.BELT_COLUMNS)]  # temperature [degC] and departures [K], of mean and surface
    motion: Annotated[Array, (layout.Motion.columns,)]  # filtered speed and values of the last step
    effects: Array  # memory of the effects, see `effects.stepping`
    learned: Annotated[Array, (layout.Learned.columns,)]  # learned departures of the vehicle

    def __repr__(self) -> str:
        degrees = ", ".join(decimals(float(degc), 1) for degc in self.belts[:, 0, layout.Belt.temperature])
        belts = f"belts {degrees} degC, " if degrees else ""
        return f"<State: {belts}speed {decimals(float(self.motion[layout.Motion.last_speed]), 2)} m/s>"


class Scratch(NamedTuple):
    """Memory within one step: it begins with the vehicle's facts for effects, and nothing is carried to the next step."""

    effects: EffectScratch
    gap_belts: Annotated[Array, (2, 2, layout.BELT_COLUMNS)]  # a belt before a gap, and after a rest
    parts: Annotated[Array, (None, layout.Part.columns)]  # contributions of all assemblies together, then of each
    loads: Array  # N, of each assembly; of wheels without belts their sum
    belt_measured: Array  # degC, of each belt; nan without a new one


def new_scratch(facts: VehicleConstants, assemblies: int, belts: int) -> Scratch:
    """Scratch memory for a vehicle: no step allocates memory. Wheels without belts are one assembly."""
    return Scratch(
        new_effect_scratch(facts),
        np.empty((2, 2, layout.BELT_COLUMNS)),
        np.empty((1 + belts, layout.Part.columns)),
        np.empty(assemblies),
        np.empty(belts),
    )


class DriveSeries(NamedTuple):
    """A drive, shape (times,); nan where unknown."""

    times: Array  # s
    speeds: Array  # m/s
    weights: Array  # N, shared as nominal loads are
    ambients: Array  # degC
    accelerations: Array  # m/s^2
    grades: Array  # rise over run
    yaw_rates: Array  # rad/s
    headings: Array  # rad
    distances: Array  # m
    slopes_by_place: Array  # as grades, used where these are unknown
    torques_by_place: Array  # Nm against travel
    torque_stds_by_place: Array  # Nm
    places_known: Array  # as `GroundSeries.known`


class GroundSeries(NamedTuple):
    """Ground along a drive from the surroundings, shape (times,); nan where unknown."""

    slopes: Array  # rise over run the way the vehicle points
    torques: Array  # Nm against travel
    torque_stds: Array  # Nm
    known: Array  # 1 where the place on the route is known, else 0


def floats(values: ArrayLike, name: str, shape: tuple[int, ...] | None = None) -> Array:
    """Copy to an array of floats, of a given shape or any; nan where masked.

    Kernels read arrays without a check of their bounds, and are compiled for arrays that can be written and are contiguous: each
    array from outside passes here.

    Raises
    ------
    InputError
        For another shape, dates, durations, or what is no number.
    """
    array = _of_numbers(values, name)
    try:
        numbers = np.array(array, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError):  # objects: dates, texts, huge whole numbers
        raise InputError(name, values, "numbers", IN_SECONDS) from None
    if isinstance(array, np.ma.MaskedArray):
        numbers[np.ma.getmaskarray(array)] = math.nan
    if shape is not None and numbers.shape != shape:
        raise InputError(name, f"an array of shape {numbers.shape}", f"shape {shape}" if shape else "one number")
    return numbers


def whole_numbers(values: ArrayLike, name: str, low: int, high: int) -> IntArray:
    """Copy to an array of whole numbers from `low` to `high`, of floats the nearest ones. Raises InputError for others."""
    array = _of_numbers(values, name)
    if array.dtype.kind not in "iu" or isinstance(array, np.ma.MaskedArray):
        array = np.rint(floats(array, name))
    if array.size and not (low <= array.min() and array.max() <= high):
        raise InputError(name, values, f"whole numbers from {low} to {high}")
    return np.array(array, dtype=np.int64, order="C")


def _of_numbers(values: ArrayLike, name: str) -> NDArray[Any]:
    try:
        array = np.asanyarray(values)
    except (TypeError, ValueError):  # rows of different lengths
        raise InputError(name, values, "numbers") from None
    if array.dtype.kind in NOT_NUMBERS:
        raise InputError(name, values, "numbers", IN_SECONDS if array.dtype.kind in DATES else "")
    return array


def bounded_array(
    values: ArrayLike, name: str, shape: tuple[int, ...] | None = None, low: float = -LARGEST, nan_allowed: bool = False
) -> Array:
    """`floats` from `low` to `LARGEST`, nan only where values may be unknown. Raises InputError with the first other one."""
    array = floats(values, name, shape)
    if array.size <= FEW:  # then without numpy, which takes ten times as long
        for element in array.ravel().tolist():
            if not (low <= element <= LARGEST or (nan_allowed and element != element)):
                break
        else:
            return array
    is_wrong = ~((array >= low) & (array <= LARGEST) | (nan_allowed & np.isnan(array)))
    if is_wrong.any():
        index = int(np.argmax(is_wrong))
        place, value = (f"{name}[{index}]", float(array.flat[index])) if array.ndim else (name, values)
        raise InputError(place, value, f"a number from {low:g} to {LARGEST:g}{', or nan if unknown' if nan_allowed else ''}")
    return array


def number(value: Any, name: str, low: float = -LARGEST, nan_allowed: bool = False) -> float:
    """One number, as `bounded_array` takes it."""
    if type(value) in (float, int) and (low <= value <= LARGEST or (nan_allowed and value != value)):
        return float(value)
    return float(bounded_array(value, name, (), low, nan_allowed))


def check_inputs(inputs: Inputs, assemblies: int, belts: int) -> Inputs:
    """Inputs that a step can use, with arrays of their own. Raises InputError: after one nan all later estimates would be nan."""
    if not isinstance(inputs, Inputs):
        raise InputError("inputs", inputs, "what Estimator.inputs makes")
    load = bounded_array(inputs.load, "load", (assemblies,), low=0.0)
    if not sum(load.tolist()) > 0.0:
        raise InputError("load", inputs.load, "loads with a sum above 0")
    ambient = number(inputs.ambient, "ambient"), number(inputs.ambient_std, "ambient_std", low=0.0)
    degc = bounded_array(inputs.belt_measured, "belt_measured", (belts,), nan_allowed=True)
    motion = [
        v if v is math.nan else number(v, name, nan_allowed=True) for v, name in zip(inputs[5:-3], MAYBE_UNKNOWN, strict=True)
    ]
    measurements = (
        int(number(inputs.reasons, "reasons", low=0.0)),
        number(inputs.fed, "fed", low=0.0),
        number(inputs.load_std, "load_std", low=0.0),
    )
    return Inputs._make((number(inputs.speed, "speed"), load, *ambient, degc, *motion, *measurements))


def is_as_compiled(inputs: Inputs, assemblies: int, belts: int) -> bool:
    """Whether inputs have the types and shapes of `check_inputs`: for others a kernel would be compiled again, for seconds."""
    if type(inputs) is not Inputs or tuple(map(type, inputs)) != KINDS:
        return False
    load, degc = inputs.load, inputs.belt_measured
    has_shapes = load.shape == (assemblies,) and degc.shape == (belts,)
    return has_shapes and load.dtype == degc.dtype == FLOAT and load.flags.carray and degc.flags.carray


def duration(value: ArrayLike, name: str, limit: float = math.inf, remedy: str = "") -> float:
    """A duration [s]; InputError for a negative or infinite one, one above `limit`, or none."""
    seconds = float(value if isinstance(value, float) else floats(value, name, ()))
    if not 0.0 <= seconds <= limit or seconds == math.inf:
        allowed = "a finite number of seconds, at least 0" if limit == math.inf else f"a number of seconds from 0 to {limit:g}"
        raise InputError(name, seconds, allowed, remedy if seconds > limit else "")
    return seconds


def times(values: ArrayLike, name: str) -> Array:
    """Times of a series [s]; InputError unless they are finite and do not fall."""
    array = floats(values, name)
    if array.ndim != 1:
        raise InputError(name, f"an array of shape {array.shape}", "shape (times,)")
    is_wrong = ~np.isfinite(array)
    is_wrong[1:] |= array[1:] < array[:-1]
    if is_wrong.any():
        index = int(np.argmax(is_wrong))
        raise InputError(f"{name}[{index}]", float(array[index]), "finite times that do not fall")
    return array


# Results


class Estimate:
    """One row of results by name: torques [Nm] positive where they resist forward travel, temperatures [degC].

    Every name of `columns.columns` works as a key, `estimate["belt_degc/front_left"]`; the most used are attributes.
    """

    __slots__ = ("index", "row")

    def __init__(self, row: Array, index: Mapping[str, int]) -> None:
        self.row = row
        self.index = index

    def __getitem__(self, name: str) -> float:
        return float(self.row[self.index[name]])

    def __repr__(self) -> str:
        degrees = ", ".join(decimals(float(degc), 1) for degc in self.belt_degc())
        belts = f", belts {degrees} degC" if degrees else ""
        texts = f": {'; '.join(self.reason_texts())}" if self.reasons else ""
        return (
            f"<Estimate: resistance {decimals(self.resistance_torque_nm)} +- {decimals(self.resistance_std_nm)} Nm "
            f"at {decimals(self['speed_mps'], 2)} m/s{belts}, {self.status}{texts}>"
        )

    @property
    def resistance_torque_nm(self) -> float:
        """Hysteresis, bearings and wind, whole vehicle, at the sprockets or the driven wheels [Nm]."""
        return float(self.row[layout.Results.resistance_torque_nm])

    @property
    def resistance_std_nm(self) -> float:
        """Standard deviation of the resistance torque [Nm]."""
        return float(self.row[layout.Results.resistance_std_nm])

    @property
    def feedforward_torque_nm(self) -> float:
        """Chosen parts, limited in rate and size [Nm]."""
        return float(self.row[layout.Results.feedforward_torque_nm])

    @property
    def reasons(self) -> layout.Reason:
        """Why the status is not plainly good."""
        return layout.Reason(int(self.row[layout.Results.reasons]))

    @property
    def status(self) -> str:
        """`ok`, or `warn` where a reason matters to users of the torque."""
        return "warn" if self.reasons & ~layout.HARMLESS else "ok"

    def reason_texts(self) -> list[str]:
        """One sentence for each reason."""
        return [text for reason, text in layout.REASON_TEXT.items() if reason & self.reasons]

    def belt_degc(self) -> Array:
        """Mean belt temperature of each assembly [degC]."""
        return self._of_assemblies(layout.OfAssembly.belt_degc)

    def belt_std_k(self) -> Array:
        """Standard deviation of each of them [K]."""
        return self._of_assemblies(layout.OfAssembly.belt_std_k)

    def _of_assemblies(self, column: int) -> Array:
        return self.row[len(layout.VEHICLE_COLUMNS) + column :: len(layout.ASSEMBLY_COLUMNS)]


@dataclass(frozen=True, eq=False, repr=False)
class Steps:
    """Results of a block of messages: one row a step."""

    stamp_ns: IntArray  # (steps,), time of measurement of the speed that made the step
    arrival_ns: IntArray  # (steps,), of its logging; of one that waited in a queue, by its stamp
    rows: Array  # (steps, columns), as `Estimator.columns` names them

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        seconds = (int(self.stamp_ns[-1]) - int(self.stamp_ns[0])) * 1e-9 if len(self) else 0.0
        return f"<Steps: {len(self)} over {decimals(seconds, 1)} s>"

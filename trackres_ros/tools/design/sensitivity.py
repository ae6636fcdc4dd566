# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Ranks the values of a vehicle file by their share of the uncertainty, by Sobol's indices over the file's ranges."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros import checks
from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.files.resources import find_vehicle
from trackres_ros.model.operating_point import INACTIVE, left_out_at
from trackres_ros.text import decimals, figures, table
from trackres_ros.tools.design.draws import CONDITIONS, MOST_LOST, absorbing_fits
from trackres_ros.tools.design.steady import ALONE, OUTCOMES, WARMEST_K, Array, remarks_on, steady
from trackres_ros.tools.design.values import scalars, short
from trackres_ros.tools.engine import LOCAL, results
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import Vehicle, load
from trackres_ros.vehicle.loading import variants

Model = Callable[[Array], Array]

NAMES = {"cold_nm": "cold resistance", "warm_nm": "warm resistance", "belt_degc": "belt temperature", "kwh_per_km": "warm energy"}
UNITS = {"cold_nm": "Nm", "warm_nm": "Nm", "belt_degc": "K", "kwh_per_km": "kWh/km"}
OF_EFFECTS = "the size of an effect is taken as known"
SURE = 0.95
RESAMPLES = 200
MOST_SHOWN = 12
LEAST_SAMPLES, MOST_SAMPLES = 8, 1 << 16
LITTLE = 0.01
PIECE = 32  # vehicles that a worker takes at a time


@dataclass(frozen=True, slots=True)
class Index:
    """Sobol's indices of one value, each with the half-width of its 95 % interval."""

    first: float  # share of the variance that would go if this value were known
    first_pm: float
    total: float  # share that would stay if all others were known
    total_pm: float
    # the outcome with this value at either end of its range, the others as the file has them
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class SensitivityResult:
    """Results of a sensitivity analysis."""

    # its conditions: name, [m/s], [degC]
    vehicle: str
    speed: float
    ambient: float
    # each outcome by the file, and its standard deviation due to the ranges
    nominal: Mapping[str, float]
    std: Mapping[str, float]
    indices: Mapping[str, Mapping[str, Index]]  # by outcome and path
    fixed: Mapping[str, str]  # why some values were not varied, by path
    # draws, in each of which every value is changed in turn; vehicles that were computed for them
    samples: int
    row_count: int
    # draws left out, as one of their vehicles is impossible; and the reason for the first
    lost_count: int
    why_lost: str
    remarks: tuple[str, ...]  # on belts outside the rubber data: of the vehicle itself, and how many drawn ones have any

    def ranked(self, outcome: str) -> list[str]:
        """Paths, by decreasing share of the uncertainty."""
        indices = self.indices[outcome]
        return sorted(indices, key=lambda path: -indices[path].total)

    def text(self, outcome: str) -> str:
        """The table of one outcome, and which value to measure first."""
        indices, unit, ranked = self.indices[outcome], UNITS[outcome], self.ranked(outcome)
        paths = list(indices)
        rows = [
            (
                short(path, paths), decimals(100.0 * indices[path].first), f"+- {decimals(100.0 * indices[path].first_pm)}",
                decimals(100.0 * indices[path].total), f"+- {decimals(100.0 * indices[path].total_pm)}",
                figures(indices[path].low - self.nominal[outcome], 3), figures(indices[path].high - self.nominal[outcome], 3),
            )
            for path in ranked[:MOST_SHOWN]
        ]  # fmt: skip
        head = ("value", "alone\n%", "", "with others\n%", "", f"at its low\n{unit}", f"at its high\n{unit}")
        kmh = KMH_PER_MPS * self.speed
        lines = [
            f"{NAMES[outcome]} of {self.vehicle} at {kmh:g} km/h, air {self.ambient:g} degC: {figures(self.nominal[outcome], 4)} "
            f"+- {figures(self.std[outcome], 2)} {unit.replace('K', 'degC')} (one standard deviation, by the ranges of the file)",
            table(rows, head),
        ]
        remainder = [path for path in ranked[MOST_SHOWN:] if indices[path].total > 0.0]
        lines += [f"and {len(remainder)} more with smaller shares"] if remainder else []
        lines.append(self._advice([short(path, paths) for path in ranked[:2]], [indices[path] for path in ranked[:2]]))
        for reason in dict.fromkeys(self.fixed.values()):
            lines.append(
                f"Held: {', '.join(short(p, list(self.fixed)) for p, of_it in self.fixed.items() if of_it == reason)}: {reason}"
            )
        if self.lost_count:
            lines.append(
                f"{self.lost_count} of {self.samples} draws are dropped, because their vehicles are impossible: {self.why_lost}"
            )
        return "\n".join([*lines, *(f"  ! {remark}" for remark in self.remarks)])

    def _advice(self, names: Sequence[str], largest: Sequence[Index]) -> str:
        """What to measure first, of the values with the largest shares."""
        if len(names) == 1:
            return f"Measure {names[0]}: no other value with a range moves it."
        (first, second), (largest_index, second_index) = names, largest
        if largest_index.total - second_index.total > math.hypot(largest_index.total_pm, second_index.total_pm):
            return f"Measure {first} first, then {second}."
        return f"Measure {first} or {second} first: {self.samples} samples do not decide which has the larger share."

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "vehicle": self.vehicle, "speed_mps": self.speed, "ambient_degc": self.ambient, "samples": self.samples,
            "drawn": self.row_count, "lost": self.lost_count, "why_lost": self.why_lost,
            "nominal": dict(self.nominal), "std": dict(self.std),
            "indices": {
                outcome: {path: asdict(index) for path, index in by_path.items()} for outcome, by_path in self.indices.items()
            },
            "held": dict(self.fixed), "remarks": list(self.remarks),
        }  # fmt: skip


def sensitivity(
    file: str, speed: float, ambient: float | None = None, samples: int = 64, seed: int = 1,
    progress: Callable[[str, int], Callable[[float], None]] = lambda _what, _total: lambda _: None,
) -> SensitivityResult:  # fmt: skip
    """Share of each outcome's uncertainty due to each value of a vehicle file, if all are uniform in their ranges.

    `file`: vehicle file, or the name of a shipped one; `speed` [m/s]; `ambient`: air [degC], by default the file's; `samples`: of
    each value, a power of two: samples times (values + 2) vehicles are computed; `progress`: takes a description and the number
    of steps, and returns a function that takes the number of finished ones.

    Raises InputError on an invalid number of samples, or inconsistent ranges; MissingExtraError if SALib is not installed.
    """
    checks.whole(samples, "samples", LEAST_SAMPLES, MOST_SAMPLES)
    if samples & (samples - 1):
        raise InputError("samples", samples, "a power of two, as 64 or 128")
    checks.seed(seed)
    vehicle = load(find_vehicle(file))
    source, air = str(vehicle.source), vehicle.chassis.ambient if ambient is None else ambient
    nominal = _outcomes(variants(vehicle), {}, speed, air)
    remarks = remarks_on(vehicle, speed, air, [steady(vehicle, speed, air)])
    ends, fixed = _ends(vehicle, speed, air, progress)
    reach = {path: np.abs(np.array(pair) - nominal).max(axis=0) for path, pair in ends.items()}
    largest = np.fmax.reduce([np.zeros(len(OUTCOMES)), *reach.values()])
    # A value that ends the balance at one end of its range has no size there, but it moves a lot.
    small = [path for path, change in reach.items() if np.isfinite(change).all() and not np.any(change > LITTLE * largest)]
    fixed |= dict.fromkeys(small, f"it moves nothing by {LITTLE:.0%} of what others do")
    fixed |= {f"effects.{active.effect.name}": OF_EFFECTS for active in vehicle.active if active.ranges}
    fixed |= {f"effects.{name}": INACTIVE for name in left_out_at(vehicle, speed, air)}
    paths = [path for path in ends if path not in small]
    if not paths:
        raise InputError(file, "no value with a range that moves an outcome", "at least one", "give ranges in the vehicle file")
    bounds = [(vehicle.parameters[path].low, vehicle.parameters[path].high) for path in paths]
    lost, reason = 0, ""

    def model(rows: Array) -> Array:
        nonlocal lost, reason
        pieces = [(i, rows[i : i + PIECE]) for i in range(0, len(rows), PIECE)]
        of_each = partial(outcomes_of, source, paths, speed, air)
        advance, outcomes = progress("vehicles", len(rows)), np.empty((len(rows), len(OUTCOMES) + 1))
        for (i, piece), result in results(of_each, pieces, LOCAL, has_few=len(rows) <= ALONE):
            outcomes[i : i + PIECE] = result
            advance(len(piece))
        bad = ~np.isfinite(outcomes).all(axis=1)
        lost = int(bad.reshape(-1, len(paths) + 2).any(axis=1).sum())
        if lost:
            reason = _why_not(vehicle, dict(zip(paths, map(float, rows[int(np.argmax(bad))]), strict=True)), speed, air)
        if lost > MOST_LOST * samples:
            problem = f"ranges in which {lost} of {samples} draws give an impossible vehicle, because {reason}"
            raise InputError(file, problem, f"at most {MOST_LOST:.0%}", "narrow the ranges of values that depend on each other")
        if extrapolated := int(np.nansum(outcomes[:, -1])):
            text = "drawn vehicles have belts outside the rubber data: their torque is extrapolated"
            remarks.append(f"{extrapolated} of {len(rows)} {text}")
        return outcomes[:, :-1]

    of_all, row_count = sobol(paths, bounds, model, samples, seed)
    indices = {
        outcome: {
            path: Index(*of_all.by_outcome[i][path], ends[path][0][i], ends[path][1][i]) for path in paths
        }
        for i, outcome in enumerate(OUTCOMES)
    }  # fmt: skip
    std = dict(zip(OUTCOMES, of_all.std, strict=True))
    nominal_values = dict(zip(OUTCOMES, nominal, strict=True))
    return SensitivityResult(
        vehicle.name, speed, air, nominal_values, std, indices, fixed, samples, row_count, lost, reason, tuple(remarks)
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Indices:
    """First and total indices with half-widths, for each outcome by name; and the standard deviation of each outcome."""

    by_outcome: list[dict[str, tuple[float, float, float, float]]]
    std: list[float]


def sobol(
    names: Sequence[str], bounds: Sequence[tuple[float, float]], model: Model, samples: int, seed: int
) -> tuple[Indices, int]:
    """Sobol's indices of a model with uniform arguments between their bounds, by SALib; and the number of its rows.

    `model`: from rows of arguments, shape (n, arguments), to rows of outcomes, shape (n, outcomes); nan for an impossible one;
    `samples`: a power of two.
    """
    try:
        from SALib.analyze import sobol as analysis
        from SALib.sample import sobol as sampling
    except ImportError:
        raise MissingExtraError("trackres sensitivity", "SALib", "design") from None
    problem = {"num_vars": len(names), "names": list(names), "bounds": [list(pair) for pair in bounds]}
    rows = np.asarray(sampling.sample(problem, samples, calc_second_order=False, seed=seed))
    outcomes = model(rows)
    # Rows of one point are compared with each other: a substitute for one would look like an effect of the changed value.
    size = len(names) + 2
    complete = np.isfinite(outcomes).all(axis=1).reshape(-1, size).all(axis=1)
    outcomes = outcomes[np.repeat(complete, size)]
    indices, std = [], []
    for column in outcomes.T:
        std.append(float(column.std()))
        if not np.ptp(column) > 1e-12 * max(1.0, float(np.abs(column).max())):
            indices.append(dict.fromkeys(names, (0.0, 0.0, 0.0, 0.0)))
            continue
        result = analysis.analyze(problem, column, calc_second_order=False, num_resamples=RESAMPLES, conf_level=SURE, seed=seed)
        columns = zip(result["S1"], result["S1_conf"], result["ST"], result["ST_conf"], strict=True)
        indices.append({name: tuple(map(float, numbers)) for name, numbers in zip(names, columns, strict=True)})  # type: ignore[misc]
    return Indices(indices, std), len(rows)


def outcomes_of(file: str, paths: Sequence[str], speed: float, ambient: float, piece: tuple[int, Array]) -> Array:
    """Outcomes of vehicles with values by path, and 1 if there are remarks, shape (n, outcomes + 1); nan for an impossible one.

    `piece`: number of the first one, and the values of each, shape (n, paths).
    """
    make, outcomes = variants(load(file)), np.full((len(piece[1]), len(OUTCOMES) + 1), np.nan)
    for row, target in zip(piece[1], outcomes, strict=True):
        with suppress(InputError):
            vehicle = make(dict(zip(paths, map(float, row), strict=True)))
            state = steady(vehicle, speed, ambient)
            target[:] = *state.outcomes, bool(remarks_on(vehicle, speed, ambient, [state]))
    return outcomes


def _why_not(vehicle: Vehicle, values: Mapping[str, float], speed: float, ambient: float) -> str:
    try:
        _outcomes(variants(vehicle), values, speed, ambient)
    except InputError as error:
        return f"{error.where.rpartition(': ')[2]}: given {error.given}; allowed: {error.allowed}"
    return f"its belts do not settle below {WARMEST_K:.0f} K over the air"


def _outcomes(
    make: Callable[[Mapping[str, float]], Vehicle], values: Mapping[str, float], speed: float, ambient: float
) -> tuple[float, ...]:
    return steady(make(values), speed, ambient).outcomes


def _ends(
    vehicle: Vehicle, speed: float, ambient: float, progress: Callable[[str, int], Callable[[float], None]]
) -> tuple[dict[str, tuple[tuple[float, ...], tuple[float, ...]]], dict[str, str]]:
    """Outcomes with each value at either end of its range; and reasons for fixed values."""
    ends, fixed, make, fits = {}, {}, variants(vehicle), absorbing_fits(vehicle, speed, ambient)
    paths = [path for path in scalars(vehicle) if path not in CONDITIONS]
    advance = progress("each value alone", len(paths))
    for path in paths:
        quantity = vehicle.parameters[path]
        advance(1)
        if quantity.high <= quantity.low:
            continue
        if path in fits:
            fixed[path] = f"the fit of {fits[path]} has absorbed its error"
            continue
        try:
            low, high = (_outcomes(make, {path: value}, speed, ambient) for value in (quantity.low, quantity.high))
            ends[path] = low, high
        except InputError as error:
            fixed[path] = f"it cannot change alone: {error.given}; allowed: {error.allowed}"
    return ends, fixed


def draw_tornado(result: SensitivityResult, outcome: str, path: Path) -> Path:
    """Outcome at the ends of each value's range, and its shares of the variance."""
    from trackres_ros.output.style import BLUE, GREY, ORANGE, picture

    indices, ranked = result.indices[outcome], result.ranked(outcome)[:MOST_SHOWN]
    names, middle = [short(p, list(indices)) for p in ranked], result.nominal[outcome]
    places = np.arange(len(ranked))[::-1]
    with picture(path, 9.5, 0.8 + 0.36 * len(ranked)) as figure:
        bars, shares = figure.subplots(1, 2, sharey=True)
        bars.barh(places, [indices[p].low - middle for p in ranked], color=BLUE, label="at its low")
        bars.barh(places, [indices[p].high - middle for p in ranked], color=ORANGE, label="at its high")
        bars.set_yticks(places, names)
        bars.set(xlabel=f"change of {NAMES[outcome]} [{UNITS[outcome]}]")
        bars.axvline(0.0, color=GREY, lw=0.8)
        bars.legend(loc="lower right")
        first = np.array([(indices[p].first, indices[p].first_pm) for p in ranked])
        total = np.array([(indices[p].total, indices[p].total_pm) for p in ranked])
        for shift, name, index, colour in ((0.15, "alone", first, BLUE), (-0.15, "with others", total, ORANGE)):
            value, half = 100.0 * index.T
            shares.errorbar(value, places + shift, xerr=half, fmt="o", ms=4, color=colour, label=name, capsize=2)
        shares.set(xlabel="share of the variance [%]", xlim=(min(0.0, shares.get_xlim()[0]), None))
        shares.axvline(0.0, color=GREY, lw=0.8)
        shares.legend(loc="lower right")
    return path

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two designs side by side: steady states, drives, resistance over speed and belt temperature, and the uncertainty of the
difference.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.errors import InputError, one_line
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import find_vehicle
from trackres_ros.model.coverage import OVERSPEED, beyond, beyond_data
from trackres_ros.model.operating_point import INACTIVE, explain_road, left_out_at, vehicle_state
from trackres_ros.model.track import track_models
from trackres_ros.text import figures, table
from trackres_ros.tools.design.drives import STAGES, DriveCycle, check_weight, left_out, read_cycle, run_cycle, with_factors
from trackres_ros.tools.design.steady import J_PER_KWH, WARMEST_K, Array, FileErrors, Steady, remarks_on, solver, steady
from trackres_ros.tools.design.uncertain import LogDerivatives, difference_std, sensitivities, slopes_of
from trackres_ros.units import GRAVITY, KMH_PER_MPS
from trackres_ros.vehicle import RoadVehicle, Vehicle, load, load_any
from trackres_ros.vehicle.road import SECTION

POINTS, MOST_VALUES, MOST_CONDITIONS = 5, 25, 200
SLOWEST_SHARE = 0.1  # of the maximum speed, of vehicles without belts, and of slow ones on tracks
SLOWEST_KMH, USUAL_KMH, COLDEST_DEGC, WARMEST_DEGC = 5.0, 30.0, -20.0, 80.0
BELTS_DEGC, AIR_DEGC = (-60.0, 150.0), (-60.0, 60.0)  # limits of belt and air temperature
STEADY = {
    "cold_nm": ("resistance, cold belts", "Nm"),
    "warm_nm": ("resistance, warm belts", "Nm"),
    "belt_degc": ("belt temperature", "degC"),
    "kwh_per_km": ("energy, warm belts", "kWh/km"),
}
DRIVEN = {
    "kwh_per_km": ("energy", "kWh/km"),
    "mean_resistance_nm": ("mean resistance", "Nm"),
    "warmest_belt_degc": ("warmest belt", "degC"),
}
OPTIONS = "--speed-kmh", "--belt-degc", "--ambient-degc", "--weight-kn", "--cycle"
TWO_SIDED_95 = 1.96
CRAWL_MPS = 1e-6  # with less everywhere, a mean over the way is one over time
SLOPE_POINTS = 3  # belt temperatures at which it is looked at how sure the loss is


@dataclass(frozen=True, slots=True)
class ComparisonRequest:
    """Conditions for the comparison of two designs."""

    vehicles: tuple[Vehicle, Vehicle]
    # of the table of resistance
    speeds_kmh: tuple[float, ...]
    belts_degc: tuple[float, ...]
    steady_kmh: tuple[float, ...]  # speeds of the steady states
    # air, and whole weights; None is each vehicle's own
    ambients_degc: tuple[float, ...]
    weights_n: tuple[float | None, ...]
    cycles: tuple[DriveCycle, ...]
    options: frozenset[str]  # given options of `ambient` and `load`: they replace recorded values

    @property
    def points(self) -> int:
        """How many operating points, steady states and drives there are."""
        grid = len(self.speeds_kmh) * len(self.belts_degc)
        return 2 * (grid + len(self.ambients_degc) * len(self.weights_n) * (len(self.steady_kmh) + len(self.cycles)))


def request_of(
    names: Sequence[str],
    *,
    speed_kmh: str | None = None,
    belt_degc: str | None = None,
    ambient_degc: str | None = None,
    weight_kn: str | None = None,
    cycle: tuple[str, ...] = (),
) -> ComparisonRequest | None:
    """Conditions to compare two vehicle files with tracks, by the options of `trackres compare`; None for anything else.

    Raises InputError if an option is not valid, or is given for something else.
    """
    files = vehicle_files(names, "tracks")
    if not files:
        for name, value in zip(OPTIONS, (speed_kmh, belt_degc, ambient_degc, weight_kn, cycle), strict=True):
            if value:
                text = ", ".join(value) if isinstance(value, tuple) else value
                raise InputError(name, text, "only with two vehicle files with tracks")
        return None
    first, second = (load(file) for file in files)
    vehicles = first, second
    fastest = min(v.chassis.max_speed for v in vehicles)
    fastest_kmh = KMH_PER_MPS * fastest
    usual = (SLOWEST_KMH if fastest_kmh > SLOWEST_KMH else SLOWEST_SHARE * fastest_kmh, fastest_kmh)
    speeds = numbers("--speed-kmh", speed_kmh or ":".join(map(str, usual)), (0.1, OVERSPEED * fastest_kmh))
    belts = numbers("--belt-degc", belt_degc or f"{COLDEST_DEGC}:{WARMEST_DEGC}", BELTS_DEGC)
    steady_kmh = speeds if speed_kmh else (min(USUAL_KMH, fastest_kmh),)
    air = (first.chassis.ambient,) if ambient_degc is None else numbers("--ambient-degc", ambient_degc, AIR_DEGC)
    weights: tuple[float | None, ...] = (None,)
    if weight_kn is not None:
        weights = tuple(1e3 * kn for kn in numbers("--weight-kn", weight_kn, (0.1, 1e5)))
        for vehicle, weight in itertools.product(vehicles, weights):
            check_weight(vehicle, weight or 0.0)
    cycles = tuple(read_cycle(name, fastest) for name in cycle or (STAGES,))
    options = (("ambient", ambient_degc), ("load", weight_kn))
    conditions = len(air) * len(weights) * (len(steady_kmh) + len(cycles))
    if conditions > MOST_CONDITIONS:
        raise InputError(", ".join(OPTIONS), f"{conditions} conditions", f"at most {MOST_CONDITIONS}")
    chosen = frozenset(role for role, value in options if value is not None)
    return ComparisonRequest(vehicles, speeds, belts, steady_kmh, air, weights, cycles, chosen)


def vehicle_files(names: Sequence[str], section: str) -> list[Path]:
    """The vehicle files of names or paths; none if one of them is no such file, or lacks the section."""
    try:
        files = [find_vehicle(name) for name in names]
    except InputError:
        return []
    return files if all(section in read_yaml(file) for file in files) else []


def numbers(option: str, text: str, limits: tuple[float, float]) -> tuple[float, ...]:
    """The numbers of `A`, `A:B`, `A:B:N` and `A,B,C`; `A:B` is five, evenly spaced.

    Raises InputError on anything else, or beyond the limits.
    """
    low, high = limits
    try:
        if ":" in text:
            begin, end, *count_text = text.split(":")
            (count,) = map(int, count_text or [str(POINTS)])
            first, last = float(begin), float(end)
            if not (2 <= count <= MOST_VALUES and first < last):
                raise ValueError
            values = [round(first + i * (last - first) / (count - 1), 4) for i in range(count)]
        else:
            values = [float(item) for item in text.split(",")]
        if not (
            values and len(values) <= MOST_VALUES and all(low <= x <= high for x in values) and len(set(values)) == len(values)
        ):
            raise ValueError
    except ValueError:
        allowed = f"A, A:B with A < B, A:B:N or A,B,C, at most {MOST_VALUES} numbers from {figures(low)} to {figures(high)}"
        raise InputError(option, text, allowed) from None
    return tuple(values)


def compare_designs(request: ComparisonRequest, advance: Callable[[float], None] = lambda _: None) -> dict[str, Any]:
    """Two vehicles at the same conditions.

    `advance`: called after each point.

    Returns
    -------
    dict
        Ready for JSON. `designs`: of each vehicle torque [Nm] and coefficient (resistance over weight) by belt temperature and
        speed, and the totals of the first drive. `steady` and `drives`: a row for each condition and outcome with both values
        and their difference. Its standard deviations are those by the ranges that both files have in common, and by all.
        `remarks`: on belts outside the rubber data, loads outside the table, and effects that a drive leaves out.
    """
    names = display_names(request.vehicles)
    slopes = _Slopes(request)
    estimators = [Estimator(vehicle) for vehicle in request.vehicles]
    rows_steady, rows_driven, states, remarks, totals = [], [], [], [], []
    for air, weight in itertools.product(request.ambients_degc, request.weights_n):
        place = {"ambient_degc": air, "weight_kn": [(v.weight if weight is None else weight) / 1e3 for v in request.vehicles]}
        for kmh in request.steady_kmh:
            pair = [steady(vehicle, kmh / KMH_PER_MPS, air, weight) for vehicle in request.vehicles]
            states.append((kmh / KMH_PER_MPS, air, pair))
            rows_steady += _rows({"speed_kmh": kmh, **place}, STEADY, *_steady(request, slopes, kmh, air, weight, pair))
            advance(2)
        for cycle in request.cycles:
            outcome, remark_lists, drive_totals = _drive_outcomes(request, slopes, estimators, cycle, air, weight)
            totals.append(drive_totals)
            remarks += [
                f"{name} on {cycle.name}: {text}" for name, texts in zip(names, remark_lists, strict=True) for text in texts
            ]
            rows_driven += _rows({"cycle": cycle.name, "recorded": cycle.conditions(request.options), **place}, DRIVEN, *outcome)
            advance(2)
    designs = [_grid(request, vehicle, name, advance) for vehicle, name in zip(request.vehicles, names, strict=True)]
    for design, first in zip(designs, totals[0], strict=True):
        tonnes, each_km = first["carried_n"] / GRAVITY / 1000.0, first["kwh_per_km"]
        design["drive"] = {
            "km": first["distance_m"] / 1000.0, "kwh_per_km": each_km, "wh_per_km_and_t": 1000.0 * each_km / tonnes,
        }  # fmt: skip
    notes = [note for cycle in request.cycles for note in cycle.notes]
    for vehicle, name in zip(request.vehicles, names, strict=True):
        if inactive := left_out_at(vehicle, request.steady_kmh[0] / KMH_PER_MPS, request.ambients_degc[0]):
            notes.append(f"steady states and table of resistance of {name}: {', '.join(inactive)}: {INACTIVE}")
    return {
        "speeds_kmh": list(request.speeds_kmh), "belts_degc": list(request.belts_degc), "designs": designs, "steady": rows_steady,
        "drives": rows_driven, "notes": notes,
        "remarks": [*_remarks(request, names, states), *dict.fromkeys(remarks)],
    }  # fmt: skip


def _remarks(
    request: ComparisonRequest, names: Sequence[str], states: Sequence[tuple[float, float, Sequence[Steady]]]
) -> list[str]:
    """Sentences on belts outside the rubber data, of steady states with speed [m/s] and air [degC], and of the table."""
    speeds, air, pairs = zip(*states, strict=True)
    belts, of_table = (x.ravel() for x in np.meshgrid(request.belts_degc, np.array(request.speeds_kmh) / KMH_PER_MPS))
    remarks = []
    for vehicle, name, of_vehicle in zip(request.vehicles, names, zip(*pairs, strict=True), strict=True):
        texts = remarks_on(vehicle, speeds, air, of_vehicle)
        remarks += [f"{name}: {text}" for text in texts]
        texts = beyond_data(vehicle, of_table, {assembly.name: belts for assembly in vehicle.assemblies})
        remarks += [f"{name}, table of resistance: {text}" for text in texts]
    return remarks


def display_names(vehicles: Sequence[Vehicle]) -> list[str]:
    """Names of the vehicles; two versions of one vehicle have one name, and go by their files, or by the paths of these."""
    own_names, stems, paths = zip(*((v.name, one_line(v.source.stem), one_line(str(v.source))) for v in vehicles), strict=True)
    return list(next((names for names in (own_names, stems, paths) if len(set(names)) == len(names)), stems))


class _Slopes:
    """Sensitivities of a vehicle over belt temperatures, at the nearest of three speeds."""

    def __init__(self, request: ComparisonRequest) -> None:
        air, speeds = request.ambients_degc, sorted(request.steady_kmh)
        belts = np.linspace(min(air), max(air) + 0.75 * WARMEST_K, SLOPE_POINTS)
        self._speeds = {kmh / KMH_PER_MPS for kmh in (speeds[0], speeds[len(speeds) // 2], speeds[-1])}
        self._by_speed = lru_cache(maxsize=None)(lambda number, speed: slopes_of(request.vehicles[number], speed, belts))

    def __call__(self, number: int, speed: float) -> LogDerivatives:
        return self._by_speed(number, min(self._speeds, key=lambda nearby: abs(nearby - speed)))


def _steady(
    request: ComparisonRequest, slopes: _Slopes, kmh: float, air: float, weight: float | None, pair: Sequence[Steady]
) -> tuple[list[Array], Array, Array]:
    """Outcomes of both vehicles, and how sure the difference is."""
    speed, values, changes = kmh / KMH_PER_MPS, [], []
    for number, (vehicle, state) in enumerate(zip(request.vehicles, pair, strict=True)):
        solve = solver(vehicle, speed, air, weight)

        def outcomes(
            errors: FileErrors, _capacity: float, solve: Callable[[FileErrors], Steady] = solve, state: Steady = state
        ) -> Array:
            return np.array((state if errors == FileErrors(errors.track) else solve(errors)).outcomes)

        warm = state.belt_degc if math.isfinite(state.belt_degc) else air
        values.append(np.array(state.outcomes))
        changes.append(sensitivities(slopes(number, speed), outcomes, np.array([air, warm, warm, warm])))
    return values, *difference_std(request.vehicles, (changes[0], changes[1]))


def _drive_outcomes(
    request: ComparisonRequest, slopes: _Slopes, estimators: Sequence[Estimator], cycle: DriveCycle, air: float,
    weight: float | None,
) -> tuple[tuple[list[Array], Array, Array], list[list[str]], list[dict[str, float]]]:  # fmt: skip
    """Outcomes of both vehicles and how sure the difference is, their remarks, and their totals."""
    values, changes, remarks, totals = [], [], [], []
    ambient = None if "ambient" in cycle.conditions(request.options) else air
    for number, estimator in enumerate(estimators):

        def outcomes(errors: FileErrors, capacity: float, estimator: Estimator = estimator) -> Array:
            sums, _ = run_cycle(with_factors(estimator, errors, capacity), cycle, weight, ambient)
            return np.array([sums[name] for name in DRIVEN])

        sums, columns = run_cycle(estimator, cycle, weight, ambient)
        carried = np.average(columns["weight_n"], weights=np.maximum(np.abs(columns["speed_mps"]), CRAWL_MPS))
        totals.append({**sums, "carried_n": float(carried)})
        remarks.append([*beyond(estimator.vehicle, columns), *left_out(columns)])
        values.append(np.array([sums[name] for name in DRIVEN]))
        speed = sums["distance_m"] / max(sums["under_way_s"], 1.0)
        mean = 0.5 * (sums["coldest_belt_degc"] + sums["warmest_belt_degc"])
        changes.append(sensitivities(slopes(number, speed), outcomes, np.full(len(DRIVEN), mean)))
    return (values, *difference_std(request.vehicles, (changes[0], changes[1]))), remarks, totals


def _rows(
    place: dict[str, Any], names: dict[str, tuple[str, str]], values: list[Array], common: Array, all_: Array
) -> list[dict[str, Any]]:
    first, second = values
    return [
        {
            **place, "outcome": name, "unit": unit, "one": _plain(first[i]), "other": _plain(second[i]),
            "difference": _plain(second[i] - first[i]), "std": _plain(common[i]), "std_with_changed": _plain(all_[i]),
        }
        for i, (name, (_, unit)) in enumerate(names.items())
    ]  # fmt: skip


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _grid(request: ComparisonRequest, vehicle: Vehicle, name: str, advance: Callable[[float], None]) -> dict[str, Any]:
    weight, models = request.weights_n[0] or vehicle.weight, track_models(vehicle)
    torque, coefficient = np.empty((2, len(request.belts_degc), len(request.speeds_kmh)))
    for i, degc in enumerate(request.belts_degc):
        for j, kmh in enumerate(request.speeds_kmh):
            belts = [degc] * len(vehicle.assemblies)
            state = vehicle_state(vehicle, kmh / KMH_PER_MPS, belts, request.ambients_degc[0], weight, models=models)
            torque[i, j], coefficient[i, j] = state.torque["resistance"], state.force / weight
            advance(1)
    return {"vehicle": name, "weight_n": weight, "torque_nm": torque.tolist(), "coefficient": coefficient.tolist()}


def interval(row: Mapping[str, Any], key: str) -> float | None:
    """Half-width of the 95 % interval of a row's difference."""
    return None if row[key] is None else TWO_SIDED_95 * row[key]


def wheels_compared(names: Sequence[str]) -> list[dict[str, Any]] | None:
    """Resistance and energy of two vehicle files without belts at five speeds; None of anything else.

    Returns speed [km/h]; of each file the resistance at its wheels [Nm] and over the way [N], energy [kWh/km], and the effects
    that are left out.
    """
    vehicles = [vehicle for vehicle in map(load_any, vehicle_files(names, SECTION)) if isinstance(vehicle, RoadVehicle)]
    if not vehicles:
        return None
    fastest = min(vehicle.chassis.max_speed for vehicle in vehicles)
    rows = []
    for speed in np.linspace(SLOWEST_SHARE * fastest, fastest, POINTS).tolist():
        states = [explain_road(vehicle, speed) for vehicle in vehicles]
        torques = [state["torque_nm"]["resistance"] for state in states]
        forces = [torque / vehicle.constants.radius for torque, vehicle in zip(torques, vehicles, strict=True)]
        energy = [1e3 * force / J_PER_KWH for force in forces]
        row = {"speed_kmh": KMH_PER_MPS * speed, "resistance_nm": torques, "force_n": forces, "kwh_per_km": energy}
        rows.append({**row, "effects_left_out": [state["effects_left_out"] for state in states]})
    return rows


def wheels_text(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    """The same as a table to read."""
    head = ["km/h", *(f"{name} [{unit}]" for unit in ("Nm", "N", "kWh/km") for name in names)]
    cells = [
        [figures(row["speed_kmh"]), *(figures(x) for key in ("resistance_nm", "force_n", "kwh_per_km") for x in row[key])]
        for row in rows
    ]
    inactive = zip(names, rows[0]["effects_left_out"], strict=True)
    notes = [f"{', '.join(effects)} of {name}: {INACTIVE}" for name, effects in inactive if effects]
    return "\n".join(["", "Resistance on the level, straight on", table(cells, head), *notes])

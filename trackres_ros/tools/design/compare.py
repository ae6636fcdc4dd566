# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two designs side by side: steady states, drives, resistance over speed and belt temperature.

How sure a difference is comes from draws of both vehicles, see `draws`.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
from trackres_ros.tools.design.draws import distribution, draws, uncertain_values
from trackres_ros.tools.design.drives import STAGES, DriveCycle, check_weight, estimator_of, left_out, read_cycle, run_cycle
from trackres_ros.tools.design.steady import J_PER_KWH, Array, Steady, remarks_on, steady
from trackres_ros.tools.design.values import AIR_DEGC, POINTS, numbers
from trackres_ros.units import GRAVITY, KMH_PER_MPS
from trackres_ros.vehicle import RoadVehicle, Vehicle, load, load_any, variants
from trackres_ros.vehicle.road import SECTION

MOST_CONDITIONS = 200
DRAWS = 256
SLOWEST_SHARE = 0.1  # of the maximum speed, of vehicles without belts, and of slow ones on tracks
SLOWEST_KMH, USUAL_KMH, COLDEST_DEGC, WARMEST_DEGC = 5.0, 30.0, -20.0, 80.0
BELTS_DEGC = (-60.0, 150.0)  # limits of belt temperatures
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
CRAWL_MPS = 1e-6  # with less everywhere, a mean over the way is one over time


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
    draws: int
    seed: int

    @property
    def points(self) -> int:
        """How many operating points, steady states, drives and drawn vehicles there are."""
        grid = len(self.speeds_kmh) * len(self.belts_degc)
        states = len(self.ambients_degc) * len(self.weights_n) * (len(self.steady_kmh) + len(self.cycles))
        return 2 * (grid + states + 2 * self.draws)

    @property
    def conditions(self) -> Iterator[tuple[float, float | None]]:
        """Each pair of air [degC] and weight [N]."""
        return itertools.product(self.ambients_degc, self.weights_n)

    def air_of(self, cycle: DriveCycle, air: float) -> float | None:
        """Air of a drive [degC]; None where it is as recorded."""
        return None if "ambient" in cycle.conditions(self.options) else air


def request_of(
    names: Sequence[str],
    *,
    speed_kmh: str | None = None,
    belt_degc: str | None = None,
    ambient_degc: str | None = None,
    weight_kn: str | None = None,
    cycle: tuple[str, ...] = (),
    draws: int = DRAWS,
    seed: int = 1,
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
    return ComparisonRequest(vehicles, speeds, belts, steady_kmh, air, weights, cycles, chosen, draws, seed)


def vehicle_files(names: Sequence[str], section: str) -> list[Path]:
    """The vehicle files of names or paths; none if one of them is no such file, or lacks the section."""
    try:
        files = [find_vehicle(name) for name in names]
    except InputError:
        return []
    return files if all(section in read_yaml(file) for file in files) else []


def compare_designs(request: ComparisonRequest, advance: Callable[[float], None] = lambda _: None) -> dict[str, Any]:
    """Two vehicles at the same conditions.

    `advance`: called after each point and draw, with the number of vehicles.

    Returns
    -------
    dict
        Ready for JSON. `designs`: of each vehicle torque [Nm] and coefficient (resistance over weight) by belt temperature and
        speed, and the totals of the first drive. `steady` and `drives`: a row for each condition and outcome, with both values,
        their difference, and of the draws 95 % intervals and the probability that the second has less. `remarks`: on belts
        outside the rubber data, loads outside the table, effects that a drive leaves out, and impossible draws.
    """
    names = display_names(request.vehicles)
    estimators = [Estimator(vehicle) for vehicle in request.vehicles]
    rows_steady, rows_driven, rows, states, remarks, totals = [], [], [], [], [], []
    for air, weight in request.conditions:
        place = {"ambient_degc": air, "weight_kn": [(v.weight if weight is None else weight) / 1e3 for v in request.vehicles]}
        for kmh in request.steady_kmh:
            pair = [steady(vehicle, kmh / KMH_PER_MPS, air, weight) for vehicle in request.vehicles]
            states.append((kmh / KMH_PER_MPS, air, pair))
            rows_steady += (new := _rows({"speed_kmh": kmh, **place}, STEADY, *(state.outcomes for state in pair)))
            rows += new
            advance(2)
        for cycle in request.cycles:
            sums, texts = zip(*(_drive(request, estimator, cycle, air, weight) for estimator in estimators), strict=True)
            totals.append(sums)
            remarks += [f"{name} on {cycle.name}: {text}" for name, lines in zip(names, texts, strict=True) for text in lines]
            place |= {"cycle": cycle.name, "recorded": cycle.conditions(request.options)}
            rows_driven += (new := _rows(place, DRIVEN, *([each[name] for name in DRIVEN] for each in sums)))
            rows += new
            advance(2)
    drawn, reasons = _drawn_outcomes(request, estimators, advance)
    _with_draws(rows, drawn)
    if reasons:
        remarks.append(
            f"{len(reasons)} of {4 * request.draws} drawn vehicles are impossible and dropped, the first: {reasons[0]}"
        )
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
        "drives": rows_driven, "draws": request.draws, "notes": notes,
        "remarks": [*_remarks(request, names, states), *dict.fromkeys(remarks)],
    }  # fmt: skip


def _drive(
    request: ComparisonRequest, estimator: Estimator, cycle: DriveCycle, air: float, weight: float | None
) -> tuple[dict[str, float], list[str]]:
    """Totals of a drive, with the mean weight over its way [N], and remarks."""
    sums, columns = run_cycle(estimator, cycle, weight, request.air_of(cycle, air))
    carried = np.average(columns["weight_n"], weights=np.maximum(np.abs(columns["speed_mps"]), CRAWL_MPS))
    return {**sums, "carried_n": float(carried)}, [*beyond(estimator.vehicle, columns), *left_out(columns)]


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


def _drawn_outcomes(
    request: ComparisonRequest, estimators: Sequence[Estimator], advance: Callable[[float], None]
) -> tuple[list[Array], list[str]]:
    """Outcomes of both designs in each draw, shape (2, draws, outcomes) each, and reasons for impossible vehicles.

    First with the values that differ as the files have them, then with these drawn too. The outcomes are in the order of
    `_outcomes`; nan for an impossible vehicle.
    """
    speed, air = request.steady_kmh[0] / KMH_PER_MPS, request.ambients_degc[0]
    uncertain = [uncertain_values(vehicle, speed, air) for vehicle in request.vehicles]
    first, second = (vehicle.parameters for vehicle in request.vehicles)
    equal = {path for path, quantity in first.items() if path in second and quantity.value == second[path].value}
    shared = [{path: quantity for path, quantity in quantities.items() if path in equal} for quantities in uncertain]
    makers = [variants(vehicle) for vehicle in request.vehicles]
    width = sum(1 for _ in request.conditions) * (len(STEADY) * len(request.steady_kmh) + len(DRIVEN) * len(request.cycles))
    drawn, reasons = [], []
    for quantities in (shared, uncertain):
        outcomes = np.full((2, request.draws, width), np.nan)
        for number, values in enumerate(draws(quantities, request.draws, request.seed)):
            for i, (make, like) in enumerate(zip(makers, estimators, strict=True)):
                try:
                    outcomes[i, number] = _outcomes(request, estimator_of(make(values[i]), like))
                except InputError as error:
                    reasons.append(one_line(str(error)))
            advance(2)
        drawn.append(outcomes)
    return drawn, reasons


def _outcomes(request: ComparisonRequest, estimator: Estimator) -> list[float]:
    """Outcomes of the steady states, then of the drives, one pair of air and weight after the other."""
    vehicle, outcomes = estimator.vehicle, list[float]()
    assert isinstance(vehicle, Vehicle)  # designs have tracks
    for air, weight in request.conditions:
        for kmh in request.steady_kmh:
            outcomes += steady(vehicle, kmh / KMH_PER_MPS, air, weight).outcomes
        for cycle in request.cycles:
            sums, _ = run_cycle(estimator, cycle, weight, request.air_of(cycle, air))
            outcomes += [sums[name] for name in DRIVEN]
    return outcomes


def _with_draws(rows: list[dict[str, Any]], drawn: Sequence[Array]) -> None:
    """Add intervals and probabilities to the rows of all outcomes, in the order of the draws' columns."""
    as_files_say, all_ = ([distribution(*pair) for pair in np.moveaxis(outcomes, 2, 0)] for outcomes in drawn)
    for row, certain, uncertain in zip(rows, as_files_say, all_, strict=True):
        row |= {
            "difference_95": certain.difference, "probability_less": certain.less,
            "difference_95_with_changed": uncertain.difference, "probability_less_with_changed": uncertain.less,
            "one_95": uncertain.one, "other_95": uncertain.other,
        }  # fmt: skip


def _rows(
    place: dict[str, Any], names: dict[str, tuple[str, str]], first: Sequence[float], second: Sequence[float]
) -> list[dict[str, Any]]:
    return [
        {**place, "outcome": name, "unit": unit, "one": _plain(one), "other": _plain(other), "difference": _plain(other - one)}
        for (name, (_, unit)), one, other in zip(names.items(), first, second, strict=True)
    ]


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

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds the common parts of the reproduction: the vehicle with every combination of loss method and thermal model, runs, figures,
tables, and the paper's claims with a computed verdict each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trackres_ros.arrays import Array
from trackres_ros.estimator.drives import SimulatedDrive, ramp_and_hold, simulate
from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.own_files import write
from trackres_ros.model.track import with_methods
from trackres_ros.output.style import STEPS, legend_beside, picture, thin_out
from trackres_ros.text import figures
from trackres_ros.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HOLDS, FAILS, IN_PART, OPEN = "holds", "does not hold", "holds in part", "cannot be checked"
INK = "#404040"
UNEXPLAINED = "No reason is on file for this outcome: the model or the vehicle file has changed since the reasons were written."


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, the program's result on it, and reasons.

    `holds` is the outcome of the predicate by model combination, or under an empty name without combinations; it is empty if the
    claim cannot be checked.
    """

    key: str  # a stable name
    where: str  # the place in the paper
    paper: str  # its statement
    holds: Mapping[str, bool]
    shows: str  # the program's result, with its numbers
    why: Mapping[str, str]  # reasons by verdict: of `HOLDS`, `FAILS` and `IN_PART` those that are understood
    numbers: Mapping[str, Any]  # behind the verdict, by name and unit
    details: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # results by heading, then by combination

    @property
    def verdict(self) -> str:
        """`HOLDS`, `FAILS`, `IN_PART` or `OPEN`, from the predicates alone."""
        outcomes = set(self.holds.values())
        if not outcomes:
            return OPEN
        return IN_PART if len(outcomes) > 1 else HOLDS if outcomes == {True} else FAILS

    def summary(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        result: dict[str, Any] = rounded(asdict(self))
        return result | {"verdict": self.verdict, "why": self.why.get(self.verdict, UNEXPLAINED)}


@dataclass(frozen=True)
class Figure:
    """A picture with its data: file names in the output folder, and its caption."""

    png: str
    data: tuple[str, ...]
    caption: str


@dataclass(frozen=True)
class Table:
    """Rows of text below a header."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Section:
    """One heading of the page."""

    title: str
    text: Sequence[str]
    figures: Sequence[Figure]
    claims: Sequence[Claim] = ()
    tables: Sequence[Table] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        result: dict[str, Any] = rounded(asdict(self))
        return result | {"claims": [claim.summary() for claim in self.claims]}


def write_csv(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Columns of one length, numbers with six significant digits, nan as an empty cell; names end in the unit."""

    def cell(value: float | str) -> str:
        return value if isinstance(value, str) else "" if math.isnan(value) else f"{value:.6g}"

    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(cell, row)) for row in rows)]
    write(path, ("\n".join(lines) + "\n").encode())


def rounded(value: Any) -> Any:
    """Numbers of a nested mapping or sequence to six significant digits, ready for JSON."""
    if isinstance(value, Mapping):
        return {str(key): rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    return float(f"{float(value):.6g}")


def percent(share: float, digits: int = 1) -> str:
    """A share as text in percent."""
    return f"{100.0 * share:.{digits}f} %"


def span(values: Iterable[float], digits: int = 0, unit: str = "") -> str:
    """The least and the greatest of some values as text, `3 to 5 Nm`; one of them where both read alike."""
    values = list(values)
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return (low if low == high else f"{low} to {high}") + unit


def percents(shares: Iterable[float], digits: int = 1) -> str:
    """The least and the greatest of some shares in percent, `3 to 5 %`."""
    return span((100.0 * share for share in shares), digits, " %")


def listed(items: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return items[0] if len(items) == 1 else ", ".join(items[:-1]) + f" and {items[-1]}"


Series = dict[str, Array]
Runs = dict[str, Series]

METHODS = ("spectral", "rainflow")
THERMAL = ("lumped", "core_surface")
COMBINATIONS = tuple(f"{method}/{thermal}" for method in METHODS for thermal in THERMAL)
STEADY_AFTER_S = 20_000.0  # at constant speed; the slowest time constant is under 2000 s
STEADY_STEP_S = 20.0  # the step follows the linearised model exactly, so the end point does not depend on it


class Stable(NamedTuple):
    """Steady state of a drive at constant speed."""

    torque_nm: float
    hysteresis_nm: float
    belt_degc: float


@dataclass
class Bench:
    """The vehicle as its file names the methods, and as every other combination."""

    vehicle: Vehicle
    dt: float  # time step of the drives [s]
    advance: Callable[[str], None]  # called after each run with what was run
    _estimators: dict[str, Estimator] = field(default_factory=dict)

    @property
    def shipped(self) -> str:
        """The combination that the vehicle file names."""
        return f"{self.vehicle.hysteresis}/{self.vehicle.thermal}"

    def estimator(self, combination: str) -> Estimator:
        """The estimator of a combination, made once."""
        if combination not in self._estimators:
            method, thermal = combination.split("/")
            self._estimators[combination] = Estimator(with_methods(self.vehicle, method, thermal))
        return self._estimators[combination]

    def run(self, name: str, drive: SimulatedDrive, weight_n: float | None = None, ambient_degc: float | None = None) -> Runs:
        """The series of `simulate.series_of` along a drive, by combination."""
        runs = {}
        for combination in COMBINATIONS:
            runs[combination] = simulate(self.estimator(combination), drive, weight_n, ambient_degc)
            self.advance(f"{name}, {combination}")
        return runs

    def stable(self, combination: str, speed: float, weight_n: float | None = None, ambient_degc: float | None = None) -> Stable:
        """Torques and belt temperature that a constant speed [m/s] tends to."""
        drive = ramp_and_hold(speed, 0.0, STEADY_AFTER_S, STEADY_STEP_S)
        series = simulate(self.estimator(combination), drive, weight_n, ambient_degc)
        return Stable(*(float(series[name][-1]) for name in ("resistance_torque_nm", "hysteresis_nm", "belt_degc")))


def at_times(series: Series, column: str, times_s: ArrayLike) -> Array:
    """Values of a column at times [s], shape of `times_s`."""
    return np.asarray(np.interp(np.asarray(times_s, float), series["time_s"], series[column]))


CSV_STEP_S = 20.0
SAME = 0.01  # values are the same that differ by less than 1 %: three times the error of the program's own loss table


@dataclass(frozen=True)
class Family:
    """Runs of one study: for each varied value, for each combination."""

    name: str  # of the files, such as fig24_speeds
    quantity: str  # varied quantity, with its unit: "speed [km/h]"
    suffix: str  # of a column in the CSV: "kmh"
    values: tuple[float, ...]
    runs: Mapping[float, Runs]
    stable: Mapping[float, Mapping[str, Stable]]

    def series(self, combination: str) -> list[Series]:
        """The runs of one combination in the order of the values."""
        return [self.runs[value][combination] for value in self.values]

    def torque(self, combination: str, start_s: float, column: str = "resistance_torque_nm") -> Array:
        """A torque [Nm] of each value from a time [s] on, shape (values, times)."""
        return np.stack([s[column][s["time_s"] >= start_s - 1e-9] for s in self.series(combination)])

    def warmed(self, time_s: float) -> dict[str, Array]:
        """Rise of the belt temperature [K] up to a time [s] by combination, shape (values,)."""
        return {
            c: np.array([float(at_times(s, "belt_degc", time_s) - s["belt_degc"][0]) for s in self.series(c)])
            for c in COMBINATIONS
        }

    def stable_torque(self, combination: str) -> Array:
        """Torque [Nm] that each value tends to, shape (values,)."""
        return np.array([self.stable[value][combination].torque_nm for value in self.values])


def run_family(
    bench: Bench,
    name: str,
    quantity: str,
    suffix: str,
    values: Sequence[float],
    case: Callable[[float], tuple[SimulatedDrive, float | None, float | None]],
) -> Family:
    """Run a drive for each value; `case` gives the drive, the weight [N] and the ambient temperature [degC] of a value."""
    runs, stable = {}, {}
    for value in values:
        drive, weight, ambient = case(value)
        runs[value] = bench.run(f"{quantity.split(' [')[0]} {value:g}", drive, weight, ambient)
        stable[value] = {c: bench.stable(c, float(drive.speed[-1]), weight, ambient) for c in COMBINATIONS}
    return Family(name, quantity, suffix, tuple(values), runs, stable)


def write_family(out: Path, family: Family) -> str:
    """The CSV of a family: torque and belt temperature of each value and combination every 20 s. Returns its name."""
    end = family.series(COMBINATIONS[0])[0]["time_s"][-1]
    times = np.arange(0.0, end + 1e-9, CSV_STEP_S)
    columns: dict[str, Array] = {"time_s": times}
    for combination in COMBINATIONS:
        for value, series in zip(family.values, family.series(combination), strict=True):
            tag = f"{value:g}{family.suffix}_{combination.replace('/', '_')}"
            columns[f"resistance_torque_nm_{tag}"] = at_times(series, "resistance_torque_nm", times)
            columns[f"belt_degc_{tag}"] = at_times(series, "belt_degc", times)
    write_csv(out / f"{family.name}.csv", columns)
    return f"{family.name}.csv"


def mark_time(axes: Axes, time_s: float, text: str) -> None:
    """A dotted line at a time with a remark at its top."""
    axes.axvline(time_s, color=INK, linewidth=0.8, linestyle=":")
    places = (time_s, 0.98), (4, 0), ("data", "axes fraction"), "offset points"
    axes.annotate(text, *places, ha="left", va="top", fontsize=8, color=INK)


def draw_family(out: Path, family: Family, combination: str, caption: str, title: str, marks: Mapping[float, str]) -> Figure:
    """Torque over temperature of one combination, which caption and title then name, one line a value."""
    methods = combination.replace("/", ", ")
    figure = Figure(f"{family.name}.png", (write_family(out, family),), f"{caption}; {methods}.")
    with picture(out / figure.png, 8.5, 5.6) as drawing:
        torque, belt = drawing.subplots(2, 1, sharex=True, height_ratios=(1.4, 1.0))
        for colour, value, series in zip(colours(family), family.values, family.series(combination), strict=True):
            torque.plot(*moving(series), color=colour, label=f"{value:g}")
            belt.plot(*thin_out(series["time_s"], series["belt_degc"]), color=colour)
        torque.set_ylim(*_limits(family, combination))
        torque.set_title(f"{title}; {methods}")
        torque.set_ylabel("resistance torque [Nm]")
        legend_beside(torque, family.quantity)
        belt.set_ylabel("belt temperature [°C]")
        belt.set_xlabel("time [s]")
        for time_s, text in marks.items():
            mark_time(torque, time_s, text)
            mark_time(belt, time_s, "")
        belt.margins(x=0.01)
        drawing.align_ylabels()
    return figure


def _limits(family: Family, combination: str) -> tuple[float, float]:
    """Limits of a torque axis [Nm] that show the time at constant speed whole; a ramp may come in from below."""
    shown = family.torque(combination, 0.0)[:, first_comparable(family) :], family.stable_torque(combination)
    low, high = min(float(part.min()) for part in shown), max(float(part.max()) for part in shown)
    return low - 0.15 * (high - low), high + 0.06 * (high - low)


def first_comparable(family: Family) -> int:
    """First sample at which every run has reached its final speed."""
    return max(int(np.argmax(s["speed_mps"] >= s["speed_mps"][-1] - 1e-9)) for s in family.series(COMBINATIONS[0]))


def moving(series: Series) -> tuple[Array, Array]:
    """Time and resistance torque without the first instant at rest, where the torque is zero, thinned for a picture."""
    torque = np.where(series["speed_mps"] > 0.0, series["resistance_torque_nm"], np.nan)
    return thin_out(series["time_s"], torque)


def colours(family: Family) -> Sequence[str]:
    """Light to dark along the values."""
    return STEPS[-len(family.values) :] if len(family.values) < len(STEPS) else STEPS


def time_table(family: Family, combination: str, times_s: Sequence[float]) -> Table:
    """Torque and belt temperature of each value at some times, and the stable ones."""
    rows = []
    for value, series in zip(family.values, family.series(combination), strict=True):
        torque, belt = (at_times(series, column, times_s) for column in ("resistance_torque_nm", "belt_degc"))
        stable = family.stable[value][combination]
        pairs = [*zip(torque, belt, strict=True), (stable.torque_nm, stable.belt_degc)]
        rows.append([f"{value:g}", *(f"{m:.0f} / {t:.1f}" for m, t in pairs)])
    caption = f"Resistance torque [Nm] / belt temperature [°C]; {combination.replace('/', ', ')}."
    return Table(caption, [family.quantity, *(f"{t:g} s" for t in times_s), "stable"], rows)


def stable_table(family: Family) -> Table:
    """Stable torque and belt temperature of each value by combination."""
    rows = [
        [f"{value:g}", *(f"{stable[c].torque_nm:.0f} / {stable[c].belt_degc:.1f}" for c in COMBINATIONS)]
        for value, stable in ((value, family.stable[value]) for value in family.values)
    ]
    caption = "Stable resistance torque [Nm] / belt temperature [°C] by combination."
    return Table(caption, [family.quantity, *(c.replace("/", ", ") for c in COMBINATIONS)], rows)


def family_numbers(family: Family, times_s: Sequence[float]) -> dict[str, object]:
    """Torques and temperatures at some times and the stable ones, by combination and value."""

    def of(value: float, combination: str) -> dict[str, object]:
        series, stable = family.runs[value][combination], family.stable[value][combination]
        return {
            "time_s": list(times_s),
            "torque_nm": at_times(series, "resistance_torque_nm", times_s).tolist(),
            "belt_degc": at_times(series, "belt_degc", times_s).tolist(),
            "stable": stable._asdict(),
        }

    return {c: {f"{value:g}": of(value, c) for value in family.values} for c in COMBINATIONS}


def spread(values: Array) -> float:
    """Greatest less least value over their mean."""
    return float(np.ptp(values) / np.mean(values))


def section_of(
    bench: Bench,
    family: Family,
    title: str,
    times_s: Sequence[float],
    pictures: Sequence[Figure],
    claims: Sequence[Claim],
    text: Sequence[str],
    **numbers: object,
) -> Section:
    """The section of a study: its tables at some times and when stable, and their numbers."""
    tables = [time_table(family, bench.shipped, times_s), stable_table(family)]
    of_all = [*text, *hot_belts(bench, family)]
    return Section(title, of_all, pictures, claims, tables, {**family_numbers(family, times_s), **numbers})


def hot_belts(bench: Bench, family: Family) -> list[str]:
    """A remark on steady belts that are hotter than the compound's sweep; empty without any."""
    last = float(bench.vehicle.rubber.sweep_degc[-1])
    hot = []
    for c in COMBINATIONS:
        values = [value for value in family.values if family.stable[value][c].belt_degc > last]
        if values:
            belts = span((family.stable[value][c].belt_degc for value in values), 0, " °C")
            hot.append(f"{c.replace('/', ', ')} at {family.quantity} {listed([f'{value:g}' for value in values])} ({belts})")
    remark = f"Stable belts beyond the compound's sweep, which ends at {last:g} °C: {'; '.join(hot)}."
    return [remark] if hot else []


def falls(key: str, where: str, family: Family, start_s: float) -> Claim:
    """The torque only falls with time at constant speed, from a time [s] on."""
    torque = {c: family.torque(c, start_s) for c in COMBINATIONS}
    rises = {c: float(np.diff(m, axis=1).max()) for c, m in torque.items()}
    shares = {c: 1.0 - m[:, -1] / m[:, 0] for c, m in torque.items()}
    end = family.series(COMBINATIONS[0])[0]["time_s"][-1]
    largest = max(rises.values())
    return Claim(
        f"{key}_torque_falls",
        where,
        "The torque gradually decreases with time.",
        {c: rises[c] < 0 for c in COMBINATIONS},
        f"From {start_s:.0f} to {end:.0f} s it falls by {percents(np.concatenate(list(shares.values())), 0)}, "
        + ("from every sample to the next." if largest < 0 else f"and rises by up to {figures(largest, 2)} Nm between samples."),
        {HOLDS: "The belt starts at ambient temperature, the loss warms it, and a warmer compound loses less."},
        {"fall": {c: s.tolist() for c, s in shares.items()}, "largest_rise_nm": rises},
        {f"fall, over {family.quantity}": {c: percents(s, 0) for c, s in shares.items()}},
    )


def same_stable(key: str, where: str, paper: str, family: Family, why: str) -> Claim:
    """All values of a family have the same steady torque, within `SAME`."""
    stable = {c: family.stable_torque(c) for c in COMBINATIONS}
    start = {c: spread(family.torque(c, 0.0)[:, first_comparable(family)]) for c in COMBINATIONS}
    end = {c: spread(values) for c, values in stable.items()}
    shrinks = all(end[c] < start[c] for c in COMBINATIONS)
    return Claim(
        f"{key}_same_stable_value",
        where,
        paper,
        {c: end[c] < SAME for c in COMBINATIONS},
        f"The stable torques differ by {percents(end.values())} of their mean, after {percents(start.values())} when the speed "
        f"is reached. Less than {percent(SAME, 0)} would be the same.",
        {FAILS: why + (" The differences shrink with time; they do not vanish." if shrinks else "")},
        {"spread_stable": end, "spread_start": start, "stable_nm": {c: values.tolist() for c, values in stable.items()}},
        {
            "stable torques": {c: span(values, 0, " Nm") for c, values in stable.items()},
            "their spread": {c: percent(s) for c, s in end.items()},
            "spread when the speed is reached": {c: percent(s) for c, s in start.items()},
        },
    )

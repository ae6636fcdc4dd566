# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits the shift of a compound: that with which isotherms of all frequencies lie on one master curve.

The splines of the master curve are eliminated for each shift (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10
(1973) 413), so that the least squares are over one to three numbers: WLF or Arrhenius, with or without the bend at the glass
transition. A number more is taken where it gains evidence and its interval excludes that it is not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from trackres_ros.compound.master import MasterCurve, chosen_penalty, master_curve, smooth
from trackres_ros.compound.prony import Prony, fit_prony
from trackres_ros.compound.reading import Sweep
from trackres_ros.compound.shift import ABSOLUTE_ZERO_DEGC, Shift
from trackres_ros.errors import InputError
from trackres_ros.model.rubber import REFERENCE_ABOVE_TG
from trackres_ros.text.numbers import decimals, figures
from trackres_ros.vehicle import Vehicle
from trackres_ros.vehicle.schema import RUBBER

Array = NDArray[np.float64]

WLF, ARRHENIUS, KEPT = "WLF", "Arrhenius", "kept"
SWEEP_FREQUENCY = RUBBER["sweep_frequency"]
WIDEST_LOG_STD = 0.35  # of the strength of the shift: known less than that, it is not known
CLEAR_BIC = 6.0  # "strong" evidence: Kass and Raftery, J. Am. Stat. Assoc. 90 (1995) 773
FEWEST_DECADES = 0.3  # of frequency, for a shift to be seen
SURE = 0.95
FIRST_PENALTY = np.array([0.3, 0.3])
START_BELOW_K = (15.0, 50.0, 110.0)  # of the pole below the coldest row
START_STRENGTHS = (200.0, 450.0, 900.0, 1600.0, 3000.0, 6000.0)
ISOTHERM_K = 2.5  # rows nearer than that may share an error: their temperature, their clamping
BOTH_SIDES = 3  # isotherms on each side of a bend
WIDEST_GLASS_K = 20.0  # an interval of the glass transition that is wider says nothing
UNDERSMOOTHED = 0.1  # of the penalty of the master curve: bends of the curve that are smoothed away are laid to the shift
NO_BEND_K = 1.0  # above the pole: a glass transition that lies below all data


@dataclass(frozen=True, slots=True)
class Value:
    """A fitted value with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class CompoundFit:
    """A fitted compound.

    Parameters
    ----------
    sweep
        The data.
    law, why
        Law of the shift, and why that.
    shift
        The shift.
    values
        ``glass_transition``, ``wlf_c1``, ``wlf_c2`` as the vehicle file takes them.
    glass_is_seen
        Whether the glass transition is a result; else it is a reference by convention.
    energy
        Activation energy [J/mol] where the law is Arrhenius'.
    master, prony
        Master curve, and the Prony series that both moduli have in common.
    """

    sweep: Sweep
    law: str
    why: str
    shift: Shift
    values: dict[str, Value]
    glass_is_seen: bool
    energy: Value | None
    master: MasterCurve
    prony: Prony

    @property
    def rms(self) -> tuple[float, float]:
        """Of the natural logarithms of storage and loss modulus about the master curve."""
        storage, loss = np.sqrt((self.master.residuals**2).mean(axis=0))
        return float(storage), float(loss)


@dataclass(frozen=True, eq=False)
class _Found:
    """One law fitted: its numbers, their covariance, and -2 ln likelihood with the price of the numbers."""

    law: _Law
    theta: Array
    covariance: Array
    dof: float
    bic: float

    @property
    def shift(self) -> Shift:
        return self.law.shift(self.theta)

    def value(self, of: Callable[[Array], float], limits: tuple[float, float] = (-np.inf, np.inf)) -> Value:
        """A function of the numbers, with its interval by the delta method."""
        centre = of(self.theta)
        step = 1e-4 * np.maximum(np.sqrt(np.diag(self.covariance)), 1e-6)
        slope = np.array([(of(self.theta + s) - of(self.theta - s)) / (2.0 * s.sum()) for s in np.diag(step)])
        wide = float(student.ppf(0.5 + 0.5 * SURE, self.dof)) * float(np.sqrt(slope @ self.covariance @ slope))
        return Value(centre, max(centre - wide, min(limits[0], centre)), min(centre + wide, max(limits[1], centre)))


@dataclass(frozen=True, eq=False)
class _Law:
    """A law of the shift as a function of numbers to be fitted."""

    name: str
    shift: Callable[[Array], Shift]
    low: Array
    high: Array
    starts: tuple[Array, ...]


def fit_compound(sweep: Sweep, vehicle: Vehicle) -> CompoundFit:
    """Fit what a rubber file and the shift of a vehicle file hold.

    Parameters
    ----------
    sweep
        Of one frequency or several.
    vehicle
        Whose shift is kept where the data do not show one.

    Raises
    ------
    InputError
        If the shift found is none that a vehicle file may hold.
    """
    at = float(np.clip(sweep.frequencies[0], SWEEP_FREQUENCY.low, SWEEP_FREQUENCY.high))
    decades = float(np.log10(sweep.frequency.max() / sweep.frequency.min()))
    if decades < FEWEST_DECADES:
        return _kept(sweep, vehicle, at, "one frequency shows none, so that of the vehicle file stays")
    arrhenius, wlf, bent = (_fitted(sweep, law, at) for law in _laws(sweep, vehicle))
    pole = wlf.value(lambda theta: theta[1])
    gain = arrhenius.bic - wlf.bic
    if gain > CLEAR_BIC and pole.low > ABSOLUTE_ZERO_DEGC:
        best, why = wlf, (
            f"the shift steepens towards a pole at {decimals(pole.value)} degC ({decimals(pole.low)} to {decimals(pole.high)}), "
            f"Arrhenius' would be at 0 K; BIC better by {decimals(gain)}"
        )  # fmt: skip
    else:
        best, why = (
            arrhenius,
            f"WLF, with a number more, betters BIC by {decimals(gain)} alone, where {figures(CLEAR_BIC)} is strong evidence",
        )
        if gain > CLEAR_BIC:
            why = f"the pole of a WLF shift is not told from 0 K ({decimals(pole.low)} to {decimals(pole.high)} degC)"
    glass = bent.value(lambda theta: theta[2])
    bend_gain = best.bic - bent.bic
    isotherms = np.unique(np.round(sweep.temp_degc / ISOTHERM_K)) * ISOTHERM_K
    below, above = (isotherms < glass.value).sum(), (isotherms > glass.value).sum()
    seen = bend_gain > CLEAR_BIC and min(below, above) >= BOTH_SIDES and np.ptp([glass.low, glass.high]) < WIDEST_GLASS_K
    if seen:
        best = bent
        why = (
            f"the shift steepens as WLF's down to {decimals(glass.value)} degC and is straight below: BIC better by "
            f"{decimals(bend_gain)} than without the bend, by {decimals(arrhenius.bic - bent.bic)} than Arrhenius'"
        )  # fmt: skip
    if float(np.sqrt(best.covariance[0, 0])) > WIDEST_LOG_STD:
        return _kept(sweep, vehicle, at, "these frequencies tell it too little, so that of the vehicle file stays")
    return _of_law(sweep, vehicle, at, best, seen, why)


def _laws(sweep: Sweep, vehicle: Vehicle) -> tuple[_Law, _Law, _Law]:
    """Arrhenius, WLF, and WLF with the bend at the glass transition."""
    coldest, warmest = float(sweep.temp_degc.min()), float(sweep.temp_degc.max())
    strengths = [log(s) for s in START_STRENGTHS]
    weakest, strongest = log(20.0), log(5e4)
    poles = [coldest - below for below in START_BELOW_K]
    rubber = vehicle.rubber
    first = Shift.of_wlf(rubber.glass_transition, rubber.wlf_c1, rubber.wlf_c2)
    spans = (1.0, 250.0)  # of Tg above the pole, with which C2 is what the file may hold

    def free(pole: float) -> float:
        return pole + NO_BEND_K

    arrhenius = _Law(
        ARRHENIUS,
        lambda th: Shift(exp(th[0]), ABSOLUTE_ZERO_DEGC, free(ABSOLUTE_ZERO_DEGC)),
        np.array([weakest]),
        np.array([strongest]),
        tuple(np.array([s]) for s in strengths),
    )
    wlf = _Law(
        WLF,
        lambda th: Shift(exp(th[0]), th[1], free(th[1])),
        np.array([weakest, ABSOLUTE_ZERO_DEGC]),
        np.array([strongest, coldest - 2.0 * NO_BEND_K]),
        tuple(np.array([s, max(p, ABSOLUTE_ZERO_DEGC + 1.0)]) for s in strengths for p in poles),
    )
    glasses = [coldest + share * (warmest - coldest) for share in (0.15, 0.3, 0.5)]
    if coldest < first.glass_transition < warmest:
        glasses.append(first.glass_transition)
    bent = _Law(
        WLF,
        lambda th: Shift(exp(th[0]), th[2] - th[1], th[2]),
        np.array([weakest, spans[0], max(coldest - 20.0, RUBBER["glass_transition"].low)]),
        np.array([strongest, spans[1], min(warmest, RUBBER["glass_transition"].high)]),
        tuple(np.array([s, span, glass]) for s in strengths[1:5] for span in (30.0, 60.0) for glass in glasses),
    )
    return arrhenius, wlf, bent


def _fitted(sweep: Sweep, law: _Law, at: float) -> _Found:
    """Least squares of one law from the best of its starts."""
    inner = [np.clip(start, law.low + 1e-6, law.high - 1e-6) for start in law.starts]

    def residuals(theta: Array, penalty: Array, scale: Array) -> Array:
        return np.asarray((smooth(sweep, law.shift(theta), at, penalty).penalised / scale).ravel(order="F"))

    penalty, scale = FIRST_PENALTY, np.array([0.02, 0.04])
    theta = min(inner, key=lambda start: float((residuals(start, penalty, scale) ** 2).sum()))
    for _ in range(2):
        theta = least_squares(
            residuals,
            theta,
            bounds=(law.low, law.high),
            x_scale=np.maximum(np.abs(theta), 0.1),
            args=(penalty, scale),
            max_nfev=60,
        ).x
        shift = law.shift(theta)
        penalty = UNDERSMOOTHED * chosen_penalty(sweep, shift, at)
        scale = np.maximum(np.sqrt((smooth(sweep, shift, at, penalty).residuals ** 2).mean(axis=0)), 1e-6)
    found = least_squares(
        residuals, theta, bounds=(law.low, law.high), x_scale=np.maximum(np.abs(theta), 0.1), args=(penalty, scale), max_nfev=60
    )
    last = smooth(sweep, law.shift(found.x), at, penalty).residuals
    scores = len(last) * np.log((last**2).mean(axis=0)).sum()
    independent = np.linalg.pinv(found.jac.T @ found.jac) * float((last / scale).ravel() @ (last / scale).ravel())
    independent /= max(last.size - len(found.x), 1)
    shared, groups = _jackknife(sweep, law, at, found.x, penalty, scale)
    wider = np.sqrt(np.maximum(np.diag(shared) / np.maximum(np.diag(independent), 1e-300), 1.0))
    dof = float(max(groups - len(found.x), 2))
    return _Found(law, found.x, independent * np.outer(wider, wider), dof, float(scores + len(found.x) * np.log(last.size)))


def _jackknife(sweep: Sweep, law: _Law, at: float, theta: Array, penalty: Array, scale: Array) -> tuple[Array, int]:
    """Covariance of the numbers, and of how many isotherms: each is left out once.

    Rows of one isotherm may share an error (of temperature, of clamping), which the splines follow where isotherms lie apart;
    leaving them out whole shows what that does to the shift (Efron, The Jackknife, the Bootstrap and Other Resampling Plans,
    1982, ch. 3). One Gauss-Newton step from the fit to all is taken for the fit to the others.
    """
    isotherm = np.unique(np.round(sweep.temp_degc / ISOTHERM_K), return_inverse=True)[1].ravel()
    groups = int(isotherm.max()) + 1
    moved = np.zeros((groups, len(theta)))
    step = 1e-4 * np.maximum(np.abs(theta), 1.0)
    for group in range(groups):
        others = sweep.some(isotherm != group)

        def left(numbers: Array, others: Sweep = others) -> Array:
            return np.asarray((smooth(others, law.shift(numbers), at, penalty).penalised / scale).ravel(order="F"))

        now = left(theta)
        inwards = np.where(theta + step < law.high, step, -step)
        slopes = np.column_stack([(left(theta + s) - now) / s.sum() for s in np.diag(inwards)])
        moved[group] = np.linalg.lstsq(slopes, -now, rcond=None)[0]
    return (groups - 1) / groups * (moved - moved.mean(axis=0)).T @ (moved - moved.mean(axis=0)), groups


def _of_law(sweep: Sweep, vehicle: Vehicle, at: float, found: _Found, seen: bool, why: str) -> CompoundFit:
    """The fit in the terms of the vehicle file: a glass transition that is not seen is a reference below the data."""
    free = found.shift
    coldest = float(sweep.temp_degc.min())
    glass = free.glass_transition
    if not seen:
        limits = RUBBER["glass_transition"]
        glass = min(vehicle.rubber.glass_transition, coldest, free.pole + RUBBER["wlf_c2"].high - REFERENCE_ABOVE_TG)
        glass = max(glass, free.pole + RUBBER["wlf_c2"].low - REFERENCE_ABOVE_TG, limits.low)

    def glass_of(theta: Array) -> float:
        return found.law.shift(theta).glass_transition if seen else glass

    def c2_of(theta: Array) -> float:
        return glass_of(theta) + REFERENCE_ABOVE_TG - found.law.shift(theta).pole

    def c1_of(theta: Array) -> float:
        return found.law.shift(theta).strength / c2_of(theta)

    values = {}
    for name, of in (("glass_transition", glass_of), ("wlf_c1", c1_of), ("wlf_c2", c2_of)):
        limits = RUBBER[name]
        values[name] = found.value(of, (limits.low, limits.high))
        if not limits.low <= values[name].value <= limits.high:
            given = f"data whose shift has {name} = {figures(values[name].value)} {limits.unit} ({found.law.name})"
            remedy = "check units of frequency and temperature; leave out what was measured in the glass"
            raise InputError(str(sweep.path), given, f"{limits.low:g} to {limits.high:g} {limits.unit}", remedy)
    shift = Shift(free.strength, free.pole, glass)
    energy = None
    if found.law.name == ARRHENIUS:
        energy = found.value(lambda theta: found.law.shift(theta).activation_energy)
    return _finished(sweep, found.law.name, why, shift, values, seen, energy, at)


def _kept(sweep: Sweep, vehicle: Vehicle, at: float, why: str) -> CompoundFit:
    """With the shift of the vehicle file, and its ranges."""
    rubber = vehicle.rubber
    values = {}
    for name in ("glass_transition", "wlf_c1", "wlf_c2"):
        q = vehicle.parameters[f"rubber.{name}"]
        values[name] = Value(getattr(rubber, name), q.low, q.high)
    shift = Shift.of_wlf(rubber.glass_transition, rubber.wlf_c1, rubber.wlf_c2)
    return _finished(sweep, KEPT, why, shift, values, False, None, at)


def _finished(
    sweep: Sweep, law: str, why: str, shift: Shift, values: dict[str, Value], seen: bool, energy: Value | None, at: float
) -> CompoundFit:
    master = master_curve(sweep, shift, at)
    return CompoundFit(sweep, law, why, shift, values, seen, energy, master, fit_prony(sweep, shift, master))

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits a compound: chooses the law of its shift, with intervals.

The laws are Arrhenius', WLF, and WLF with the bend at the glass transition. Another parameter is added if it gains evidence and
its interval excludes the simpler law.
"""

from dataclasses import dataclass
from math import exp, log

import numpy as np

from trackres_ros.errors import InputError
from trackres_ros.model.rubber import REFERENCE_ABOVE_TG
from trackres_ros.text import decimals, figures
from trackres_ros.tools.compound.master import MasterCurve, master_curve
from trackres_ros.tools.compound.prony import Prony, fit_prony
from trackres_ros.tools.compound.reading import Array, Sweep
from trackres_ros.tools.compound.shift import ABSOLUTE_ZERO_DEGC, Shift
from trackres_ros.tools.compound.superposition import ISOTHERM_K, FittedShift, Law, Value, fitted, with_power
from trackres_ros.vehicle import Vehicle
from trackres_ros.vehicle.description import RUBBER

WLF, ARRHENIUS, KEPT = "WLF", "Arrhenius", "kept"
SWEEP_FREQUENCY = RUBBER["sweep_frequency"]
WIDEST_LOG_STD = 0.35  # of the strength of the shift: with a larger error, it is unknown
CLEAR_BIC = 6.0  # "strong" evidence: Kass and Raftery, J. Am. Stat. Assoc. 90 (1995) 773
FEWEST_DECADES = 0.3  # of frequency, for a shift to be observable
START_BELOW_K = (15.0, 50.0, 110.0)  # of the pole below the coldest row
START_STRENGTHS = (200.0, 450.0, 900.0, 1600.0, 3000.0, 6000.0)
BOTH_SIDES = 3  # isotherms on each side of a bend
WIDEST_GLASS_K = 20.0  # a wider interval of the glass transition is uninformative
MOST_ROWS = 2000  # that the shift is fitted to; of a longer sweep some are drawn
BETTER_RMS = 0.1  # a vertical shift that betters rms by less is not worth a remark
OVERLAPPING = 0.5  # of neighbouring isotherms: with less overlap, only the splines between them determine the shift
NO_BEND_K = 1.0  # above the pole: a glass transition that lies below all data


@dataclass(frozen=True, eq=False)
class CompoundFit:
    """A fitted compound."""

    sweep: Sweep
    # law of the shift, and the reason for it
    law: str
    why: str
    shift: Shift
    values: dict[str, Value]  # ``glass_transition``, ``wlf_c1``, ``wlf_c2`` for the vehicle file
    glass_is_seen: bool  # whether the glass transition is a result; else it is a reference by convention
    energy: Value | None  # activation energy [J/mol] for Arrhenius' law
    # power of absolute temperature in a vertical shift of the moduli, and rms of both moduli with it; None if that is not clear.
    # The shift is that fitted with it; the model has no vertical shift, and the moduli of the fit exclude it
    power: Value | None
    with_power: tuple[float, float] | None
    # master curve, and the common Prony series of both moduli
    master: MasterCurve
    prony: Prony

    @property
    def rms(self) -> tuple[float, float]:
        """Of the natural logarithms of storage and loss modulus about the master curve."""
        storage, loss = np.sqrt((self.master.residuals**2).mean(axis=0))
        return float(storage), float(loss)


def fit_compound(sweep: Sweep, vehicle: Vehicle) -> CompoundFit:
    """Fit the content of a rubber file and the shift of a vehicle file.

    `sweep`: of one frequency or several; `vehicle`: its shift is kept if the data do not show one. Raises InputError if a vehicle
    file may not hold the fitted shift.
    """
    frequency = float(np.clip(sweep.frequencies[0], SWEEP_FREQUENCY.low, SWEEP_FREQUENCY.high))
    decades = float(np.log10(sweep.frequency.max() / sweep.frequency.min()))
    if decades < FEWEST_DECADES:
        given = f"{len(sweep.frequencies)} frequencies within a factor of {figures(10.0**decades, 2)} do"
        if len(sweep.frequencies) == 1:
            given = "one frequency does"
        return _file_shift(sweep, vehicle, frequency, f"{given} not determine it, so the vehicle file's shift stays")
    rows = _sample_rows(sweep)
    arrhenius, wlf, bent_fit = (fitted(rows, law, frequency) for law in _laws(rows, vehicle))
    pole = wlf.value(lambda theta: theta[1])
    gain = arrhenius.bic - wlf.bic
    if gain > CLEAR_BIC and pole.low > ABSOLUTE_ZERO_DEGC:
        best_fit, reason = wlf, ""
    else:
        best_fit, reason = (
            arrhenius,
            f"WLF, with one more parameter, improves BIC by only {decimals(gain)}; {figures(CLEAR_BIC)} is strong evidence",
        )
        if gain > CLEAR_BIC:
            reason = (
                f"the pole of a WLF shift is not distinguishable from 0 K ({decimals(pole.low)} to {decimals(pole.high)} degC)"
            )
    glass = bent_fit.value(lambda theta: theta[2])
    bend_gain = best_fit.bic - bent_fit.bic
    isotherms = np.unique(np.round(sweep.temp_degc / ISOTHERM_K)) * ISOTHERM_K
    count_below, count_above = (isotherms < glass.value).sum(), (isotherms > glass.value).sum()
    is_visible = (
        bend_gain > CLEAR_BIC and min(count_below, count_above) >= BOTH_SIDES and np.ptp([glass.low, glass.high]) < WIDEST_GLASS_K
    )
    if is_visible:
        best_fit = bent_fit
        reason = (
            f"the shift steepens as WLF's down to {decimals(glass.value)} degC and is straight below: BIC better by "
            f"{decimals(bend_gain)} than without the bend, by {decimals(arrhenius.bic - bent_fit.bic)} than Arrhenius'"
        )  # fmt: skip
    if max(float(np.sqrt(c[0, 0])) for c in best_fit.covariances) > WIDEST_LOG_STD:
        return _file_shift(
            sweep, vehicle, frequency, "these frequencies determine it too poorly, so the vehicle file's shift stays"
        )
    if _overlapping(rows, best_fit.shift, decades) < OVERLAPPING:
        return _file_shift(
            sweep, vehicle, frequency, "the isotherms are too far apart to overlap, so the vehicle file's shift stays"
        )
    raised_fit = fitted(rows, with_power(best_fit), frequency)
    power = raised_fit.value(lambda theta: theta[-1])
    is_better = (
        max(1.0 - rms_after / rms_before for rms_after, rms_before in zip(raised_fit.rms, best_fit.rms, strict=True)) > BETTER_RMS
    )
    is_clear = is_better and best_fit.bic - raised_fit.bic > CLEAR_BIC and (power.low > 0.0 or power.high < 0.0)
    if best_fit is wlf:
        pole = (raised_fit if is_clear else wlf).value(lambda theta: theta[1])
        reason = (
            f"the shift steepens towards a pole at {decimals(pole.value)} degC ({decimals(pole.low)} to {decimals(pole.high)}), "
            f"Arrhenius' would be at 0 K; BIC better by {decimals(gain)}"
        )  # fmt: skip
    return _of_law(sweep, vehicle, frequency, best_fit, raised_fit if is_clear else None, is_visible, reason)


def _sample_rows(sweep: Sweep) -> Sweep:
    """At most `MOST_ROWS` rows, the same each time."""
    count = len(sweep.storage)
    if count <= MOST_ROWS:
        return sweep
    is_drawn = np.zeros(count, dtype=bool)
    is_drawn[np.random.default_rng(0).choice(count, MOST_ROWS, replace=False)] = True
    return sweep.some(is_drawn)


def _overlapping(sweep: Sweep, shift: Shift, decades: float) -> float:
    """Share of neighbouring isotherms that overlap on the master curve."""
    isotherms = np.unique(np.round(sweep.temp_degc / ISOTHERM_K)) * ISOTHERM_K
    return float((np.abs(np.diff(shift.log_shift(isotherms))) < decades).mean())


def _laws(sweep: Sweep, vehicle: Vehicle) -> tuple[Law, Law, Law]:
    """Arrhenius, WLF, and WLF with the bend at the glass transition."""
    coldest_degc, warmest_degc = float(sweep.temp_degc.min()), float(sweep.temp_degc.max())
    strengths = [log(s) for s in START_STRENGTHS]
    log_weakest, log_strongest = log(20.0), log(5e4)
    poles = [coldest_degc - distance for distance in START_BELOW_K]
    rubber = vehicle.rubber
    first_shift = Shift.of_wlf(rubber.glass_transition, rubber.wlf_c1, rubber.wlf_c2)
    spans = (1.0, 250.0)  # of Tg above the pole, with which C2 is what the file may hold

    def free_strength(pole: float) -> float:
        return pole + NO_BEND_K

    arrhenius = Law(
        ARRHENIUS,
        lambda th: Shift(exp(th[0]), ABSOLUTE_ZERO_DEGC, free_strength(ABSOLUTE_ZERO_DEGC)),
        np.array([log_weakest]),
        np.array([log_strongest]),
        tuple(np.array([s]) for s in strengths),
    )
    wlf = Law(
        WLF,
        lambda th: Shift(exp(th[0]), th[1], free_strength(th[1])),
        np.array([log_weakest, ABSOLUTE_ZERO_DEGC]),
        np.array([log_strongest, coldest_degc - 2.0 * NO_BEND_K]),
        tuple(np.array([s, max(p, ABSOLUTE_ZERO_DEGC + 1.0)]) for s in strengths for p in poles),
    )
    glasses = [coldest_degc + share * (warmest_degc - coldest_degc) for share in (0.15, 0.3, 0.5)]
    if coldest_degc < first_shift.glass_transition < warmest_degc:
        glasses.append(first_shift.glass_transition)
    bent_law = Law(
        WLF,
        lambda th: Shift(exp(th[0]), th[2] - th[1], th[2]),
        np.array([log_weakest, spans[0], max(coldest_degc - 20.0, RUBBER["glass_transition"].low)]),
        np.array([log_strongest, spans[1], min(warmest_degc, RUBBER["glass_transition"].high)]),
        tuple(np.array([s, span, glass]) for s in strengths[1:5] for span in (30.0, 60.0) for glass in glasses),
    )
    return arrhenius, wlf, bent_law


def _of_law(
    sweep: Sweep,
    vehicle: Vehicle,
    frequency: float,
    bent_or_plain: FittedShift,
    raised_fit: FittedShift | None,
    is_visible: bool,
    reason: str,
) -> CompoundFit:
    """The fit in the terms of the vehicle file: an unobserved glass transition is a reference below the data.

    With a clear vertical shift, the shift is that of `raised_fit`: the other one depends on the selection of rows. The
    model has no vertical shift, and intervals include both.
    """

    def inner_theta(theta: Array) -> Array:
        return theta if raised_fit is None else theta[:-1]

    best_fit = raised_fit or bent_or_plain
    free_shift = bent_or_plain.law.shift(inner_theta(best_fit.theta))
    coldest_degc = float(sweep.temp_degc.min())
    glass = free_shift.glass_transition
    if not is_visible:
        limits = RUBBER["glass_transition"]
        glass = min(vehicle.rubber.glass_transition, coldest_degc, free_shift.pole + RUBBER["wlf_c2"].high - REFERENCE_ABOVE_TG)
        glass = max(glass, free_shift.pole + RUBBER["wlf_c2"].low - REFERENCE_ABOVE_TG, limits.low)

    def glass_of(theta: Array) -> float:
        return bent_or_plain.law.shift(theta).glass_transition if is_visible else glass

    def c2_of(theta: Array) -> float:
        return glass_of(theta) + REFERENCE_ABOVE_TG - bent_or_plain.law.shift(theta).pole

    def c1_of(theta: Array) -> float:
        return bent_or_plain.law.shift(theta).strength / c2_of(theta)

    values = {}
    for name, value_of in (("glass_transition", glass_of), ("wlf_c1", c1_of), ("wlf_c2", c2_of)):
        limits = RUBBER[name]
        values[name] = best_fit.value(lambda theta, of_name=value_of: of_name(inner_theta(theta)), (limits.low, limits.high))  # type: ignore[misc]
        if raised_fit is not None:
            values[name] = values[name].joined(bent_or_plain.value(value_of, (limits.low, limits.high)))
        if not limits.low <= values[name].value <= limits.high:
            given = f"data whose shift has {name} = {figures(values[name].value)} {limits.unit} ({bent_or_plain.law.name})"
            remedy = "check units of frequency and temperature; remove rows measured in the glassy state"
            raise InputError(str(sweep.path), given, f"{limits.low:g} to {limits.high:g} {limits.unit}", remedy)
    shift = Shift(free_shift.strength, free_shift.pole, glass)
    energy = None
    if bent_or_plain.law.name == ARRHENIUS:
        energy = best_fit.value(lambda theta: bent_or_plain.law.shift(inner_theta(theta)).activation_energy)
    power, rms = (None, None) if raised_fit is None else (raised_fit.value(lambda theta: theta[-1]), raised_fit.rms)
    master = master_curve(sweep, shift, frequency)
    prony = fit_prony(sweep, shift, master)
    return CompoundFit(sweep, bent_or_plain.law.name, reason, shift, values, is_visible, energy, power, rms, master, prony)


def _file_shift(sweep: Sweep, vehicle: Vehicle, frequency: float, reason: str) -> CompoundFit:
    """With the shift of the vehicle file, and its ranges."""
    rubber = vehicle.rubber
    values = {}
    for name in ("glass_transition", "wlf_c1", "wlf_c2"):
        q = vehicle.parameters[f"rubber.{name}"]
        values[name] = Value(getattr(rubber, name), q.low, q.high)
    shift = Shift.of_wlf(rubber.glass_transition, rubber.wlf_c1, rubber.wlf_c2)
    master = master_curve(sweep, shift, frequency)
    return CompoundFit(sweep, KEPT, reason, shift, values, False, None, None, None, master, fit_prony(sweep, shift, master))

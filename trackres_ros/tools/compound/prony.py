# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

r"""The Prony series that both moduli have in common: relaxation strengths of no negative sign, by bounded least squares.

$E'(\omega) = E_\infty + \sum_i E_i \frac{\omega^2 \tau_i^2}{1 + \omega^2 \tau_i^2}$ and
$E''(\omega) = \sum_i E_i \frac{\omega \tau_i}{1 + \omega^2 \tau_i^2}$ (Ferry, Viscoelastic Properties of
Polymers, 3rd ed., ch. 3) are Kramers-Kronig's relation for a linear solid. What they leave says whether storage modulus, loss
modulus and shift belong together.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import lsq_linear

from trackres_ros.tools.compound.master import MasterCurve
from trackres_ros.tools.compound.reading import Array, Sweep
from trackres_ros.tools.compound.shift import Shift

EACH_DECADE = 1.5  # terms: more cannot be distinguished (Baumgaertel and Winter, Rheol. Acta 28 (1989) 511)
BEYOND = 1.0  # decades on both sides of the data, whose tails reach in
MOST_TERMS = 60
REFERENCE_DEGC = 20.0
GUIDE_EACH_DECADE = 5  # points of the master curve, each with the weight of a row: between rows a series would oscillate
LEAST_WEIGHT = 0.01  # minimum relative error of a modulus


@dataclass(frozen=True, eq=False)
class Prony:
    """A Prony series."""

    reference_degc: float  # temperature [degC] of the relaxation times
    tau: Array  # relaxation times [s], rising, shape (terms,)
    # relaxation strengths [Pa] and their standard deviations, shape (terms,); first that of infinite time, E_inf
    strength: Array
    std: Array
    # of storage and loss modulus over their values, at the rows and at points of the master curve, shape (rows, 2), (points, 2)
    residuals: tuple[Array, Array]

    def moduli(self, frequency: ArrayLike) -> tuple[Array, Array]:
        """Storage and loss modulus [Pa] at frequencies [Hz] at the reference temperature."""
        storage, loss = _terms(np.atleast_1d(np.asarray(frequency, dtype=float)), self.tau)
        return storage @ self.strength, loss @ self.strength

    @property
    def rms(self) -> tuple[float, float]:
        """Of both moduli, relative; at the rows or along the master curve, whichever is larger."""
        storage, loss = np.max([np.sqrt((residual**2).mean(axis=0)) for residual in self.residuals], axis=0)
        return float(storage), float(loss)


def fit_prony(sweep: Sweep, shift: Shift, master: MasterCurve) -> Prony:
    """Fit both moduli of a shifted sweep at once, each relative to its value and error."""
    reference = float(np.clip(REFERENCE_DEGC, sweep.temp_degc.min(), sweep.temp_degc.max()))
    reference = max(reference, shift.glass_transition)  # WLF cannot be written about a temperature in the glass
    log_moved = shift.log_shift(sweep.temp_degc) - shift.log_shift(reference)
    log_f = np.log10(sweep.frequency) + log_moved
    low, high = -log_f.max() - BEYOND - np.log10(2.0 * np.pi), -log_f.min() + BEYOND - np.log10(2.0 * np.pi)
    count = int(np.clip(round(EACH_DECADE * (high - low)), 3, MOST_TERMS))
    tau = np.logspace(low, high, count)
    weight = 1.0 / np.maximum(master.scale, LEAST_WEIGHT)
    rows = _rows(log_f, tau, (sweep.storage, sweep.loss), weight)
    guide_degc = np.linspace(master.low_degc, master.high_degc, int(GUIDE_EACH_DECADE * (high - low)))
    log_guide = np.log10(master.at_frequency) + shift.log_shift(guide_degc) - shift.log_shift(reference)
    stacked_rows = np.vstack([rows, _rows(log_guide, tau, master.moduli(guide_degc), weight)])
    size = np.linalg.norm(stacked_rows, axis=0)
    target = np.repeat(weight, len(log_f))
    targets = np.concatenate([target, np.repeat(weight, len(guide_degc))])
    strengths_found = lsq_linear(stacked_rows / size, targets, (0.0, np.inf), method="bvls", max_iter=10 * len(size)).x / size
    std, is_used = np.zeros_like(strengths_found), strengths_found > 0.0
    residual = targets - stacked_rows @ strengths_found
    of_rows, of_guide = np.split(residual, [len(target)])
    freedom = max(len(target) - int(is_used.sum()), 1)
    scaled_rows = stacked_rows[:, is_used] / size[is_used]
    spread = np.diag(np.linalg.pinv(scaled_rows.T @ scaled_rows)) * len(residual) / len(target)  # the guide repeats the rows
    std[is_used] = np.sqrt(spread * float(of_rows @ of_rows) / freedom) / size[is_used]
    residuals = [(part / np.repeat(weight, len(part) // 2)).reshape(2, -1).T for part in (of_rows, of_guide)]
    return Prony(reference, tau, strengths_found, std, (residuals[0], residuals[1]))


def _rows(log_f: Array, tau: Array, moduli: tuple[Array, Array], weight: Array) -> Array:
    """Rows of least squares: contribution of each strength to both moduli, over their values and errors."""
    terms = _terms(10.0**log_f, tau)
    return np.vstack([part * (w / modulus)[:, None] for part, w, modulus in zip(terms, weight, moduli, strict=True)])


def _terms(frequency: Array, tau: Array) -> tuple[Array, Array]:
    """Contribution of each strength to both moduli, shape (frequencies, 1 + terms); first that of infinite time."""
    x = 2.0 * np.pi * frequency[:, None] * tau
    x2 = np.minimum(x, 1e100) ** 2
    rubber, no_rubber = np.ones((len(frequency), 1)), np.zeros((len(frequency), 1))
    return np.hstack([rubber, x2 / (1.0 + x2)]), np.hstack([no_rubber, x / (1.0 + x2)])

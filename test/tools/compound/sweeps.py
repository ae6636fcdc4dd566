# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sweeps of compounds whose shift is known.

Shifts, as quoted from J. D. Ferry, Viscoelastic Properties of Polymers, 3rd ed., Wiley 1980, Table 11-II (not held against the
book):
reference temperature, C1, C2, Tg.
Moduli: a Prony series of our own, in the shape of a rubber's: glass, softening, rubber.
"""

from pathlib import Path

import numpy as np

from trackres_ros.tools.compound.reading import Sweep
from trackres_ros.tools.compound.shift import Shift
from trackres_ros.units import ZERO_DEGC_K

FERRY_K = {
    "natural rubber": (248.0, 8.86, 101.6, 200.0),
    "SBR": (298.0, 4.57, 113.6, 210.0),
    "polyisobutylene": (298.0, 8.61, 200.4, 202.0),
}
LOG_TAU = np.linspace(-14.0, 6.0, 61)
STRENGTH = 2.6e7 * 10.0 ** (-0.55 * (LOG_TAU + 6.0)) / (1.0 + 10.0 ** (-1.08 * (LOG_TAU + 6.5)))
STRENGTH += 1.3e5 * 10.0 ** (-0.08 * (LOG_TAU + 6.0))
RUBBERY = 2e6
FREQUENCIES = np.logspace(-1.0, 1.7, 7)


def published(name):
    """The shift of a polymer in Ferry's table."""
    reference, c1, c2, glass = FERRY_K[name]
    return Shift(c1 * c2, reference - c2 - ZERO_DEGC_K, glass - ZERO_DEGC_K)


def moduli(log_f):
    """Storage and loss modulus [Pa] over the logarithm of the reduced frequency."""
    w = 2.0 * np.pi * 10.0 ** (np.asarray(log_f)[..., None] + LOG_TAU)
    return RUBBERY + (STRENGTH * w**2 / (1.0 + w**2)).sum(-1), (STRENGTH * w / (1.0 + w**2)).sum(-1)


def sweep(shift, temps, frequencies=FREQUENCIES, noise=0.005, shared=0.005, seed=0, about=None):
    """A sweep of isotherms with errors of each value (twice as large of the loss), and such as an isotherm shares."""
    temp, frequency = (x.ravel() for x in np.meshgrid(temps, frequencies, indexing="ij"))
    about = shift.glass_transition + 50.0 if about is None else about
    storage, loss = moduli(np.log10(frequency) + shift.log_shift(temp) - shift.log_shift(about))
    random = np.random.default_rng(seed)
    of_isotherm = shared * np.repeat(random.standard_normal(len(temps)), len(frequencies))
    errors = random.standard_normal((2, len(temp))) * np.array([[noise], [2.0 * noise]])
    return Sweep(
        Path("made.csv"), frequency, temp, storage * np.exp(of_isotherm + errors[0]), loss * np.exp(of_isotherm + errors[1])
    )

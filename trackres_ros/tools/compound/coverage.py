# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes the temperatures and frequencies of a vehicle's belts, and the share that a sweep covers by superposition."""

from dataclasses import dataclass
from math import floor

import numpy as np
from numpy.typing import NDArray

from trackres_ros.model.coverage import balance_degc
from trackres_ros.model.loss_table import loss_table
from trackres_ros.model.track import track_model
from trackres_ros.tools.compound.fitting import CompoundFit
from trackres_ros.units import KMH_PER_MPS
from trackres_ros.vehicle import Vehicle

SLOWEST_KMH = 5.0
POINTS = 60  # points per side of the grid that measures coverage
ROUNDING_K = 0.01


@dataclass(frozen=True, slots=True)
class Need:
    """Range of the belts of a vehicle."""

    # belt temperature [degC]: that of the coldest air of the file's range, and the steady one at the greatest speed in the
    # hottest
    coldest: float
    hottest: float
    # frequency [Hz]: of the belt's turns at 5 km/h, and of a road wheel's passage at the greatest speed
    slowest: float
    fastest: float


@dataclass(frozen=True, eq=False)
class Covered:
    """The share of a need that the data cover."""

    share: float  # of the rectangle of temperature and logarithm of frequency
    # coldest belt [degC] that is covered at the fastest and at the slowest frequency of the need
    coldest_fast: float
    coldest_slow: float
    # hottest belt [degC] that is covered at the fastest frequency or any, and at the slowest
    hottest: float
    hottest_slow: float

    def sentence(self, need: Need) -> str:
        """Covered and extrapolated ranges, in words."""
        belts = f"{need.coldest:.0f} to {need.hottest:.0f} degC, {need.slowest:.1f} to {need.fastest:.0f} Hz"
        text = f"The data cover {floor(100.0 * self.share)} % of what the vehicle's belts need ({belts})"
        gaps = []
        if self.coldest_slow > need.coldest:
            gaps.append(f"colder than {self.coldest_slow:.0f} degC at any frequency")
        if self.coldest_fast > max(need.coldest, self.coldest_slow):
            gaps.append(f"colder than {self.coldest_fast:.0f} degC at {need.fastest:.0f} Hz")
        if self.hottest < need.hottest:
            gaps.append(f"hotter than {self.hottest:.0f} degC")
        if self.hottest_slow < min(need.hottest, self.hottest):
            gaps.append(f"hotter than {self.hottest_slow:.0f} degC at {need.slowest:.1f} Hz")
        return f"{text}; extrapolated, with the last values held: {', '.join(gaps)}." if gaps else f"{text}."


def need_of(vehicle: Vehicle) -> Need:
    """Range of the belts of a vehicle."""
    air, top = vehicle.parameters["chassis.ambient"], vehicle.chassis.max_speed
    hottest_degc = max(balance_degc(vehicle, name, loss_table(vehicle, name), top, air.high) for name in vehicle.tracks)
    longest_loop = max(track.belt.loop_length for track in vehicle.tracks.values())
    loads = zip(vehicle.assemblies, vehicle.nominal_loads(), strict=True)
    contacts = [track_model(vehicle, assembly_load.track).loss.contacts(top, air.low, load) for assembly_load, load in loads]
    fastest_hz = float(max(contact.frequency.max() for contact in contacts))
    return Need(air.low, hottest_degc, SLOWEST_KMH / KMH_PER_MPS / longest_loop, fastest_hz)


def is_covered(fit: CompoundFit, frequency: NDArray[np.float64], temp_degc: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether data by superposition give the moduli at frequencies [Hz] and temperatures [degC], broadcast.

    The moduli of a belt hotter than any row are unknown at any frequency.
    """
    equivalent = fit.shift.equivalent_degc(frequency, temp_degc, fit.master.at_frequency)
    is_inside = (equivalent >= fit.master.low_degc - ROUNDING_K) & (equivalent <= fit.master.high_degc + ROUNDING_K)
    return np.asarray(is_inside & (temp_degc <= fit.sweep.temp_degc.max()))


def covered(fit: CompoundFit, need: Need) -> Covered:
    """Compute the share of a need that the data of a fit cover."""
    temp, log_f = np.meshgrid(
        np.linspace(need.coldest, need.hottest, POINTS), np.linspace(np.log10(need.slowest), np.log10(need.fastest), POINTS)
    )
    share = float(is_covered(fit, 10.0**log_f, temp).mean())

    def end(degc: float, frequency: float) -> float:
        return float(fit.shift.equivalent_degc(fit.master.at_frequency, degc, frequency))

    low, high = fit.master.low_degc, fit.master.high_degc
    return Covered(
        share, end(low, need.fastest), end(low, need.slowest), float(fit.sweep.temp_degc.max()), end(high, need.slowest)
    )

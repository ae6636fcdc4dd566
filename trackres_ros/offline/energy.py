# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Computes distance, time, resistance, energy and belt temperatures of a drive from rows of results."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trackres_ros.text.numbers import decimals
from trackres_ros.units import STANDSTILL_MPS

Array = NDArray[np.float64]

MEGA, MJ_PER_KWH = 1e6, 3.6
LONGEST_STEP_S, UNUSUAL = 1.0, 5.0  # or that many times the usual: data of a longer step are unknown


def steps_of(time_s: Array) -> Array:
    """Time from the row before to each row [s]; 0 for the first, after a gap, and where time does not rise."""
    step = np.diff(time_s, prepend=time_s[:1])
    longest = max(LONGEST_STEP_S, UNUSUAL * float(np.median(step)))
    return np.where((step > 0.0) & (step <= longest), step, 0.0)


def energy_j(step_s: Array, speed: Array, torque: Array, radius: float) -> float:
    """Energy of a torque at the sprockets [Nm] along a drive, shapes (rows,), with their radius [m]; unknown values add
    nothing.
    """
    return float(np.nansum(step_s * speed * torque)) / radius


def taken(time_s: Array, speed: Array, torque: Array, belts_degc: Array, radius: float) -> dict[str, float]:
    """Summary of a drive: distance, time, resistance, energy and temperatures, of the belts if there are any.

    Parameters
    ----------
    time_s, speed, torque
        Times [s], speeds [m/s] and resistance at the sprockets [Nm], shape (rows,).
    belts_degc
        Of each belt, shape (belts, rows) [degC]; empty without belts.
    radius
        Of the sprockets [m].
    """
    step = steps_of(time_s)
    under_way = np.where(np.abs(speed) > STANDSTILL_MPS, step, 0.0)
    energy_mj = energy_j(step, speed, torque, radius) / MEGA
    driven = float(np.nansum(step * np.abs(speed)))
    belts = {}
    if len(belts_degc):
        belts = {"coldest_belt_degc": float(np.nanmin(belts_degc)), "warmest_belt_degc": float(np.nanmax(belts_degc))}
    return {
        "distance_m": driven,
        "under_way_s": float(under_way.sum()),
        "mean_resistance_nm": float(np.nansum(under_way * np.abs(torque))) / max(float(under_way.sum()), 1e-9),
        "largest_resistance_nm": float(np.nanmax(np.abs(torque))),
        "energy_mj": energy_mj,
        "kwh_per_km": energy_mj / MJ_PER_KWH / max(driven / 1000.0, 1e-9) if driven > 0.0 else 0.0,
        **belts,
    }


def taken_text(of: Mapping[str, float]) -> str:
    """The same in a sentence."""
    if not of["under_way_s"]:
        return "The vehicle stood the whole time"
    way, minutes = decimals(of["distance_m"] / 1000.0, 2), decimals(of["under_way_s"] / 60.0, 1)
    mean, largest = decimals(of["mean_resistance_nm"]), decimals(of["largest_resistance_nm"])
    energy, each_km = decimals(of["energy_mj"], 1), decimals(of["kwh_per_km"], 2)
    belts = ""
    if "coldest_belt_degc" in of:
        belts = f"; belts {decimals(of['coldest_belt_degc'], 1)} to {decimals(of['warmest_belt_degc'], 1)} degC"
    return (
        f"The drive: {way} km, {minutes} min of driving; mean resistance {mean} Nm, at most {largest} Nm; {energy} MJ "
        f"({each_km} kWh/km){belts}"
    )

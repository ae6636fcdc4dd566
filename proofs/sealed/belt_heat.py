# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models the truth's belt temperature: heat conduction through the thickness, between an inner and an outer face."""

from __future__ import annotations

import math
from typing import Annotated

from trackres_ros.arrays import Array
from trackres_ros.kernels.marks import kernel

LAYERS = 15
KELVIN = 273.15


@kernel
def roll(
    step: float,
    speed: Array,
    load_row: Array,
    ambient: Array,
    factor: Array,
    film: Array,
    outer_flux: Array,
    ground: Array,
    first_log_speed: float,
    step_log_speed: float,
    indentation: Annotated[Array, (None, None)],
    bending: Array,
    bending_share: Array,
    shift_constants: Array,
    activation: float,
    capacity: float,
    area: float,
    conductance: float,
    layers: Array,
    rates: Array,
    force: Array,
    mean: Array,
    surface: Array,
) -> None:
    """Fill loss per metre [N], mean and outer surface temperature [degC]; change the layers' temperatures.

    Parameters
    ----------
    speed, load_row, ambient, factor, film, outer_flux, ground
        Series of shape (n,): travel speed [m/s], row in the table (a fraction between rows), air [degC], factor on the
        loss, film coefficient [W/m^2/K], what the sun brings to the outer face [W/m^2], conductance to the ground [W/K].
    indentation, bending
        Tables of `belt_loss`, shapes (loads, speeds) and (speeds,).
    bending_share
        Of each layer, shape (layers,).
    shift_constants
        Glass transition, c1, c2, temperature above the first that is the reference, and where the shift goes on straight.
    activation
        A further exp(activation (1/T - 1/313 K)) on the loss [K]; 0 for none.
    capacity, area, conductance
        Of one belt [J/K], of both faces [m^2], from the middle of a layer to that of the next [W/K].
    layers, rates
        Temperatures of the layers, inside first [degC], and as much space.
    """
    count = len(layers)
    each = capacity / count
    last = indentation.shape[1] - 2
    for i in range(speed.shape[0]):
        travel = abs(speed[i])
        log_speed = math.log10(travel) if travel > 1e-6 else -6.0
        row = min(int(load_row[i]), indentation.shape[0] - 2)
        part = load_row[i] - row
        total = warmth = 0.0
        for j in range(count):
            above = max(layers[j] - shift_constants[0], -shift_constants[4]) - shift_constants[3]
            x = log_speed - shift_constants[1] * above / (shift_constants[2] + above)
            place = (x - first_log_speed) / step_log_speed
            k = min(max(int(place), 0), last)
            share = place - k
            pressed = (1.0 - part) * ((1.0 - share) * indentation[row, k] + share * indentation[row, k + 1]) + part * (
                (1.0 - share) * indentation[row + 1, k] + share * indentation[row + 1, k + 1]
            )
            bent = (1.0 - share) * bending[k] + share * bending[k + 1]
            more = math.exp(activation * (1.0 / (layers[j] + KELVIN) - 1.0 / 313.15))
            lost = (pressed / count + bent * bending_share[j]) * more * factor[i]
            total += lost
            warmth += layers[j]
            rates[j] = lost * travel
        force[i] = total
        mean[i] = warmth / count
        # A face and half a layer behind it in series; the face itself holds no heat.
        to_face = 2.0 * conductance
        face = 0.5 * film[i] * area
        inner = (to_face * layers[0] + face * ambient[i]) / (to_face + face)
        outer = (to_face * layers[count - 1] + (face + ground[i]) * ambient[i] + outer_flux[i] * 0.5 * area) / (
            to_face + face + ground[i]
        )
        surface[i] = outer
        rates[0] += to_face * (inner - layers[0])
        rates[count - 1] += to_face * (outer - layers[count - 1])
        for j in range(count - 1):
            flow = conductance * (layers[j] - layers[j + 1])
            rates[j] -= flow
            rates[j + 1] += flow
        for j in range(count):
            layers[j] += step * rates[j] / each

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Equations (2) to (4): moduli by time-temperature superposition."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackres_ros.model.rubber import REFERENCE_ABOVE_TG, RubberModel, log_shift_factor

temperatures = st.floats(-120.0, 200.0)
frequencies = st.floats(-9.0, 9.0).map(lambda x: 10.0**x)
wlf = st.tuples(st.floats(-80.0, 0.0), st.floats(5.0, 12.0), st.floats(85.0, 130.0))  # Tg, C1, C2


def shifted(compound, glass_transition, c1, c2):
    return RubberModel(replace(compound, glass_transition=glass_transition, wlf_c1=c1, wlf_c2=c2))


@given(f=frequencies, t=temperatures, stiffening=st.floats(1.0, 3.0))
def test_equation_2_is_the_length_of_both_moduli(compound, f, t, stiffening):
    rubber = RubberModel(replace(compound, layer_stiffening=stiffening))
    length = np.hypot(rubber.storage_modulus(f, t), rubber.loss_modulus(f, t))
    assert float(rubber.dynamic_modulus(f, t)) == pytest.approx(stiffening * float(length), rel=1e-12)


@given(index=st.integers(0, 42))
def test_the_sweep_comes_back_at_its_own_frequency(compound, index):
    rubber, t = RubberModel(compound), compound.sweep_degc[index]
    assert float(rubber.storage_modulus(compound.sweep_frequency, t)) == pytest.approx(compound.storage_pa[index], rel=1e-9)
    assert float(rubber.loss_modulus(compound.sweep_frequency, t)) == pytest.approx(compound.loss_pa[index], rel=1e-9)


@given(shift=wlf, t=st.floats(-90.0, 120.0))
def test_equivalent_temperature_undoes_the_shift(compound, shift, t):
    rubber = shifted(compound, *shift)
    assert float(rubber.equivalent_temperature(rubber.reduced_frequency(compound.sweep_frequency, t))) == pytest.approx(
        t, abs=1e-8
    )


@given(f=frequencies, t=temperatures)
def test_superposition(compound, f, t):
    """E(f, T) = E(f_sweep, T_eq)."""
    rubber = RubberModel(compound)
    equivalent = rubber.equivalent_temperature(rubber.reduced_frequency(f, t))
    assert float(rubber.loss_modulus(f, t)) == pytest.approx(
        float(rubber.loss_modulus(compound.sweep_frequency, equivalent)), rel=1e-9
    )


@given(f=frequencies, t=temperatures, reference=temperatures)
def test_equation_3_for_any_reference_temperature(compound, f, t, reference):
    """E(f, T) = E(f a_T / a_T0, T0)."""
    rubber = RubberModel(compound)
    frequency = f * 10.0 ** float(rubber.log_shift(t) - rubber.log_shift(reference))
    if 1e-29 < frequency < 1e29:
        assert float(rubber.storage_modulus(f, t)) == pytest.approx(float(rubber.storage_modulus(frequency, reference)), rel=1e-8)


@given(t=st.floats(-58.0, 200.0))
def test_printed_equation_4_is_the_wlf_law_referred_to_tg(compound, t):
    tg = compound.glass_transition
    paper_shift = -8.86 * (t - tg - 50.0) / (51.5 + t - tg)
    wlf_shift = -8.86 * (t - (tg + 50.0)) / (101.6 + t - (tg + 50.0))
    shift = float(RubberModel(compound).log_shift(t))
    assert shift == pytest.approx(paper_shift, rel=1e-12, abs=1e-12)
    assert shift == pytest.approx(wlf_shift, rel=3e-3, abs=1e-3)


@given(y=st.floats(-8.8, 8.6))
def test_equivalent_temperature_in_closed_form(compound, y):
    """T_eq = Tg + (443 - 51.5 y)/(8.86 + y) with y = log10 a_T + log10(f/f_sweep), held within the sweep."""
    closed_form = compound.glass_transition + (443.0 - 51.5 * y) / (8.86 + y)
    degc = RubberModel(compound).equivalent_temperature(y + np.log10(compound.sweep_frequency))
    assert float(degc) == pytest.approx(np.clip(closed_form, -90.0, 120.0), abs=1e-9)


@given(shift=wlf)
def test_shift_is_smooth_at_the_glass_transition(compound, shift):
    tg, c1, c2 = shift
    (lower, slope_below), (upper, slope_above) = (log_shift_factor(tg + d, tg, c1, c2) for d in (-1e-7, 1e-7))
    assert lower - upper == pytest.approx(-2e-7 * slope_above, rel=1e-3)
    assert slope_below == pytest.approx(slope_above, rel=1e-6)


@given(shift=wlf, first=temperatures, second=temperatures)
def test_shift_falls_with_temperature(compound, shift, first, second):
    low_degc, high_degc = sorted((first, second))
    rubber = shifted(compound, *shift)
    assert rubber.log_shift(high_degc) <= rubber.log_shift(low_degc)
    if high_degc - low_degc > 1e-6:
        assert rubber.log_shift(high_degc) < rubber.log_shift(low_degc)
    assert np.isfinite(rubber.log_shift([low_degc, high_degc])).all()


def test_shift_has_no_pole(compound):
    pole = compound.glass_transition + REFERENCE_ABOVE_TG - compound.wlf_c2
    shifts = RubberModel(compound).log_shift(np.linspace(pole - 5.0, pole + 5.0, 1001))
    assert (np.diff(shifts) < 0.0).all()
    assert np.ptp(shifts) < 10.0


@given(first=st.floats(-200.0, 200.0), second=st.floats(-200.0, 200.0))
def test_equivalent_temperature_falls_with_reduced_frequency(compound, first, second):
    low, high = sorted((first, second))
    high_degc, low_degc = RubberModel(compound).equivalent_temperature([low, high])
    assert low_degc <= high_degc
    assert compound.sweep_degc[0] <= low_degc
    assert high_degc <= compound.sweep_degc[-1]


def test_beyond_the_sweep_the_end_values_stay(compound):
    rubber = RubberModel(compound)
    assert rubber.storage_modulus([1e-12, 0.0], 120.0) == pytest.approx([compound.storage_pa[-1]] * 2)
    assert rubber.loss_modulus([1e-12, 0.0], 120.0) == pytest.approx([compound.loss_pa[-1]] * 2)
    assert rubber.storage_modulus(1e12, [-90.0, -150.0]) == pytest.approx([compound.storage_pa[0]] * 2)
    assert rubber.loss_modulus(1e12, [-90.0, -150.0]) == pytest.approx([compound.loss_pa[0]] * 2)


@given(shift=wlf, t=temperatures)
def test_the_scalar_shift_is_the_vectorised_one(compound, shift, t):
    value, _ = log_shift_factor(t, *shift)
    assert value == pytest.approx(float(shifted(compound, *shift).log_shift(t)), rel=1e-12, abs=1e-12)


@given(shift=wlf, t=temperatures)
def test_the_slope_of_the_shift_is_its_derivative(compound, shift, t):
    step = 1e-4
    _, slope = log_shift_factor(t, *shift)
    derivative = (log_shift_factor(t + step, *shift)[0] - log_shift_factor(t - step, *shift)[0]) / (2 * step)
    assert slope == pytest.approx(derivative, rel=1e-5)


@given(scale=st.floats(0.1, 10.0), f=frequencies, t=temperatures)
def test_the_scale_acts_on_the_loss_modulus_alone(compound, scale, f, t):
    base_rubber, scaled = RubberModel(compound), RubberModel(replace(compound, loss_modulus_scale=scale))
    assert float(scaled.loss_modulus(f, t)) == pytest.approx(scale * float(base_rubber.loss_modulus(f, t)), rel=1e-9)
    assert float(scaled.storage_modulus(f, t)) == float(base_rubber.storage_modulus(f, t))


def test_between_the_points_of_the_sweep_nothing_overshoots(compound):
    grid = np.linspace(-90.0, 120.0, 4201)
    storage = RubberModel(compound).storage_modulus(compound.sweep_frequency, grid)
    assert (np.diff(storage) <= 1e-6 * storage[1:]).all()

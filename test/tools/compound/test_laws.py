# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of superposition, of Prony series, and of a fit: what went in comes out, within its intervals."""

import re
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from faults import contents
from hypothesis import assume, given
from hypothesis import strategies as st
from sweeps import FERRY_K, FREQUENCIES, moduli, published, sweep

from trackres_ros.files.resources import config_dir
from trackres_ros.model.rubber import RubberModel
from trackres_ros.tools.compound.coverage import need_of
from trackres_ros.tools.compound.fitting import ARRHENIUS, KEPT, WLF, fit_compound
from trackres_ros.tools.compound.reading import read_sweep
from trackres_ros.tools.compound.shift import ABSOLUTE_ZERO_DEGC, GAS_CONSTANT, Shift
from trackres_ros.tools.compound.writing import (
    ALIKE_K,
    MOST_MEASURED_ROWS,
    ROWS_K,
    files_of,
    prony_text,
    table_degc,
    write_compound,
)
from trackres_ros.vehicle import load

SHIFTS = st.builds(Shift.of_wlf, st.floats(-80, -30), st.floats(4, 20), st.floats(55, 200))
TEMPS = st.floats(-90, 120)


@pytest.fixture(scope="module")
def vehicle():
    return load("xgd24d")


@pytest.fixture(scope="module")
def natural_rubber(vehicle):
    """Fitted to what reaches from the glass to a hot belt."""
    return fit_compound(sweep(published("natural rubber"), np.arange(-85.0, 61.0, 5.0)), vehicle)


@given(SHIFTS, TEMPS, TEMPS, st.floats(1e-3, 1e3))
def test_frequency_times_shift_factor_equals_another_temperature(shift, temp, other, frequency):
    decades = shift.log_shift(temp) - shift.log_shift(other)
    assume(abs(decades) < 290.0)  # full precision of a double
    carried = frequency * 10.0**decades
    item, same = shift.equivalent_degc(frequency, temp, 1.0), shift.equivalent_degc(carried, other, 1.0)
    assert same == pytest.approx(item, rel=1e-6, abs=1e-6)
    assert shift.equivalent_degc(1.0, temp, 1.0) == pytest.approx(temp, abs=1e-6)


@given(st.floats(-80, -30), st.floats(4, 20), st.floats(55, 200), TEMPS)
def test_the_shift_is_that_of_the_model(vehicle, glass, c1, c2, temp):
    model = RubberModel(replace(vehicle.rubber, glass_transition=glass, wlf_c1=c1, wlf_c2=c2))
    shift = Shift.of_wlf(glass, c1, c2)
    assert shift.wlf() == pytest.approx((c1, c2))
    assert shift.log_shift(temp) - shift.log_shift(glass + 50.0) == pytest.approx(float(model.log_shift(temp)), abs=1e-9)


def test_arrhenius_is_a_wlf_shift_with_its_pole_at_absolute_zero():
    shift, temps = Shift(3000.0, ABSOLUTE_ZERO_DEGC, -60.0), np.array([-20.0, 20.0, 80.0])
    kelvin = temps - ABSOLUTE_ZERO_DEGC
    expectation = shift.activation_energy / GAS_CONSTANT / np.log(10.0) * (1.0 / kelvin - 1.0 / kelvin[0])
    assert shift.log_shift(temps) - shift.log_shift(-20.0) == pytest.approx(expectation)


def test_scaling_all_frequencies_keeps_the_shift_and_moduli(vehicle):
    temps, shift = np.arange(-60.0, 61.0, 8.0), published("natural rubber")
    item = sweep(shift, temps)
    faster = replace(item, frequency=10.0 * item.frequency)
    fits = [fit_compound(entry, vehicle) for entry in (item, faster)]
    for name, result in fits[0].values.items():
        assert fits[1].values[name].value == pytest.approx(result.value, rel=1e-4)
    degc = np.linspace(-60.0, 60.0, 9)
    for slow, fast in zip(fits[0].master.moduli(degc), fits[1].master.moduli(degc), strict=True):
        assert fast == pytest.approx(slow, rel=1e-3)
    for slow, fast in zip(fits[0].prony.moduli([1.0, 100.0]), fits[1].prony.moduli([10.0, 1000.0]), strict=True):
        assert fast == pytest.approx(slow, rel=1e-3)


@pytest.mark.parametrize("name", FERRY_K)
def test_published_shifts_come_back_within_their_intervals(vehicle, name):
    shift = published(name)
    inside = []
    for seed in range(2):
        result = fit_compound(sweep(shift, np.arange(shift.glass_transition + 10.0, 61.0, 5.0), seed=seed), vehicle)
        assert result.law == WLF
        assert not result.glass_is_seen
        c1, c2 = replace(shift, glass_transition=result.shift.glass_transition).wlf()
        for value, true in ((result.values["wlf_c1"], c1), (result.values["wlf_c2"], c2)):
            assert value.value == pytest.approx(true, rel=0.05)
            assert value.high - value.low < 0.2 * true
            inside.append(value.low <= true <= value.high)
    assert sum(inside) >= 3  # of 4, at 95 %


def test_a_glass_transition_that_is_measured_comes_back(vehicle, natural_rubber):
    """Near that of SBR isotherms hardly overlap, so steep is its shift: what is known of it less well is said so."""
    sbr = published("SBR")
    temps = np.arange(sbr.glass_transition - 11.0, 61.0, 5.0)
    steep = [fit_compound(sweep(sbr, temps, shared=0.02, seed=seed), vehicle) for seed in range(2)]
    for shift, result, width in ((published("natural rubber"), natural_rubber, 0.1), *((sbr, item, 0.3) for item in steep)):
        assert result.law == WLF
        assert result.glass_is_seen
        for value, true in zip(result.values.values(), (shift.glass_transition, *shift.wlf()), strict=True):
            assert value.low <= true <= value.high
            assert value.high - value.low < width * abs(true)


def test_arrhenius_comes_back_as_such_with_its_energy(vehicle):
    energy = 60e3
    shift = Shift(energy / GAS_CONSTANT / np.log(10.0), ABSOLUTE_ZERO_DEGC, -100.0)
    result = fit_compound(sweep(shift, np.arange(-40.0, 101.0, 7.0), about=-20.0), vehicle)
    assert result.law == ARRHENIUS
    assert result.energy.low <= energy <= result.energy.high
    assert result.values["wlf_c2"].value == pytest.approx(result.values["glass_transition"].value + 50.0 - ABSOLUTE_ZERO_DEGC)


def test_errors_of_isotherms_widen_the_intervals(vehicle):
    shift, temps = published("SBR"), np.arange(-50.0, 61.0, 5.0)
    widths = []
    for shared in (0.0, 0.03):
        values = fit_compound(sweep(shift, temps, shared=shared), vehicle).values
        widths.append(values["wlf_c1"].high - values["wlf_c1"].low)
    assert widths[1] > 1.5 * widths[0]


def test_elasticity_rising_with_temperature_keeps_the_shift(vehicle):
    shift = published("SBR")
    plain = sweep(shift, np.arange(-50.0, 96.0, 5.0))
    assert fit_compound(plain, vehicle).power is None
    factor = (plain.temp_degc - ABSOLUTE_ZERO_DEGC) / 300.0
    result = fit_compound(replace(plain, storage=factor * plain.storage, loss=factor * plain.loss), vehicle)
    assert result.power.low <= 1.0 <= result.power.high
    assert max(result.with_power) < 0.5 * max(result.rms)
    c1, c2 = replace(shift, glass_transition=result.shift.glass_transition).wlf()
    for value, true in ((result.values["wlf_c1"], c1), (result.values["wlf_c2"], c2)):
        assert value.low <= true <= value.high
        assert value.value == pytest.approx(true, rel=0.05)


def test_the_master_curve_has_the_true_moduli_in_its_intervals(natural_rubber):
    shift, master = published("natural rubber"), natural_rubber.master
    degc = np.linspace(-85.0, 55.0, 29)
    true = np.log(np.column_stack(moduli(np.log10(master.at_frequency) + shift.log_shift(degc) - shift.log_shift(-23.15))))
    result, std = np.log(np.column_stack(master.moduli(degc))), master.log_std(degc)
    assert np.abs(result - true).max() < 0.05
    is_inside = np.abs(result - true) < 1.96 * np.hypot(std, 0.005)  # errors of isotherms are shared, and documented
    assert is_inside.mean() > 0.85
    assert natural_rubber.rms == pytest.approx((0.0071, 0.0112), rel=0.3)


def test_a_prony_series_obeys_kramers_and_kronig(natural_rubber):
    """E'(w) - E_inf = 2/pi P int E''(w e^s) / (1 - e^2s) ds; both sides of the pole are taken together."""
    prony = natural_rubber.prony
    assert (prony.strength >= 0.0).all()
    s = (np.arange(24_000) + 0.5) * 2e-3
    for frequency in (1e-2, 1.0, 1e4):
        above, below = prony.moduli(frequency * np.exp(s))[1], prony.moduli(frequency * np.exp(-s))[1]
        integral = float((above / (1.0 - np.exp(2.0 * s)) + below / (1.0 - np.exp(-2.0 * s))).sum()) * 2e-3
        assert 2.0 / np.pi * integral == pytest.approx(float(prony.moduli(frequency)[0][0]) - prony.strength[0], rel=1e-2)
    assert max(prony.rms) < 1.5 * max(natural_rubber.rms)


def test_a_prony_series_keeps_its_rms_between_the_rows(vehicle):
    """Below the glass transition, rows 5 K apart are almost two decades apart."""
    fit = fit_compound(read_sweep(config_dir() / "rubber" / "nr_sbr_10hz.csv"), vehicle)
    master, prony, degc = fit.master, fit.prony, np.linspace(fit.master.low_degc, fit.master.high_degc, 1000)
    moved = fit.shift.log_shift(degc) - fit.shift.log_shift(prony.reference_degc)
    series = prony.moduli(master.at_frequency * 10.0**moved)
    for result, curve, rms in zip(series, master.moduli(degc), prony.rms, strict=True):
        assert np.sqrt(np.mean((result / curve - 1.0) ** 2)) < 1.05 * rms
        assert np.abs(result / curve - 1.0).max() < 6.0 * rms


@pytest.mark.parametrize("warmer", [0.0, 105.0])
def test_the_prony_file_alone_gives_the_moduli(vehicle, natural_rubber, warmer):
    """Its head and its rows, above the glass transition; one is above room temperature."""
    data = natural_rubber.sweep
    fit = fit_compound(replace(data, temp_degc=data.temp_degc + warmer), vehicle) if warmer else natural_rubber
    text = prony_text(fit)
    result = re.search(r"log10 a_T = -(\S+) \(T ([+-]) (\S+)\) / \((\S+) \+ T \2 \3\), T in degC, above (\S+) degC", text)
    c1, c2, glass, reference = (float(result[i]) for i in (1, 4, 5, 3))
    reference = -reference if result[2] == "+" else reference
    rows = text[text.index("tau_s,") :].splitlines()
    tau, strength = np.genfromtxt(rows, delimiter=",", skip_header=1).T[:2]
    frequency, degc = (x.ravel() for x in np.meshgrid(FREQUENCIES, np.arange(glass, 60.0 + warmer, 10.0)))
    distance = degc - reference
    x2 = (2.0 * np.pi * frequency * 10.0 ** (-c1 * distance / (c2 + distance)) * tau[1:, None]) ** 2
    series = strength[0] + strength[1:] @ (x2 / (1.0 + x2)), strength[1:] @ (np.sqrt(x2) / (1.0 + x2))
    curve = fit.master.moduli(fit.shift.equivalent_degc(frequency, degc, fit.master.at_frequency))
    for result, expectation, rms in zip(series, curve, fit.prony.rms, strict=True):
        assert np.abs(1e6 * result / expectation - 1.0).max() < 6.0 * rms
    assert f"at {reference:.6g} degC" in text


def test_moduli_that_do_not_belong_together_have_no_prony_series(vehicle, natural_rubber):
    wrong = replace(natural_rubber.sweep, loss=2.0 * natural_rubber.sweep.loss)
    result = fit_compound(wrong, vehicle)
    assert max(result.rms) < 0.02  # a master curve each
    assert max(result.prony.rms) > 0.2


@pytest.mark.parametrize(
    ("frequencies", "step", "said"),
    [
        ([10.0], 3.0, "one frequency does not"), ([9.0, 10.0, 11.0], 3.0, "3 frequencies within a factor of 1.2 do not"),
        (FREQUENCIES, 30.0, "too far apart"),
    ],
)  # fmt: skip
def test_too_few_frequencies_or_isotherms_keep_the_shift(vehicle, frequencies, step, said):
    result = fit_compound(sweep(published("SBR"), np.arange(-50.0, 96.0, step), frequencies), vehicle)
    assert result.law == KEPT
    assert said in result.why
    assert result.values["wlf_c1"].value == vehicle.rubber.wlf_c1
    assert result.values["wlf_c1"].low == vehicle.parameters["rubber.wlf_c1"].low


@pytest.mark.parametrize("step", [0.01, 0.04, 0.049, 0.06])
@pytest.mark.parametrize("low", [15.0, -60.0])
def test_rows_of_a_ramp_cover_it_evenly(vehicle, low, step):
    ramp = np.arange(low, 21.0, step)
    item = SimpleNamespace(temp_degc=ramp, frequencies=[10.0])
    rows = table_degc(SimpleNamespace(sweep=item, master=SimpleNamespace(low_degc=ramp[0], high_degc=ramp[-1])))
    steps = np.diff([*rows, ramp[-1]])
    assert rows[0] == ramp[0]
    assert (steps[:-1] > ALIKE_K).all()
    assert steps.max() < max(2.0 * ALIKE_K, ROWS_K) if len(ramp) > MOST_MEASURED_ROWS else 2.0 * ALIKE_K


def test_the_written_vehicle_has_the_measured_moduli(vehicle, natural_rubber, tmp_path):
    data = natural_rubber.sweep
    written = write_compound(natural_rubber, vehicle, files_of(tmp_path / "NR 7.csv", tmp_path / "out"))
    model = RubberModel(written.rubber)
    for measured, modulus, rms in (
        (data.storage, model.storage_modulus, natural_rubber.rms[0]),
        (data.loss, model.loss_modulus, natural_rubber.rms[1]),
    ):
        deviation = np.log(modulus(data.frequency, data.temp_degc) / measured)
        assert np.sqrt((deviation**2).mean()) == pytest.approx(rms, rel=0.1)
    for name, value in natural_rubber.values.items():
        q = written.parameters[f"rubber.{name}"]
        assert (q.value, q.low, q.high) == pytest.approx((value.value, value.low, value.high), rel=1e-5)
        assert q.flag == "F"
    assert written.rubber.density == vehicle.rubber.density
    assert written.name == "xgd24d_NR_7"
    assert "# Written by trackres compound fit from made.csv" in written.rubber_source.read_text()
    repetition = write_compound(natural_rubber, written, files_of(tmp_path / "NR 7.csv", tmp_path / "again"))
    assert repetition.source.read_text() == written.source.read_text()


@pytest.mark.parametrize("of_thin", ["front", "rear"])
def test_the_need_is_that_of_all_kinds_of_track(of_thin):
    plain = load("xgd24d")
    ((name, track),) = plain.tracks.items()
    tracks = {name: track, "thin": replace(track, name="thin", belt=replace(track.belt, thickness=0.025))}
    assemblies = tuple(replace(assembly, track="thin" if assembly.axle == of_thin else name) for assembly in plain.assemblies)
    need = need_of(replace(plain, tracks=tracks, assemblies=assemblies))
    assert need.fastest == need_of(replace(plain, tracks={name: tracks["thin"]})).fastest > need_of(plain).fastest


def test_an_interrupted_fit_leaves_the_old_vehicle_or_the_new(vehicle, natural_rubber, tmp_path, monkeypatch):
    other = fit_compound(sweep(published("SBR"), np.arange(-60.0, 61.0, 3.0), [10.0]), vehicle)
    move = Path.replace

    def of_rubber(files):
        rubber = load(files["vehicle"]).rubber
        return rubber.wlf_c1, rubber.sweep_frequency, *rubber.storage_pa

    for moves in count():
        done = count()

        def interrupted(part, place, done=done, last=moves):
            if next(done) == last:
                raise KeyboardInterrupt
            return move(part, place)

        files = files_of(tmp_path / "sweep.csv", tmp_path / str(moves))
        write_compound(natural_rubber, vehicle, files)
        old = contents(files["vehicle"].parent), of_rubber(files)
        with monkeypatch.context() as changed, suppress(KeyboardInterrupt):
            changed.setattr(Path, "replace", interrupted)
            write_compound(other, vehicle, files)
        remainders = contents(files["vehicle"].parent), of_rubber(files)
        if next(done) <= moves:  # there was no such move
            break
        assert remainders == old, moves
    assert remainders[1] != old[1]
    assert moves == 4  # of the journal, and of rubber, series and vehicle

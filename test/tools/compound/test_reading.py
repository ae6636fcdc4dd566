# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The same sweep in every format of instruments; errors are reported with line and column."""

from math import pi

import numpy as np
import pytest
from sweeps import published, sweep

from trackres_ros.errors import InputError
from trackres_ros.tools.compound.reading import read_sweep

DATA = sweep(published("SBR"), np.arange(-45.0, 61.0, 15.0), [0.5, 5.0, 50.0])


def text(head, columns, separator=";", comma=False, before="", units=None):
    """A file of columns, as an instrument would write it."""
    lines = [separator.join(head)] + ([separator.join(units)] if units else [])
    for row in zip(*columns, strict=True):
        cells = [f"{x:.8g}" for x in row]
        lines.append(separator.join(cell.replace(".", ",") for cell in cells) if comma else separator.join(cells))
    return before + "\n".join(lines) + "\n"


PLAIN = ["T [degC]", "f [Hz]", "E' [MPa]", "E'' [MPa]"]
T, F, E1, E2 = DATA.temp_degc, DATA.frequency, DATA.storage, DATA.loss
FORMS = {
    "MPa, commas": text(
        ["Temperature (\u00b0C)", "Frequency (Hz)", "Storage Modulus (MPa)", "Loss Modulus (MPa)"],
        [T, F, E1 / 1e6, E2 / 1e6], ","),
    "kelvin, rad/s, tan delta": text(
        ["T [K]", "Angular frequency [rad/s]", "E' [Pa]", "tan(delta)"], [T + 273.15, 2 * pi * F, E1, E2 / E1], "\t"
    ),
    "decimal commas, units below": text(
        ["Temperatur", "Frequenz", "Speichermodul", "Verlustmodul", "tan \u03b4"], [T, F, E1 / 1e6, E2 / 1e6, E2 / E1], ";", True,
        "# Probe 12\n", ["\u00b0C", "Hz", "MPa", "MPa", "-"],
    ),
    "shear, kPa, other columns": text(
        ["Point", "t [s]", "Temp. / \u00b0C", "f / Hz", "G\u2032 / kPa", "G\u2033 / kPa", "|G*| / kPa", "Static force [N]"],
        [T * 0, T * 0 + 7, T, F, E1 / 3e3, E2 / 3e3, E1, T], "\t",
    ),
    "degF, psi, lines about the test": text(
        ["Temp (\u00b0F)", "Freq (kHz)", "E' (psi)", "E'' (psi)"],
        [T * 1.8 + 32, F / 1e3, E1 / 6894.757, E2 / 6894.757], ";", False,
        "Instrument;DMA 850\nOperator;nobody\nTemperature program;ramp\n\n",
    ),
    "omega in 1/s, N/mm2, quotes": text(
        ['"T, degC"', "omega (1/s)", "E1 (N/mm2)", "E2 (N/mm2)"], [T, 2 * pi * F, E1 / 1e6, E2 / 1e6], ","
    ),
    "spaces, a line of prose": text(
        ["T[degC]", "f[Hz]", "E'[MPa]", "E''[MPa]"], [T, F, E1 / 1e6, E2 / 1e6], "   ", False,
        "storage modulus over temperature\n",
    ),
    "names between tabs, numbers between spaces": "freq\tG'\tG\"\tTemp\nrad/s\tPa\tPa\tC\n"
    + text(["# rows"], [2 * pi * F, E1 / 3, E2 / 3, T], "  "),
    "other names, units below, a number for each set": text(
        ["f", "E_stor", "E_loss", "T", "Set"], [F, E1 / 1e6, E2 / 1e6, T, T * 0], ",", False, "",
        ["Hz", " MPa", " MPa", " C", " -"],
    ),
    "a column twice": text(
        ["Temp [C]", "f [Hz]", "E_prime [Pa]", "E_double_prime [Pa]", "Temp [C]"], [T, F, E1, E2, T], "\t"
    ),
    "logarithms beside the values": text(
        ["log10 Frequency [Hz]", "lg storage modulus [Pa]", *PLAIN, "log tan delta"],
        [np.log10(F), np.log10(E1), T, F, E1 / 1e6, E2 / 1e6, np.log10(E2 / E1)],
    ),
    "complex modulus, loss angle": text(
        ["T [degC]", "f [Hz]", "|E*| [MPa]", "\u03b4 [\u00b0]"],
        [T, F, np.hypot(E1, E2) / 1e6, np.degrees(np.arctan2(E2, E1))],
    ),
    "complex modulus in shear, phase angle in rad": text(
        ["Temp (\u00b0C)", "Frequency (Hz)", "Complex shear modulus (kPa)", "Phase angle (rad)", "Complex viscosity (Pa s)"],
        [T, F, np.hypot(E1, E2) / 3e3, np.arctan2(E2, E1), E1], ",",
    ),
    "complex modulus, tan delta": text(
        ["Temperatur", "Frequenz", "Komplexer E-Modul", "tan \u03b4"], [T, F, np.hypot(E1, E2) / 1e6, E2 / E1], ";", True, "",
        ["\u00b0C", "Hz", "MPa", "-"],
    ),
    "complex modulus, loss modulus": text(
        ["T [degC]", "f [Hz]", "E* [MPa]", "E'' [MPa]"], [T, F, np.hypot(E1, E2) / 1e6, E2 / 1e6]
    ),
    "storage modulus, loss angle": text(
        ["T [degC]", "f [Hz]", "E' [MPa]", "Loss angle [deg]"], [T, F, E1 / 1e6, np.degrees(np.arctan2(E2, E1))]
    ),
    "complex modulus and phase without units beside others": text(
        [*PLAIN, "E*", "Phase"], [T, F, E1 / 1e6, E2 / 1e6, np.hypot(E1, E2), E2 / E1]
    ),
    "a column without numbers": text([*PLAIN, "tan delta"], [T, F, E1 / 1e6, E2 / 1e6, T * np.nan]),
}  # fmt: skip


def read(tmp_path, content, coding="utf-8", **given):
    path = tmp_path / "sweep.csv"
    path.write_bytes(content.encode(coding))
    return read_sweep(path, **given)


def same(found, order=slice(None)):
    for name in ("frequency", "temp_degc", "storage", "loss"):
        np.testing.assert_allclose(getattr(found, name), getattr(DATA, name)[order], rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_the_same_sweep(tmp_path, form):
    same(read(tmp_path, FORMS[form]))


@pytest.mark.parametrize("coding", ["utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_every_coding_and_line_end(tmp_path, coding, ends):
    form = FORMS["decimal commas, units below" if coding != "latin-1" else "MPa, commas"]
    result = read(tmp_path, form.replace("\n", ends), coding)
    same(result)
    assert bool(result.notes) == (coding == "latin-1")


def test_a_column_for_each_frequency(tmp_path):
    by = [np.isclose(F, f) for f in (0.5, 5.0, 50.0)]
    head = ["T [degC]", *(f"{name}_{f}Hz [MPa]" for f in (0.5, 5, 50) for name in ("E'", "E''"))]
    columns = [T[by[0]], *(e[rows] / 1e6 for rows in by for e in (E1, E2))]
    same(read(tmp_path, text(head, columns)), np.concatenate([np.flatnonzero(rows) for rows in by]))


def test_blocks_with_their_names_again_and_rows_with_gaps(tmp_path):
    form = FORMS["decimal commas, units below"].splitlines()
    repetitions = [*form[:6], "", *form[1:3], *form[6:], "10;;;;"]
    result = read(tmp_path, "\n".join(repetitions))
    same(result)
    assert result.notes == ("1 rows with an empty cell were left out",)


def test_a_frequency_may_be_given_beside(tmp_path):
    once = np.isclose(F, 5.0)
    content = text(["T [degC]", "E' [MPa]", "E'' [MPa]"], [T[once], E1[once] / 1e6, E2[once] / 1e6])
    same(read(tmp_path, content, frequency_hz=5.0), once)
    with pytest.raises(InputError, match="--frequency-hz"):
        read(tmp_path, content)


def test_what_is_computed_from_a_complex_modulus_is_noted(tmp_path):
    found = read(tmp_path, FORMS["complex modulus, loss angle"])
    assert found.notes == ("computed: storage modulus from |E*| [MPa], tan delta from \u03b4 [\u00b0]",)


def test_each_frequency_has_its_own_complex_modulus(tmp_path):
    by = [np.isclose(F, f) for f in (0.5, 5.0, 50.0)]
    head = ["T [degC]", *(f"{name}_{f}Hz [{unit}]" for f in (0.5, 5, 50) for name, unit in (("|E*|", "MPa"), ("delta", "deg")))]
    both = (np.hypot(E1, E2) / 1e6, np.degrees(np.arctan2(E2, E1)))
    columns = [T[by[0]], *(values[rows] for rows in by for values in both)]
    same(read(tmp_path, text(head, columns)), np.concatenate([np.flatnonzero(rows) for rows in by]))


GOOD = FORMS["MPa, commas"]
BAD = {
    "no file of columns": ("a\nb\n", "missing: a temperature, a storage modulus"),
    "nothing": ("", "no line with text"),
    "no text": ("PK\3\4\0\n1\0", "binary data.*save it as text"),
    "no unit": (
        GOOD.replace(" (Hz)", ""), "line 1, unit of Frequency: given 'none'; allowed: Hz, kHz, mHz or rad/s",
    ),
    "another unit": (GOOD.replace("(MPa)", "(MP)", 1), "unit of Storage Modulus.*'MP'.*did you mean MPa"),
    "a word": (GOOD.replace("\n-45,", "\ncold,", 1), r"line 2, column Temperature \(\u00b0C\): given 'cold'"),
    "kelvin under degC": (text(PLAIN, [T + 273.15, F, E1, E2]), "column T .*-150 to 300 degC"),
    "GPa over MPa": (GOOD.replace("(MPa)", "(GPa)"), r"line 2, column Storage Modulus \(GPa\): .*check its unit"),
    "less loss than none": (text(PLAIN, [T, F, E1 / 1e6, -E2 / 1e6]), "line 2, column E''"),
    "decimal commas between commas": (FORMS["decimal commas, units below"].replace(";", ","), "semicolons or tabs"),
    "both marks": (text(PLAIN, [T, F, E1 / 1e6, E2 / 1e6]).replace("0.5;", "0,5;", 1), "0.5 with a decimal point and 0,5 with"),
    "tan delta of another test": (text([*PLAIN, "tan delta"], [T, F, E1 / 1e6, E2 / 1e6, 2 * E2 / E1]), "% off"),
    "twice": (GOOD.replace("Loss Modulus", "Storage Modulus"), "line 1, column 4: .*one column of storage modulus"),
    "an empty cell between spaces": (FORMS["spaces, a line of prose"].replace("   5   ", "   ", 1), "line 4: .*4 cells"),
    "two of a kind": (GOOD.replace("Loss Modulus", "E'"), "line 1, column 4: .*one column of storage modulus"),
    "one modulus in shear": (GOOD.replace("Storage", "Shear storage"), "'Shear storage .* in shear, Loss .* in tension'"),
    **{
        f"{log} of column {place + 1}": (
            GOOD.replace(name, log.format(name), 1), f"line 1, column {place + 1}: .*itself, not its logarithm",
        )
        for place, name in enumerate(GOOD.splitlines()[0].split(","))
        for log in ("log {}", "log10({})", "lg {}", "LN_{}", "Log{}", "{} (log)")
    },
    "a loss angle without a unit": (
        text(["T [degC]", "f [Hz]", "|E*| [MPa]", "delta"], [T, F, E1, E2]), "unit of delta: given 'none'; allowed: deg, rad",
    ),
    "a loss angle in degrees under rad": (
        text(["T [degC]", "f [Hz]", "|E*| [MPa]", "delta [rad]"], [T, F, E1 / 1e6, T * 0 + 95.0]), "column delta .rad.*check its",
    ),
    "too few": ("\n".join(GOOD.splitlines()[:5]), "4 rows at 2 temperatures over 15 K"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said_with_its_place(tmp_path, case):
    content, text_here = BAD[case]
    with pytest.raises(InputError, match=text_here) as error:
        read(tmp_path, content)
    assert str(tmp_path / "sweep.csv") in str(error.value)
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    ("head", "missing", "there"),
    [
        ("T [degC],f [Hz],E' [MPa]", ["loss modulus", "tan delta"], ["temperature", "storage"]),
        ("T [degC],f [Hz],Ep", ["storage", "loss modulus"], ["temperature"]),
        ("T [degC],E' [MPa]", ["loss modulus"], ["temperature", "storage"]),
        ("f [Hz],E' [MPa],E'' [MPa]", ["temperature"], ["storage", "loss modulus"]),
        ("T [degC],tan delta,x", ["storage"], ["temperature", "loss modulus"]),
    ],
)
def test_a_column_that_is_missing_is_named(tmp_path, head, missing, there):
    path = tmp_path / "sweep.csv"
    path.write_text("\n".join([head, *(",".join(str(10 * i + j) for j in range(head.count(",") + 1)) for i in range(9))]))
    with pytest.raises(InputError) as error_info:
        read_sweep(path)
    statement = str(error_info.value).partition("missing: ")[2]
    assert all(part in statement for part in missing)
    assert not any(part in statement for part in there)
    assert "line 1" in str(error_info.value)

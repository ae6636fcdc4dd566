# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Polyisoprenes measured and shifted by others: the published shift comes back.

The isotherms of Auhl, Ramirez, Likhtman, Chambon, Fernyhough, J. Rheol. 52 (2008) 801, as they come with RepTate
(github.com/jorge-ramirez-upm/RepTate, data/PI_LINEAR/osc, not part of this project): put that folder as ``polyisoprene`` beside
the other recordings of others. Run as a program it prints the numbers of docs/compound.md.
"""

import os
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest

from trackres_ros.errors import InputError
from trackres_ros.tools.compound.fitting import WLF, fit_compound
from trackres_ros.tools.compound.master import master_curve
from trackres_ros.tools.compound.reading import read_sweep
from trackres_ros.tools.compound.shift import Shift
from trackres_ros.tools.compound.superposition import Law, fitted, with_power
from trackres_ros.vehicle import load

DEFAULT = Path(__file__).resolve().parents[4] / "shared" / "data" / "real"
FOLDER = Path(os.environ.get("TRACKRES_REAL_DATA", DEFAULT)) / "polyisoprene"
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"no sweeps at {FOLDER}; set TRACKRES_REAL_DATA to its folder")

# Of the headers of its data/PI_LINEAR/*.tts: -C1 (T + 35 degC) / (T + 114.03 degC).
PUBLISHED = Shift(8.77210163229153 * (114.03 - 35.0), -114.03, -58.0)
SOFTEST_PA = 17e3  # in shear: three times as much a rubber file may hold. A polymer that is not cured flows below
MOLAR_MASSES = "PI1000k-02", "PI600k", "PI400k-03", "PI223k-14", "PI88K-09", "PI33K-8"
PARTS_HZ = 0.05, 0.1, 0.3, 1.0
FREE = Law(
    WLF,
    lambda th: Shift(np.exp(th[0]), th[1], th[1] + 1.0),
    np.array([3.0, -273.0]),
    np.array([10.8, -60.0]),
    tuple(np.array([strength, pole]) for strength in (6.0, 6.8) for pole in (-150.0, -100.0)),
)


def sweep_of(name, folder):
    """The isotherms of one polymer; frequency, both moduli and temperature lead each row."""
    rows = []
    for file in sorted(FOLDER.glob(f"{name}*.osc")):
        for line in file.read_text(encoding="latin-1").splitlines():
            cells = line.split()[:4]
            if len(cells) == 4 and cells[0][0].isdigit() and float(cells[1]) > SOFTEST_PA:
                rows.append("\t".join(cells))
    path = Path(folder) / f"{name}.txt"
    path.write_text("\n".join(["Freq\tG'\tG\"\tTemp", "rad/s\tPa\tPa\tdegC", *rows]) + "\n", encoding="utf-8")
    return read_sweep(path)


def of_parts(sweep):
    """For a part of the rows, without and with a rise beside the shift: pole [degC], and rms of the loss modulus elsewhere."""
    results = []
    for most in PARTS_HZ:
        part, rest = sweep.some(sweep.frequency <= most), sweep.some(sweep.frequency > most)
        place = part.frequencies[0]
        without = fitted(part, FREE, place)
        row = []
        for shift in (without.shift, fitted(part, with_power(without), place).shift):
            master = master_curve(part, shift, place)
            equivalent = shift.equivalent_degc(rest.frequency, rest.temp_degc, place)
            known = (equivalent >= master.low_degc) & (equivalent <= master.high_degc)
            deviation = np.log(master.moduli(equivalent[known])[1] / rest.loss[known])
            row += [shift.pole, float(np.sqrt((deviation**2).mean()))]
        results.append(row)
    return np.array(results)


def test_published_shifts_come_back(tmp_path):
    inside = []
    for name in MOLAR_MASSES:
        result = fit_compound(sweep_of(name, tmp_path), load("xgd24d"))
        assert result.law == WLF
        for value, published in zip(list(result.values.values())[1:], PUBLISHED.wlf(), strict=True):
            inside.append(value.low <= published <= value.high)
            assert value.value == pytest.approx(published, rel=0.06)
        assert result.power.low <= 1.0  # of rubber elasticity alone, less the density that falls
        assert result.power.high >= 0.75
        assert max(result.with_power) < 0.02
    assert sum(inside) >= 10  # of 12, at 95 %


def test_with_an_elastic_rise_the_shift_is_independent_of_rows(tmp_path):
    parts = of_parts(sweep_of(MOLAR_MASSES[0], tmp_path))
    assert np.ptp(parts[:, 2]) < 0.3 * np.ptp(parts[:, 0])
    np.testing.assert_allclose(parts[:, 2], PUBLISHED.pole, atol=5.0)


def test_a_file_as_it_is_names_more_columns_than_it_has(tmp_path):
    path = tmp_path / "one.osc"
    shutil.copy(next(FOLDER.glob("PI88K-09_FS_-40C*.osc")), path)
    with pytest.raises(InputError, match="11 cells'; allowed: 14 cells"):
        read_sweep(path)


if __name__ == "__main__":
    print("published: C1 {:.2f}, C2 {:.1f} K about -8 degC".format(*PUBLISHED.wlf()))
    with tempfile.TemporaryDirectory() as folder:
        for name in MOLAR_MASSES:
            sweep = sweep_of(name, folder)
            found, without = fit_compound(sweep, load("xgd24d")), fitted(sweep, FREE, sweep.frequencies[0])
            print(f"{name}: {len(sweep.loss)} rows, {sweep.temp_degc.min():.0f} to {sweep.temp_degc.max():.0f} degC")
            print("  fitted  ", ", ".join(f"{n} {v.value:.2f} ({v.low:.2f} to {v.high:.2f})" for n, v in found.values.items()))
            print(f"  power {found.power.value:.2f}, rms", ", ".join(f"{100 * x:.1f} %" for x in found.with_power))
            c2 = -8.0 - without.shift.pole
            print(
                f"  without  C1 {without.shift.strength / c2:.2f}, C2 {c2:.1f}, rms", *(f"{100 * x:.1f} %" for x in without.rms)
            )
        print(f"{MOLAR_MASSES[0]}, rows below some Hz: pole without, rms of the loss modulus above; the same with a rise")
        for most, row in zip(PARTS_HZ, of_parts(sweep_of(MOLAR_MASSES[0], folder)), strict=True):
            print(f"  {most:g} Hz: {row[0]:.0f} degC, {100 * row[1]:.1f} %; {row[2]:.0f} degC, {100 * row[3]:.1f} %")

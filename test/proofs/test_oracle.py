# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The oracle sees a torque that is there, and none that is not."""

import numpy as np
import pytest

from proofs.sealed.cases import Case, sensors_of
from proofs.sealed.phenomena import PROGRAM
from proofs.sealed.recordings import make_case
from proofs.sealed.scoring import LEAST_GAIN, fit_truth

MINUTES = 12.0  # of each drive


def made(folder, level, hidden, minutes=MINUTES, seed=21):
    """The folder of a case, and the torque of its hidden physics in each drive [Nm]."""
    case = Case(f"{level}_{len(hidden)}", level, hidden, {}, False, False, False, True, seed)
    make_case(folder, minutes, case)
    truth = np.load(folder / "sealed" / f"{case.name}.npz")
    added = [truth[f"added/{name}"] for name in hidden]
    return folder / "cases" / case.name, np.split(added[0], np.cumsum(truth["lengths"])[:-1]) if added else []


@pytest.mark.long
def test_an_addition_gains_where_it_is_and_nowhere_else(tmp_path):
    with_it, added = made(tmp_path, "outside", {PROGRAM: {"seed": 2.0, "size": 2.0}})
    without, _ = made(tmp_path, "none", {})
    there, absent = (fit_truth(folder, (), added) for folder in (with_it, without))
    assert there.identifiable
    assert there.gain > 2.0 * LEAST_GAIN
    assert not absent.identifiable
    assert abs(absent.gain) < 0.6 * LEAST_GAIN


def once_a_second(level, seeds):
    """The first seed of a case recorded at 1 Hz, and the first of one recorded faster."""
    slow = {bool(sensors_of(Case("a", level, {}, {}, False, False, False, True, seed)).every_s): seed for seed in reversed(seeds)}
    return slow[True], slow[False]


HIDDEN = {"street_slope": {"steepest": 0.02}}, {"stretch_load": {"share": 0.2, "bulk": 1.0, "seed": 3.0}}


@pytest.mark.long
@pytest.mark.parametrize(("hidden", "seed"), [*zip(HIDDEN, once_a_second("street", range(20)), strict=True)])
def test_the_fit_finds_the_towns_torque_and_not_a_shifted_one(tmp_path, hidden, seed):
    folder, added = made(tmp_path, "street", hidden, 6.0, seed)
    result = fit_truth(folder, (), added)
    assert result.gain > 2.0 * LEAST_GAIN
    assert result.mae < 0.8 * result.mae_base
    shifted = fit_truth(folder, (), [np.roll(item, len(item) // 2) for item in added])
    assert shifted.gain < 0.5 * result.gain

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The oracle sees a torque that is there, and none that is not."""

import numpy as np
import pytest

from trackres_ros.evaluation.sealed.cases import AFTER_FREEZE, OUTSIDE, Case
from trackres_ros.evaluation.sealed.generate import make_case
from trackres_ros.evaluation.sealed.oracle import LEAST_GAIN, fit_truth

MINUTES = 12.0  # of each drive: on shorter ones no bearing is sure to seize


def made(folder, level, hidden):
    """The folder of a case, and what is hidden in it adds to the torque of each drive [Nm]."""
    case = Case(level, level, hidden, {}, False, False, False, True, 21)
    make_case((folder, case, MINUTES))
    truth = np.load(folder / "sealed" / f"{level}.npz")
    added = [truth[f"added/{name}"] for name in hidden]
    return folder / "cases" / level, np.split(added[0], np.cumsum(truth["lengths"])[:-1]) if added else []


@pytest.mark.long
@pytest.mark.parametrize("name", ["mud", *AFTER_FREEZE])
def test_an_addition_gains_where_it_is_and_nowhere_else(tmp_path, name):
    for sub in ("cases", "sealed"):
        (tmp_path / sub).mkdir()
    values = {key: float(x) for key, x in OUTSIDE[name](np.random.default_rng(2), 1.0).items()}
    with_it, added = made(tmp_path, "outside", {name: values})
    without, _ = made(tmp_path, "none", {})
    there, absent = (fit_truth(folder, (), added) for folder in (with_it, without))
    assert there.identifiable
    assert there.gain > 2.0 * LEAST_GAIN
    assert not absent.identifiable
    assert abs(absent.gain) < 0.6 * LEAST_GAIN

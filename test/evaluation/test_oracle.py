# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The oracle sees a torque that is there, and none that is not."""

import numpy as np
import pytest

from trackres_ros.evaluation.sealed.cases import OUTSIDE, Case
from trackres_ros.evaluation.sealed.generate import make_case
from trackres_ros.evaluation.sealed.oracle import LEAST_GAIN, fit_truth


def made(folder, level, hidden):
    """The folder of a case, and what is hidden in it adds to the torque of each drive [Nm]."""
    case = Case(level, level, hidden, {}, False, False, False, True, 21)
    make_case((folder, case, 5.0))
    truth = np.load(folder / "sealed" / f"{level}.npz")
    added = [truth[f"added/{name}"] for name in hidden]
    return folder / "cases" / level, np.split(added[0], np.cumsum(truth["lengths"])[:-1]) if added else []


@pytest.mark.long
def test_an_addition_gains_where_it_is_and_nowhere_else(tmp_path):
    for sub in ("cases", "sealed"):
        (tmp_path / sub).mkdir()
    mud = {key: float(x) for key, x in OUTSIDE["mud"](np.random.default_rng(2), 1.0).items()}
    with_mud, added = made(tmp_path, "outside", {"mud": mud})
    without, _ = made(tmp_path, "none", {})
    there, absent = (fit_truth(folder, (), added) for folder in (with_mud, without))
    assert there.identifiable
    assert there.gain > 2.0 * LEAST_GAIN
    assert not absent.identifiable
    assert abs(absent.gain) < 0.6 * LEAST_GAIN

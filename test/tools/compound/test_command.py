# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command: its output can be loaded, its statements are true, and damaged files end in one line."""

import json
import random
from pathlib import Path

import numpy as np
import pytest
from mutator import mutations
from test_reading import FORMS, PLAIN, F, T, text

from trackres_ros.errors import InputError
from trackres_ros.tools.compound.fitting import fit_compound
from trackres_ros.tools.compound.reading import read_sweep
from trackres_ros.tools.compound.writing import files_of, write_compound
from trackres_ros.vehicle import load

DAMAGED, FITTED = 200, 2
LONGEST_LINE = 3000  # characters


def refusal(function, *given):
    """Result of a function, or the line that refuses the input."""
    try:
        return function(*given), ""
    except InputError as error:
        return None, str(error)


def a_line(text):
    return text.isprintable() and len(text) < LONGEST_LINE


def fitted(sweep, vehicle, folder):
    fit = fit_compound(sweep, vehicle)
    return write_compound(fit, vehicle, files_of(sweep.path, folder))


def test_the_reference_compound_comes_out_as_it_went_in(good, repository, tmp_path, drawn):
    words = ("compound", "fit", repository / "config" / "rubber" / "nr_sbr_10hz.csv")
    result = json.loads(good(*words, "--json", cwd=tmp_path))
    assert result["shift"]["law"] == "kept"
    assert result["rms"]["storage"] < 0.005
    assert result["rms"]["loss"] < 0.01
    assert max(result["prony"]["rms_storage"], result["prony"]["rms_loss"]) < 0.03
    assert [Path(path).suffix for path in result["written"]] == [".yaml", ".csv", ".csv", ".png"]
    assert all((tmp_path / path).stat().st_size > 500 for path in result["written"])
    assert [drawn.faults(figure) for figure in drawn.figures] == [[]]
    fit_result, reference = load(tmp_path / result["written"][0]).rubber, load("xgd24d").rubber
    np.testing.assert_allclose(fit_result.storage_pa, reference.storage_pa, rtol=0.02)
    np.testing.assert_allclose(fit_result.loss_pa, reference.loss_pa, rtol=0.02)
    assert 0.0 < result["covered"]["share"] < 1.0
    assert "extrapolated" in result["covered"]["text"]
    text = good(*words, cwd=tmp_path)
    page = (repository / "docs" / "compound.md").read_text(encoding="utf-8").split("```\n")[1]
    assert page.splitlines()[1:] == text.splitlines()[1:]
    assert f"rms of a Prony series of {result['prony']['terms']} terms" in text
    assert result["covered"]["text"] in text
    assert "! to fit a shift," in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("none.csv",), "none.csv: given 'no such file or folder'"),
        (("sweep.csv", "--vehicle", "xgd24"), "or one of agri3t, xgd24d"),
        (("sweep.csv", "--frequency-hz", "-1"), "'--frequency-hz': -1.0 is not in the range"),
        (
            ("sweep.csv", "--frequency-hz", "5"),
            "--frequency-hz: given '5'; allowed: nothing, as sweep.csv: line 1 says the frequency",
        ),
        (("out/rubber/sweep.csv", "-o", "out"), "would overwrite"),
        (("sweep.csv", "-o", "diagnosis"), "a folder of its own"),
    ],
)
def test_what_cannot_be_is_refused(refused, tmp_path, words, said):
    (tmp_path / "out" / "rubber").mkdir(parents=True)
    (tmp_path / "diagnosis").mkdir()
    (tmp_path / "diagnosis" / "surroundings.yaml").write_text("schema: 1\n")
    for path in (tmp_path, tmp_path / "out" / "rubber"):
        (path / "sweep.csv").write_text(FORMS["MPa, commas"], encoding="utf-8")
    assert said in refused("compound", "fit", *words, cwd=tmp_path)


def test_of_a_compound_whose_belts_would_burn_nothing_is_written(refused, tmp_path):
    """As soft as a polymer that is not cured, or a sweep in another unit than it says."""
    soft = 10.0 ** np.linspace(0.5, -1.2, len(T))
    (tmp_path / "sweep.csv").write_text(text(PLAIN, [np.sort(T), F, soft, 0.9 * soft]), encoding="utf-8")
    assert "sweep.csv: tracks.triangular: given 'a belt that settles at" in refused("compound", "fit", "sweep.csv", cwd=tmp_path)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["sweep.csv"]


def test_a_damaged_sweep_is_read_or_refused_in_one_line(tmp_path):
    path, readable, refusal_here = tmp_path / "sweep.csv", [], []
    for content in mutations(FORMS["decimal commas, units below"].encode(), DAMAGED, seed=3):
        path.write_bytes(content)
        value, text = refusal(read_sweep, path)
        (refusal_here if value is None else readable).append(text if value is None else value)
    assert all(map(a_line, refusal_here))
    assert min(len(readable), len(refusal_here)) > DAMAGED // 20
    vehicle = load("xgd24d")
    for number, value in enumerate(random.Random(1).sample(readable, FITTED)):
        assert a_line(refusal(fitted, value, vehicle, tmp_path / str(number))[1])


def test_whatever_rubber_may_have_is_fitted_or_refused(tmp_path):
    """Numbers without any order, within the limits."""
    vehicle, random = load("xgd24d"), np.random.default_rng(5)
    for number in range(FITTED):
        rows = int(random.integers(8, 60))
        temp = random.choice([random.uniform(-150, 300, rows), np.round(random.uniform(-80, 80, rows), -1)])
        frequency = 10.0 ** random.uniform(*sorted(random.uniform(-6, 6, 2)), rows)
        storage = 10.0 ** random.uniform(-1.2, 4.2, rows)
        loss = np.clip(storage * 10.0 ** random.uniform(-4, 0.6, rows), 1e-4, 1e4)
        path = tmp_path / f"{number}.csv"
        table = np.column_stack([temp, frequency, storage, loss])
        np.savetxt(path, table, "%.6g", ";", header="T [degC];f [Hz];E' [MPa];E'' [MPa]", comments="")
        assert a_line(refusal(fitted, read_sweep(path), vehicle, tmp_path / "out")[1])

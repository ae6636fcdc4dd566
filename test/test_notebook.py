# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The notebook runs from top to bottom, its results can be displayed, and it finds the hidden physics."""

import ast
import json

import pytest

NEEDED = ("pandas", "xarray", "matplotlib", "jinja2")


@pytest.fixture(scope="module")
def notebook(repository):
    return repository / "examples" / "front_door.ipynb"


def test_it_is_kept_without_outputs(notebook):
    content = json.loads(notebook.read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    for cell in content["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None
            ast.parse("".join(cell["source"]))


def run(notebook):
    """The names that its cells leave, and by its type what each cell shows."""
    shown, names = {}, {"__name__": "__main__"}
    cells = (cell for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code")
    for number, cell in enumerate(cells):
        tree = ast.parse("".join(cell["source"]))
        last = ast.Expression(tree.body.pop().value) if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, f"cell {number}", "exec"), names)
        if last:
            value = eval(compile(last, f"cell {number}", "eval"), names)
            shown[type(value).__name__] = value
    return names, shown


@pytest.mark.long
def test_it_runs_and_finds_what_it_hides(notebook, tmp_path, monkeypatch, capsys):
    for module in NEEDED:
        pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("trackres_ros.diagnosis.report.pictures.draw_all", lambda *_: [])  # see test/diagnosis/test_pictures.py
    names, shown = run(notebook)
    for kind in ("SimulationResult", "Recording", "ReplayResult", "DiagnosisResult", "DataFrame", "DataArray"):
        assert shown[kind]._repr_html_(), kind
    assert len(shown["NotebookFigure"]._repr_png_()) > 20_000
    assert names["found"].status == "named"
    found = {effect.name: dict(effect.values) for effect in names["found"].effects}
    assert found == {"turning_scrub": {"friction": pytest.approx(names["FRICTION"], rel=0.15)}}
    printed = capsys.readouterr().out.splitlines()
    before, after = (float(line.split()[-2]) for line in printed if "error is below" in line)
    assert after < 0.6 * before
    assert (tmp_path / "report" / "report.html").is_file()

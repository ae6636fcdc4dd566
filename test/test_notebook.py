# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The notebook runs from top to bottom, its results can be displayed, and it finds the hidden physics."""

import ast
import json
import os
import subprocess
import sys

import pytest

NEEDED = ("pandas", "xarray", "matplotlib", "jinja2", "ruptures")

RUN = """
import ast, json, sys
cells = json.loads(open(sys.argv[1], encoding="utf-8").read())["cells"]
shown, names = [], {"__name__": "__main__"}
for number, cell in enumerate(cell for cell in cells if cell["cell_type"] == "code"):
    tree = ast.parse("".join(cell["source"]))
    last = ast.Expression(tree.body.pop().value) if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, f"cell {number}", "exec"), names)
    if last:
        value = eval(compile(last, f"cell {number}", "eval"), names)
        html = (value._repr_html_() if hasattr(value, "_repr_html_") else "") or ""
        png = len(value._repr_png_()) if hasattr(value, "_repr_png_") else 0
        shown.append({"type": type(value).__name__, "text": repr(value)[:2000], "html": html[:200000], "png": png})
found = names["found"]
values = {effect.name: dict(effect.values) for effect in found.effects}
print(json.dumps({"shown": shown, "status": found.status, "effects": values, "hidden": names["FRICTION"]}))
"""


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


@pytest.mark.long
def test_it_runs_and_finds_what_it_hides(notebook, tmp_path, repository):
    for module in NEEDED:
        pytest.importorskip(module)
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    command = [sys.executable, "-c", RUN, str(notebook)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    *printed, last = done.stdout.splitlines()
    told = json.loads(last)
    shown = {value["type"]: value for value in told["shown"]}
    for kind in ("SimulationResult", "Recording", "ReplayResult", "DiagnosisResult", "DataFrame", "DataArray"):
        assert shown[kind]["html"], kind
    assert shown["NotebookFigure"]["png"] > 20_000
    assert told["status"] == "named"
    assert told["effects"] == {"turning_scrub": {"friction": pytest.approx(told["hidden"], rel=0.15)}}
    before, after = (float(line.split()[-2]) for line in printed if "error is below" in line)
    assert after < 0.6 * before
    assert (tmp_path / "report" / "report.html").is_file()

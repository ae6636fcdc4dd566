# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pages that lead to a first result: their blocks are run in an empty folder, one after the other, and end as they say."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BLOCK = re.compile(r'^```(\w+)(?: title="(\S+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
NAMED = {"first-tester": "warmup", "own-effect": "side_guard", "first-controller": None, "first-designer": None, "export": None}


@pytest.mark.long
@pytest.mark.parametrize("page", sorted(NAMED))
def test_a_page_leads_where_it_says(page, repository, tmp_path):
    for module in ("rosbags", "jinja2", "matplotlib"):
        pytest.importorskip(module)
    if page == "export":
        pytest.importorskip("fmpy")
    if page == "export" and not all(map(shutil.which, ("cc", "cmake"))):
        pytest.skip("no C compiler or no cmake is installed")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PYTHONPATH": str(repository), "PATH": path}
    trackres = f"{shlex.quote(sys.executable)} -m trackres_ros"
    ran = 0
    for kind, title, text in BLOCK.findall((repository / "docs" / f"{page}.md").read_text(encoding="utf-8")):
        if title:
            (tmp_path / title).parent.mkdir(exist_ok=True)
            (tmp_path / title).write_text(text, encoding="utf-8")
        elif kind == "sh":
            script = f'set -e\ntrackres() {{ {trackres} "$@"; }}\n{text}'
            done = subprocess.run(["bash", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
            ran += text.count("trackres ")
    assert ran >= 3
    if NAMED[page]:
        report = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
        assert [effect["name"] for effect in report["effects"]] == [NAMED[page]]
        assert report["verdict"]["grade"] == "confirmed"


@pytest.mark.parametrize("page", sorted(NAMED))
def test_it_is_found_from_the_readme(page, repository):
    assert f"(docs/{page}.md)" in (repository / "README.md").read_text(encoding="utf-8")

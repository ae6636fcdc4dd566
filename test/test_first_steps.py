# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pages that lead to a first result: their blocks run in an empty folder, one after the other, and end as they say."""

import json
import re
import runpy
import shlex
import shutil
import subprocess

import pytest

BLOCK = re.compile(r'^```(\w+)(?: title="(\S+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
NAMED = {"first-tester": "warmup", "own-effect": "side_guard", "first-controller": None, "first-designer": None, "export": None}


@pytest.mark.long
@pytest.mark.parametrize("page", sorted(NAMED))
def test_a_page_leads_where_it_says(page, repository, tmp_path, monkeypatch, good):
    for module in ("rosbags", "jinja2", "matplotlib"):
        pytest.importorskip(module)
    if page == "export":
        pytest.importorskip("fmpy")
    if page == "export" and not all(map(shutil.which, ("cc", "cmake"))):
        pytest.skip("no C compiler or no cmake is installed")
    monkeypatch.chdir(tmp_path)
    ran = 0
    for kind, title, text in BLOCK.findall((repository / "docs" / f"{page}.md").read_text(encoding="utf-8")):
        if title:
            (tmp_path / title).parent.mkdir(exist_ok=True)
            (tmp_path / title).write_text(text, encoding="utf-8")
        elif kind == "sh":
            for line in text.splitlines():
                ran += run(line, good)
    assert ran >= 3
    if NAMED[page]:
        report = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
        assert [effect["name"] for effect in report["effects"]] == [NAMED[page]]
        assert report["verdict"]["grade"] == "confirmed"
        assert report["verdict"]["may_be"] == []


def run(line, good):
    """Run a line of a page, commands and Python in this process; whether it is a command of ours."""
    program, *words = shlex.split(line)
    if program == "trackres":
        good(*words, *(["--quick", "--no-page"] if words[0] == "diagnose" else []))
    elif program == "python":
        runpy.run_path(words[0], run_name="__main__")
    else:
        subprocess.run(["bash", "-c", line], check=True)
    return program == "trackres"


@pytest.mark.parametrize("page", sorted(NAMED))
def test_it_is_found_from_the_readme(page, repository):
    assert f"(docs/{page}.md)" in (repository / "README.md").read_text(encoding="utf-8")

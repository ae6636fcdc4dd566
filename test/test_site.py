# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The documentation builds as a site, strictly: no link leads nowhere, nothing is fetched from elsewhere."""

import os
import re
import runpy
import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def site(repository, tmp_path_factory):
    for needed in ("mkdocs", "material", "latex2mathml"):
        pytest.importorskip(needed, reason=f"{needed} is not installed: make site installs it")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    variables = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=repository, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_of_the_docs_is_in_it(site, repository):
    pages = {path.relative_to(repository / "docs") for path in (repository / "docs").rglob("*.md")}
    missing = {
        page for page in pages if page.name not in ("README.md", "index.md") and not (site / page.with_suffix(".html")).exists()
    }
    assert not missing


def test_it_begins_with_the_readme(site, repository):
    first = (repository / "README.md").read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
    assert re.search(rf"<h1[^>]*>{first}", (site / "index.html").read_text(encoding="utf-8"))


def test_it_has_the_tables_of_the_program(site):
    for page, entry in (
        ("api", "load_vehicle"),
        ("effects", "viscous_bearing"),
        ("node", "mismatch_hold_s"),
        ("recordings", "specific_force"),
        ("robustness", "OFF_ROUTE"),
    ):
        assert re.search(rf"<(td|h3)[^>]*><code>{entry}</code>", (site / f"{page}.html").read_text(encoding="utf-8"))


def test_equations_are_drawn_without_a_script(site):
    page = (site / "model.html").read_text(encoding="utf-8")
    assert page.count("<math") > 50
    assert "arithmatex" not in page


def test_the_examples_are_shown_with_their_code(site, repository):
    page = (site / "examples" / "index.html").read_text(encoding="utf-8")
    for example in repository.glob("examples/*.py"):
        assert example.name in page
    assert page.count("<pre") >= len(list(repository.glob("examples/*.py")))


def test_the_front_page_leads_to_the_newest_version(repository, tmp_path):
    for version in ("0.9.0", "0.10.0", "0.2.1"):
        (tmp_path / version).mkdir()
        (tmp_path / version / "index.html").touch()
    (tmp_path / "1.0.0").mkdir()  # a build that failed
    tool = runpy.run_path(str(repository / "tools" / "site"))
    assert tool["write_index"](tmp_path) == "0.10.0"
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert re.search(r"url=([^\"]+)", page)[1] == "0.10.0/index.html"
    assert re.findall(r'href="([^"]+)"', page) == ["0.10.0/index.html", "0.9.0/index.html", "0.2.1/index.html"]

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The documentation builds as a site, strictly: no link leads nowhere, nothing is fetched from elsewhere."""

import os
import re
import subprocess
import sys

import pytest

for needed in ("mkdocs", "material", "latex2mathml"):
    pytest.importorskip(needed, reason=f"{needed} is not installed: make site installs it")


@pytest.fixture(scope="module")
def site(repository, tmp_path_factory):
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


def test_equations_are_drawn_without_a_script(site):
    page = (site / "model.html").read_text(encoding="utf-8")
    assert page.count("<math") > 50
    assert "arithmatex" not in page

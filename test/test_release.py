# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The quick items of the release checklist hold, and each of its comparisons finds a file that differs."""

import re
import runpy
import shutil

import pytest


@pytest.fixture
def release(repository, tmp_path):
    """The checklist on a copy of the files it compares."""
    for name in ("setup.py", "package.xml", "trackres_ros/version.py", "CITATION.cff", "CHANGELOG.rst"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(repository / name, tmp_path / name)
    names = runpy.run_path(str(repository / "tools" / "release"))
    names["versions_agree"].__globals__["ROOT"] = tmp_path
    return names


def test_versions_and_dates_of_the_tree_agree(release, tmp_path):
    version, date = release["versions_agree"](), release["dates_agree"]()
    assert f"{version} ({date})" in (tmp_path / "CHANGELOG.rst").read_text()


@pytest.mark.parametrize("name", ["setup.py", "package.xml", "trackres_ros/version.py", "CITATION.cff", "CHANGELOG.rst"])
def test_a_file_with_another_version_is_named(release, tmp_path, name):
    version = release["versions_agree"]()
    path = tmp_path / name
    text = path.read_text()
    changed = re.sub(rf"{re.escape(version)}(?=$|[\"< ])", "9.8.7", text, flags=re.MULTILINE)
    assert changed != text
    path.write_text(changed)
    with pytest.raises(release["NotReadyError"], match=rf"{re.escape(name)} has 9\.8\.7"):
        release["versions_agree"]()


def test_another_date_in_the_citation_is_found(release, tmp_path):
    path = tmp_path / "CITATION.cff"
    path.write_text(re.sub(r"date-released: .*", "date-released: 2001-02-03", path.read_text()))
    with pytest.raises(release["NotReadyError"], match="2001-02-03"):
        release["dates_agree"]()


def test_a_release_has_no_change_without_version(release, tmp_path):
    path = tmp_path / "CHANGELOG.rst"
    closed = re.sub(r"^Forthcoming\n-+$", "9.8.7 (2030-01-02)\n------------------", path.read_text(), flags=re.MULTILINE)
    path.write_text(closed)
    release["changelog_is_closed"]()
    path.write_text(f"Forthcoming\n-----------\n* A change.\n\n{closed}")
    with pytest.raises(release["NotReadyError"], match="Forthcoming"):
        release["changelog_is_closed"]()
    assert release["released"](closed) == ("9.8.7", "2030-01-02")


def test_addresses_that_lead_nowhere_are_found(release, tmp_path):
    path = tmp_path / "package.xml"
    nowhere = re.sub(r'(<url type="repository">).*?<', rf"\1{tmp_path}/nowhere<", path.read_text())
    for email, said in (("somebody@users.noreply.example.com", "noreply"), ("somebody@example.com", "ls-remote")):
        path.write_text(re.sub(r'email=".*?"', f'email="{email}"', nowhere))
        with pytest.raises(release["NotReadyError"], match=said):
            release["addresses_are_real"]()


def test_links_of_the_readme_lead_to_the_repository(release, repository, tmp_path):
    shutil.copy(repository / "README.md", tmp_path)
    path = tmp_path / "package.xml"
    without = re.sub(r'<url type="repository">.*?</url>', "", path.read_text())
    path.write_text(without.replace("<license>", '<url type="repository">https://example.com/here</url><license>', 1))
    setup = (tmp_path / "setup.py").read_text().partition("\nsetup(")[0]
    names = {"__file__": str(tmp_path / "setup.py")}
    exec(compile(setup, "setup.py", "exec"), names)
    text = names["long_description"]()
    assert "](https://example.com/here/raw/HEAD/docs/laps.png)" in text
    assert "](https://example.com/here/blob/HEAD/docs/node.md)" in text
    assert not re.findall(r"\]\((?!https?:|#)", text)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ament's linters, where ROS is: what colcon test expects of a package. Elsewhere ruff holds the same rules alone."""

import pytest

CHECKED = ("trackres_ros", "launch", "setup.py")
# What ruff.toml leaves out as well, and sections that pydocstyle sees in words of a sentence.
OTHERWISE = (
    "D203", "D205", "D213", "D301", "D400", "D401", "D405", "D406", "D407", "D410", "D411", "D413", "D414", "D415", "D417",
)  # fmt: skip


@pytest.fixture(autouse=True)
def in_repository(repository, monkeypatch):
    monkeypatch.chdir(repository)


@pytest.mark.filterwarnings("ignore")  # the linters' own
def test_flake8(capfd):
    pytest.importorskip("flake8", reason="flake8 is not installed")
    linter = pytest.importorskip("ament_flake8.main", reason="ament_flake8 is not installed")
    status, errors = linter.main_with_errors(argv=["--config", "test/ament.flake8", *CHECKED])
    capfd.readouterr()  # the names of all files
    assert (status, errors) == (0, [])


@pytest.mark.filterwarnings("ignore")
def test_pep257():
    pytest.importorskip("pydocstyle", reason="pydocstyle is not installed")
    linter = pytest.importorskip("ament_pep257.main", reason="ament_pep257 is not installed")
    assert linter.main(argv=[*CHECKED, "--add-ignore", *OTHERWISE]) == 0


@pytest.mark.filterwarnings("ignore")
def test_package_xml_is_as_its_schema_says(capfd):
    linter = pytest.importorskip("ament_xmllint.main", reason="ament_xmllint is not installed")
    status = linter.main(argv=["package.xml"])
    said = "".join(capfd.readouterr())
    if "Failed to locate the main schema" in said or status == "Could not find 'xmllint' executable":
        pytest.skip("the schema lies in the network, which is not reached, or there is no xmllint")
    assert status == 0, said

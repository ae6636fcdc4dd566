# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The package as pip installs it, away from the checkout."""

import json
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest

import trackres_ros


@pytest.fixture(scope="module")
def installed(tmp_path_factory, request):
    root = request.config.rootpath
    folder = tmp_path_factory.mktemp("install")
    source = folder / "source"
    ignore = shutil.ignore_patterns(".git", ".venv", "out", "build", "*.egg-info", "__pycache__", ".*_cache", ".hypothesis")
    shutil.copytree(root, source, ignore=ignore)
    target = folder / "site"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--target", str(target), str(source)], check=True, capture_output=True, text=True)
    return target


def test_every_module_is_installed(installed, repository):
    here = {path.relative_to(repository) for path in (repository / "trackres_ros").rglob("*.py")}
    there = {path.relative_to(installed) for path in (installed / "trackres_ros").rglob("*.py")}
    assert here == there
    assert (installed / "trackres_ros" / "py.typed").exists()


def test_shipped_vehicles_are_found_by_name(installed, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    command = [sys.executable, "-P", "-m", "trackres_ros", "vehicle", "check", "agri3t", "--points", "10", "--json"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True)
    assert str(installed) in json.loads(done.stdout)["file"]


def test_the_ament_files_are_in_place(installed, repository):
    share = installed / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "trackres_ros").exists()
    package = ET.parse(share / "trackres_ros" / "package.xml").getroot()
    assert package.findtext("version") == trackres_ros.__version__
    assert (share / "trackres_ros" / "config" / "topics" / "sample.yaml").exists()
    assert (share / "trackres_ros" / "launch" / "replay.launch.py").exists()
    assert trackres_ros.__version__ in (repository / "CHANGELOG.rst").read_text()

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The package as pip installs it, away from the checkout."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import xml.etree.ElementTree as ET

import pytest

import trackres_ros

COLCON = re.compile(r"colcon build ((?:--base-paths \S+ )?--packages-select \w+)")


@pytest.fixture(scope="module")
def installed(tmp_path_factory, request):
    root = request.config.rootpath
    folder = tmp_path_factory.mktemp("install")
    source = folder / "source"
    ignore = shutil.ignore_patterns(
        ".git", ".venv", "out", "build", "*.egg-info", "__pycache__", ".*_cache", ".hypothesis", "*.so"
    )
    shutil.copytree(root, source, ignore=ignore)
    target = folder / "site"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--no-compile", "--target", str(target), str(source)], check=True, capture_output=True, text=True)
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


COMPILED = "from trackres_ros.kernels.marks import COMPILED; print(COMPILED)"


def runs_compiled(path, folder):
    """Whether the package at a path runs compiled kernels, and what it says."""
    command = [sys.executable, "-P", "-c", COMPILED]
    done = subprocess.run(command, cwd=folder, env={**os.environ, "PYTHONPATH": str(path)}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip() == "True", done.stderr


@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler is installed")
def test_the_kernels_are_compiled_where_it_is_installed(installed, tmp_path):
    assert runs_compiled(installed, tmp_path) == (True, "")
    assert [path.suffixes for path in (installed / "trackres_ros" / "kernels").glob("built.*")] == [[".abi3", ".so"]]
    assert "Tag: cp311-abi3-linux_" in next(installed.glob("trackres_ros-*.dist-info/WHEEL")).read_text()


@pytest.fixture
def source(tmp_path, repository):
    """The sources without anything built."""
    ignored = shutil.ignore_patterns("[.]*", "build", "out", "docs", "test", "*.egg-info", "__pycache__", "*.so")
    return shutil.copytree(repository, tmp_path / "source", ignore=ignored)


def test_without_a_compiler_it_is_built_and_runs_in_python(tmp_path, source):
    command = [sys.executable, "-P", "setup.py", "--quiet", "build", "--build-lib", str(tmp_path / "built")]
    without = {**os.environ, "CC": str(tmp_path / "no_compiler")}
    done = subprocess.run(command, cwd=source, env=without, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "about 100 times" in done.stderr
    assert "apt install gcc python3-dev" in done.stderr
    compiled, said = runs_compiled(tmp_path / "built", tmp_path)
    assert not compiled
    assert said.count("plain Python, a step about 100 times slower") == 1


def test_the_source_archive_has_what_the_kernels_are_built_of(tmp_path, source):
    command = [sys.executable, "-P", "setup.py", "--quiet", "sdist", "--dist-dir", str(tmp_path)]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    with tarfile.open(next(tmp_path.glob("*.tar.gz"))) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {f"trackres_ros/kernels/templates/{name}.c" for name in ("binding", "helpers")} < names
    assert not [name for name in names if name.endswith(".so")]


@pytest.mark.parametrize("links", [(), ("--symlink-install",)], ids=["copied", "linked"])
def test_colcon_builds_it_and_its_commands_run(tmp_path, repository, links):
    if not importlib.util.find_spec("colcon_ros"):
        pytest.skip("colcon is not installed for this Python: pip install colcon-common-extensions")
    ignored = shutil.ignore_patterns("[.]*", "build", "install", "log", "out", "docs", "*.egg-info", "__pycache__", "*.so")
    shutil.copytree(repository, tmp_path / "src" / "trackres_ros", ignore=ignored)
    program = "import sys; from colcon_core.command import main; sys.exit(main())"
    build = [sys.executable, "-W", "ignore", "-c", program, "build", "--packages-select", "trackres_ros", *links]
    uncompiled = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}  # Python compiles what is imported
    done = subprocess.run(build, cwd=tmp_path, env=uncompiled, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    installed = tmp_path / "install" / "trackres_ros"
    for file in ("lib/trackres_ros/estimator", "share/trackres_ros/launch/trackres.launch.py", "share/trackres_ros/package.xml"):
        assert (installed / file).exists(), file
    run = f"source install/setup.bash && cd / && {installed}/lib/trackres_ros/trackres vehicle list"
    listed = subprocess.run(["bash", "-c", run], cwd=tmp_path, capture_output=True, text=True)
    assert listed.returncode == 0, listed.stderr
    assert "xgd24d" in listed.stdout
    where = f"source install/setup.bash && cd / && {sys.executable} -P -c '{COMPILED}'"
    said = subprocess.run(["bash", "-c", where], cwd=tmp_path, capture_output=True, text=True)
    assert said.stdout.strip() == str(shutil.which("cc") is not None), said.stderr


def test_colcon_finds_each_package_as_the_pages_build_it(tmp_path, repository):
    """Colcon does not look for packages inside another one."""
    if not importlib.util.find_spec("colcon_ros"):
        pytest.skip("colcon is not installed for this Python: pip install colcon-common-extensions")
    ignored = shutil.ignore_patterns("[.]*", "build", "install", "log", "out", "docs", "test", "*.egg-info", "__pycache__")
    shutil.copytree(repository, tmp_path / "src" / "trackres_ros", ignore=ignored)
    pages = [repository / "README.md", *(repository / "docs").glob("*.md")]
    shown = {line for page in pages for line in COLCON.findall(page.read_text(encoding="utf-8"))}
    assert {words.split()[-1] for words in shown} == {"trackres_ros", "trackres_feedforward"}
    program = "import sys; from colcon_core.command import main; sys.exit(main())"
    for words in map(str.split, shown):
        found = [sys.executable, "-W", "ignore", "-c", program, "list", "--names-only", *words]
        assert subprocess.run(found, cwd=tmp_path, capture_output=True, text=True).stdout.split() == words[-1:]

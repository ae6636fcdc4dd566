# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

import gc
import importlib.util
import io
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
from contextlib import nullcontext, redirect_stderr, redirect_stdout
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import settings

if not {"PYTEST_XDIST_WORKER", "TRACKRES_INTERPRETED"} & os.environ.keys():  # before the kernels are imported
    subprocess.run([sys.executable, Path(__file__).parents[1] / "tools" / "kernels"], check=True)

from trackres_ros.estimator.estimator import Estimator
from trackres_ros.files.resources import config_dir
from trackres_ros.vehicle import load

settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")

NAMED_ALIKE = (
    "SALib asammdf bokeh cantools cyclonedds dask distributed fsspec h5py openpyxl pandas pyarrow pysindy pyulog rosbags "
    "threadpoolctl xarray"
)
EXTRAS = {
    **{name: name for name in NAMED_ALIKE.split()},
    "can": "python-can",
    "lz4": "rosbags",
    "sklearn": "scikit-learn",
    "zstandard": "rosbags",
}
"""Modules that extras bring, each with the requirement in setup.py by which they come."""
NOT_THERE = re.compile(r"no Python module (\w+)|No module named '(\w+)")


SQUEAK = """
from trackres_ros.effects import Effect, Parameter, Terms

class Squeak(Effect):
    name = "squeak"
    acts_on = "torque"
    belongs_to = "vehicle"
    text = "something squeaks"
    parameters = (Parameter("torque", "Nm", 0.0, 100.0, 10.0, "of it", off=0.0),)

    def terms(self, at, p):
        return Terms(torque=p.torque * at.direction)
"""


def pytest_configure():
    """Begun in the background of a script, this process ignores an interrupt, and so would all that tests start and interrupt."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def environment_of_commands():
    """What a command run in this process sets for what it starts goes with the test."""
    before = os.environ.get("PYTHONSAFEPATH")
    yield
    if before is None:
        os.environ.pop("PYTHONSAFEPATH", None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    """A test that an extra's library is missing for is skipped, as where rosdep alone was used; `make` installs them all."""
    report = yield
    for found in NOT_THERE.finditer(str(report.longrepr) if report.failed else ""):
        name = found[1] or found[2]
        if name in EXTRAS and not importlib.util.find_spec(name):
            report.outcome, report.longrepr = "skipped", (str(item.path), item.location[1], f"{name} is not installed")
            break
    return report


def pytest_collection_finish():
    """What is loaded by now stays: the collector of cycles need not look at it again and again."""
    gc.freeze()


@pytest.fixture(scope="session")
def xgd24d():
    return load("xgd24d")


@pytest.fixture(scope="session")
def agri3t():
    return load("agri3t")


@pytest.fixture(scope="session", params=["xgd24d", "agri3t"])
def vehicle(request):
    """Each shipped vehicle in turn."""
    return load(request.param)


@pytest.fixture(scope="session")
def reference(xgd24d):
    """Estimator of the reference vehicle."""
    return Estimator(xgd24d)


@pytest.fixture(scope="session")
def carrier(agri3t):
    """Estimator of the small carrier: another number of assemblies, wheels and axles."""
    return Estimator(agri3t)


@pytest.fixture
def configuration(tmp_path):
    """The shipped configuration in a folder of its own, to be changed at will."""
    return Path(shutil.copytree(config_dir(), tmp_path / "config"))


@pytest.fixture(scope="session")
def extras():
    """Modules that extras bring, each with its requirement."""
    return EXTRAS


@pytest.fixture(scope="session")
def repository():
    return Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def imported(repository):
    """A module by its path in the repository, which is in no package."""

    def made(path):
        spec = importlib.util.spec_from_file_location(Path(path).stem, repository / path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return made


@pytest.fixture(scope="session")
def trackres():
    """The command line in this process: `trackres(*words, cwd=None)` returns its exit code and both output streams."""
    return _trackres


@pytest.fixture(scope="session")
def good():
    """Output of a successful command: `good(*words, cwd=None)`."""

    def good(*words, cwd=None):
        done = _trackres(*words, cwd=cwd)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return good


@pytest.fixture(scope="session")
def refused():
    """The line with which a command refuses its words: `refused(*words, cwd=None)`."""

    def refused(*words, cwd=None):
        done = _trackres(*words, cwd=cwd)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), (words, done)
        assert done.stderr.startswith("trackres: error: ")
        return done.stderr

    return refused


def _trackres(*words, cwd=None):
    """The command line of the package, or of `python -m proofs` where `proofs` is the first word."""
    from trackres_ros.tasks.main import cli, main

    commands, program = cli, "trackres"
    if words[:1] == ("proofs",):
        from proofs.commands import proofs

        words, commands, program = words[1:], proofs, "python -m proofs"

    streams, handlers = (io.StringIO(), io.StringIO()), {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    with pytest.MonkeyPatch.context() as changed, redirect_stdout(streams[0]), redirect_stderr(streams[1]):
        changed.setenv("COLUMNS", "200")
        if cwd:
            changed.chdir(cwd)
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in words], commands, program)
    for number, handler in handlers.items():
        signal.signal(number, handler)
    return SimpleNamespace(returncode=ended.value.code, stdout=streams[0].getvalue(), stderr=streams[1].getvalue())


@pytest.fixture
def in_this_process(monkeypatch):
    """Makes a module do the work of a fleet's engine here, on what a worker would get."""

    def run_pieces(_client, function, work):
        return ((one, function(pickle.loads(pickle.dumps(one)))) for one in work)

    def change(module):
        for name, value in (("engine", lambda *_: nullcontext()), ("run_pieces", run_pieces), ("dashboard", lambda _: "")):
            monkeypatch.setattr(module, name, value, raising=False)

    return change


@pytest.fixture
def own(tmp_path):
    """A folder with an effect of a user's own, `squeak`."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "squeak.py").write_text(SQUEAK)
    return folder


@pytest.fixture
def undrawn(monkeypatch):
    """Pictures are made, but not drawn: their files are empty."""
    monkeypatch.setattr("trackres_ros.output.style.png_of", lambda _figure: b"")


@pytest.fixture
def drawn(monkeypatch):
    """`figures` as they are saved, and `faults(figure)`: what of one is cut off, collides or covers something."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    figures, save, write = [], FigureCanvasAgg.print_png, FigureCanvasSVG.print_svg

    def saved(canvas, *args, **kwargs):
        save(canvas, *args, **kwargs)
        figures.append(canvas.figure)

    def written(canvas, *args, **kwargs):
        write(canvas, *args, **kwargs)
        FigureCanvasAgg(canvas.figure)  # laid out for its own resolution
        canvas.figure.draw_without_rendering()
        figures.append(canvas.figure)

    monkeypatch.setattr(FigureCanvasAgg, "print_png", saved)
    monkeypatch.setattr(FigureCanvasSVG, "print_svg", written)
    return SimpleNamespace(figures=figures, faults=_faults)


def _faults(figure):
    """Text that is hard to read, in words."""
    from matplotlib.axis import Tick
    from matplotlib.legend import Legend
    from matplotlib.text import Text

    renderer, whole = figure.canvas.get_renderer(), figure.bbox.padded(1.0)
    axes = [a for a in figure.axes if a.get_visible()]
    of_hidden = {id(t) for a in figure.axes if not a.get_visible() for t in a.findobj(Text)}
    of_ticks = {id(t) for tick in figure.findobj(Tick) for t in tick.findobj(Text)}
    texts = [t for t in figure.findobj(Text) if id(t) not in of_hidden | of_ticks]
    found = []
    for one in axes:
        for axis in (one.xaxis, one.yaxis):
            low, high = sorted(axis.get_view_interval())
            labels = [t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high]
            labels = [t for t in labels if t.get_visible() and t.get_text()]
            boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in labels]
            found += [f"{a!r} touches {b!r}" for (a, at), (b, by) in combinations(boxes, 2) if at.overlaps(by)]
            texts += labels
    for text in texts:
        if text.get_visible() and text.get_text().strip() and _outside(text.get_window_extent(renderer), whole):
            found.append(f"{text.get_text()!r} is cut off")
    for legend in figure.findobj(Legend):
        box = legend.get_window_extent(renderer)
        if any(box.overlaps(one.get_window_extent(renderer)) for one in axes):
            found.append("a legend lies over axes")
        if _outside(box, whole):
            found.append("a legend is cut off")
    return found


def _outside(box, whole):
    return box.x0 < whole.x0 or box.y0 < whole.y0 or box.x1 > whole.x1 or box.y1 > whole.y1

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from trackres_ros.cli.main import cli
from trackres_ros.diagnosis import diagnose, load_base, read_recordings
from trackres_ros.diagnosis.trial import drives, write_recordings
from trackres_ros.effects import Active, catalogue


@pytest.fixture(scope="session")
def loaded():
    return load_base("xgd24d")


@pytest.fixture(scope="session")
def effects():
    return catalogue()


@pytest.fixture(scope="session")
def recorded(loaded, effects, tmp_path_factory):
    """Makes recordings with effects at their typical values; the same ones are made once."""
    made: dict[tuple, list[Path]] = {}

    def make(*names, seed=1, count=2, minutes=10.0):
        key = (*names, seed, count, minutes)
        if key not in made:
            rng = np.random.default_rng(seed)
            sessions = drives(loaded.base, loaded.known.max_speed, count, minutes, rng)
            active = [Active(effects[name], effects[name].values()) for name in names]
            made[key] = write_recordings(loaded.base, tmp_path_factory.mktemp("recorded"), sessions, active, rng)
        return made[key]

    return make


@pytest.fixture(scope="session")
def run():
    """`trackres diagnose` on recordings of the reference vehicle, as typed."""

    def run_it(paths, out, *options):
        command = ["diagnose", *map(str, paths), "--vehicle", "xgd24d", "-o", str(out), "--quick", *options]
        return CliRunner().invoke(cli, command, catch_exceptions=True)

    return run_it


@pytest.fixture(scope="session")
def diagnosed(recorded, loaded):
    """The same as an object, of the Python interface."""
    return diagnose(read_recordings(recorded("turning_scrub"), None), loaded, seed=1, quick=True)


@pytest.fixture(scope="session")
def scrubbed(run, recorded, tmp_path_factory):
    """Folder, report and run of a diagnosis of recordings with turning scrub."""
    out = tmp_path_factory.mktemp("report") / "deep" / "out"
    done = run(recorded("turning_scrub"), out)
    assert done.exit_code == 0, done.exception
    return out, json.loads((out / "report.json").read_text()), done

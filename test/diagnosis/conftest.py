# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import least_squares
from worlds import judging

import trackres_ros as tr
import trackres_ros.diagnosis.report
from trackres_ros.diagnosis import DiagnosisOptions, diagnose, load_base, read_recordings
from trackres_ros.diagnosis.inference.fitting import with_levels
from trackres_ros.diagnosis.search import explanations
from trackres_ros.diagnosis.synthetic import drives, write_recordings
from trackres_ros.effects import Active, catalogue
from trackres_ros.tasks.main import cli


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
    """`trackres diagnose` on recordings, as typed, without a page unless a test looks at it."""

    def run_it(paths, out, *options, page=False, vehicle="xgd24d"):
        without = () if page else ("--no-page",)
        words = ["diagnose", *paths, "--vehicle", vehicle, "-o", out, "--quick", *without, *options]
        outcome = CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)
        if outcome.exit_code == 0:
            check_report(json.loads((Path(out) / "report.json").read_text()))
        return outcome

    return run_it


@pytest.fixture(scope="session")
def check_form():
    """Refuses a file that does not satisfy the schema of report.json."""
    return check_report


def check_report(report):
    jsonschema.Draft202012Validator(report_schema()).validate(report)


def report_schema():
    return json.loads((Path(trackres_ros.diagnosis.report.__file__).parent / "report.schema.json").read_text())


@pytest.fixture(scope="session")
def forms_in_schema():
    """The forms of unnamed terms that report.json may have."""
    return report_schema()["properties"]["described"]["items"]["properties"]["form"]["enum"]


@pytest.fixture(scope="session")
def scrub_result(recorded):
    """The result of `tr.diagnose` for recordings with turning scrub, one that is read and one path, and the stages it names."""
    stages = []
    item, other = recorded("turning_scrub")
    return tr.diagnose([tr.read(item), str(other)], "xgd24d", quick=True, on_stage=stages.append), stages


@pytest.fixture(scope="session")
def diagnosed(scrub_result):
    """The diagnosis of recordings with turning scrub."""
    return scrub_result[0].diagnosis


@pytest.fixture(scope="session")
def diagnoses(recorded, loaded, request):
    """Diagnoses of recordings with effects, as objects of the Python interface; the same ones are made once."""
    made = {}

    def make(*names, seed=1):
        if (*names, seed) == ("turning_scrub", 1):
            return request.getfixturevalue("diagnosed")
        if (*names, seed) not in made:
            recordings = read_recordings(recorded(*names), None)
            made[(*names, seed)] = diagnose(recordings, loaded, DiagnosisOptions(quick=True, seed=seed))
        return made[(*names, seed)]

    return make


@pytest.fixture(scope="session")
def scrubbed(run, recorded, tmp_path_factory):
    """Folder, report and run of a diagnosis of recordings with turning scrub."""
    output = tmp_path_factory.mktemp("report") / "deep" / "out"
    process = run(recorded("turning_scrub"), output, page=True)
    assert process.exit_code == 0, process.exception
    return output, json.loads((output / "report.json").read_text()), process


@pytest.fixture(scope="session")
def explained():
    """Searches explanations of a fitted base's residual, and chooses one."""

    def explain(found, effects, **given):
        item = judging(with_levels(found), effects)
        with pytest.MonkeyPatch.context() as changed:
            changed.setattr(explanations, "MOST_TERMS", 2)  # enough for what tests hide
            item.search.run()
        item.chosen = item.choice.best(**given)
        return item

    return explain


@pytest.fixture(scope="session")
def robust_least_squares():
    """Expected torques of a base that is fitted by scipy's least squares with a soft L1 loss and the file's priors."""

    def expected(problem):
        names = [q.name for q in problem.base.parameters]
        columns = ("low", "high", "nominal", "std")
        low, high, nominal, std = (np.array([getattr(q, name) for q in problem.base.parameters]) for name in columns)

        def residuals(values):
            prediction = problem.predict(dict(zip(names, values, strict=True)), ())
            place = zip(problem.sessions, prediction, problem.masks, strict=True)
            torque = np.concatenate([(s.torque - p.torque)[m] for s, p, m in place])
            return np.concatenate((torque / 30.0, (values - nominal) / std))

        start = np.clip(nominal, low + 1e-6 * std, high - 1e-6 * std)
        result = least_squares(residuals, start, bounds=(low, high), x_scale=std, loss="soft_l1", max_nfev=40)
        return problem.predict(dict(zip(names, result.x, strict=True)), ())

    return expected

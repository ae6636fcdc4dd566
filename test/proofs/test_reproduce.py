# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The paper reproduced: files, verdicts, and that the page in the repository is the command's output."""

import csv
import json
import re
import struct
from types import SimpleNamespace

import numpy as np
import pytest

from proofs.reproduce import reproduce
from proofs.reproduce.bench import (
    COMBINATIONS,
    FAILS,
    HOLDS,
    IN_PART,
    OPEN,
    UNEXPLAINED,
    Bench,
    Claim,
    Family,
    Stable,
    falls,
    same_stable,
)
from proofs.reproduce.run import page_of, tables_of
from proofs.reproduce.strain import indentation, search_error, spectrum
from proofs.reproduce.studies import _order_from, _warmer_is_larger_later, weights
from proofs.reproduce.trials import ACCELERATION, TRIALS
from trackres_ros.errors import InputError
from trackres_ros.vehicle import load

pytest.importorskip("matplotlib")

COARSE_S = 2.5
VERDICTS = {
    "contact_grows_with_load": HOLDS,
    "tension_in_spectrum": IN_PART,
    "loss_modulus_falls": HOLDS,
    "laps_10_fall": HOLDS,
    "laps_10_settle": HOLDS,
    "stated_error_10": OPEN,
    "laps_30_fall": HOLDS,
    "laps_30_settle": HOLDS,
    "stated_error_30": OPEN,
    "straight_50_falls": HOLDS,
    "stated_error_50": OPEN,
    "speeds_torque_falls": HOLDS,
    "speeds_same_stable_value": FAILS,
    "faster_warms_faster": HOLDS,
    "faster_settles_sooner": IN_PART,
    "slower_is_larger": FAILS,
    "weights_torque_falls": HOLDS,
    "weights_different_stable_values": HOLDS,
    "heavier_is_larger": HOLDS,
    "ambients_torque_falls": HOLDS,
    "ambients_same_stable_value": FAILS,
    "colder_is_larger_first": HOLDS,
    "warmer_is_larger_later": FAILS,
    "colder_warms_more": HOLDS,
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder, summary and progress of a run with coarse steps."""
    folder, shares = tmp_path_factory.mktemp("figures"), []
    summary = reproduce(folder, lambda _, share: shares.append(share), page=folder.parent / "page.md", dt=COARSE_S)
    return SimpleNamespace(folder=folder, summary=summary, shares=shares)


@pytest.fixture(scope="module")
def docs(repository):
    return repository / "docs"


def claims_of(summary):
    return {claim["key"]: claim for section in summary["sections"] for claim in section["claims"]}


def section_of(summary, title):
    return next(section for section in summary["sections"] if section["title"].startswith(title))


def read_csv(path):
    with path.open() as lines:
        rows = list(csv.DictReader(lines))
    return {name: [row[name] for row in rows] for name in rows[0]}


def test_every_figure_is_there_as_picture_and_table(made):
    figures = [figure for section in made.summary["sections"] for figure in section["figures"]]
    for number in ("06", "10", "11", "16", "18", "20", "22", "24", "25", "26"):
        assert any(figure["png"].startswith(f"fig{number}") for figure in figures)
    for figure in figures:
        header = (made.folder / figure["png"]).read_bytes()[:24]
        assert header[:8] == b"\x89PNG\r\n\x1a\n"
        assert min(struct.unpack(">II", header[16:24])) > 300
        for name in figure["data"]:
            columns = read_csv(made.folder / name)
            assert len(columns) >= 3
            assert all(len(values) >= 20 and any(values) for values in columns.values())
    linked = set(re.findall(r"\]\(([^)#]+)\)", page_of(made.summary)))
    assert linked == {path.name for path in made.folder.iterdir()}
    assert json.loads((made.folder / "summary.json").read_text(encoding="utf-8")) == made.summary


def test_the_page_elsewhere_leads_into_the_folder(made):
    beside = (made.folder.parent / "page.md").read_text(encoding="utf-8")
    assert beside == page_of(made.summary, f"{made.folder.name}/")
    links = re.findall(r"\]\(([^)#]+)\)", beside)
    assert links
    assert all((made.folder.parent / link).is_file() for link in links)


def test_links_of_the_departures_lead_to_headings(made):
    text = page_of(made.summary)
    headings = {re.sub(r"[^\w-]", "", line[3:].lower().replace(" ", "-")) for line in text.splitlines() if line.startswith("## ")}
    targets = set(re.findall(r"\]\(#([^)]+)\)", text))
    assert targets
    assert targets <= headings


def test_each_claim_has_its_row_and_each_table_its_numbers(made):
    claims, tables = (read_csv(made.folder / name) for name in ("claims.csv", "tables.csv"))
    assert set(claims["claim"]) == {claim["paper"] for claim in claims_of(made.summary).values()}
    row = next(row for row in zip(*claims.values(), strict=True) if row[4] == "spectral, lumped" and row[6] == "stable torques")
    assert row[2:4] == ("section 4.2.1, Figure 24, conclusion 2", FAILS)
    assert row[5] == "no"
    assert row[7].endswith(" Nm")
    cells = [row[1:] for section in made.summary["sections"] for table in section["tables"] for row in table["rows"]]
    assert tables["value"] == [cell for row in cells for cell in row]


def test_progress_rises_to_one(made):
    assert (np.diff(made.shares) > 0).all()
    assert made.shares[-1] == 1.0


def test_verdicts(made):
    assert {key: claim["verdict"] for key, claim in claims_of(made.summary).items()} == VERDICTS


def test_every_verdict_has_its_reason(made):
    for claim in claims_of(made.summary).values():
        assert claim["why"] != UNEXPLAINED, claim["key"]
        assert claim["why"] or claim["verdict"] == OPEN


def test_the_page_in_the_repository_is_what_the_command_writes(made, docs):
    stored = json.loads((docs / "reproduction" / "summary.json").read_text(encoding="utf-8"))
    assert (docs / "reproduction.md").read_text(encoding="utf-8") == page_of(stored, "reproduction/")
    for name, text in tables_of(stored).items():
        assert (docs / "reproduction" / name).read_text(encoding="utf-8") == text
    linked = set(re.findall(r"\]\(reproduction/([^)#]+)\)", page_of(stored, "reproduction/")))
    assert linked == {path.name for path in (docs / "reproduction").iterdir()}
    old, new = claims_of(stored), claims_of(made.summary)
    assert {key: claim["verdict"] for key, claim in old.items()} == {key: claim["verdict"] for key, claim in new.items()}
    for key in old:
        assert [old[key][part] for part in ("paper", "where", "why")] == [new[key][part] for part in ("paper", "where", "why")]
    for result_before, time_now in zip(stored["sections"], made.summary["sections"], strict=True):
        assert_near(result_before["numbers"], time_now["numbers"], result_before["title"])


def assert_near(a, b, where):
    if isinstance(a, dict):
        assert a.keys() == b.keys(), where
        for key in a:
            assert_near(a[key], b[key], f"{where}, {key}")
    elif isinstance(a, list):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_near(x, y, f"{where}, {i}")
    elif a is None or b is None:
        assert a is b, where
    else:
        assert a == pytest.approx(b, rel=2e-3, abs=1e-6), where


# The reference numbers of the project: an independent prototype of the same model, torque [Nm] and belt temperature [degC].
PROTOTYPE_SPEEDS = {
    "10": [(3003, 15), (2925, 19), (2840, 23), (2786, 27), (2722, 31)],
    "30": [(3265, 17), (3023, 27), (2837, 39), (2747, 47), (2665, 54)],
    "50": [(3505, 18), (3138, 35), (2910, 53), (2813, 62), (2741, 70)],
}
PROTOTYPE_WEIGHTS = {"200": (2196, 59), "250": (2573, 67), "300": (2960, 75), "350": (3352, 83)}
PROTOTYPE_AMBIENTS = {"-15": (7143, 3784, 3181), "0": (4662, 3558, 3063), "15": (3877, 3355, 2959), "30": (3505, 3186, 2867)}


def test_it_agrees_with_the_independent_prototype(made):
    speeds, weight, ambient = (
        section_of(made.summary, title)["numbers"]["spectral/lumped"] for title in ("Figure 24", "Figure 25", "Figure 26")
    )
    for kmh, values in PROTOTYPE_SPEEDS.items():
        assert speeds[kmh]["torque_nm"] == pytest.approx([torque for torque, _ in values], rel=0.03)
        assert speeds[kmh]["belt_degc"] == pytest.approx([belt for _, belt in values], abs=2.0)
    for kn, (torque, belt) in PROTOTYPE_WEIGHTS.items():
        assert weight[kn]["torque_nm"][-1] == pytest.approx(torque, rel=0.03)
        assert weight[kn]["belt_degc"][-1] == pytest.approx(belt, abs=2.0)
    for degc, values in PROTOTYPE_AMBIENTS.items():
        assert [ambient[degc]["torque_nm"][i] for i in (0, 1, 4)] == pytest.approx(values, rel=0.03)


def test_no_ambient_crosses_another_in_the_table(made):
    columns = read_csv(made.folder / "fig26_ambients.csv")
    for combination in COMBINATIONS:
        tag = combination.replace("/", "_")
        torque = np.array([columns[f"resistance_torque_nm_{t}degc_{tag}"] for t in (-15, 0, 15, 30)], dtype=float)
        assert (np.diff(torque, axis=0) < 0).all()


def test_the_same_run_writes_the_same_bytes(made, tmp_path):
    bench = Bench(load("xgd24d"), COARSE_S, lambda text: None)
    for part in (indentation, spectrum, weights):
        part(bench, tmp_path)
    written = sorted(path.name for path in tmp_path.iterdir())
    assert len(written) == 8
    for name in written:
        assert (tmp_path / name).read_bytes() == (made.folder / name).read_bytes(), name


@pytest.mark.parametrize("dt", [0.0, -1.0, 60.0, float("nan")])
def test_a_step_that_cannot_be_is_refused(tmp_path, dt):
    with pytest.raises(InputError, match="dt"):
        reproduce(tmp_path / "out", dt=dt)
    assert not (tmp_path / "out").exists()


def made_up_family(torque, belt):
    """A family of two values whose four combinations all have the given torques and temperatures, shape (2, times)."""
    time = np.arange(torque.shape[1]) * 10.0
    runs = {
        value: {
            c: {"time_s": time, "speed_mps": np.full(len(time), 10.0), "resistance_torque_nm": torque[i], "belt_degc": belt[i]}
            for c in COMBINATIONS
        }
        for i, value in enumerate((0.0, 30.0))
    }
    stable = {
        value: {c: Stable(float(torque[i, -1]), 0.0, float(belt[i, -1])) for c in COMBINATIONS}
        for i, value in enumerate((0.0, 30.0))
    }
    return Family("made_up", "ambient [°C]", "degc", (0.0, 30.0), runs, stable)


DECAY = np.exp(-np.arange(100) / 20.0)


def test_a_crossing_would_be_seen():
    cold, warm = 1000.0 + 800.0 * DECAY, 1050.0 + 200.0 * DECAY
    belt = np.stack([cold, warm])
    crossing = _warmer_is_larger_later(made_up_family(np.stack([cold, warm]), belt))
    assert crossing.verdict == HOLDS
    assert "There is a crossing" in crossing.shows
    apart = _warmer_is_larger_later(made_up_family(np.stack([cold + 100.0, warm]), belt))
    assert apart.verdict == FAILS
    assert "no crossing" in apart.shows


def test_equal_stable_values_would_be_seen():
    torque = np.stack([1000.0 + 800.0 * DECAY, 1000.0 + 200.0 * DECAY])
    assert same_stable("k", "w", "p", made_up_family(torque, torque), "").verdict == HOLDS
    torque[1] += 30.0
    assert same_stable("k", "w", "p", made_up_family(torque, torque), "").verdict == FAILS


def test_a_rise_of_the_torque_would_be_seen():
    torque = np.stack([1000.0 + 800.0 * DECAY, 1000.0 + 200.0 * DECAY])
    assert falls("k", "w", made_up_family(torque, torque), 0.0).verdict == HOLDS
    torque[0, 50] += 500.0
    claim = falls("k", "w", made_up_family(torque, torque), 0.0)
    assert claim.verdict == FAILS
    assert "rises by up to" in claim.shows


def test_the_order_of_speeds_is_told_with_its_time():
    time = np.arange(4.0)
    assert _order_from(np.array([[1.0, 3.0, 3.0, 3.0], [2.0, 2.0, 2.0, 2.0]]), time) == 1.0
    assert _order_from(np.array([[3.0, 3.0], [2.0, 2.0]]), time[:2]) == 0.0
    assert _order_from(np.array([[3.0, 1.0], [2.0, 2.0]]), time[:2]) is None


@pytest.mark.parametrize(
    ("outcomes", "verdict"),
    [({"a": True, "b": True}, HOLDS), ({"a": False, "b": False}, FAILS), ({"a": True, "b": False}, IN_PART), ({}, OPEN)],
)
def test_a_verdict_follows_from_its_predicates(outcomes, verdict):
    claim = Claim("k", "w", "p", outcomes, "s", {HOLDS: "because"}, {})
    assert claim.verdict == verdict
    assert claim.summary()["why"] == ("because" if verdict == HOLDS else UNEXPLAINED)


def test_the_search_of_the_paper_can_miss():
    errors = [search_error(load_n, 0.40, 0.035) for load_n in (1e3, 2e3, 3e3, 4e3, 5e3, 500e3)]
    assert max(errors) > 0.01
    assert errors[-1] < 0.01


def way(speed, dt):
    """Distance [m] by the trapezoidal rule."""
    return float(np.sum(0.5 * (speed[1:] + speed[:-1])) * dt)


def test_the_straight_is_as_long_as_the_paper_says():
    drive = TRIALS[-1].drive(0.01)
    assert way(drive.speed, 0.01) == pytest.approx(2000.0, rel=1e-4)
    assert drive.time_s[-1] == pytest.approx(155.0)
    assert drive.acceleration.max() == pytest.approx(ACCELERATION)


@pytest.mark.parametrize("trial", TRIALS[:2], ids=lambda trial: trial.name)
def test_a_lap_is_as_long_as_its_circle(trial):
    drive = trial.drive(0.01)
    starts = np.flatnonzero((drive.speed[1:] > 0) & (drive.speed[:-1] == 0))
    assert way(drive.speed[: int(starts[1])], 0.01) == pytest.approx(2 * np.pi * 100.0, rel=1e-3)
    assert drive.time_s[-1] == pytest.approx(trial.duration_s)

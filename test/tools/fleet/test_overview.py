# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The overview of a fleet: what its colours mean, and how the size of a change is written."""

import re
from collections import Counter

import numpy as np
import pytest
from fleet_rows import row as good_row
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import poisson

pytest.importorskip("fsspec")
pytest.importorskip("pyarrow")

from trackres_ros.diagnosis import load_base
from trackres_ros.diagnosis.synthetic import drives
from trackres_ros.tools.fleet.alerts import alerts
from trackres_ros.tools.fleet.changes import DAY_S, SUFFER_CHANGE
from trackres_ros.tools.fleet.dataset import FleetDataset
from trackres_ros.tools.fleet.page.write import EDGES, shade, signed, write_pages
from trackres_ros.tools.fleet.trends import change_sentence, day_of, strength, trends

BEGIN_S, RECORDINGS, CHANGED_FROM = 1.75e9, 24, 12
NAMES, UNITS = ("bearing_friction", "torque_gain.error", "torque_offset.offset"), ("1", "1", "Nm")
OF_FILE, STD = np.array([0.0075, 0.0, 0.0]), np.array([0.002, 0.03, 150.0])
SHADE = re.compile(r'<td class="cell ((?:more|less)\d(?: unsure)?|same|unsearched)">')


def fleet(folder, moved, seed=0, recordings=RECORDINGS, mismatch=None, load=True):
    """Dataset of vehicles; `moved`: by vehicle, the change of the parameters from the middle on, in their units."""
    dataset, rng, precision = FleetDataset(folder), np.random.default_rng(seed), np.diag([400.0] * 3)
    dataset.prepare()
    for vehicle, change in moved.items():
        own = 0.2 * rng.standard_normal(3)
        for number in range(recordings):
            point = own + 0.03 * rng.standard_normal(3) + (np.array(change) / STD if number >= CHANGED_FROM else 0.0)
            start = BEGIN_S + 2.0 * DAY_S * number
            more = {
                "url": f"/data/{vehicle}/{number}.csv", "content": f"{vehicle}{number}", "start_s": start, "day": day_of(start),
                "mismatch": (mismatch or {}).get(vehicle, 0.04), "load_recorded": load, "vehicle_values": "v",
                "names": list(NAMES), "units": list(UNITS), "nominal": OF_FILE.tolist(), "std": STD.tolist(), "point": [0.0] * 3,
                "covariance": [0.0] * 6, "precision": precision[np.triu_indices(3)].tolist(),
                "linear": (precision @ point + 20.0 * rng.standard_normal(3)).tolist(),
            }  # fmt: skip
            dataset.put({**good_row(0, vehicle), **more}, None)
    return dataset


def overview(dataset):
    """The page, of each vehicle in the page's order the shades of its months, and all results."""
    result = trends(dataset, {})
    page = write_pages(dataset.folder, result, dataset).read_text()
    rows = re.findall(r'<tr><th><a href="vehicles/([^"]+)\.html">.*?</tr>', page, re.DOTALL)
    texts = re.split(r"<tr><th><a ", page)[1:]
    return page, {name: SHADE.findall(text) for name, text in zip(rows, texts, strict=True)}, result


def unchanged(count):
    return {f"v{number:02d}": (0.0, 0.0, 0.0) for number in range(count)}


def change(size, percent=None, **more):
    return {"size": size, "percent_of_file": percent, "percent_of_torque": None, "alike": [], "unit": "1", **more}


@pytest.mark.parametrize("seed", range(4))
def test_the_largest_change_is_darkest_and_first(tmp_path, seed):
    """The unchanged vehicles have the largest mismatch."""
    worst, small, eased = ((share * OF_FILE[0], 0.0, 0.0) for share in (0.5, 0.19, -0.3))
    moved = {"a": (0.0, 0.0, 0.0), "b": small, "c": worst, "d": (0.0, 0.0, 0.0), "e": eased}
    _, shades, _ = overview(fleet(tmp_path, moved, seed, mismatch={"a": 0.5, "d": 0.4, "c": 0.01}))
    assert list(shades) == ["c", "e", "b", "a", "d"]
    last = {name: months[-1] for name, months in shades.items()}
    assert [last[name][:4] for name in "cbe"] == ["more", "more", "less"]
    assert last["c"][4] == str(len(EDGES) + 1) > last["b"][4]
    assert {*shades["a"], *shades["d"]} == {"same"}
    assert all(months[0] == "same" for months in shades.values())  # before the change


def test_an_unchanged_fleet_is_coloured_at_the_stated_rate(tmp_path):
    coloured, expected = 0, 0.0
    for seed in range(3):
        _, shades, result = overview(fleet(tmp_path / str(seed), unchanged(8), seed, mismatch={"v03": 0.6}))
        coloured += sum(set(months) != {"same"} for months in shades.values())
        expected += result["expected_false_alarms"]
    assert 0.3 < expected < 1.0
    assert coloured <= poisson.ppf(0.999, expected)


def test_a_mismatch_alters_no_colour(tmp_path):
    moved = {**unchanged(3), "worn": (0.003, 0.0, 0.0)}
    high = {"v01": 0.9, "worn": 0.001}
    low, other = (overview(fleet(tmp_path / name, moved, mismatch=of))[1] for name, of in (("low", {}), ("high", high)))
    assert low == other


@given(st.floats(0.01, 1e4), st.floats(0.01, 1e4), st.sampled_from([1.0, -1.0]))
def test_a_larger_change_is_never_paler(one, other, sign):
    low, high = (shade(change(sign, sign * percent)) for percent in sorted((one, other)))
    assert low[:4] == high[:4] == ("more" if sign > 0 else "less")
    assert 1 <= int(low[4]) <= int(high[4]) <= len(EDGES) + 1


def test_a_change_is_in_per_cent_of_the_files_value(tmp_path):
    moved = {**unchanged(3), "worn": (0.003, 0.0, 0.0), "gain": (0.0, 0.09, 0.0), "shifted": (0.0, 0.0, -450.0)}
    page, _, result = overview(fleet(tmp_path, moved))
    worn, gain, shifted = (result["vehicles"][name]["changes"][0] for name in ("worn", "gain", "shifted"))
    assert worn["percent_of_file"] == pytest.approx(100.0 * worn["size"] / OF_FILE[0]) == pytest.approx(40.0, rel=0.2)
    assert (worn["file"], worn["percent_of_torque"]) == (OF_FILE[0], None)
    assert (gain["percent_of_file"], shifted["percent_of_file"]) == (None, None)
    assert gain["percent_of_torque"] == pytest.approx(100.0 * gain["size"])
    assert shifted["percent_of_torque"] == pytest.approx(100.0 * shifted["size"] / 900.0)  # of its mean torque
    assert strength(shifted) == abs(shifted["percent_of_torque"])
    for c, unit in ((worn, "% of the file's value"), (gain, "% of the reading"), (shifted, "Nm")):
        assert f" {unit} (95 %), known on" in change_sentence("x", c)
    assert [alert["percent_of_file"] for alert in alerts(result)] == [None, None, worn["percent_of_file"]]
    assert all(f" {signed(c)}</span>" in page for c in (worn, gain, shifted))
    assert signed(shifted).endswith(" Nm")


def test_direction_and_doubt_of_a_change_are_text_too(tmp_path):
    moved = {**unchanged(3), "worn": (0.003, 0.0, 0.0), "eased": (-0.003, 0.0, 0.0)}
    for load, doubt in ((True, ""), (False, " ?")):
        page, shades, result = overview(fleet(tmp_path / str(load), moved, load=load))
        for name, arrow in (("worn", "▲"), ("eased", "▼")):
            (c,) = result["vehicles"][name]["changes"]
            assert f"{arrow} {signed(c)}{doubt}</span> bearing_friction" in page
            assert ("unsure" in shades[name][-1]) == (not load)
            assert ("payload would also explain it" in change_sentence(name, c)) == (not load)


def test_a_vehicle_with_few_recordings_is_not_called_unchanged(tmp_path):
    dataset = fleet(tmp_path, unchanged(3))
    fleet(tmp_path, {"young": (0.0, 0.0, 0.0)}, recordings=3)
    page, shades, _ = overview(dataset)
    assert set(shades["young"]) == {"unsearched"}
    assert "unsearched" not in {s for name, months in shades.items() for s in months if name != "young"}
    assert "not searched" in page.partition("young.html")[2]


def test_a_growing_change_is_smaller_in_earlier_months(tmp_path):
    dataset = fleet(tmp_path, unchanged(3))
    for row in dataset.rows():
        number = round((row["start_s"] - BEGIN_S) / (2.0 * DAY_S))
        if row["vehicle"] == "v00":
            dataset.put({**row, "linear": [400.0 * 0.2 * max(0, number - 5), *row["linear"][1:]]}, None)
    result = trends(dataset, {})
    (c,) = result["vehicles"]["v00"]["changes"]
    june, july = (result["months"]["v00"][month]["change"] for month in ("2025-06", "2025-07"))
    assert c["kind"] == "ramp"
    assert 0.0 < june["size"] < july["size"]
    assert july["percent_of_file"] == pytest.approx(c["percent_of_file"])  # its last month


def test_more_of_each_parameter_is_more_torque():
    """So one colour is the direction of all of them; the errors of the torque sensor are so by their definition."""
    checked = Counter()
    for vehicle in ("xgd24d", "agri3t"):
        loaded = load_base(vehicle)
        base = loaded.base
        sessions = drives(base, loaded.known.max_speed, 1, 10.0, np.random.default_rng(1))
        for name in set(SUFFER_CHANGE) & set(base.nominal):
            torque, more = (
                np.abs(base.predict(sessions, base.nominal | {name: factor * base.nominal[name]}, ())[0].torque).mean()
                for factor in (1.0, 1.2)
            )
            assert more > torque
            checked[name] += 1
    assert len(checked) == 4


def luminance(colour):
    """Relative one of #rgb or #rrggbb: WCAG 2.2."""
    parts = re.findall("..", colour[1:]) if len(colour) == 7 else [2 * c for c in colour[1:]]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (int(p, 16) / 255.0 for p in parts)]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


def test_a_cells_text_is_readable_and_darker_is_more(tmp_path):
    page = overview(fleet(tmp_path, unchanged(1), recordings=1))[0]
    shades = re.findall(r"\.((?:more|less)\d) \{ background-color: (#\w+); color: (#\w+); \}", page)
    assert len(shades) == 2 * (len(EDGES) + 1)
    for _, background, ink in shades:
        bright, dark = sorted(map(luminance, (background, ink)), reverse=True)
        assert (bright + 0.05) / (dark + 0.05) >= 4.5
    for side in ("more", "less"):
        ladder = [luminance(background) for name, background, _ in shades if name.startswith(side)]
        assert ladder == sorted(ladder, reverse=True)

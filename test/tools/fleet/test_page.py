# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pages of a fleet in a real browser: fifteen vehicles with months of recordings, on a screen and on a phone."""

import hashlib
import re
from html import escape
from urllib.parse import quote, unquote

import numpy as np
import pytest
from browser import IN_A_BROWSER, asked, opened

pytest.importorskip("fsspec")
pytest.importorskip("pyarrow")

from trackres_ros.tools.fleet.changes import DAY_S
from trackres_ros.tools.fleet.dataset import FleetDataset
from trackres_ros.tools.fleet.page.write import write_pages
from trackres_ros.tools.fleet.periods import DIAGNOSES, INPUTS
from trackres_ros.tools.fleet.recordings import find_recordings
from trackres_ros.tools.fleet.task import Task, analyse
from trackres_ros.tools.fleet.trends import day_of, trends
from trackres_ros.tools.fleet.vehicles import one_vehicle

VEHICLES, RECORDINGS, EVERY_DAYS = 15, 6, 14.0
ODD = "Löwe 1 #7 & 50 %"
WORN = "truck-07", 3, 1.2  # which, from which recording on, by how much of the file's standard deviation
pytestmark = [pytest.mark.long, IN_A_BROWSER]


@pytest.fixture(scope="module")
def pages(driven, tmp_path_factory):
    """Of a few recordings that were analysed, many: each with values of its own."""
    fleet = one_vehicle("xgd24d", None)
    found = list(find_recordings([str(driven / "recordings" / "truck-01")]))
    analysed = [analyse(Task(f.url, f.stamp, fleet.vehicle_of(f.url), ())) for f in found]
    folder, rng = tmp_path_factory.mktemp("large"), np.random.default_rng(1)
    dataset = FleetDataset(folder)
    dataset.prepare()
    p = len(analysed[0]["names"])
    bearing = analysed[0]["names"].index("bearing_friction")
    for v in range(VEHICLES):
        own = 0.3 * rng.standard_normal(p)
        for r in range(RECORDINGS):
            row, precision = analysed[r % len(analysed)], np.zeros((p, p))
            precision[np.triu_indices(p)] = row["precision"]
            precision += np.triu(precision, 1).T
            moved = own + 0.1 * rng.standard_normal(p)
            name = f"truck-{v + 1:02d}" if v else ODD
            if name == WORN[0] and r >= WORN[1]:
                moved[bearing] += WORN[2]
            start = analysed[0]["start_s"] + EVERY_DAYS * DAY_S * r
            url = f"/data/{name}/drive_{r:04d}.mcap"
            content = hashlib.sha256(url.encode()).hexdigest()
            linear = np.array(row["linear"]) + precision @ moved
            more = {"url": url, "vehicle": name, "start_s": start, "day": day_of(start), "content": content}
            dataset.put({**row, **more, "linear": linear.tolist()}, None)
    place = folder / DIAGNOSES / quote(ODD, safe="") / dataset.rows(["day"])[0]["day"][:7]
    place.mkdir(parents=True)
    (place / INPUTS).touch()
    (place / "report.html").touch()
    (place / "report.json").write_text('{"verdict": {"status": "none", "sentence": "No physics missing"}}')
    write_pages(folder, trends(dataset, {None: {"bearing_friction": 0.012}}), dataset)
    return folder


def test_on_screen_each_vehicle_is_a_row_without_script_errors(pages, tmp_path):
    done = opened(pages / "index.html", tmp_path, "--dump-dom")
    assert not re.findall(r"CONSOLE.*(?:error|Uncaught)", done.stderr, re.IGNORECASE)
    assert all(name in done.stdout for name in (escape(ODD), *(f"truck-{v + 1:02d}" for v in range(1, VEHICLES))))
    assert f"{VEHICLES * RECORDINGS} of {VEHICLES * RECORDINGS} recordings of {VEHICLES} vehicles compared" in done.stdout
    wide, rows, cells = asked(
        pages / "index.html", tmp_path, 1200, "seen.documentElement.scrollWidth",
        "seen.querySelectorAll('.fleet tbody tr').length", "seen.querySelectorAll('.fleet .cell a').length",
    )  # fmt: skip
    assert wide <= 1200
    assert rows == VEHICLES
    assert cells >= 3 * VEHICLES  # a month each, that leads to the vehicle's page


def test_what_changed_is_said_on_the_first_page(pages):
    assert f"{WORN[0]}: bearing_friction rose at once" in (pages / "index.html").read_text()


@pytest.mark.parametrize("page", ["index.html", "vehicles/truck-07.html"])
def test_on_a_phone_the_page_itself_does_not_scroll_sideways(pages, tmp_path, page):
    (wide,) = asked(pages / page, tmp_path, 400, "seen.documentElement.scrollWidth")
    assert 300 < wide <= 400


def test_every_link_leads_to_a_file(pages):
    for page in (pages / "index.html", *(pages / "vehicles").glob("*.html")):
        for link in re.findall(r'href="([^"#]+)', page.read_text()):
            assert (page.parent / unquote(link)).exists(), f"{page.name}: {link}"
        assert ">-0.0<" not in page.read_text()
    assert f'href="../{DIAGNOSES}/{quote(quote(ODD))}/' in (pages / "vehicles" / f"{quote(ODD)}.html").read_text()

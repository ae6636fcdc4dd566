# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The page in a real browser, where one is installed: on a screen, on a phone, on paper."""

import copy
import html
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from browser import BROWSER, IN_A_BROWSER, asked, opened

from trackres_ros.diagnosis.report.charts import Picture
from trackres_ros.diagnosis.report.page import GRADES, glance, write_page

ON_PAPER = pytest.mark.skipif(BROWSER is None or not shutil.which("pdftotext"), reason="no chromium or pdftotext on this machine")
WHY = "over a thousand times less likely than drivetrain_efficiency, in words that take up their room"


@pytest.fixture(scope="module")
def widest(scrubbed, diagnosed, tmp_path_factory):
    """A page with the longest of everything a report may hold, and that report."""
    output, result, _ = scrubbed
    r = copy.deepcopy(result)
    lap = "2026-02-03T11-12-13_vehicle_17_test_ground_north_loop_second_driver_with_trailer_part_0001.mcap: 12"
    r["heldout"]["laps"] = [lap for _ in r["heldout"]["laps"]]
    r["recordings"] = [f"/data/vehicles/seventeen/winter/{lap}"] * 3
    r["candidates"] = [
        {**r["candidates"][0], "round": 1 + i // 6, "name": "drivetrain_efficiency", "chosen": i == 0, "delta_loglik": 123456.7,
         "level_score": -123456.7, "threshold": 1650.4, "d_prime": 1e-3, "why": f"{WHY} last{i}"} for i in range(12)
    ]  # fmt: skip
    page = tmp_path_factory.mktemp("widest") / "report.html"
    write_page(page, r, glance(diagnosed, {}), shown(output), "Diagnosis of a vehicle with a long name")
    return page, r


def shown(folder):
    """The pictures of a report's folder."""
    return [Picture(path, path.stem, f"What {path.stem} shows, in words") for path in sorted(Path(folder).glob("*.svg"))]


def paper(page, folder):
    """Words of the printed page with their right edges, and the width of its sheets."""
    pdf = folder / "page.pdf"
    opened(page, folder, f"--print-to-pdf={pdf}", "--no-pdf-header-footer")
    boxes = subprocess.run(["pdftotext", "-bbox", pdf, "-"], capture_output=True, text=True, timeout=60, check=True).stdout
    words = re.findall(r'<word xMin="([-\d.]+)".*? xMax="([-\d.]+)".*?>(.*?)</word>', boxes)
    (width,) = set(re.findall(r'<page width="([\d.]+)"', boxes))
    return [(html.unescape(text), float(remainder), float(right)) for remainder, right, text in words], float(width)


@ON_PAPER
def test_on_paper_nothing_is_cut_off(widest, tmp_path):
    page, r = widest
    words, width = paper(page, tmp_path)
    assert [text for text, remainder, right in words if remainder < 0 or right > width] == []
    texts = {text for text, _, _ in words}
    assert {f"last{i}" for i in range(12)} <= texts
    printed_text = "".join(text for text, _, _ in words)
    lap = re.sub(r"\s", "", r["heldout"]["laps"][0])
    assert printed_text.count(lap) > len(r["recordings"])  # by lap too, which is folded on a screen


@IN_A_BROWSER
def test_on_a_phone_the_page_itself_does_not_scroll_sideways(widest, tmp_path):
    page, _ = widest
    wide, pictures = asked(page, tmp_path, 390, "seen.documentElement.scrollWidth", "seen.images.length")
    assert pictures > 4
    assert 300 < wide <= 390


@pytest.mark.parametrize("grade", GRADES)
def test_each_effect_says_how_far_it_is_confirmed(scrubbed, diagnosed, tmp_path, grade):
    output, result, _ = scrubbed
    r = copy.deepcopy(result)
    for part in (r["verdict"], *r["effects"]):
        part["grade"] = grade
    r["written"] = {"base": grade != "refuted", "effects": ["turning_scrub"] if grade == "confirmed" else [], "why": "so it is"}
    result = diagnosed if grade == "confirmed" else replace(diagnosed, kept=replace(diagnosed.kept, effects=()))
    write_page(tmp_path / "report.html", r, glance(result, {}), shown(output), "Diagnosis")
    page = (tmp_path / "report.html").read_text()
    assert [text for text in GRADES.values() if text in page] == [GRADES[grade]]
    written = re.search(r'<p id="written">(.*?)</p>', page)[1]
    assert ("turning_scrub" in written, "no effect" in written) == (grade == "confirmed", grade != "confirmed")
    assert ("the re-fitted base" in written) == r["written"]["base"]
    assert "So it is." in written


def test_the_page_begins_with_the_residual_and_its_terms(scrubbed, diagnosed, tmp_path):
    """And what is only suspected is listed under it, with its probability."""
    output, result, _ = scrubbed
    page = (output / "report.html").read_text()
    assert re.findall("<h2>(.*?)</h2>", page)[0] == "What the model lacks, over time"
    first = re.findall(r'alt="(.*?)"', page)[0]
    assert first.startswith("Measured torque minus the re-fitted model")
    assert "with turning scrub over it; below it the residual" in first
    assert 'id="may-be"' not in page
    r = copy.deepcopy(result)
    r["verdict"]["may_be"] = [{"name": "air_drag", "share": 0.4}, {"name": "none of these", "share": None}]
    write_page(tmp_path / "report.html", r, glance(diagnosed, {}), shown(output), "Diagnosis")
    listed = re.search(r'<ul id="may-be">(.*?)</ul>', (tmp_path / "report.html").read_text())[1]
    assert re.findall("<li>(.*?)</li>", listed) == ["air drag: 40 %", "none of these"]


def test_numbers_on_the_page_are_as_people_write_them(widest):
    page, _ = widest
    cells = re.findall(r'<td class="n"[^>]*>(.*?)</td>', page.read_text())
    assert len(cells) > 30
    for cell in cells:
        assert "e+" not in cell
        assert not re.search(r"(^|[ …])-0(\.0*)?($| )", cell), cell
        assert all(len(re.sub(r"^0+", "", re.sub(r"\D", "", part))) <= 6 for part in cell.split(" … ")), cell

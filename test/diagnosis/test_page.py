"""The page in a real browser, where one is installed."""

import html
import shutil
import subprocess

import pytest

BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
ALONE = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
ALONE += ["--disable-component-update", "--disable-sync", "--enable-logging=stderr", "--virtual-time-budget=3000", "--dump-dom"]


@pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine")
def test_the_page_opens_without_an_error_or_a_network(scrubbed, tmp_path):
    out, found, _ = scrubbed
    page = tmp_path / "report.html"
    page.write_text((out / "report.html").read_text().replace("</body>", SCRIPT + "</body>"))
    command = [BROWSER, *ALONE, f"--user-data-dir={tmp_path / 'profile'}", f"file://{page}"]
    opened = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in opened.stderr
    assert found["verdict"]["sentence"] in html.unescape(opened.stdout)
    seen = dict(part.split("=") for part in opened.stdout.partition("<title>")[2].partition("</title>")[0].split(";"))
    assert int(seen["pictures"]) > 4
    assert seen["shown"] == seen["described"] == seen["pictures"]
    assert seen["requests"] == "0"
    assert float(seen["mae"]) == pytest.approx(found["heldout"]["mae"]["with_effects"], rel=5e-3)


SCRIPT = """<script>window.onload = () => {
  const all = [...document.images];
  const parts = {
    pictures: all.length, shown: all.filter(i => i.naturalWidth > 0).length, described: all.filter(i => i.alt.length > 20).length,
    requests: performance.getEntriesByType("resource").filter(r => r.name.startsWith("http")).length,
    mae: document.getElementById("mae-with_effects").textContent,
  };
  document.title = Object.entries(parts).map(([k, v]) => k + "=" + v).join(";");
}</script>"""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pages in a real browser, where one is installed."""

import shutil
import subprocess

import pytest

BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
ALONE = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"]
ALONE += ["--disable-component-update", "--disable-sync", "--enable-logging=stderr", "--virtual-time-budget=3000"]
IN_A_BROWSER = pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine")


def opened(page, folder, *options):
    """The browser after it has done something with a page."""
    command = [BROWSER, *ALONE, f"--user-data-dir={folder / 'profile'}", *options, f"file://{page}"]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


def asked(page, folder, width, *questions):
    """Whole numbers that expressions about the document `seen` give, where a page is shown so wide [px]."""
    frame = folder / "frame.html"
    frame.write_text(
        f"""<iframe src="file://{page}" style="width:{width}px;height:800px"></iframe><script>window.onload = () => {{
        const seen = document.querySelector("iframe").contentDocument;
        document.title = [{", ".join(questions)}].join(";");
        }}</script>"""
    )
    title = opened(frame, folder, "--allow-file-access-from-files", "--dump-dom").stdout.partition("<title>")[2]
    return [int(answer) for answer in title.partition("</title>")[0].split(";")]

"""What is generated in docs/ is what the program says now, and the links in the pages lead somewhere."""

import re
import subprocess
import sys

import pytest

from trackres_ros.estimator.layout import REASON_TEXT, Count


def test_the_settings_page_is_up_to_date(repository):
    done = subprocess.run(
        [sys.executable, repository / "tools" / "make-docs", "--settings"], capture_output=True, text=True, check=True
    )
    assert done.stdout == (repository / "docs" / "settings.md").read_text()


def test_every_counter_and_reason_has_its_policy(repository):
    page = (repository / "docs" / "robustness.md").read_text()
    for count in Count:
        assert f"`{count.name.lower()}`" in page
    for reason in REASON_TEXT:
        assert f"`{reason.name}`" in page


def test_links_between_pages_lead_somewhere(repository):
    pages = [*repository.glob("*.md"), *(repository / "docs").glob("*.md")]
    assert len(pages) > 8
    for page in pages:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
            if not target.startswith(("http", "mailto")):
                assert (page.parent / target).exists(), f"{page.name}: {target}"


@pytest.mark.parametrize("word", ["make demo", "make test", "docs/laps.png"])
def test_the_readme_starts_with_the_two_commands(repository, word):
    assert word in "\n".join((repository / "README.md").read_text().splitlines()[:20])

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Generated text in docs/ is up to date, and the links in the pages have targets."""

import doctest
import re
import runpy

import pytest

import trackres_ros as tr
from trackres_ros.estimator.columns import REASON_TEXT, Count
from trackres_ros.estimator.constants import PLAUSIBLE
from trackres_ros.node.notices import LIVE_KINDS
from trackres_ros.node.status import COMPARISON_KEYS, DISTURBANCE_KEYS, ESTIMATE_KEYS, INPUT_KEYS, STATE_KEYS

GENERATED = ["docs/api.md", "docs/settings.md", "docs/node.md", "docs/effects.md", "docs/trust.md"]
GENERATED += ["config/trackres.yaml", "config/plotjuggler.xml", "config/foxglove.json"]

MOST_WORDS = 25
"""Of a sentence of a page, and of a cell of a table."""


@pytest.fixture(scope="module")
def texts(repository):
    """What `tools/make-docs` writes: a function for each page."""
    with pytest.MonkeyPatch.context() as changed:
        changed.syspath_prepend(str(repository / "tools"))
        return runpy.run_path(str(repository / "tools" / "make-docs"))["TEXTS"]


@pytest.mark.parametrize("name", GENERATED)
def test_what_is_generated_is_up_to_date(repository, texts, name):
    assert texts[name]() == (repository / name).read_text()


def test_the_examples_of_the_interface_hold(repository, tmp_path, monkeypatch):
    for module in ("pandas", "rosbags"):
        pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    page = repository / "docs" / "api.md"
    failed, tried = doctest.testfile(str(page), module_relative=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert not failed
    assert tried > 20


def test_the_page_of_the_interface_has_all_of_it(repository):
    page = (repository / "docs" / "api.md").read_text()
    told = set(re.findall(r"^### `(\w+)`", page, re.MULTILINE))
    assert told == {*tr.__all__} - {"__version__", "MissingExtraError"}


def test_every_remark_of_the_live_node_is_explained(repository):
    page = (repository / "docs" / "robustness.md").read_text()
    for name, kind in LIVE_KINDS.items():
        assert f"| `{name}` | {kind.level.name.lower()} | {kind.meaning} |" in page


def test_every_input_with_limits_is_listed(repository):
    page = (repository / "docs" / "robustness.md").read_text()
    limits = page.partition("### Limits of the inputs")[2].partition("\n## ")[0].lower()
    for role in ("speed", "load", "wheel_speed", *PLAUSIBLE):
        assert ("acceleration" if role == "accel" else role.replace("_", " ")) in limits


def test_every_key_of_the_diagnostics_is_explained(repository):
    page = (repository / "docs" / "node.md").read_text()
    for keys in (ESTIMATE_KEYS, INPUT_KEYS, COMPARISON_KEYS, STATE_KEYS, DISTURBANCE_KEYS):
        for key in keys:
            assert f"`{key}`" in page


def test_the_commands_of_the_proof_have_the_seeds_of_its_scores(repository):
    commands = (repository / "docs" / "trust.md").read_text()
    runs = (repository / "docs" / "trust" / "runs.csv").read_text()
    assert set(re.findall(r"\b20\d{6}\b", commands)) == set(re.findall(r",(20\d{6}),", runs)) != set()


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


def test_cells_and_lines_of_the_pages_are_short(repository):
    pages = [repository / "README.md", repository / "CONTRIBUTING.md", *(repository / "docs").rglob("*.md")]
    long = []
    for page in pages:
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            cells = re.split(r"(?<!\\)\|", line.strip("|")) if line.startswith("|") else []
            if len(line) >= 2000 or any(len(cell.split()) > 25 for cell in cells):
                long.append(f"{page.name}:{number}: {line[:80]}")
    assert not long, "at most 25 words in a cell and 2,000 characters in a line:\n" + "\n".join(long)


def sentences(text):
    """Sentences of a page without code blocks, tables and pictures; code spans and addresses of links are one word."""
    text = re.sub(r"^ *(```|\$\$).*?^ *\1 *$|<!--.*?-->", "", text, flags=re.DOTALL | re.MULTILINE)
    paragraphs, open_ = [], False
    for line in text.splitlines():
        prose = bool(line.strip()) and not line.startswith(("|", "#")) and (open_ or not line.startswith("    "))
        item = re.match(r"\s*([-*+>]|\d+\.) ", line)
        if prose and (item or not open_):
            paragraphs.append("")
        if prose:
            paragraphs[-1] += " " + line[item.end() if item else 0 :].strip()
        open_ = prose
    for paragraph in paragraphs:
        plain = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", paragraph)
        plain = re.sub(r"`+[^`]+`+|\$[^$]+\$", "code", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", plain))
        yield from re.split(r"(?<=[.!?])[*\"')\]]*\s+", plain)


COUNTED = [("A `b c` [d e](f g).", [4]), ("- A.\n- B c: d\n  e. F", [1, 4, 1]), ("A:\n\n    b c\n", [1])]


@pytest.mark.parametrize(("text", "words"), COUNTED)
def test_sentences_are_counted_as_a_reader_does(text, words):
    assert [len(re.findall(r"\S*\w\S*", sentence)) for sentence in sentences(text)] == words


def test_sentences_of_the_pages_are_short(repository):
    pages = [repository / "README.md", repository / "CONTRIBUTING.md", *(repository / "docs").glob("*.md")]
    long = []
    for page in [*pages, *(repository / "docs" / "decisions").glob("*.md")]:
        found = [s for s in sentences(page.read_text(encoding="utf-8")) if len(re.findall(r"\S*\w\S*", s)) > MOST_WORDS]
        long += [f"{page.name}: {sentence}" for sentence in found]
    assert not long, f"at most {MOST_WORDS} words in a sentence:\n" + "\n".join(long)


@pytest.mark.parametrize("word", ["make demo", "make test", "docs/laps.png"])
def test_the_readme_starts_with_the_two_commands(repository, word):
    assert word in "\n".join((repository / "README.md").read_text().splitlines()[:20])


def test_files_that_pages_name_are_there(repository):
    """By their path from the repository, the package or the proofs."""
    places = [repository, repository / "trackres_ros", repository / "trackres_ros" / "diagnosis"]
    pages = [repository / "README.md", repository / "CONTRIBUTING.md", *(repository / "docs").rglob("*.md")]
    named = [(page, path) for page in pages for path in re.findall(r"`((?:[a-z_]+/)+[a-z_0-9]+\.py)`", page.read_text())]
    assert len(named) > 30
    assert not [(page.name, path) for page, path in named if not any((place / path).exists() for place in places)]

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Generated text in docs/ is up to date or complete, and the links in the pages have targets."""

import doctest
import re
import runpy

import pytest

import trackres_ros as tr
from trackres_ros.effects import catalogue
from trackres_ros.estimator.columns import Count
from trackres_ros.node.notices import KINDS
from trackres_ros.node.parameters import PARAMETERS, make_parameters
from trackres_ros.node.status import COMPARISON_KEYS, DISTURBANCE_KEYS, ESTIMATE_KEYS, INPUT_KEYS, STATE_KEYS
from trackres_ros.node.transport import live_topics
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.roles import PLAUSIBLE
from trackres_ros.tasks.main import cli
from trackres_ros.vehicle import load

GENERATED = ["README.md", "docs/trust.md", "config/trackres.yaml", "config/plotjuggler.xml", "config/foxglove.json"]

MOST_WORDS = 25
"""Of a sentence of a page, and of a cell of a table."""


@pytest.fixture(scope="module")
def make_docs(repository):
    """Names of `tools/make-docs`."""
    with pytest.MonkeyPatch.context() as changed:
        changed.syspath_prepend(str(repository / "tools"))
        return runpy.run_path(str(repository / "tools" / "make-docs"))


@pytest.fixture(scope="module")
def site_pages(make_docs):
    """The pages with tables of the program as the site has them: text by name."""
    return {name: page() for name, page in make_docs["PAGES"].items()}


@pytest.mark.parametrize("name", GENERATED)
def test_what_is_generated_is_up_to_date(repository, make_docs, name):
    assert make_docs["TEXTS"][name]() == (repository / name).read_text()


def test_tables_of_the_program_are_not_stored(repository, site_pages):
    for name, text in site_pages.items():
        stored = (repository / name).read_text(encoding="utf-8")
        for part in re.findall(r"<!-- (\w+) -->", stored):
            lines = [re.search(rf"<!-- {part} -->\n(.*?)<!-- /{part} -->", page, re.DOTALL)[1] for page in (stored, text)]
            assert lines[0].count("\n") == 1
            assert lines[0] != lines[1]


def test_the_examples_of_the_interface_hold(site_pages, tmp_path, monkeypatch):
    for module in ("pandas", "rosbags"):
        pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "api.md"
    page.write_text(site_pages["docs/api.md"], encoding="utf-8")
    failed, tried = doctest.testfile(str(page), module_relative=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert not failed
    assert tried > 20


def test_the_page_of_the_interface_has_all_of_it(repository, site_pages):
    names = {*tr.__all__} - {"__version__", "MissingExtraError"}
    assert set(re.findall(r"^### `(\w+)`", site_pages["docs/api.md"], re.MULTILINE)) == names
    stored = (repository / "docs" / "api.md").read_text(encoding="utf-8")
    assert names <= set(re.findall(r"`(\w+)`", stored))


def test_the_page_of_effects_has_all_of_them(site_pages):
    for effect in catalogue().values():
        for name in [effect.text, *(f"`{effect.name}` | {parameter.name} |" for parameter in effect.parameters)]:
            assert f"| {name}" in site_pages["docs/effects.md"]


def test_the_page_of_the_node_has_parameters_and_topics(repository, site_pages):
    page = site_pages["docs/node.md"]
    for name, parameter in PARAMETERS.items():
        assert re.findall(rf"^\| `{name}` .*\| (.*) \|$", page, re.MULTILINE) == [parameter.meaning]
    for topic in live_topics(load("xgd24d"), Topics.load(repository / "config" / "topics" / "default.yaml")):
        assert f"{topic.name.lstrip('/')}` | {topic.type} |" in page


def test_defaults_that_the_page_of_the_node_tells_hold(repository):
    page = (repository / "docs" / "node.md").read_text(encoding="utf-8")
    parameters = make_parameters({"vehicle": "xgd24d"})
    assert f"keep last {parameters.input_quality().depth}, " in page
    assert f"keep last {parameters.count('output_depth')} " in page
    assert f"`output_rate_hz`, {parameters.number('output_rate_hz'):g} Hz by default" in page
    for name in ("output_deadline_s", "speed_max_age_s", "feedforward_fade_s", "slow_input_max_age_s"):
        default = f"{parameters.number(name):g} s"
        assert f"`{name}` ({default})" in page or f"{default} (`{name}`)" in page


def test_every_status_has_its_cause_and_its_meaning(repository, site_pages):
    causes = (repository / "docs" / "robustness.md").read_text(encoding="utf-8")
    for name, kind in KINDS.items():
        assert f"`{name}`" in causes
        assert f"| `{name}` | {kind.level.name.lower()} | {kind.meaning} |" in site_pages["docs/robustness.md"]


def test_a_status_has_the_level_of_its_kind(repository):
    causes = (repository / "docs" / "robustness.md").read_text(encoding="utf-8").partition("### All statuses")[0]
    levels = re.findall(r"\b(OK|WARN|STALE|ERROR) ((?:`[A-Z_]+`(?:, )?)+)", causes)
    named = [(level, name) for level, names in levels for name in re.findall(r"`(\w+)`", names)]
    assert len({name for _, name in named}) > 45
    assert not [(level, name) for level, name in named if KINDS[name].level.name != level]


def test_every_input_with_limits_is_listed(repository):
    page = (repository / "docs" / "robustness.md").read_text()
    limits = page.partition("### Limits of the inputs")[2].partition("\n## ")[0].lower()
    for role in ("speed", "load", "wheel_speed", *PLAUSIBLE):
        assert ("acceleration" if role == "accel" else role.replace("_", " ")) in limits


def test_every_key_of_the_diagnostics_is_explained(site_pages):
    page = site_pages["docs/node.md"]
    for keys in (ESTIMATE_KEYS, INPUT_KEYS, COMPARISON_KEYS, STATE_KEYS, DISTURBANCE_KEYS):
        for key in keys:
            assert f"`{key}`" in page


def test_the_commands_of_the_proof_have_the_seeds_of_its_scores(repository):
    commands = (repository / "docs" / "trust.md").read_text()
    runs = (repository / "docs" / "trust" / "runs.csv").read_text()
    assert set(re.findall(r"\b20\d{6}\b", commands)) == set(re.findall(r",(20\d{6}),", runs)) != set()


def test_the_page_of_commands_has_each_command(repository):
    page = (repository / "docs" / "commands.md").read_text(encoding="utf-8")
    names = cli.list_commands(None)
    assert len(names) > 20
    assert not [name for name in names if f"`trackres {name}" not in page]


def test_every_counter_has_its_policy(repository):
    page = (repository / "docs" / "robustness.md").read_text()
    for count in Count:
        assert f"`{count.name.lower()}`" in page


def test_links_between_pages_lead_somewhere(repository):
    pages = [*repository.glob("*.md"), *(repository / "docs").glob("*.md")]
    assert len(pages) > 8
    for page in pages:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
            if not target.startswith(("http", "mailto")):
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def pages_of(repository, site_pages, pattern):
    """README, CONTRIBUTING and pages of docs/ as the site has them: text by path."""
    pages = [repository / "README.md", repository / "CONTRIBUTING.md", *repository.glob(pattern)]
    stored = {page.relative_to(repository).as_posix(): page.read_text(encoding="utf-8") for page in pages}
    return {name: site_pages.get(name, text) for name, text in stored.items()}


def test_cells_and_lines_of_the_pages_are_short(repository, site_pages):
    long = []
    for name, text in pages_of(repository, site_pages, "docs/**/*.md").items():
        for number, line in enumerate(text.splitlines(), 1):
            cells = re.split(r"(?<!\\)\|", line.strip("|")) if line.startswith("|") else []
            if len(line) >= 2000 or any(len(cell.split()) > 25 for cell in cells):
                long.append(f"{name}:{number}: {line[:80]}")
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


def test_sentences_of_the_pages_are_short(repository, site_pages):
    long = []
    pages = pages_of(repository, site_pages, "docs/*.md") | pages_of(repository, site_pages, "docs/decisions/*.md")
    for name, text in pages.items():
        found = [s for s in sentences(text) if len(re.findall(r"\S*\w\S*", s)) > MOST_WORDS]
        long += [f"{name}: {sentence}" for sentence in found]
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

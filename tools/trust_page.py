# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""docs/trust.md and README.md: their marked parts, from the tables of the proofs in docs/trust/."""

from itertools import groupby

from marks import ROOT, page_with

from proofs.sealed.results import TARGETS
from proofs.tables import read_table

TRUTHS = {"own": "Own truth", "second": "Second truth", "groomer": "Groomer"}
SCORES = {
    "none: false alarm": "nothing hidden: a name",
    "none: false description": "nothing hidden: a description",
    "single, identifiable: right name": "one effect: its name",
    "compensated, identifiable: right name": "one effect, with a file fitted to it: its name",
    "masked, identifiable: right name": "a weak effect: its name",
    "two, each identifiable: both": "two effects: both names",
    "two: at least one": "two effects: at least one name",
    "not identifiable: class or abstain": "an effect that does not show: a class or silence",
    "outside: confirmed wrong name": "outside the catalogue: a confirmed wrong name",
    "outside: described or unexplained": "outside the catalogue: described or unexplained",
    "outside, seen by the oracle: described, and the statement is true": "outside the catalogue: a true description",
    "street: confirmed wrong name": "a town: a confirmed wrong name",
    "recommended manoeuvre resolves the tie": "a class: the advised manoeuvre separates it",
    "held-out laps: never worse than the base": "held-out laps not worse than re-fitted",
    "95 % intervals cover": "95 % intervals that cover",
}
"""Scores of the page, in words."""
RIGHT = {"one effect that shows": "single, identifiable: right name", "two that show": "two, each identifiable: both"}


def page() -> str:
    """The page with what the tables say."""
    tables = {path.stem: read_table(path) for path in sorted((ROOT / "docs" / "trust").glob("*.csv"))}
    return page_with(
        "docs/trust.md",
        short=short(tables),
        scores=scores(tables["scores"]),
        real=real(tables["real"]),
        replays=replays(tables["real_replays"], tables["real_learning"]),
        payload=payload({row["quantity"]: row["value"] for row in tables["real_numbers"]}),
        emps="\n".join(
            f"- {row['model']}: {row['here_percent']} %, published {row['published_percent']} %"
            for row in tables["emps_errors"]
            if row["published_percent"] and not row["model"].startswith("Coulomb friction in the file")
        ),
        paper="\n".join(paper(row) for row in tables["paper"]),
        loop=loop(tables["loop"]),
    )


def readme() -> str:
    """README.md with the errors of the closed loop."""
    return page_with("README.md", loop=loop(read_table(ROOT / "docs" / "trust" / "loop.csv")))


def loop(rows) -> str:
    """Errors of the feed-forward with the vehicle file before and after the diagnosis."""
    return "; ".join(f"{row['part']} {row['before_nm']} -> {row['after_nm']} Nm" for row in rows[:2])


def markdown(head, rows) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(cells)} |".replace("  ", " ") for cells in (head, *rows)]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:]])


def counted(rows, score, truths=tuple(TRUTHS)) -> str:
    """Hits and tries of a score over truths: ``3 of 11``."""
    of_score = [row for row in rows if row["score"] == score and row["truth"] in truths and row["of"]]
    return " of ".join(str(sum(int(row[part]) for row in of_score)) for part in ("hits", "of"))


def short(tables) -> str:
    """What a reader must know, over all truths."""
    rows, real = tables["scores"], tables["real"]
    outcomes = {outcome: sum(row["outcome"] == outcome for row in real) for outcome in ("right", "silent", "wrong")}
    return "\n".join(
        (
            f"- With nothing hidden, {counted(rows, 'none: false alarm')} sealed cases got a name, "
            f"{counted(rows, 'none: false description')} a description.",
            *(f"- {what[0].upper()}{what[1:]}: {counted(rows, score)} named rightly." for what, score in RIGHT.items()),
            f"- Physics outside the catalogue: {counted(rows, 'outside: confirmed wrong name')} got a confirmed wrong name, "
            f"{counted(rows, 'outside: described or unexplained')} were described or unexplained.",
            f"- Held-out laps: {counted(rows, 'held-out laps: never worse than the base')} cases are not worse than re-fitted.",
            f"- Real recordings with a concealed channel: {outcomes['right']} right, {outcomes['silent']} silent, "
            f"{outcomes['wrong']} wrong of {len(real)}.",
        )
    )


def scores(rows) -> str:
    """The main scores of each truth, with their targets; bold where missed."""
    by_score = {(row["truth"], row["score"]): row for row in rows}

    def cell(row) -> str:
        if row is None or not row["value"]:
            return ""
        text = f"{row['hits']} of {row['of']}"
        return f"**{text}**" if row["met"] == "no" else text

    return markdown(
        ("Score", "Target", *TRUTHS.values()),
        [
            (words, " ".join(map(str, TARGETS[score])), *(cell(by_score.get((truth, score))) for truth in TRUTHS))
            for score, words in SCORES.items()
        ],
    )


def real(rows) -> str:
    """What was found where a channel was concealed; recordings are named once."""
    cells, last = [], ""
    for row in rows:
        name = "" if row["recordings"] == last else row["recordings"]
        cells.append((name, row["concealed"], row["found"].replace("_", " "), row["outcome"]))
        last = row["recordings"]
    return markdown(("Recordings", "Concealed", "Found", "Outcome"), cells)


def replays(errors, learned) -> str:
    """The error of replays with the shipped file and with all that a diagnosis wrote; what learning while driving changes."""
    lines = []
    for drives, group in groupby(errors, key=lambda row: row["drives"]):
        first, *_, last = group
        lines.append(f"- {drives}: {first['error_nm']} -> {last['error_nm']} Nm with {last['files']}")
    for teacher, group in groupby(learned, key=lambda row: row["teacher"].partition(",")[0]):
        shares = [float(row["learned_nm"]) / float(row["file_nm"]) - 1.0 for row in group]
        low, high = (f"{100.0 * share:+.0f}".replace("-0", "0") for share in (min(shares), max(shares)))
        lines.append(f"- learning on {teacher} while driving, on its other drives: {low} to {high} %")
    return "\n".join(lines)


def payload(numbers) -> str:
    """How well masses without recorded passengers follow them."""
    close, joined = (next(numbers[q] for q in numbers if q.startswith(f"bus: {of}")) for of in ("of these", "stretches joined"))
    correlation = numbers["bus: correlation of the masses with the passengers"]
    return f"they follow the passengers with a correlation of {correlation}; {close} of {joined} are within 8 % of their weight"


def paper(row) -> str:
    """The findings of one way to drive the paper's test."""
    found = row["found"].replace("_", " ")
    return f"- {row['driven']}: {found}. Held-out error: {row['refitted_nm']} -> {row['with_effects_nm']} Nm."

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""report.html: one page without a network, readable on paper and on a phone. Its first view is a sentence and four tiles."""

from __future__ import annotations

import base64
import hashlib
import platform
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy

from trackres_ros.diagnosis.empirical.term import FOLLOWED, Term, by_improvement
from trackres_ros.diagnosis.findings.verdict import LACK_OF_FIT_P
from trackres_ros.diagnosis.findings.wording import alternatives_text, capitalise, form_words, is_small, largest_of, range_of
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.report.charts import Picture
from trackres_ros.diagnosis.report.interactive import Interactive
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SUSPECTED
from trackres_ros.effects.effect import BELONGS_TO
from trackres_ros.files.file_sets import present_content
from trackres_ros.files.own_files import write
from trackres_ros.text import alike, decimals, figures, templates, told_apart
from trackres_ros.vehicle.writing.sensor_lines import file_phrase
from trackres_ros.version import __version__

MOST_WORDS = 40  # upper limit for the sentence
STANDS_OUT_P, MOST_LIGHTS = 0.05, 6  # of bins
FEW = 3  # most names in a sentence
LEAST_SHARE = 0.01  # of the mean error: least gain for a new file
ANSWERS = {
    "spells": "At times, on and off",
    "place": "By place on the route",
    "recordings": "From recording to recording",
    "drift": "Over time, slowly",
}
SURE = "laps left out of the fit confirm it"
SURE_OF_NONE = {
    CONFIRMED: "the hold-out laps confirm it",
    SUSPECTED: "the hold-out laps neither confirm nor reject the re-fit",
    REFUTED: "the hold-out laps reject the re-fit",
}


class Tile(NamedTuple):
    """A question, its answer in a few words, and the details."""

    name: str
    answer: str
    detail: str


class Glance(NamedTuple):
    """The first view of a page."""

    headline: str
    tiles: tuple[Tile, ...]
    highlights: tuple[tuple[str, str], ...]  # keys and words of highlightable items
    by_file: tuple[list[str], list[str]]  # names of the written effects: in vehicle.yaml, and in surroundings.yaml
    stage: str  # the last completed stage: the re-fitted base, or the fit with terms


def glance(d: Diagnosis, lines: Mapping[str, str]) -> Glance:
    """The first view of a diagnosis, which may write `lines` for the topics file."""
    return Glance(headline(d), tiles(d, lines), tuple(list_highlights(d)), by_file(d), stage_of(d))


def tiles(d: Diagnosis, lines: Mapping[str, str]) -> tuple[Tile, ...]:
    """The four tiles, in reading order."""
    return _place_tile(d), _cause_tile(d), _error_tile(d), _advice_tile(d, lines)


def headline(d: Diagnosis) -> str:
    """The verdict in fewer than `MOST_WORDS` words; parts that the tiles repeat are dropped first."""
    place, cause = _place_tile(d), _cause_tile(d)
    verdict, lead, possible_causes = d.verdict, leading(d), _list_possible_causes(d)
    errors = f"Hold-out error: {_errors(d)}"
    if verdict.status == "none":
        sensor_sentences = [s.statement for s in d.gated.sensors]
        parts = [
            *(sensor_sentences or [cause.answer]),
            *(f"The largest: {change.text}" for change in verdict.changed[:1]),
            errors,
        ]
    elif lead is None or verdict.status == "unexplained":
        remark = "" if d.last.hint else "No effect of the catalogue explains it"
        parts = [verdict.seen, f"It may be: {possible_causes}" if possible_causes else remark]
    elif not lead.is_named:
        remark = "" if lead.instead else "No effect of the catalogue explains this"
        parts = [lead.sentences[0], errors, f"Also confirmed: {_names(d)}" if _names(d) else remark]
    else:
        place_text = f"{place.answer}, {place.detail[:1].lower()}{place.detail[1:]}" if lead.place else place.detail
        has_several = sum(t.is_named for t in _sure_terms(d)) > 1
        parts = [place_text, f"The cause{'s are' if has_several else ' is'} {_names(d)} (confirmed)", errors]
    text = ""
    for part in filter(None, parts):
        if len(f"{text} {part}".split()) < MOST_WORDS:
            text = f"{text} {part}.".strip()
    return text or f"{' '.join(parts[0].split()[: MOST_WORDS - 2])} ..."


def _list_possible_causes(d: Diagnosis) -> str:
    """Possible causes, with probabilities; empty if none is listed."""
    names_listed = d.verdict.may_be[:FEW]
    return ", ".join(_plain_name(name) + ("" if share is None else f" ({100.0 * share:.0f} %)") for name, share in names_listed)


def stage_of(d: Diagnosis) -> str:
    """The last completed stage: the re-fitted base, or the fit with found effects and terms."""
    return "with_effects" if d.terms else "refitted"


def list_highlights(d: Diagnosis) -> Iterator[tuple[str, str]]:
    """Keys and words of highlightable items: effects where they act most, and significant bins."""
    for t in d.found:
        if t.spans:
            yield f"effect:{t.name}", f"{_plain_name(t.name)} acts most"
    numbers = Counter[str]()
    bins = []
    for b in d.at_base.bins:
        if b.p < STANDS_OUT_P:
            bins.append((b, f"{b.variable}:{numbers[b.variable]}"))
        numbers[b.variable] += 1
    for b, key in sorted(bins, key=lambda pair: (pair[0].p, -abs(pair[0].mean_residual)))[:MOST_LIGHTS]:
        yield key, f"{range_of(b)}: {decimals(b.mean_residual, signed=True)} Nm"


def _reported_terms(d: Diagnosis) -> list[Term]:
    """All terms and a drift: confirmed ones first, then those that reduce the hold-out error most."""
    return by_improvement([*d.terms, *([] if d.drift is None else [d.drift])])


def leading(d: Diagnosis) -> Term | None:
    """The confirmed term, named or not, that reduces the hold-out error most; without one, an unconfirmed term."""
    return next(iter(_reported_terms(d)), None)


def _place_tile(d: Diagnosis) -> Tile:
    name, lead, verdict = "Where", leading(d), d.verdict
    if verdict.status == "none":
        count = len(d.at_end.bins)
        ranges = f"{count} range{'' if count == 1 else 's'} of speed, load, temperature and more were compared"
        return Tile(name, "Nowhere after the re-fit" if verdict.changed else "No difference beyond noise", ranges)
    unexplained = verdict.status == "unexplained"
    unexplained_bins = [b for b in d.at_end.bins if b.p < LACK_OF_FIT_P]
    if unexplained and unexplained_bins:
        b = largest_of(unexplained_bins)
        return Tile(name, f"At {range_of(b)}", f"{decimals(b.mean_residual, signed=True)} Nm on average")
    if lead is None or verdict.slow:
        return Tile(name, "At times unrelated to any recorded channel", verdict.seen)
    if not lead.is_named:
        answer = ANSWERS.get(str(lead.form)) or f"By {lead.variable or lead.gate or 'time'}"
        return Tile(name, answer, f"About {figures(lead.size_nm)} Nm where it acts")
    location, place = lead.location, lead.place
    lead_text = f"By {location.variable}" if location is not None and location.both_ways else "Everywhere"
    if location is not None and location.tightest_m is not None and place == location.text:
        place = f"in curves tighter than {figures(location.tightest_m, 2)} m"
    return Tile(name, capitalise(place) or lead_text, capitalise(lead.seen))


def _cause_tile(d: Diagnosis) -> Tile:
    name, verdict, possible_causes = "What", d.verdict, _list_possible_causes(d)
    if verdict.status == "none":
        answer = "Only values of the file were wrong" if verdict.changed else "No physics is missing"
        if d.gated.sensors:
            other_answer = f"apart from that: {answer[0].lower()}{answer[1:]}"
            return Tile(name, "A sensor may be wrong", f"{d.gated.sensors[0].statement}; {other_answer}")
        return Tile(name, answer, SURE_OF_NONE[verdict.grade])
    sure_terms = _sure_terms(d)
    if not sure_terms:
        hint = d.last.hint
        hint_text = f"{_plain_name(hint)} may be a part of it" if hint else "no effect of the catalogue explains it"
        return Tile(name, "Unexplained", f"it may be: {possible_causes}" if possible_causes else hint_text)
    answers, detail = [], [SURE]
    for term in sure_terms:
        if not term.is_named:
            answers.append(f"{form_words(term)} (no name)")
        elif len(term.members) == 1:
            answers.append(_plain_name(term.name))
        else:
            names_by_weight = sorted(term.members, key=lambda n: -term.weights[n])
            rest_text = [f"{len(names_by_weight) - FEW} more"] if len(names_by_weight) > FEW else []
            answers.append(
                alternatives_text(
                    [*(f"{_plain_name(n)} ({100 * term.weights[n]:.0f} %)" for n in names_by_weight[:FEW]), *rest_text]
                )
            )
            detail.append("not distinguishable here")
    if possible_causes:
        detail.append(f"it may also be: {possible_causes}")
    return Tile(name, " and ".join(answers), "; ".join(dict.fromkeys(detail)))


def by_file(d: Diagnosis) -> tuple[list[str], list[str]]:
    """Names of the written effects: in vehicle.yaml, and in surroundings.yaml."""
    surroundings_names = {t.name for t in d.found if t.effect.belongs_to == "surroundings"}
    names_written = [name for kind in BELONGS_TO for name in d.kept.names_of(kind)]
    return [n for n in names_written if n not in surroundings_names], [n for n in names_written if n in surroundings_names]


def _error_tile(d: Diagnosis) -> Tile:
    share = 100.0 * _share(d)
    equal_text = "Nothing to gain" if d.verdict.status == "none" else "No better"
    answer = equal_text if abs(share) < 100.0 * LEAST_SHARE else f"{abs(share):.0f} % {'less' if share > 0.0 else 'more'} error"
    file_note = "" if d.kept.values is not None or any(by_file(d)) else "; the file keeps its values"
    return Tile("How much better", answer, f"mean error of the hold-out laps: {_errors(d)}{file_note}")


def _advice_tile(d: Diagnosis, lines: Mapping[str, str]) -> Tile:
    name, lead, unexplained = "Next", leading(d), d.verdict.status == "unexplained"
    if d.gated.sensors and not lines:
        return Tile(name, "Check the sensor", f"{d.gated.sensors[0].statement}; correct one and diagnose again")
    for task in d.advice:
        if lead is None or lead.name in task.separates:
            return Tile(name, "Drive once more", f"{capitalise(task.manoeuvre)} ({figures(task.minutes, 2)} min)")
    if lines:
        return Tile(name, "Correct the sensor", f"{file_phrase(lines)} {'; '.join(lines.values())}")
    if d.found and any(by_file(d)):
        own_names, surroundings_names = (" and ".join(map(_plain_name, names)) for names in by_file(d))
        if not surroundings_names:
            return Tile(name, "Use vehicle.yaml", f"it has {own_names}")
        for_places = f"surroundings.yaml has {surroundings_names}, for the places where it applies"
        return Tile(
            name,
            "Use vehicle.yaml and surroundings.yaml",
            f"the first has {own_names}; {for_places}" if own_names else for_places,
        )
    if lead is not None and lead.confirmed and not lead.is_named:
        return Tile(name, "Look for the cause", " or ".join(lead.mechanisms[:2]))
    if lead is not None and lead.confirmed and not unexplained:
        return Tile(name, "Keep the given values", "the result is not written; the full verdict has the reason")
    if lead is not None:
        return Tile(name, "Record more laps", "the result is not confirmed")
    if unexplained:
        return Tile(name, "Investigate where the error is largest", "record more channels there: slope, wind, load, brakes")
    if d.kept.values is not None and _share(d) >= LEAST_SHARE:
        return Tile(name, "Use vehicle.yaml", "it has the re-fitted parameters")
    return Tile(name, "Nothing to do", "keep the given values")


def _errors(d: Diagnosis) -> str:
    mae, followed_error, error_without_sensor = d.held_out.mae, _error_with_following(d), d.held_out.without_sensor
    with_it, modelled_terms = mae["with_effects"], [t for t in _sure_terms(d) if t.form not in FOLLOWED]
    if followed_error is not None:
        with_it, error_without_sensor, modelled_terms = followed_error, None, _sure_terms(d)[:1]
    sensor_text = (
        ""
        if error_without_sensor is None
        else f", {figures(error_without_sensor)} without the assumed error of the torque sensor"
    )
    error_text = f"{figures(mae['nominal'])} Nm with the file, {figures(mae['refitted'])} re-fitted"
    if followed_error is None and stage_of(d) != "with_effects":
        return f"{error_text}{sensor_text}"
    sources = dict.fromkeys(filter(None, (t.held_out_from for t in modelled_terms)))
    source_text = f", from {' and '.join(sources)}" if sources else ""
    return f"{error_text}, {figures(with_it)} with it{source_text}{sensor_text}"


def _error_with_following(d: Diagnosis) -> float | None:
    """Mean hold-out error with live estimation of an unpredictable term; None if not needed."""
    sure_terms = _sure_terms(d)
    return sure_terms[0].improvement.after if sure_terms and sure_terms[0].form in FOLLOWED else None


def _share(d: Diagnosis) -> float:
    """Share of the mean hold-out error that the last stage removes; 0 without an error, as of a torque of the model itself."""
    mae, followed_error, error_without_sensor = d.held_out.mae, _error_with_following(d), d.held_out.without_sensor
    final_error = (
        mae[stage_of(d)] if error_without_sensor is None else error_without_sensor
    )  # no file holds an error of the sensor
    final_error = final_error if followed_error is None else followed_error
    return (mae["nominal"] - final_error) / mae["nominal"] if mae["nominal"] else 0.0


def _sure_terms(d: Diagnosis) -> list[Term]:
    """Confirmed terms, named or not, the largest reduction of the hold-out error first; none if the residual is
    too large to trust them. Small ones are omitted if there are others.
    """
    if d.verdict.status == "unexplained":
        return []
    sure_terms = [t for t in _reported_terms(d) if t.confirmed]
    return [t for t in sure_terms if not is_small(t)] or sure_terms


def _names(d: Diagnosis) -> str:
    """The names; for a large class, the number of its members."""
    classes = [t.members for t in _sure_terms(d) if t.is_named]
    return " and ".join(
        " or ".join(map(_plain_name, names)) if len(names) <= FEW else f"one of {len(names)} effects" for names in classes
    )


def _plain_name(name: str) -> str:
    return name.replace("_", " ")


KINDS = {".svg": "image/svg+xml", ".png": "image/png"}
VERDICTS = {
    "none": "No physics missing",
    "named": "Named",
    "one_of": "One of several",
    "described": "Described",
    "unexplained": "Unexplained",
}
GRADES = {
    "confirmed": "confirmed by laps left out of the fit",
    "suspected": "suspected: it fits, but is not confirmed",
    "refuted": "refuted: laps left out of the fit get worse with it, or it replaces a given value",
}


def write_page(
    path: Path,
    report: dict[str, Any],
    summary: Glance,
    pictures: Sequence[Picture],
    title: str,
    plots: Interactive | str = "",
    provenance: Sequence[tuple[str, str]] = (),
) -> None:
    """Write the page of a report, with its first view and pictures in it.

    Parameters
    ----------
    plots
        Interactive plots, or the reason for having none.
    provenance
        Sources of the page: names and texts.

    Raises
    ------
    MissingExtraError
        Without jinja2.
    """
    package = "trackres_ros.diagnosis.report"
    environment = templates(package, "report.html", "diagnosis", figures=figures, interval=interval, r2=r2)
    page = environment.get_template("page.html").render(
        r=report,
        title=title,
        verdict=VERDICTS[report["verdict"]["status"]],
        grades=GRADES,
        **summary._asdict(),
        plots=plots if isinstance(plots, Interactive) else None,
        no_plots=plots if isinstance(plots, str) else "",
        script=Path(__file__).with_name("page.js").read_text(encoding="utf-8"),
        provenance=provenance,
        pictures=[(p, KINDS[p.path.suffix], base64.b64encode(present_content(p.path) or b"").decode()) for p in pictures],
    )
    write(path, page.encode())


def r2(value: float | None) -> str:
    """A coefficient of determination; a value below 1 is never rounded to 1."""
    text = decimals(value, 3)
    return "> 0.999" if text == "1.000" and value != 1.0 else text


def interval(parameter: dict[str, Any]) -> tuple[str, str, str]:
    """A parameter's value, its interval, and the vehicle file's value, all rounded to the precision of the interval."""
    values = parameter["value"], parameter.get("nominal")
    if not parameter["ci95"] or None in parameter["ci95"]:
        value, nominal = (figures(v) for v in values)
        return value, "only a bound" if parameter.get("bound_only") else "-", nominal
    low, high = parameter["ci95"]
    value, nominal, *ends = alike((*values, low, high), high - low)
    return value, " … ".join(ends), nominal


def provenance(read: Sequence[Path], seconds: float | None) -> list[tuple[str, str]]:
    """Name and text of each item of the provenance, from the read files and folders and the duration of the diagnosis."""
    program = Path(sys.argv[0])
    words = [program.name] if program.stem != "__main__" else ["python", "-m", program.parent.name]
    names = told_apart([str(path) for path in read])
    versions = f"trackres {__version__}, Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}"
    return [
        ("made", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"),
        ("version", versions),
        ("command", shlex.join([*words, *sys.argv[1:]])),
        *([] if seconds is None else [("duration", f"{seconds:.1f} s, without this page")]),
        *((name, f"SHA-256 {digest}") for name, path in zip(names, read, strict=True) if (digest := sha256(path))),
    ]


def sha256(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder in sequence; empty if neither exists."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else []
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as content:
            while block := content.read(1 << 20):
                digest.update(block)
    return digest.hexdigest() if files else ""

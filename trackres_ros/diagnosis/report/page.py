# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""report.html: one page without a network, readable on paper and on a phone.

The four tiles of the page and the sentence over them: where, what, how much better, next step.
"""

from __future__ import annotations

import base64
import hashlib
import platform
import re
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from trackres_ros.diagnosis.empirical.terms import FOLLOWED
from trackres_ros.diagnosis.findings.verdict import LACK_OF_FIT_P
from trackres_ros.diagnosis.findings.wording import either, form_words, upper
from trackres_ros.diagnosis.report.interactive import Interactive
from trackres_ros.diagnosis.report.series import MOST_RECORDINGS, Picture
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, REFUTED, SMALL_SHARE, SUSPECTED
from trackres_ros.files.file_sets import present
from trackres_ros.files.own_files import write
from trackres_ros.text.names import told_apart
from trackres_ros.text.numbers import alike, decimals, figures, from_to
from trackres_ros.text.templates import templates
from trackres_ros.vehicle.writing.sensor_lines import replaced
from trackres_ros.version import __version__

MOST_WORDS = 40  # upper limit for the sentence
STANDS_OUT_P, MOST_LIGHTS = 0.05, 6  # of bins
FEW = 3  # most names in a sentence
AVERAGED = "Averaged"  # first word of a slow residual's description
LEAST_SHARE = 0.01  # of the mean error: least gain for a new file
SURE = "laps left out of the fit confirm it"
SURE_OF_NONE = {
    CONFIRMED: "the hold-out laps confirm it",
    SUSPECTED: "the hold-out laps neither confirm nor reject the re-fit",
    REFUTED: "the hold-out laps reject the re-fit",
}


@dataclass(frozen=True, slots=True)
class Tile:
    """A question, its answer in a few words, and the details."""

    name: str
    answer: str
    detail: str


def tiles(report: dict[str, Any]) -> tuple[Tile, ...]:
    """The four tiles of a report, in reading order."""
    return _where(report), _what(report), _better(report), _next(report)


def headline(report: dict[str, Any]) -> str:
    """The verdict in fewer than `MOST_WORDS` words; parts that the tiles repeat are dropped first."""
    where, what, *_ = tiles(report)
    verdict, lead, possible = report["verdict"], leading(report), _possible(report)
    errors = f"Hold-out error: {_errors(report)}"
    if verdict["status"] == "none":
        said = [s["text"] for s in report["sensors"]]
        parts = [*(said or [what.answer]), *(f"The largest: {changed['text']}" for changed in verdict["changed"][:1]), errors]
    elif lead is None or verdict["status"] == "unexplained":
        nothing = "" if verdict["hint"] else "No effect of the catalogue explains it"
        parts = [verdict["seen"], f"It may be: {possible}" if possible else nothing]
    elif "form" in lead:
        first, *_ = lead["sentence"].split(". ")
        nothing = "" if lead.get("instead") else "No effect of the catalogue explains this"
        parts = [first, errors, f"Also confirmed: {_names(report)}" if _names(report) else nothing]
    else:
        placed = f"{where.answer}, {where.detail[:1].lower()}{where.detail[1:]}" if lead["acts"]["text"] else where.detail
        several = sum("form" not in term for term in _sure(report)) > 1
        parts = [placed, f"The cause{'s are' if several else ' is'} {_names(report)} (confirmed)", errors]
    text = ""
    for part in filter(None, parts):
        if len(f"{text} {part}".split()) < MOST_WORDS:
            text = f"{text} {part}.".strip()
    return text or f"{' '.join(parts[0].split()[: MOST_WORDS - 2])} ..."


def _possible(r: dict[str, Any]) -> str:
    """Possible causes, with probabilities; empty if none is listed."""
    listed = r["verdict"]["may_be"][:FEW]
    return ", ".join(_plain(x["name"]) + ("" if x["share"] is None else f" ({100.0 * x['share']:.0f} %)") for x in listed)


def stage_of(report: dict[str, Any]) -> str:
    """The last completed stage: the re-fitted base, or the fit with found effects and terms."""
    modelled = report["effects"] or [t for t in report["described"] if t["heldout"] and t["form"] not in FOLLOWED]
    return "with_effects" if modelled else "refitted"


def range_of(b: dict[str, Any]) -> str:
    """The range of a bin in words."""
    return f"{b['variable']} {from_to(b['lo'], b['hi'])} {b['unit']}"


def lights(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Keys and words of highlightable items: effects where they act most, and significant bins."""
    for e in report["effects"]:
        if e["where"]["time"]:
            yield f"effect:{e['name']}", f"{_plain(e['name'])} acts most"
    numbers = Counter[str]()
    bins = []
    for b in report["residual_by_regime"]["base"]:
        if b["p"] < STANDS_OUT_P:
            bins.append((b, f"{b['variable']}:{numbers[b['variable']]}"))
        numbers[b["variable"]] += 1
    for b, key in sorted(bins, key=lambda of: (of[0]["p"], -abs(of[0]["mean_residual"])))[:MOST_LIGHTS]:
        yield key, f"{range_of(b)}: {decimals(b['mean_residual'], signed=True)} Nm"


def leading(r: dict[str, Any]) -> dict[str, Any] | None:
    """The confirmed term, named or not, that reduces the hold-out error most; without one, an unconfirmed term."""
    return max([*r["effects"], *r["described"]], key=lambda t: (t["grade"] == CONFIRMED, _gained(t)[0]), default=None)


def _where(r: dict[str, Any]) -> Tile:
    name, lead, verdict = "Where", leading(r), r["verdict"]
    if verdict["status"] == "none":
        count = len(r["residual_by_regime"]["end"])
        ranges = f"{count} range{'' if count == 1 else 's'} of speed, load, temperature and more were compared"
        return Tile(name, "Nowhere after the re-fit" if verdict["changed"] else "No difference beyond noise", ranges)
    unexplained = verdict["status"] == "unexplained"
    left = [b for b in r["residual_by_regime"]["end"] if b["p"] < LACK_OF_FIT_P]
    if unexplained and left:
        b = max(left, key=lambda b: abs(b["mean_residual"]))
        return Tile(name, f"At {range_of(b)}", f"{decimals(b['mean_residual'], signed=True)} Nm on average")
    if lead is None or (unexplained and verdict["seen"].startswith(AVERAGED)):
        return Tile(name, "At times unrelated to any recorded channel", verdict["seen"])
    if "form" in lead:
        answers = {
            "spells": "At times, on and off",
            "place": "By place on the route",
            "recordings": "From recording to recording",
            "drift": "Over time, slowly",
        }
        answer = answers.get(lead["form"]) or f"By {lead['variable'] or lead['gate'] or 'time'}"
        return Tile(name, answer, f"About {figures(lead['size_nm'])} Nm where it acts")
    by = f"By {lead['acts']['by']}" if lead["acts"]["by"] else "Everywhere"
    return Tile(name, upper(_of_curves(lead["acts"]["text"])) or by, upper(lead["acts"]["size"]))


def _of_curves(text: str) -> str:
    """A range in words; a curvature as the radius of the curve."""
    above = re.fullmatch(r"above (\S+) 1/m of curvature", text)
    return f"in curves tighter than {figures(1.0 / float(above[1]), 2)} m" if above and float(above[1]) > 0.0 else text


def _what(r: dict[str, Any]) -> Tile:
    name, verdict, possible = "What", r["verdict"], _possible(r)
    if verdict["status"] == "none":
        answer = "Only values of the file were wrong" if verdict["changed"] else "No physics is missing"
        if r["sensors"]:
            besides = f"apart from that: {answer[0].lower()}{answer[1:]}"
            return Tile(name, "A sensor may be wrong", f"{r['sensors'][0]['text']}; {besides}")
        return Tile(name, answer, SURE_OF_NONE[verdict["grade"]])
    sure = _sure(r)
    if not sure:
        hint = verdict["hint"]
        nothing = f"{_plain(hint)} may be a part of it" if hint else "no effect of the catalogue explains it"
        return Tile(name, "Unexplained", f"it may be: {possible}" if possible else nothing)
    answers, detail = [], [SURE]
    for term in sure:
        if "form" in term:
            answers.append(f"{form_words(term['form'])} (no name)")
        elif len(term["class"]) == 1:
            answers.append(_plain(term["name"]))
        else:
            likeliest = sorted(term["class"], key=lambda n: -term["weights"][n])
            more = [f"{len(likeliest) - FEW} more"] if len(likeliest) > FEW else []
            answers.append(either([*(f"{_plain(n)} ({100 * term['weights'][n]:.0f} %)" for n in likeliest[:FEW]), *more]))
            detail.append("not distinguishable here")
    if possible:
        detail.append(f"it may also be: {possible}")
    return Tile(name, " and ".join(answers), "; ".join(dict.fromkeys(detail)))


def by_file(r: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Names of the written effects: in vehicle.yaml, and in surroundings.yaml."""
    around = {e["name"] for e in r["effects"] if e["belongs_to"] == "surroundings"}
    written = r["written"]["effects"]
    return [n for n in written if n not in around], [n for n in written if n in around]


def _better(r: dict[str, Any]) -> Tile:
    share = 100.0 * _share(r)
    same = "Nothing to gain" if r["verdict"]["status"] == "none" else "No better"
    answer = same if abs(share) < 100.0 * LEAST_SHARE else f"{abs(share):.0f} % {'less' if share > 0.0 else 'more'} error"
    kept = "" if r["written"]["base"] or r["written"]["effects"] else "; the file keeps its values"
    return Tile("How much better", answer, f"mean error of the hold-out laps: {_errors(r)}{kept}")


def _next(r: dict[str, Any]) -> Tile:
    name, lead, written = "Next", leading(r), r["written"]
    unexplained = r["verdict"]["status"] == "unexplained"
    if r["sensors"] and not r["topics_lines"]:
        return Tile(name, "Check the sensor", f"{r['sensors'][0]['text']}; correct one and diagnose again")
    for a in r["advice"]:
        if lead is None or lead["name"] in a["separates"]:
            return Tile(name, "Drive once more", f"{upper(a['manoeuvre'])} ({figures(a['minutes'], 2)} min)")
    if r["topics_lines"]:
        return Tile(name, "Correct the sensor", f"{replaced(r['topics_lines'])} {'; '.join(r['topics_lines'].values())}")
    if r["effects"] and written["effects"]:
        here, elsewhere = (" and ".join(map(_plain, names)) for names in by_file(r))
        if not elsewhere:
            return Tile(name, "Use vehicle.yaml", f"it has {here}")
        of_place = f"surroundings.yaml has {elsewhere}, for the places where it applies"
        return Tile(name, "Use vehicle.yaml and surroundings.yaml", f"the first has {here}; {of_place}" if here else of_place)
    if lead is not None and lead["grade"] == CONFIRMED and "form" in lead:
        return Tile(name, "Look for the cause", " or ".join(lead["mechanisms"][:2]))
    if lead is not None and lead["grade"] == CONFIRMED and not unexplained:
        return Tile(name, "Keep the given values", "the result is not written; the full verdict has the reason")
    if lead is not None:
        return Tile(name, "Record more laps", "the result is not confirmed")
    if unexplained:
        return Tile(name, "Investigate where the error is largest", "record more channels there: slope, wind, load, brakes")
    if written["base"] and _share(r) >= LEAST_SHARE:
        return Tile(name, "Use vehicle.yaml", "it has the re-fitted parameters")
    return Tile(name, "Nothing to do", "keep the given values")


def _errors(r: dict[str, Any]) -> str:
    mae, followed, without = r["heldout"]["mae"], _followed(r), r["heldout"]["without_sensor_error"]
    with_it, modelled = mae["with_effects"], [t for t in _sure(r) if t.get("form") not in FOLLOWED]
    if followed is not None:
        with_it, without, modelled = followed, None, _sure(r)[:1]
    plain = "" if without is None else f", {figures(without)} without the assumed error of the torque sensor"
    refitted = f"{figures(mae['nominal'])} Nm with the file, {figures(mae['refitted'])} re-fitted"
    if followed is None and stage_of(r) != "with_effects":
        return f"{refitted}{plain}"
    sources = dict.fromkeys(filter(None, (t.get("held_out_from") for t in modelled)))
    taken = f", from {' and '.join(sources)}" if sources else ""
    return f"{refitted}, {figures(with_it)} with it{taken}{plain}"


def _followed(r: dict[str, Any]) -> float | None:
    """Mean hold-out error with live estimation of an unpredictable term; None if not needed."""
    sure = _sure(r)
    return sure[0]["heldout"]["mae"][1] if sure and sure[0].get("form") in FOLLOWED else None


def _share(r: dict[str, Any]) -> float:
    """Share of the mean hold-out error that the last stage removes; 0 without an error, as of a torque of the model itself."""
    mae, followed, without = r["heldout"]["mae"], _followed(r), r["heldout"]["without_sensor_error"]
    after = mae[stage_of(r)] if without is None else without  # no file holds an error of the sensor
    after = after if followed is None else followed
    return float((mae["nominal"] - after) / mae["nominal"]) if mae["nominal"] else 0.0


def _sure(r: dict[str, Any]) -> list[dict[str, Any]]:
    """Confirmed terms, named or not, the largest reduction of the hold-out error first; none if the residual is
    too large to trust them. Small ones are omitted if there are others.
    """
    if r["verdict"]["status"] == "unexplained":
        return []
    sure = sorted((t for t in (*r["effects"], *r["described"]) if t["grade"] == CONFIRMED), key=lambda t: -_gained(t)[0])
    return [t for t in sure if _gained(t)[1] >= SMALL_SHARE] or sure


def _gained(term: dict[str, Any]) -> tuple[float, float]:
    """Reduction of the mean hold-out error by a term [Nm], and as a share; a share of one for oscillations, without an error."""
    if term["heldout"] is None:
        return 0.0, 1.0
    before, after = term["heldout"]["mae"]
    return before - after, (before - after) / before if before else 0.0


def _names(r: dict[str, Any]) -> str:
    """The names; for a large class, the number of its members."""
    classes = [e["class"] for e in _sure(r) if "form" not in e]
    return " and ".join(" or ".join(map(_plain, of)) if len(of) <= FEW else f"one of {len(of)} effects" for of in classes)


def _plain(name: str) -> str:
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
    pictures: Sequence[Picture],
    title: str,
    plots: Interactive | str = "",
    provenance: Sequence[tuple[str, str]] = (),
) -> None:
    """Write the page of a report with its pictures in it.

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
        headline=headline(report),
        tiles=tiles(report),
        by_file=by_file(report),
        lights=list(lights(report)),
        stage=stage_of(report),
        most_recordings=MOST_RECORDINGS,
        plots=plots if isinstance(plots, Interactive) else None,
        no_plots=plots if isinstance(plots, str) else "",
        script=Path(__file__).with_name("page.js").read_text(encoding="utf-8"),
        provenance=provenance,
        pictures=[(p, KINDS[p.path.suffix], base64.b64encode(present(p.path) or b"").decode()) for p in pictures],
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

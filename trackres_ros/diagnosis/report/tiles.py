# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The four tiles of the page and the sentence over them: where, what, how much better, what to do next."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from trackres_ros.text.numbers import alike, decimals, figures

MOST_WORDS = 40  # of the sentence: fewer than these
STANDS_OUT_P = 0.05
FEW = 3  # names that a sentence holds
LEAST_SHARE = 0.01  # of the mean error, that is worth a new file
SURE = {
    "confirmed": "the hold-out laps confirm it",
    "suspected": "suspected: the hold-out laps neither confirm nor reject it",
    "refuted": "the hold-out laps reject it",
}
SURE_OF_NONE = {
    "confirmed": "the hold-out laps agree",
    "suspected": "the hold-out laps neither confirm nor reject the re-fit",
    "refuted": "the hold-out laps reject the re-fit",
}


@dataclass(frozen=True, slots=True)
class Tile:
    """A question, its answer in a few words, and what stands behind it."""

    name: str
    answer: str
    detail: str


def tiles(report: dict[str, Any]) -> tuple[Tile, ...]:
    """The four tiles of a report, in the order in which one asks."""
    return _where(report), _what(report), _better(report), _next(report)


def headline(report: dict[str, Any]) -> str:
    """The verdict in one sentence of fewer than `MOST_WORDS` words; what stands in the tiles anyway gives way first."""
    where, what, *_ = tiles(report)
    status = report["verdict"]["status"]
    if status == "none":
        changed = report["verdict"].get("changed")
        parts = [f"{what.answer}: hold-out error {_errors(report)}", *([changed[0]["text"]] if changed else []), what.detail]
    elif status == "unexplained":
        parts = [
            f"Measurement and simulation differ {_lower(where.answer)}, and no effect of the catalogue explains it",
            where.detail,
        ]
    else:
        placed = f"{where.answer} {_lower(where.detail)}" if "the vehicle needs" in _lower(where.detail) else where.answer
        parts = [f"{placed}: {_names(report) or what.answer}, {_grade(report)}", f"hold-out error {_errors(report)}"]
    said = parts[0]
    for part in parts[1:]:
        if part and len(f"{said}; {part}".split()) < MOST_WORDS:
            said = f"{said}; {part}"
    words = said.split()
    return f"{said}." if len(words) < MOST_WORDS else f"{' '.join(words[: MOST_WORDS - 2])} ..."


def stage_of(report: dict[str, Any]) -> str:
    """The last stage that was reached: the base re-fitted, or what was found on it."""
    modelled = report["effects"] or [t for t in report.get("described", ()) if t["heldout"]]
    return "with_effects" if modelled else "refitted"


def standing_out(report: dict[str, Any], stage: str = "base") -> list[dict[str, Any]]:
    """Bins that stand out of noise, the clearest first."""
    bins = [b for b in report["residual_by_regime"][stage] if b["p"] is not None and b["p"] < STANDS_OUT_P]
    return sorted(bins, key=lambda b: (b["p"], -abs(b["mean_residual"] or 0.0)))


def range_of(b: dict[str, Any]) -> str:
    """The range of a bin in words."""
    low, high = alike((b["lo"], b["hi"]), (b["hi"] or 0.0) - (b["lo"] or 0.0))
    return f"{b['variable']} {low} to {high} {b['unit']}"


def lights(report: dict[str, Any], most: int = 6) -> Iterator[tuple[str, str]]:
    """Key and words of what can be lit up with a press: effects where they act most, and bins that stand out."""
    for e in report["effects"]:
        if e["where"]["time"]:
            yield f"effect:{e['name']}", f"{_plain(e['name'])} acts most"
    numbers: dict[str, int] = {}
    keys = {}
    for b in report["residual_by_regime"]["base"]:
        numbers[b["variable"]] = numbers.get(b["variable"], -1) + 1
        keys[id(b)] = f"{b['variable']}:{numbers[b['variable']]}"
    for b in standing_out(report)[:most]:
        yield keys[id(b)], f"{range_of(b)}: {decimals(b['mean_residual'], signed=True)} Nm"


def leading(r: dict[str, Any]) -> dict[str, Any] | None:
    """The confirmed term, named or not, that takes most off the error of the hold-out laps; one not confirmed where none is."""

    def weight(term: dict[str, Any]) -> tuple[bool, float]:
        before, after = (term.get("heldout") or {}).get("mae") or (0.0, 0.0)
        return term.get("grade") == "confirmed", (before or 0.0) - (after or 0.0)

    return max([*r["effects"], *r.get("described", ())], key=weight, default=None)


def _where(r: dict[str, Any]) -> Tile:
    name, lead = "Where", leading(r)
    if lead is not None and "form" not in lead:
        acts = lead.get("acts")
        if acts:
            return Tile(name, _upper(_of_curves(acts["text"])) or "Everywhere", _upper(acts["size"]))
        for b in lead["where"]["regime"]:
            return Tile(name, _upper(range_of(b)), f"{decimals(b['mean_residual'], signed=True)} Nm on average")
    if r["verdict"]["status"] == "none":
        ranges = f"{_count(r['residual_by_regime']['end'], 'range')} of speed, load, temperature and more were compared"
        return Tile(name, "Nowhere beyond noise", ranges)
    if lead is not None and "form" in lead:
        answers = {"place": "By place on the route", "drift": "Over time, slowly", "level_change": "From a time on"}
        answer = answers.get(lead["form"]) or f"By {lead['variable'] or lead['gate'] or 'time'}"
        seen = lead.get("seen_nm") or lead["size_nm"]
        return Tile(name, answer, f"The residual there is about {figures(seen, 2)} Nm")
    for b in standing_out(r, "end"):
        return Tile(name, f"At {range_of(b)}", f"{decimals(b['mean_residual'], signed=True)} Nm on average")
    return Tile(name, "At times that follow nothing recorded", "the residual changes slowly, over half-minutes")


def _of_curves(text: str) -> str:
    """A range in words; a curvature as the radius that one drives."""
    above = re.fullmatch(r"above (\S+) 1/m of curvature", text)
    return f"in curves tighter than {figures(1.0 / float(above[1]), 2)} m" if above and float(above[1]) > 0.0 else text


def _what(r: dict[str, Any]) -> Tile:
    name, verdict, lead = "What", r["verdict"], leading(r)
    if r["effects"]:
        named, unsure = _by_grade(r)
        answers = []
        for e in named:
            shares = [f"{_plain(n)} ({100 * (e['weights'].get(n) or 0.0):.0f} %)" for n in e["class"]]
            answers.append(_plain(e["name"]) if len(e["class"]) <= 1 else f"{', '.join(shares[:-1])} or {shares[-1]}")
        answers += [f"a {_plain(t['form'])} (no name)" for t in r.get("described", ()) if t.get("grade") == "confirmed"]
        detail = [SURE.get(_grade(r), "")]
        if any(len(e["class"]) > 1 for e in named):
            detail.append("cannot be told apart here")
        if unsure:
            detail.append(f"only suspected: {', '.join(_plain(e['name']) for e in unsure)}")
        return Tile(name, " and ".join(answers), "; ".join(filter(None, detail)))
    if verdict["status"] == "none":
        answer = "Only values of the file were off" if verdict.get("changed") else "No physics is missing"
        return Tile(name, answer, SURE_OF_NONE.get(verdict.get("grade"), ""))
    if lead is not None:
        return Tile(name, f"no name, a form: {_plain(lead['form'])}", SURE.get(_grade(r), ""))
    return Tile(name, "Unexplained", "no effect of the catalogue does it")


def by_file(r: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Names of the effects that were written: to vehicle.yaml, and to surroundings.yaml."""
    around = {e["name"] for e in r["effects"] if e.get("belongs_to") == "surroundings"}
    written = r["written"]["effects"]
    return [n for n in written if n not in around], [n for n in written if n in around]


def _better(r: dict[str, Any]) -> Tile:
    name, mae = "How much better", r["heldout"]["mae"]
    if not mae["nominal"] or mae[stage_of(r)] is None:
        return Tile(name, "Unknown", "the hold-out laps have no error to compare")
    share = 100.0 * _share(r)
    same = "Nothing to gain" if r["verdict"]["status"] == "none" else "No better"
    answer = (
        f"{share:.0f} % less error"
        if share >= 100.0 * LEAST_SHARE
        else f"{-share:.0f} % more error"
        if share <= -100.0 * LEAST_SHARE
        else same
    )
    written = r.get("written")
    kept = "" if written is None or written["base"] or written["effects"] else "; the file keeps its values"
    return Tile(name, answer, f"mean error of the hold-out laps: {_errors(r)}{kept}")


def _next(r: dict[str, Any]) -> Tile:
    name, lead = "Next", leading(r)
    for a in r["advice"]:
        if lead is None or lead.get("name") in a["separates"]:
            return Tile(name, "Drive once more", f"{_upper(a['manoeuvre'])} ({figures(a['minutes'], 2)} min)")
    if r.get("topics_lines"):
        return Tile(name, "Correct the sensor", f"put into the topics file: {', '.join(r['topics_lines'])}")
    written = r.get("written") or {"base": False, "effects": []}
    if r["effects"] and written["effects"]:
        here, elsewhere = (" and ".join(map(_plain, names)) for names in by_file(r))
        if not elsewhere:
            return Tile(name, "Use vehicle.yaml", f"it has {here}")
        of_place = f"surroundings.yaml has {elsewhere}, for where it holds"
        return Tile(name, "Use vehicle.yaml and surroundings.yaml", f"the first has {here}; {of_place}" if here else of_place)
    if lead is not None and "form" in lead and lead.get("grade") == "confirmed":
        return Tile(name, "Look at the vehicle", " or ".join(lead["mechanisms"][:2]))
    if lead is not None:
        return Tile(name, "Record more laps", "the hold-out laps do not confirm enough to write it")
    if r["verdict"]["status"] == "unexplained":
        return Tile(name, "Look where it is largest", "record what varies there: slope, wind, load, brakes")
    if written["base"] and _share(r) >= LEAST_SHARE:
        return Tile(name, "Use vehicle.yaml", "it has the re-fitted parameters")
    return Tile(name, "Nothing to do", "keep the vehicle file as it is")


def _errors(r: dict[str, Any]) -> str:
    mae = r["heldout"]["mae"]
    with_it = f" → {figures(mae['with_effects'])} with it" if stage_of(r) == "with_effects" else ""
    return f"{figures(mae['nominal'])} → {figures(mae['refitted'])} re-fitted{with_it} [Nm]"


def _share(r: dict[str, Any]) -> float:
    """Share of the mean error on held-out laps that the last stage takes away; 0 where it is not known."""
    before, after = r["heldout"]["mae"]["nominal"], r["heldout"]["mae"][stage_of(r)]
    return 0.0 if not before or after is None else float((before - after) / before)


def _by_grade(r: dict[str, Any]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Effects to name, and those that are only suspected beside them: where something is confirmed, only that is named."""
    of: dict[bool, list[dict[str, Any]]] = {True: [], False: []}
    for e in r["effects"]:
        of[_is_sure(e, r)].append(e)
    lead = leading(r)
    return (of[True], of[False]) if lead is not None and _is_sure(lead, r) else (of[False], [])


def _is_sure(term: dict[str, Any], r: dict[str, Any]) -> bool:
    return bool((term.get("grade") or r["verdict"].get("grade")) == "confirmed")


def _names(r: dict[str, Any]) -> str:
    """The names; of many that look alike, how many they are."""
    named, lead = _by_grade(r)[0], leading(r)
    names = [" or ".join(map(_plain, e["class"])) if len(e["class"]) <= FEW else f"one of {len(e['class'])}" for e in named]
    if names and lead is not None and "form" in lead:
        names.insert(0, f"a {_plain(lead['form'])} without a name")
    return " and ".join(names)


def _grade(r: dict[str, Any]) -> str:
    lead = leading(r)
    return (lead.get("grade") if lead is not None else None) or r["verdict"].get("grade") or "not judged"


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _count(of: list[Any], what: str) -> str:
    return f"{len(of)} {what}{'' if len(of) == 1 else 's'}"


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Summarises a replay: inputs, defects and results."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from trackres_ros.errors import one_line
from trackres_ros.estimator import columns as at
from trackres_ros.learning.columns import lines as lines_of
from trackres_ros.learning.columns import shown
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.store import LearnedFile
from trackres_ros.model.coverage import beyond
from trackres_ros.model.resistance import resistance_parts
from trackres_ros.offline.energy import taken_text
from trackres_ros.offline.replay import Replayed
from trackres_ros.output.preview import HEAD, picture_columns
from trackres_ros.recording.recording import defects_of
from trackres_ros.recording.samples import Finding, SampleBlock, Source
from trackres_ros.text.numbers import decimals, figures, number_of

MANY_REFUSED = 0.1  # of the speeds: more are no faults of single samples
MOST_KEPT = 10_000_000
"""Samples kept for inspection, a quarter of a gigabyte; ten hours of three channels at 50 Hz are half as many. The inspection
takes 0.2 GB more with four roles, 0.8 GB with one."""


class KeptSource:
    """A source that passes another on, and keeps its blocks on request, to search them for defects afterwards."""

    def __init__(self, source: Source, keep: bool) -> None:
        self._source, self._keep = source, keep
        self._kept: list[SampleBlock] = []
        self._dropped = False
        self.name, self.roles = source.name, source.roles
        self.zero_is_unset = source.zero_is_unset
        self.torque_candidates = source.torque_candidates

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the reader; see `Source`."""
        return self._source.notes

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of reading itself."""
        if not self._dropped:
            return self._source.findings
        text = f"more than {MOST_KEPT} samples: gaps, stuck and quantised values are not searched"
        return (*self._source.findings, Finding("", "too_long", 1, float("nan"), text))

    def blocks(self, max_rows: int = 65536) -> Iterator[SampleBlock]:
        """Blocks of the source."""
        self._kept.clear()
        samples = 0
        for block in self._source.blocks(max_rows):
            samples += len(block)
            if self._keep and samples > MOST_KEPT:
                self._kept.clear()
                self._keep, self._dropped = False, True
            if self._keep:
                self._kept.append(block)
            yield block

    def all_findings(self) -> tuple[Finding, ...]:
        """Defects of the samples; only those of reading if the blocks were not kept."""
        return (*self.findings, *defects_of(self._kept, self._source)) if self._keep else self.findings


def summary(result: Replayed, name: str, notes: Sequence[str], findings: Sequence[Finding]) -> dict[str, Any]:
    """The report as a dict ready for JSON: the recording's name, the notes of its reading, and its defects."""
    estimator = result.session.estimator
    last = {name: _finite(float(result.last[i])) for i, name in enumerate(estimator.columns) if name != "reasons"}
    learned = {} if result.learner is None else {"learning": {**_learned(result.learner), **_saved(result.learned_file)}}
    torque = at.Results.resistance_torque_nm
    first_nm, last_nm = float(result.picture[0, HEAD + torque]), float(result.last[torque])
    drive = result.totals.as_dict()
    counters: dict[str, dict[str, int]] = {}
    for channel, count, number in result.counts:
        counters.setdefault(channel, {})[count.name.lower()] = number
    return {
        "vehicle": estimator.vehicle.name,
        "recording": name,
        "notes": list(notes),
        "findings": [
            {"role": f.role, "kind": f.kind, "count": f.count, "first_time_s": _finite(f.first_time_s), "text": f.text}
            for f in findings
        ],
        "messages": result.messages,
        "steps": result.steps,
        "duration_s": result.totals.duration_s,
        "counters": counters,
        "reasons": [
            {"reason": (reason.name or "").lower(), "text": at.REASON_TEXT[reason], "steps": number}
            for reason, number in sorted(result.reasons.items())
        ],
        "remarks": _remarks(result),
        "drive": drive,
        "resistance_torque_nm": {"first": first_nm, "largest": drive["largest_resistance_nm"], "last": last_nm},
        "last": last,
        **({} if result.comparison is None else {"comparison": dict(result.comparison)}),
        **learned,
    }


def _remarks(result: Replayed) -> list[str]:
    """Speeds that no such vehicle has, belts outside of the rubber data, loads outside of the table; of the picture's samples."""
    estimator = result.session.estimator
    return [*_too_fast(result), *beyond(estimator.vehicle, picture_columns(estimator.columns, result.picture))]


def _too_fast(result: Replayed) -> Iterator[str]:
    counts = {count: number for channel, count, number in result.counts if channel == "speed"}
    refused = sum(counts.get(count, 0) for count in (at.Count.OUT_OF_RANGE, at.Count.IMPLAUSIBLE))
    every = sum(counts.get(count, 0) for count in (at.Count.ACCEPTED, *at.REFUSALS))
    if refused > MANY_REFUSED * every:
        yield f"{refused} of {every} speeds refused as too fast for this vehicle: wrong unit?"


def text(report: dict[str, Any]) -> str:
    """The report for people."""
    last = report["last"]
    belts = {name.partition("/")[2]: value for name, value in last.items() if name.startswith("belt_degc/")}
    long_gaps = sum(item["steps"] for item in report["reasons"] if item["reason"] == "gap_unknown")
    left_out = f"; {number_of(long_gaps, 'long gap')} left out" if long_gaps else ""
    over = f"{number_of(report['steps'], 'step')} over {report['duration_s']:.1f} s{left_out}"
    lines = [f"{number_of(report['messages'], 'message')}, {over}"]
    lines += [f"  note: {note}" for note in report["notes"]]
    lines += [f"  found: {item['role'] and item['role'] + ': '}{item['text']}" for item in report["findings"]]
    for channel, counts in report["counters"].items():
        refused = {name: number for name, number in counts.items() if name != "accepted"}
        if refused:
            lines.append(f"  counted: {channel}: " + ", ".join(f"{name} {number}" for name, number in refused.items()))
    lines += [f"  status: {item['text']} ({number_of(item['steps'], 'step')})" for item in report["reasons"]]
    lines += [f"  ! {remark}" for remark in report["remarks"]]
    stood = not report["drive"]["under_way_s"] and set(report["counters"].get("speed", ())) - {"accepted"}
    totals = taken_text(report["drive"]) + (" in the accepted samples" if stood else "")
    lines.append(totals if report["duration_s"] else "The drive has no totals: no two rows without a long gap between them")
    lines.append(
        f"At the end, at {decimals(last['speed_mps'] * 3.6, 1)} km/h: resistance "
        f"{decimals(last['resistance_torque_nm'])} +- {decimals(last['resistance_std_nm'])} Nm ("
        + ", ".join(f"{part} {decimals(last[column])}" for part, column in resistance_parts(bool(belts)).items())
        + ")"
    )
    if (comparison := report.get("comparison")) and comparison["steps"]:
        error, steps = decimals(comparison["mean_error_nm"], 3), number_of(comparison["steps"], "step")
        lines.append(
            f"Measured torque: mean error {error} Nm in means over {comparison['step_s']:g} s ({steps}, as a diagnosis compares)"
        )
    if "learning" in report:
        lines.append(f"Learning ({report['learning']['mode']}): {report['learning']['text']}")
        lines += [f"  {item['text']}" for item in report["learning"]["parameters"]]
        lines += _saved_lines(report["learning"].get("vehicle_file"))
    if belts:
        lines.append("Belts: " + ", ".join(f"{name} {decimals(value, 1)} degC" for name, value in belts.items()))
    return "\n".join(map(one_line, lines))


def _learned(learner: Learner) -> dict[str, Any]:
    """Learned parameters at the end."""
    values = shown(learner)
    each = lines_of(learner, values)
    return {
        "mode": learner.mode,
        "text": learner.text,
        "acts": learner.acts,
        "coverage": values[0],
        "parameters": [{"name": name, "text": text, **dict(known)} for name, text, known in each],
    }


def _saved(file: LearnedFile | None) -> dict[str, Any]:
    """What the vehicle file got that the replay was asked to write."""
    if file is None:
        return {}
    changed = {name: {"before": before, "written": value} for name, (before, value) in file.changed.items()}
    return {"vehicle_file": {"path": str(file.path), "changed": changed, "kept": dict(file.kept), "why_not": file.why_not}}


def _saved_lines(file: dict[str, Any] | None) -> list[str]:
    if file is None:
        return []
    if file["why_not"]:
        return [f"Not written: {file['path']}: {file['why_not']}"]
    lines = [f"In {file['path']}"]
    for name, of in file["changed"].items():
        before, value = (figures(x, 4) for x in (of["before"], of["written"]))
        lines.append(f"  {name} {before} -> {value}")
    return lines + [f"  {name} {figures(value, 4)} as before: not known well enough" for name, value in file["kept"].items()]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The diagnosis as report.json; its form is fixed, additions are allowed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from trackres_ros.diagnosis.base.variables import BY_NAME, varying_series
from trackres_ros.diagnosis.empirical.payload import Payload, Stretch
from trackres_ros.diagnosis.empirical.term import FOLLOWED, Route, Term
from trackres_ros.diagnosis.findings.wording import (
    LEAST_AHEAD,
    LEFT_OUT,
    join_sentences,
    likelier_text,
    rejected_sentences,
    why_not,
)
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.selection.held_out import REFUTED, SUSPECTED, Improvement
from trackres_ros.diagnosis.selection.locate import Bin, residual_sources
from trackres_ros.effects.effect import BELONGS_TO
from trackres_ros.route.learned import SLOPE
from trackres_ros.vehicle.writing.changes import Interval
from trackres_ros.vehicle.writing.sensor_lines import file_phrase, sensor_lines
from trackres_ros.vehicle.writing.vehicle_file import SURROUNDINGS_FILE

SCHEMA = 1
BINS, CELLS = 24, (24, 12)  # of a histogram; of speed and acceleration


def report(d: Diagnosis, paths: Sequence[Path]) -> dict[str, Any]:
    """All findings as plain data."""
    scale = (d.kept.values or {}).get("torque_scale", d.base.torque_scale)
    lines = sensor_lines(d.kept.effects_of("sensor"), {s.name: s.bindings for s in d.sessions}, scale)
    written_names = {kind: d.kept.names_of(kind) for kind in BELONGS_TO}
    routes = [_route(t, t.pattern, d.final) for t in d.in_order if isinstance(t.pattern, Route)]
    content = {
        "schema": SCHEMA,
        "recordings": [str(path) for path in paths],
        "base": _base(d),
        "verdict": _verdict(d),
        "effects": [_effect(t) for t in d.found],
        "described": [_describe_term(t) for t in (*d.described, *(() if d.drift is None else (d.drift,)))],
        "route": routes[0] if routes else None,
        "routes": routes,
        **{
            grade: [
                {"name": t.name, "heldout": _improvement(t.improvement), "grade": t.grade, "why": join_sentences(sentences)}
                for t, sentences in ((t, rejected_sentences([t])) for t in d.unconfirmed if t.grade == grade)
            ]
            for grade in (SUSPECTED, REFUTED)
        },
        "possible": [{"name": name, "share": share} for name, share in d.shares.items()],
        "written": {
            "base": d.kept.values is not None,
            "values": d.kept.values,
            "effects": [name for names in written_names.values() for name in names],
            "disturbance": None if d.kept.disturbance is None else d.kept.disturbance.disturbance.form,
            "why": d.kept.text,
        },
        "heldout": _held_out(d),
        "not_visible": [{"name": n.name, "why": n.why} for n in d.alone.separability.of_names.not_visible],
        "rejected": [{"reason": reason, "samples": seconds} for reason, seconds in d.gated.exclusions.items()],
        "advice": [asdict(advice) for advice in d.advice],
        "candidates": _candidates(d),
        "residual_by_regime": {
            stage: [{**_bin(b), "samples": b.samples, "p": b.p} for b in regime_map.bins]
            for stage, regime_map in (("base", d.at_base), ("end", d.at_end))
        },
        "changes": [
            {"recording": c.recording, "t_s": c.time, "before": c.before, "after": c.after, "unit": "Nm"} for c in d.changes
        ],
        "whiteness_p": d.periodogram_p,
        "noise": d.noise.text,
        "residual_sources": _sources(d.final),
        "split": d.split.text,
        "notes": d.gated.notes,
        "warnings": d.gated.warnings,
        "sensors": [
            {"effect": s.effect or None, "value": s.value if s.effect else None, "text": s.statement} for s in d.gated.sensors
        ],
        "inputs": inputs(d),
        "kept": written_names,
        "topics_lines": lines,
        "to_do": _to_do(d, lines),
        "thermal": None if d.thermal is None else asdict(d.thermal),
    }  # fmt: skip
    return {key: value if key == "inputs" else _plain_value(value) for key, value in content.items()}


def _base(d: Diagnosis) -> dict[str, Any]:
    """The re-fitted model, and its errors of the instrument."""
    nominal = {q.name: q for q in d.base.parameters}
    return {
        "model": d.base.name,
        "refitted": {
            name: {
                "nominal": nominal[name].nominal,
                "value": value,
                "unit": nominal[name].unit,
                "of_file": nominal[name].of_file,
                **_interval(d.base_intervals.get(name)),
            }
            for name, value in d.final.base_values.items()
        },
        "instrument": {
            sensor_term.effect.name: {q.name: {"value": sensor_term.values[q.name], "unit": q.unit}}
            for sensor_term in d.final.instrument
            for q in sensor_term.effect.parameters
        },
    }


def _verdict(d: Diagnosis) -> dict[str, Any]:
    """The conclusion of the diagnosis, and the values of the vehicle file that the re-fit changes."""
    return {
        "status": d.verdict.status,
        "grade": d.verdict.grade,
        "sentence": d.verdict.sentence,
        "hint": d.last.hint or None,
        "seen": d.verdict.seen or None,
        "may_be": [{"name": name, "share": share} for name, share in d.verdict.may_be],
        "changed": [
            {
                "name": c.name, "unit": c.unit, "nominal": c.nominal, "value": c.value,
                "ci95": None if c.at_bound else [c.low, c.high], "torque_nm": c.torque_nm, "text": c.text,
            }
            for c in d.verdict.changed
        ],
    }  # fmt: skip


def _held_out(d: Diagnosis) -> dict[str, Any]:
    errors = d.held_out
    return {
        "laps": errors.laps,
        "mae": errors.mae,
        "r2": errors.r2,
        "bias": errors.bias,
        "improvement_ci95": [errors.of_effects.low, errors.of_effects.high],
        "of_refit": _improvement(errors.of_refit),
        "without_sensor_error": errors.without_sensor,
        "by_lap": {measure: {stage: x.tolist() for stage, x in stages.items()} for measure, stages in errors.by_lap.items()},
    }


def _candidates(d: Diagnosis) -> list[dict[str, Any]]:
    """The rounds of the search: without each term of the final fit, which comes first, and from all of them."""
    rounds = [(term.rivals, (term,)) for term in d.in_order if term.rivals is not None]
    return [
        {
            "round": number,
            "name": c.name,
            "delta_loglik": c.gain,
            "level_score": c.level,
            "kept": c.kept,
            "d_prime": c.d_prime,
            "threshold": search_round.cost,
            "chosen": c in terms_chosen,
            "why": why(c, search_round.cost, *terms_chosen),
        }
        for number, (search_round, terms_chosen) in enumerate([*rounds, (d.last, ())], 1)
        for c in (*terms_chosen, *search_round.candidates)
    ]


def _to_do(d: Diagnosis, lines: Mapping[str, str]) -> list[str]:
    """Next steps for the kept results, in addition to using the vehicle file."""
    steps = []
    surroundings, sensors = (", ".join(d.kept.names_of(kind)) for kind in ("surroundings", "sensor"))
    if surroundings:
        steps.append(
            f"The surroundings, not the vehicle, cause {surroundings}. That is written to {SURROUNDINGS_FILE}, for "
            "--surroundings where it applies."
        )
    if lines:
        steps.append(f"A sensor causes {sensors}. No file corrects that: {file_phrase(lines)}:")
    return steps


def why(c: Term, cost: float, choice: Term | None = None) -> str:
    """Why a candidate was chosen or not, of a round at this cost."""
    if choice is c:
        return "chosen"
    if choice is not None and c.name in choice.members:
        return f"not distinguishable from {choice.name} here"
    if c.level <= cost:
        return "the best of as many candidates may gain as much by chance"
    if not c.matters:
        return f"adds only {100.0 * c.share:.1f} % of the torque"
    if choice is None:
        return why_not(c)
    if c.level > choice.level - LEAST_AHEAD:
        if choice.is_name and not c.is_name:
            return f"fits as well as {choice.name}, but is a form: it bends to the data"
        on_laps = f"{LEFT_OUT} decide for {choice.name}" if c.name in choice.worse else why_not(c)
        return f"fits as well as {choice.name}, but {on_laps}"
    return f"{likelier_text(choice, c)} times less likely than {choice.name}"


def _effect(t: Term) -> dict[str, Any]:
    effect, location = t.effect, t.location
    units = {q.name: q.unit for q in effect.parameters}
    return {
        "name": t.name,
        "class": t.members,
        "weights": t.weights,
        "acts_on": effect.acts_on,
        "acts": {"text": t.place, "size": t.seen, "by": location.variable if location is not None and location.both_ways else ""},
        "grade": t.grade,
        "heldout": _improvement(t.improvement),
        "on_bounds": t.on_bounds,
        "belongs_to": effect.belongs_to,
        "parameters": {
            name: {"value": value, "unit": units[name], **_interval(t.intervals[name])} for name, value in t.values.items()
        },
        "where": {
            "time": [[s.recording, s.begin, s.end] for s in t.spans],
            "regime": [{**_bin(b), "p": b.p} for b in t.regime],
        },
        "evidence": {
            "delta_loglik": t.gain,
            "level_score": t.level,
            "bic_gain": t.bic_gain,
            "stability": t.stability,
            "kept": t.kept,
            "d_prime": t.d_prime,
        },
        "text": effect.text,
    }


def _sources(final_fit: Fit) -> dict[str, Any]:
    s = residual_sources(final_fit)
    sensors = {"torque_sensor": s.torque_sensor, "speed_sensor": s.speed_sensor}
    return {"total": s.total, **sensors, "model_at_most": s.model, "unit": "Nm", "text": s.text}


def _describe_term(t: Term) -> dict[str, Any]:
    """A term without a name, or a drift, with its improvement of laps left out."""
    is_followed = t.form in FOLLOWED
    return {
        "form": t.form,
        "name": None if is_followed else t.name,
        "variable": t.variable or None,
        "gate": t.gate or None,
        "period_m": t.period_m,
        "memory": t.memory,
        "size_nm": t.size_nm,
        "sentence": t.sentence,
        "mechanisms": t.mechanisms,
        "predictable": t.predictable,
        "held_out_from": t.held_out_from,
        **({"stretches": t.pattern.stretches} if isinstance(t.pattern, Payload) else {}),
        "gain_nm": t.improvement.before - t.improvement.after,
        "grade": t.grade,
        "heldout": _improvement(t.improvement),
        "parameters": {name: _pair(interval) for name, interval in t.intervals.items()},
        **({} if is_followed else {"instead": t.instead or None}),
    }


def _route(t: Term, route: Route, final_fit: Fit) -> dict[str, Any]:
    route_values = t.learned(final_fit)
    return {
        "name": t.name,
        "kind": route_values.kind,
        "slope_likelier_by": route.slope_gain,
        "streets_m": route.metres,
        "passed_again_m": route.again_m,
        "passes": route.passes,
        "rms": float(np.sqrt(np.nanmean(route_values.value**2))),
        "std_median": float(np.nanmedian(route_values.std)),
        "unit": "1" if route_values.kind == SLOPE else "Nm",
    }


def _improvement(i: Improvement) -> dict[str, Any]:
    return {"mae": [i.before, i.after], "ci95": [i.low, i.high], "grade": i.grade}


def _bin(b: Bin) -> dict[str, Any]:
    return {"variable": b.variable, "lo": b.low, "hi": b.high, "mean_residual": b.mean_residual, "unit": b.unit}


def _interval(interval: Interval | None) -> dict[str, Any]:
    """An interval; at the end of its range it is only a bound."""
    bound_only = interval is not None and interval.bound_only
    return {"ci95": None if bound_only else _pair(interval), "bound_only": bound_only}


def _pair(interval: Interval | None) -> list[float] | None:
    return None if interval is None else [interval.low, interval.high]


def _plain_value(value: Any) -> Any:
    """Plain data for JSON: numbers with 6 significant digits, None if not finite. Those of a `Stretch` are complete."""
    if isinstance(value, float):
        return float(np.format_float_positional(value, 6, fractional=False)) if math.isfinite(value) else None
    if isinstance(value, Stretch):
        return asdict(value)
    if isinstance(value, Mapping):
        return {key: _plain_value(item) for key, item in value.items()}
    return [_plain_value(item) for item in value] if isinstance(value, list | tuple) else value


def inputs(d: Diagnosis) -> dict[str, Any]:
    """Summary of the recordings as plain data: the length and gaps of each [s], the range and histogram of each variable."""
    used_steps = np.concatenate([s.used for s in d.sessions])
    recordings = []
    for s in d.sessions:
        gaps = [end - begin for begin, end in s.stretches(~s.used)]
        recordings.append(
            {
                "name": s.name,
                "seconds": float(len(s) * s.step),
                "compared_s": float(s.used.sum() * s.step),
                "held_out_s": float(d.split.held_out_mask(s).sum() * s.step),
                "gaps": len(gaps),
                "longest_gap_s": float(max(gaps, default=0.0)),
                "laps": len(np.unique(s.block)),
                "measured": sorted(s.given),
            }
        )
    series = {"torque": np.concatenate([s.torque for s in d.sessions])[used_steps]}
    series |= {name: samples[used_steps] for name, samples in varying_series(d.sessions, d.refitted.predicted).items()}
    ranges = []
    for name, samples in series.items():
        low, middle, high = (_shorten(q) for q in np.quantile(samples, (0.0, 0.5, 1.0)))
        unit = "Nm" if name == "torque" else BY_NAME[name].unit
        seconds = (np.histogram(samples, BINS)[0] * d.sessions[0].step).tolist()
        ranges.append({"variable": name, "unit": unit, "low": low, "median": middle, "high": high, "histogram_s": seconds})
    return {"step_s": d.sessions[0].step, "recordings": recordings, "ranges": ranges, "coverage": _coverage(d)}


def _coverage(d: Diagnosis) -> dict[str, Any]:
    """Compared seconds by speed and acceleration: one row for each range of the acceleration, the least first."""
    used_steps = np.concatenate([s.used for s in d.sessions])
    speed = np.concatenate([s.speed for s in d.sessions])[used_steps]
    accel = np.concatenate([BY_NAME["acceleration"].of(*x) for x in zip(d.sessions, d.refitted.predicted, strict=True)])[
        used_steps
    ]
    counts, speeds, accels = np.histogram2d(speed, accel, CELLS)
    seconds = (counts.T * d.sessions[0].step).tolist()
    ends = {"speed": [_shorten(speeds[0]), _shorten(speeds[-1])], "acceleration": [_shorten(accels[0]), _shorten(accels[-1])]}
    return {**ends, "seconds": seconds}


def _shorten(value: float) -> float:
    return float(np.format_float_positional(value, 4, fractional=False))

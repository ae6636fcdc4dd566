# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The diagnosis as report.json; its form is fixed, additions are allowed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from trackres_ros.diagnosis.empirical.routes import Route
from trackres_ros.diagnosis.empirical.terms import Described
from trackres_ros.diagnosis.findings.found import NamedEffect, Told
from trackres_ros.diagnosis.findings.residual_bins import Bin
from trackres_ros.diagnosis.findings.residual_sources import ResidualSources, residual_sources
from trackres_ros.diagnosis.findings.spread import Spread
from trackres_ros.diagnosis.findings.wording import likelier
from trackres_ros.diagnosis.inference.fitting import Fit
from trackres_ros.diagnosis.pipeline import Diagnosis
from trackres_ros.diagnosis.report.inputs import inputs
from trackres_ros.diagnosis.selection.held_out import CONFIRMED, HeldOut, Improvement
from trackres_ros.diagnosis.selection.naming import Candidate, Step
from trackres_ros.effects.effect import BELONGS_TO
from trackres_ros.recording.binding import TopicBinding
from trackres_ros.route.learned import SLOPE
from trackres_ros.vehicle.writing.changes import Interval
from trackres_ros.vehicle.writing.sensor_lines import sensor_lines
from trackres_ros.vehicle.writing.vehicle_file import SURROUNDINGS_FILE

SCHEMA = 1
NO_BINDINGS: Mapping[str, TopicBinding] = MappingProxyType({})


def report(d: Diagnosis, paths: Sequence[Path], bindings: Mapping[str, TopicBinding] = NO_BINDINGS) -> dict[str, Any]:
    """All findings as plain data; `bindings` are how the recordings were read."""
    belongs_to = {active.effect.name: active.effect.belongs_to for active in d.final.effects}
    scale = (d.kept.values or {}).get("torque_scale", d.base.torque_scale)
    lines = sensor_lines(d.kept.of("sensor"), bindings, scale)
    return {
        "schema": SCHEMA,
        "recordings": [str(path) for path in paths],
        "base": _base(d),
        "verdict": _verdict(d),
        "effects": [_effect(f, belongs_to[f.name]) for f in d.found],
        "described": [
            *(_described(t) for t in d.described),
            *([_drift(d.drift, d.tracked)] if d.drift and d.tracked else []),
            *([_spread(d.spread)] if d.spread else []),
        ],
        "route": _route(d.routes[0], d.final) if d.routes else None,
        "routes": [_route(route, d.final) for route in d.routes],
        "refuted": [{"name": g.name, "heldout": _improvement(g.improvement)} for g in d.refuted],
        "possible": [{"name": name, "share": _number(share)} for name, share in d.shares.items()],
        "written": {
            "base": d.kept.values is not None,
            "values": None if d.kept.values is None else _numbers(dict(d.kept.values)),
            "effects": [name for kind in BELONGS_TO for name in d.kept.names_of(kind)],
            "disturbance": None if d.kept.disturbance is None else d.kept.disturbance.disturbance.form,
            "why": d.kept.text,
        },
        "heldout": _held_out(d.held_out),
        "not_visible": [{"name": n.name, "why": n.why} for n in d.steps[-1].separability.of_names.not_visible],
        "rejected": [{"reason": reason, "samples": seconds} for reason, seconds in d.gated.excluded.items()],
        "advice": _advice(d),
        "candidates": _candidates(d),
        "residual_by_regime": {"base": [_bin(b) for b in d.at_base.bins], "end": [_bin(b) for b in d.at_end.bins]},
        "changes": None
        if d.changes is None
        else [
            {
                "recording": c.recording,
                "t_s": _number(c.time),
                "before": _number(c.before),
                "after": _number(c.after),
                "unit": "Nm",
            }
            for c in d.changes
        ],
        "whiteness_p": _number(d.periodogram_p),
        "noise": d.noise.text,
        "residual_sources": _sources(residual_sources(d.final)),
        "split": d.split.text,
        "notes": list(d.gated.notes),
        "inputs": inputs(d),
        "kept": {kind: d.kept.names_of(kind) for kind in BELONGS_TO},
        "topics_lines": lines,
        "to_do": _to_do(d, lines),
        "thermal": None
        if d.thermal is None
        else {"mean_k": _number(d.thermal.mean_k), "mean_abs_k": _number(d.thermal.mean_abs_k), "text": d.thermal.text},
    }


def _base(d: Diagnosis) -> dict[str, Any]:
    """The re-fitted model, and its errors of the instrument."""
    nominal = {q.name: q for q in d.base.parameters}
    return {
        "model": d.base.name,
        "refitted": {
            name: {
                "nominal": _number(nominal[name].nominal),
                "value": _number(value),
                "unit": nominal[name].unit,
                **_of_base(d.base_intervals.get(name)),
            }
            for name, value in d.final.base_values.items()
        },
        "instrument": {
            active.effect.name: {q.name: {"value": _number(active.values[q.name]), "unit": q.unit}}
            for active in d.final.instrument
            for q in active.effect.parameters
        },
    }


def _verdict(d: Diagnosis) -> dict[str, Any]:
    """The conclusion of the diagnosis, and the values of the vehicle file that the re-fit changes."""
    return {
        "status": d.verdict.status,
        "grade": d.verdict.grade,
        "sentence": d.verdict.sentence,
        "hint": d.steps[-1].hint or None,
        "seen": d.verdict.seen or None,
        "may_be": [{"name": name, "share": None if share is None else _number(share)} for name, share in d.verdict.may_be],
        "changed": [
            {
                "name": c.name,
                "unit": c.unit,
                "nominal": _number(c.nominal),
                "value": _number(c.value),
                "ci95": [_number(c.low), _number(c.high)],
                "torque_nm": _number(c.torque_nm),
                "text": c.text,
            }
            for c in d.verdict.changed
        ],
    }


def _held_out(held_out: HeldOut) -> dict[str, Any]:
    """Errors on the hold-out laps."""
    return {
        "laps": list(held_out.laps),
        "mae": _numbers(held_out.mae),
        "r2": _numbers(held_out.r2),
        "bias": _numbers(held_out.bias),
        "improvement_ci95": [_number(held_out.of_effects.low), _number(held_out.of_effects.high)],
        "of_refit": _improvement(held_out.of_refit),
        "by_lap": {
            measure: {stage: [_number(float(x)) for x in values] for stage, values in stages.items()}
            for measure, stages in held_out.by_lap.items()
        },
    }


def _advice(d: Diagnosis) -> list[dict[str, Any]]:
    """Drives that would separate effects not distinguishable in these recordings."""
    return [
        {
            "separates": list(a.separates),
            "groups": [list(group) for group in a.groups],
            "manoeuvre": a.manoeuvre,
            "expected_d_prime": _number(a.expected_d_prime),
            "minutes": _number(a.minutes),
            "information_bit": _number(a.information),
        }
        for a in d.advice
    ]


def _candidates(d: Diagnosis) -> list[dict[str, Any]]:
    """All tried candidates, round by round."""
    return [
        {
            "round": i + 1,
            "name": c.name,
            "delta_loglik": _number(c.gain),
            "log_evidence": _number(c.criterion),
            "bic_gain": _number(c.bic_gain),
            "taken_by_other_forms": _number(c.form_error_gain),
            "kept": _number(c.kept),
            "d_prime": _number(c.d_prime),
            "threshold": _number(s.threshold),
            "chosen": s.chosen is c,
            "why": _why(c, s),
        }
        for i, s in enumerate(d.steps)
        for c in s.candidates
    ]


def _to_do(d: Diagnosis, lines: Mapping[str, str]) -> list[str]:
    """Next steps for the kept results, in addition to using the vehicle file."""
    said = []
    around, sensors = (", ".join(d.kept.names_of(kind)) for kind in ("surroundings", "sensor"))
    if around:
        said.append(
            f"The surroundings, not the vehicle, cause {around}. That is written to {SURROUNDINGS_FILE}, for --surroundings "
            "where it applies."
        )
    if lines:
        said.append(f"A sensor causes {sensors}. No file corrects that: in the topics file, replace the line of the role with:")
    return said


def _why(c: Candidate, step: Step) -> str:
    """Why a candidate was chosen or not."""
    if step.chosen is c:
        return "chosen"
    if step.chosen is not None and c.name in step.members:
        return f"not distinguishable from {step.chosen.name} here"
    if c.gain <= step.threshold:
        return "noise alone may gain as much" if c.gain <= step.by_noise else "the model's own error may gain as much"
    if c.net_gain <= step.threshold:
        return f"another form of {' or '.join(step.before.effect_names)} may gain as much"
    if c.net_evidence <= 0.0:
        return "explains less than its parameters cost (evidence)"
    if not c.matters:
        return f"adds only {c.share:.1%} of the torque"
    if step.chosen is None:
        return "hold-out laps do not confirm it"
    return f"{likelier(step.chosen, c)} times less likely than {step.chosen.name}"


def _effect(f: NamedEffect, belongs_to: str) -> dict[str, Any]:
    chosen = f.step.chosen
    assert chosen
    units = {q.name: q.unit for q in f.parameters}
    return {
        "name": f.name,
        "class": list(f.step.members),
        "weights": _numbers(dict(f.step.weights)),
        "acts_on": f.acts_on,
        "acts": {"text": f.acts.text, "size": f.seen},
        "grade": f.graded.grade,
        "heldout": _improvement(f.graded.improvement),
        "on_bounds": list(f.graded.on_bounds),
        "belongs_to": belongs_to,
        "parameters": {
            name: {
                "value": _number(value),
                "unit": units[name],
                "ci95": None if f.intervals[name].bound_only else _pair(f.intervals[name]),
                "bound_only": f.intervals[name].bound_only,
            }
            for name, value in f.values.items()
        },
        "where": {
            "time": [[s.recording, _number(s.begin), _number(s.end)] for s in f.where],
            "regime": [
                {
                    "variable": b.variable,
                    "lo": _number(b.low),
                    "hi": _number(b.high),
                    "mean_residual": _number(b.mean_residual),
                    "unit": b.unit,
                    "p": _number(b.p),
                }
                for b in f.regime
            ],
        },
        "evidence": {
            "delta_loglik": _number(chosen.gain),
            "log_evidence": _number(chosen.criterion),
            "bic_gain": _number(chosen.bic_gain),
            "stability": _number(f.step.stability),
            "kept": _number(chosen.kept),
            "d_prime": _number(chosen.d_prime),
        },
        "text": f.text,
    }


def _sources(s: ResidualSources) -> dict[str, Any]:
    return {
        "total": _number(s.total),
        "torque_sensor": None if s.torque_sensor is None else _number(s.torque_sensor),
        "speed_sensor": None if s.speed_sensor is None else _number(s.speed_sensor),
        "model_at_most": _number(s.model),
        "unit": "Nm",
        "text": s.text,
    }


def _described(t: Told) -> dict[str, Any]:
    of = t.described
    return {
        **_term(of),
        **_worth(t.graded.improvement, t.graded.grade),
        "seen_nm": _number(t.seen_nm),
        "parameters": {name: _pair(interval) for name, interval in t.intervals.items()},
    }


def _route(route: Route, final: Fit) -> dict[str, Any]:
    """A term by place."""
    learned = route.learned(final)
    return {
        "name": route.candidate.name,
        "kind": learned.kind,
        "slope_likelier_by": _number(route.apart),
        "streets_m": _number(route.metres),
        "passed_again_m": _number(route.again_m),
        "passes": route.passes,
        "rms": _number(float(np.sqrt(np.nanmean(learned.value**2)))),
        "std_median": _number(float(np.nanmedian(learned.std))),
        "unit": "1" if learned.kind == SLOPE else "Nm",
    }


def _drift(of: Described, tracked: Improvement) -> dict[str, Any]:
    return {**_term(of), **_worth(tracked, tracked.grade), "parameters": {}}


def _spread(of: Spread) -> dict[str, Any]:
    tested = {"ratio": _number(of.ratio), "p": _number(of.p), "laps": of.laps}
    return {**_term(of.described), "gain_nm": None, "grade": CONFIRMED, "heldout": None, "parameters": {}, **tested}


def _worth(found: Improvement, grade: str) -> dict[str, Any]:
    return {"gain_nm": _number(found.before - found.after), "grade": grade, "heldout": _improvement(found)}


def _term(of: Described) -> dict[str, Any]:
    return {
        "form": of.form,
        "name": of.name or None,
        "variable": of.variable or None,
        "gate": of.gate or None,
        "period_m": None if of.period_m is None else _number(of.period_m),
        "memory": None if of.memory is None else _number(of.memory),
        "size_nm": _number(of.size_nm),
        "sentence": of.sentence,
        "mechanisms": list(of.mechanisms),
        "predictable": of.predictable,
        **({"stretches": [asdict(stretch) for stretch in of.stretches]} if of.stretches else {}),
    }


def _improvement(i: Improvement) -> dict[str, Any]:
    return {"mae": [_number(i.before), _number(i.after)], "ci95": [_number(i.low), _number(i.high)], "grade": i.grade}


def _bin(b: Bin) -> dict[str, Any]:
    return {
        "variable": b.variable, "lo": _number(b.low), "hi": _number(b.high), "mean_residual": _number(b.mean_residual),
        "unit": b.unit, "samples": b.samples, "p": _number(b.p),
    }  # fmt: skip


def _number(value: float) -> float | None:
    """A number with 6 significant digits for JSON; None if not finite."""
    value = float(value)
    return float(np.format_float_positional(value, 6, fractional=False)) if math.isfinite(value) else None


def _numbers(values: dict[str, float]) -> dict[str, float | None]:
    return {name: _number(value) for name, value in values.items()}


def _of_base(interval: Interval | None) -> dict[str, Any]:
    """Interval of a base value; at the end of its range it is only a bound."""
    bound_only = interval is not None and interval.bound_only
    return {"ci95": None if bound_only else _pair(interval), "bound_only": bound_only}


def _pair(interval: Interval | None) -> list[float | None] | None:
    return None if interval is None else [_number(interval.low), _number(interval.high)]

"""The whole diagnosis, step after step; each result is frozen and can be looked at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackres_ros.diagnosis.advise import Advice, advise
from trackres_ros.diagnosis.base import Base
from trackres_ros.diagnosis.bases import LoadedBase
from trackres_ros.diagnosis.changes import Change, changes
from trackres_ros.diagnosis.confirm import Graded, confirm, keep
from trackres_ros.diagnosis.fitting import Fit, Problem
from trackres_ros.diagnosis.gate import Gated, gate, split
from trackres_ros.diagnosis.held_out import CONFIRMED, HeldOut, HeldOutLaps, held_out
from trackres_ros.diagnosis.intervals import Interval, intervals
from trackres_ros.diagnosis.kept import Kept
from trackres_ros.diagnosis.levels import for_tests, with_levels
from trackres_ros.diagnosis.locate import ThermalCheck, acts, against_travel, contribution, regime_of, spans, stray, thermal_check
from trackres_ros.diagnosis.naming import Step, begin, choose
from trackres_ros.diagnosis.regimes import RegimeMap, cumulative_periodogram, regime_map
from trackres_ros.diagnosis.sanity import aligned_clock, check_torque, nothing_to_conclude, unlike
from trackres_ros.diagnosis.screening import QUICK_REPLICATES, REPLICATES
from trackres_ros.diagnosis.session import Session, Split
from trackres_ros.diagnosis.verdict import Found, Verdict, judge
from trackres_ros.diagnosis.whitening import Noise
from trackres_ros.effects import catalogue
from trackres_ros.effects.rotating_inertia import RotatingInertia
from trackres_ros.recording import Recording
from trackres_ros.sources import open_source
from trackres_ros.topics import Topics

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All that was found.

    Attributes
    ----------
    base, gated, split
        The base model, what passed the gate, and what was held out.
    nominal
        Torque of each session with the values of the vehicle file [Nm].
    refitted, final
        The base re-fitted, and with the effects found; values as by `levels.with_levels`.
    at_base, at_end
        Residual by regime of both.
    changes
        When the residual of the re-fitted base changes its level; None where that could not be looked for.
    periodogram_p
        Probability that the last whitened residual is white.
    thermal
        Measured against simulated belt temperature, with the base re-fitted; None where none was measured.
    steps, found, refuted
        Rounds of the choice, the effects found, and those that were chosen and that held-out laps refute.
    base_intervals
        Of the base's parameters in `final`.
    held_out, advice, verdict
        What it is worth, what to drive next, and what it comes to.
    kept
        What of it may be written.
    """

    base: Base
    gated: Gated
    split: Split
    nominal: tuple[Array, ...]
    refitted: Fit
    final: Fit
    at_base: RegimeMap
    at_end: RegimeMap
    changes: list[Change] | None
    periodogram_p: float
    thermal: ThermalCheck | None
    steps: tuple[Step, ...]
    found: tuple[Found, ...]
    refuted: tuple[Graded, ...]
    base_intervals: dict[str, Interval]
    held_out: HeldOut
    advice: tuple[Advice, ...]
    verdict: Verdict
    kept: Kept

    @property
    def noise(self) -> Noise:
        """What whitens the residual of the last fit as far as it goes."""
        return for_tests(self.final).noise

    @property
    def sessions(self) -> tuple[Session, ...]:
        """The recordings."""
        return self.final.problem.sessions


def read_recordings(paths: Sequence[Path], topics: Topics | None) -> list[Recording]:
    """Read recordings, each one session, in the order of their clocks where all have one."""
    recordings = [Recording.from_source(open_source([path], topics)) for path in paths]
    starts = [r.start_ns for r in recordings]
    return [r for _, r in sorted(zip(starts, recordings, strict=True), key=lambda pair: pair[0])] if all(starts) else recordings


def diagnose(
    recordings: Sequence[Recording],
    vehicle: LoadedBase,
    hide: Sequence[str] = (),
    holdout: int | Sequence[str] | None = None,
    seed: int = 1,
    quick: bool = False,
    effects_dir: Path | None = None,
    keep_suspected: bool = False,
    said: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Find where recordings part from a base model, which effect is left out, and what a model with it is worth.

    Parameters
    ----------
    vehicle
        See `bases.load_base`.
    hide
        Roles that are not to be read.
    holdout
        See `gate.split`.
    seed
        Of all that is drawn: equal seeds give equal results.
    quick
        Fewer draws.
    effects_dir
        Folder with effects of the user's own.
    keep_suspected
        Whether effects that fit and that held-out laps do not confirm are kept too.
    said
        Takes the name of each stage.

    Raises
    ------
    InputError
        If the recordings cannot be used; says why.
    """
    rng, base = np.random.default_rng(seed), vehicle.base
    effects = {
        name: effect.beside(base.rotating_mass_factor) if isinstance(effect, RotatingInertia) else effect
        for name, effect in catalogue(effects_dir, base.facts.weight * base.facts.radius, on_tyres=not base.has_belt).items()
    }
    said("gate: units, clocks, gaps")
    gated = gate(recordings, vehicle.known, hide)
    gated, nominal = align_and_check(gated, vehicle)
    chosen = split(gated.sessions, holdout)
    masks = tuple(chosen.training_mask(s) for s in gated.sessions)
    said("re-fit of the base")
    tested = begin(Problem(base, gated.sessions, masks, nominal))
    said("where: residual by regime")
    refitted = with_levels(tested)
    tested_base = for_tests(refitted)
    at_base = regime_map(tested_base, rng)
    steps, best = choose(tested, effects, QUICK_REPLICATES if quick else REPLICATES, rng, said)
    said("what it is worth: laps held out")
    laps = HeldOutLaps(gated.sessions, [chosen.held_out_mask(s) for s in gated.sessions], rng)
    final, graded, refuted = confirm(with_levels(best), refitted, laps) if best.effects else (refitted, {}, ())
    predicted = {"refitted": refitted.predicted, "with_effects": final.predicted}
    worth = held_out(laps, {"nominal": nominal, **{stage: [p.torque for p in of] for stage, of in predicted.items()}})
    names, odd = ", ".join(s.name for s in gated.sessions), unlike(gated.sessions, nominal)
    refused = nothing_to_conclude(names, worth.r2, worth.mae, float(np.abs(laps.measured).mean()), odd)
    if refused:
        raise refused
    said("what is left")
    tested_end = for_tests(final)
    at_end = regime_map(tested_end, rng)
    said("how sure: intervals")
    bounds = intervals(final)
    by_name = {s.chosen.name: s for s in steps if s.chosen}
    found = []
    for active in final.effects:
        adds = contribution(final, active.effect.name)
        resists = against_travel(final.problem.sessions, adds) if active.effect.acts_on != "sensor" else adds
        where = acts(final, resists)
        found.append(
            Found(
                active.effect.name,
                active.effect.text,
                active.effect.acts_on,
                active.effect.parameters,
                by_name[active.effect.name],
                active.values,
                {q: bounds[active.effect.name, q] for q in active.values},
                adds,
                resists,
                spans(final.problem.sessions, adds),
                where,
                regime_of(refitted, at_base, where),
                graded[active.effect.name],
            )
        )
    said("what to drive next")
    told = [s for s in steps if s.chosen and s.chosen.name in graded]
    advice = [a for s in told for a in advise(s.candidates, s.members, vehicle.known.max_speed)]
    verdict = judge(found, refuted, refitted, at_end, stray(final), steps[-1].hint, worth)
    kinds = {name: effect.belongs_to for name, effect in effects.items()}
    settled = {f.name for f in found if {kinds[m] for m in f.step.members} <= {kinds[f.name]}}
    believed = [
        f.name for f in found if keep_suspected or (verdict.names and f.graded.grade == CONFIRMED and f.name in settled)
    ]
    return Diagnosis(
        base, gated, chosen, nominal, refitted, final, at_base, at_end, changes(tested_base), cumulative_periodogram(tested_end),
        thermal_check(refitted),
        tuple(steps), tuple(found), refuted, {name: b for (effect, name), b in bounds.items() if not effect},
        worth, tuple(advice), verdict, keep(believed, final, refitted, worth, laps, bounds),
    )  # fmt: skip


def align_and_check(gated: Gated, vehicle: LoadedBase) -> tuple[Gated, tuple[Array, ...]]:
    """Clocks put right, sign and unit checked, by the torque that the vehicle file expects; and that torque."""
    values = {q.name: q.nominal for q in vehicle.base.parameters}

    def by_file(sessions: Sequence[Session]) -> list[Array]:
        return [p.torque for p in vehicle.base.predict(sessions, values, (), [np.zeros(len(s)) for s in sessions])]

    expected = by_file(gated.sessions)
    moved = [aligned_clock(s, e) for s, e in zip(gated.sessions, expected, strict=True)]
    sessions = tuple(s for s, _ in moved)
    notes = (*gated.notes, *(note for _, note in moved if note))
    check_torque(sessions, expected, by_file([replace(s, accel=np.zeros(len(s))) for s in sessions]), vehicle.known)
    notes = (*notes, *unlike(sessions, expected))
    return replace(gated, sessions=sessions, notes=notes), tuple(expected)

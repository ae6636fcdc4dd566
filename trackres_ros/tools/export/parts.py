# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Divides an estimator for C: constants in the code, arrays of the state, effects by number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trackres_ros.effects import stepping
from trackres_ros.effects.calls import EffectCalls, function_of
from trackres_ros.effects.effect import Active
from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.kernels.flow import translate_body
from trackres_ros.kernels.functions import Instance, Translator
from trackres_ros.kernels.kinds import INT, REAL, WIDE, ArrayOf, Const, Kind, Record, Scalar
from trackres_ros.tools.export import step

NAMES_OF_CONSTANTS = {"assembly": "assemblies", "loss": "loss", "drive": "drive", "channel_limits": "limits"}


@dataclass(frozen=True, eq=False)
class StateArray:
    """An array of the state: its name, initial values, the meaning of its axes, and the kind of its numbers if not integers."""

    name: str
    start: Any
    axes: str
    of: Scalar = REAL

    @property
    def kind(self) -> ArrayOf:
        """Its kind in C."""
        return ArrayOf(INT if self.start.dtype.kind == "i" else self.of, self.start.shape)


class Parts:
    """The parts of the C of one estimator, with learned values as `State.learned`.

    `single` makes numbers `float`, but for those that sum small increments up. `tuned` numbers of the kernel are in the state,
    not in the code, to be changed while it runs.
    """

    def __init__(
        self, estimator: Estimator, learned_values: Any = None, is_single: bool = False, tunable_names: Sequence[str] = ()
    ) -> None:
        self.estimator, self.tuned = estimator, tuple(tunable_names)
        session = estimator.session()
        if learned_values is not None:
            session.learned[:] = learned_values
        self.arrays = _state_arrays(session, WIDE if is_single else REAL)
        if tunable_names:
            start = np.array([float(getattr(estimator.constants.number, name)) for name in tunable_names])
            self.arrays.append(StateArray("tuned", start, ", ".join(tunable_names)))
        self._by_name = {array.name: array for array in self.arrays}
        self.arrays = [array for array in self.arrays if array.start.size]
        self.translator = Translator(translate_body, is_single)
        self.translator.is_checked = False
        self.effects = EffectCalls(self.translator)
        self._translate_effects()
        self.entries = self._translate_entries()

    @property
    def active(self) -> list[Active]:
        """All active effects, in the order of their rows."""
        return [*self.estimator.vehicle.own, *self.estimator.vehicle.surroundings]

    # Effects

    def _translate_effects(self) -> None:
        """Number the functions of the effects here from 1; the table of effects gets these numbers."""
        rows = self.estimator.constants.effects.copy()
        numbers: dict[Any, int] = {}
        actives = self.active
        for row in rows:
            effect = actives[row[stepping.STATE]].effect
            for column, method in ((stepping.TERMS_AT, "terms"), (stepping.LAG_AT, "lag")):
                if row[column] == 0:
                    continue
                key = function_of(effect, method)
                if key not in numbers:
                    numbers[key] = len(numbers) + 1
                    self.effects.add(key, numbers[key])
                row[column] = numbers[key]
        self._rows = rows

    # The step

    def _array(self, name: str) -> Kind:
        """The kind of an array of the state; one without entries is a constant."""
        array = self._by_name[name]
        return array.kind if array.start.size else Const(array.start)

    def records(self) -> dict[str, Record]:
        """The records for the entries: constants, memory of the guards, carried state, and scratch memory."""
        k, session = self.estimator.constants, self.estimator.session()
        record_changes = {"effects": self._rows, "number": _scale_number(k.number)}
        numbers = [
            (name, REAL if name in self.tuned else Const(value)) for name, value in record_changes["number"]._asdict().items()
        ]
        constants: list[tuple[str, Kind]] = []
        for name in k._fields:
            if name == "effect_values":
                constants.append((name, self._array(name)))
                continue
            if name == "number" and self.tuned:
                constants.append((name, Record("numbers", tuple(numbers))))
                continue
            value = record_changes.get(name, getattr(k, name))
            if isinstance(value, np.ndarray):
                self.translator.table_names[id(value)] = NAMES_OF_CONSTANTS.get(name, name)
            constants.append((name, Const(value)))
        self._kept = record_changes
        memory = tuple((name, self._array(name)) for name in session.memory._fields)
        carried_arrays = tuple((name, self._array(f"carried_{name}")) for name in ("belts", "motion", "effects", "learned"))
        arrays = self.estimator.scratch()
        effects = tuple((name, self._array(name)) for name in arrays.effects._fields)
        other_arrays = tuple((name, self._array(name)) for name in arrays._fields if name != "effects")
        scratch = (("effects", Record("effect_scratch", effects)), *other_arrays)
        return {
            "k": Record("constants", tuple(constants)),
            "memory": Record("memory", memory),
            "carried": Record("carried", carried_arrays),
            "scratch": Record("scratch", scratch),
        }

    def _translate_entries(self) -> dict[str, Instance]:
        records = self.records()
        given = ArrayOf(REAL, (len(self.estimator.channels),))
        output_kind = ArrayOf(REAL, (len(self.estimator.columns),))
        kinds_used: list[Kind] = [records["k"], records["memory"], records["carried"], records["scratch"]]
        feeds = [*kinds_used, self._array("clock")]
        kinds: dict[Any, list[Kind]] = {
            step.step: [*feeds, given, REAL, output_kind],
            step.take_message: [*feeds, INT, INT, INT, REAL, output_kind],
            step.feedforward_now: [records["k"], records["memory"], self._array("carried_motion"), INT],
            step.reasons_now: [records["k"], records["memory"], INT],
            step.is_stale: [records["k"], records["memory"], INT],
            step.rest_after: [*kinds_used, REAL, REAL],
        }
        return {function.__name__: self.translator.instance(function, given) for function, given in kinds.items()}


def _scale_number(number: Any) -> Any:
    """Numbers of the kernel as plain Python numbers."""
    return type(number)(*(value.item() if isinstance(value, np.generic) else value for value in number))


def _state_arrays(session: Session, of_sums: Scalar) -> list[StateArray]:
    """The whole state that changes from step to step, the wider numbers first; as in a new session.

    In a step belts and effects move by its share of a time constant: at 1 kHz and of an hour, a `float` does not resolve that.
    """
    memory, k, scratch = session.memory, session.estimator.constants, session.estimator.scratch()
    return [
        StateArray("clock", np.zeros(3, dtype=np.int64), "now, the latest time since the last speed [ns], and its rounding"),
        StateArray("times", memory.times, "channel x what the guards remember [ns]"),
        StateArray("counters", memory.counters, "channel x counter"),
        StateArray("reasons", memory.reasons, "steps at which each reason held"),
        StateArray("carried_belts", session.belts, "assembly x mean and surface x temperature and departures", of_sums),
        StateArray("carried_effects", session.effects, "memory of the effects", of_sums),
        StateArray("values", memory.values, "channel, last accepted value"),
        StateArray("followed", memory.followed, "place on a route"),
        StateArray("tracked", memory.tracked, "speed and odometer"),
        StateArray("runs", memory.runs, "channel x what it is compared with, and what is doubted"),
        StateArray("carried_motion", session.motion, "motion and feed-forward"),
        StateArray("carried_learned", session.learned, "what was learned of the vehicle"),
        StateArray("effect_values", k.effect_values, "effect x parameter"),
        StateArray("loads", np.zeros_like(scratch.loads), "[N]"),
        StateArray("belt_measured", np.zeros_like(scratch.belt_measured), "[degC]"),
        StateArray("terms", scratch.effects.terms, "what effects do together in a step"),
        StateArray("conditions", scratch.effects.conditions, "what effects read in a step"),
        StateArray("answer", scratch.effects.answer, "what an effect answers"),
        StateArray("gap_belts", np.zeros_like(scratch.gap_belts), "before and after a gap x node x temperature and departures"),
        StateArray("parts", np.zeros_like(scratch.parts), "all assemblies and each x contributions to a step"),
        StateArray("row", np.zeros(len(session.estimator.columns)), "results of the last step"),
    ]

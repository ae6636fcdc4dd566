# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learned parameters as columns after the results of a step, and as lines of a status; the same live, in bags and in tables."""

from __future__ import annotations

from collections.abc import Sequence

from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.estimator import Session
from trackres_ros.learning.delay import EARLIEST_S, LATEST_S
from trackres_ros.learning.learner import Learner
from trackres_ros.learning.parameters import DELAY, VEHICLES_OWN, Learnable
from trackres_ros.model.resistance import direction
from trackres_ros.text import figures

LEARNING, LEARNED, FROZEN, HELD = range(4)
STATES_OF = ("learning", "learned", "frozen", "at its bound")
TORQUE, COVERAGE, ACTS = "learned_resistance_torque_nm", "learned_coverage", "learned_acts"
Line = tuple[str, str, tuple[tuple[str, str], ...]]
"""Name, message and values of a status."""


class LearningColumns:
    """The columns of a learner, after those of the estimate, by the names of `column_names`."""

    def __init__(self, learner: Learner) -> None:
        self._learner = learner
        self._values: list[float] = []
        self._second = -2

    def row_values(self, row: Sequence[float], session: Session) -> list[float]:
        """The columns of a finished step."""
        learner, values = self._learner, session.learned
        second = learner.gate.second.number
        if second != self._second:
            self._values, self._second = learning_values(learner), second
        torque = row[layout.Results.resistance_torque_nm]
        if values[layout.Learned.on] == 0.0 and learner.is_active and learner.learned.applied.any():
            torques = learner.learned.applied * values[layout.Learned.sensitivities]
            torque += float(torques.sum()) - float(torques[layout.OF_MASS])
            torque += learner.learned.lasting_nm * direction(row[layout.Results.speed_mps])
        return [torque, *self._values]


def column_names(learnables: Sequence[Learnable]) -> tuple[str, ...]:
    """Names of the columns of a learner.

    Learned resistance [Nm], whether it acts or not; share of the required driving; whether learned values are used, or would be;
    and value, standard deviation and state of each learned parameter.
    """
    names = (name for learnable in learnables for name in columns_of(learnable))
    return (TORQUE, COVERAGE, ACTS, *names)


def columns_of(learnable: Learnable) -> tuple[str, str, str]:
    """Value, standard deviation and state of one learned parameter."""
    unit = "" if learnable.unit == "1" else f"_{learnable.unit.lower()}"
    return f"learned_{learnable.name}{unit}", f"learned_{learnable.name}_std{unit}", f"learned_{learnable.name}_state"


def learning_values(learner: Learner) -> list[float]:
    """The columns but for the torque, which change once a second."""
    values = [learner.buckets.share, float(learner.is_active)]
    is_frozen, has_evidence, is_at_bound = bool(learner.freeze_reason), learner.has_evidence, learner.is_at_bound
    stds = learner.stds(learner.learned.covariance, learner.own)
    for learnable in learner.learnables:
        if learnable.state == DELAY:
            values += [*learner.delay.kept.value, float(LEARNED if learner.delay.kept.is_known else LEARNING)]
            continue
        counts = learnable.state in VEHICLES_OWN and bool(has_evidence[learnable.state])
        status = HELD if counts and is_at_bound[learnable.state] else LEARNED if counts else LEARNING
        state = FROZEN if is_frozen and counts else status
        values += [
            learnable.value(float(learner.learned.mean[learnable.state])),
            learnable.size(float(stds[learnable.state])),
            float(state),
        ]
    return values


def lines(learner: Learner, row: Sequence[float]) -> list[Line]:
    """Name, message and values of a status for each learned parameter, from a row that ends in the numbers of `shown`."""
    coverage, acts, *values = row[len(row) - 2 - 3 * len(learner.learnables) :]
    low, high = [*learner.prior.low.tolist(), EARLIEST_S], [*learner.prior.high.tolist(), LATEST_S]
    rows: list[Line] = []
    for i, learnable in enumerate(learner.learnables):
        value, std, state = values[3 * i : 3 + 3 * i]
        facts = (
            ("value", f"{value:.6g}"),
            ("std", figures(std)),
            ("unit", learnable.unit),
            ("nominal", f"{learnable.nominal:.6g}"),
            ("low", f"{learnable.value(low[learnable.state]):.6g}"),
            ("high", f"{learnable.value(high[learnable.state]):.6g}"),
            ("coverage", f"{coverage:.3f}"),
            ("state", STATES_OF[int(state)]),
            ("acts", str(bool(acts) and int(state) != LEARNING and learnable.state in VEHICLES_OWN).lower()),
        )
        unit = f" {learnable.unit}" if learnable.unit != "1" else ""
        rows.append(
            (
                learnable.name,
                f"{learnable.meaning}: {figures(value, 4)} +- {figures(std, 2)}{unit}, {STATES_OF[int(state)]}",
                facts,
            )
        )
    return rows

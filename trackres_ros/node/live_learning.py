# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learning in a running node: inputs, statuses and the three modes off, watch and on."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from trackres_ros.estimator.estimator import Estimator, Session
from trackres_ros.estimator.snapshot import LEARNED_AT
from trackres_ros.learning.columns import LearningColumns, lines, shown
from trackres_ros.learning.learner import OFF, ON, Learner, use_file
from trackres_ros.learning.store import go_on, since_learned, stored
from trackres_ros.node.notices import Notice
from trackres_ros.node.transport import Level, Status


class LiveLearning:
    """A learner for a node with a measured torque; without one it does nothing. Learned values are kept while it is off, and
    those of the state file without a torque.
    """

    def __init__(self, estimator: Estimator, mode: str, measured: bool) -> None:
        self.mode = mode
        self.learner = Learner(estimator, mode) if measured else None
        self._columns = None if self.learner is None else LearningColumns(self.learner)
        self._kept: Any = None  # plain values for the state file while nothing learns

    def go_on(self, session: Session, saved: Any, now: float) -> str:
        """Continue with a session and the learned values of a state file at a time [s since 1970]; return a text for the log.

        They are less certain by the time since they were learned.

        Raises ValueError if they are not from a learner of this vehicle; they are then not used.
        """
        use_file(session.learned)
        if saved is None:
            return ""
        if self.learner is None:
            self._kept = saved
            return "the learned parameters are kept, but no torque is measured"
        go_on(session, self.learner, saved, since_learned(saved, now))
        self._kept = saved if self.mode == OFF else None
        return f"{self.learner.learned.seconds / 60.0:.0f} min of driving were used for learning"

    def wear(self, seconds: float) -> None:
        """Account for more time off [s] before the first speed; values that are only kept say when they were learned."""
        if self.learner is not None and self._kept is None:
            self.learner.wear(seconds)

    def stored(self) -> Any:
        """Plain values for the state file; None if nothing was learned."""
        return self._kept if self.learner is None or self._kept is not None else stored(self.learner)

    def take(self, stamp_ns: int, row: list[float], session: Session) -> None:
        """Take the results of a step."""
        if self.learner is not None and self.mode != OFF:
            before = session.learned.copy()
            try:
                self.learner.take(stamp_ns, row, session)
                if not np.isfinite(session.learned).all():
                    raise ArithmeticError("a learned parameter is not finite")
            except BaseException:  # learned values for the next step stay unchanged
                session.learned[:] = before
                raise

    def columns(self, row: list[float], session: Session) -> list[float]:
        """Values of the columns after those of an estimate."""
        return [] if self._columns is None else self._columns.of(row, session)

    def change(self, mode: str, session: Session) -> None:
        """Change the mode; learned values stay, and act only in mode `on`."""
        if self.learner is None or mode == self.mode:
            self.mode = mode
            return
        if mode == OFF:
            self._kept = {LEARNED_AT: time.time(), **stored(self.learner)}
        elif self._kept is not None:
            go_on(session, self.learner, self._kept, since_learned(self._kept, time.time()))
            self._kept = None
        if OFF in (mode, self.mode):
            self.learner.restart()
        self.mode = self.learner.mode = mode
        if mode != ON:
            use_file(session.learned)

    def restart(self, session: Session) -> None:
        """Restart the estimate; values learned of the vehicle stay, and act again once the learner allows it."""
        use_file(session.learned)
        if self.learner is not None:
            self.learner.restart()

    def reset(self, session: Session) -> str:
        """Reset the learned parameters; return a text for the log."""
        use_file(session.learned)
        if self.learner is None and self._kept is None:
            return "no torque is measured, so there is nothing to reset"
        self._kept = None
        if self.learner is not None:
            self.learner.reset()
        return "the learned parameters are reset: the vehicle file is used"

    @property
    def text(self) -> str:
        """Status of learning, in a sentence; empty if learning is off."""
        if self.learner is None:
            return ""
        return OFF if self.mode == OFF else self.learner.text

    def statuses(self, node: str, vehicle: str) -> Sequence[Status]:
        """A status of each learned value, as published."""
        if self.learner is None or self.mode == OFF:
            return ()
        overall = (
            ("mode", self.mode),
            ("acts", str(self.learner.acts).lower()),
            ("frozen", self.learner.frozen),
            ("disturbance", self.learner.disturbance),
        )
        learned = lines(self.learner, shown(self.learner))
        listed = [("learning", self.text, overall), *learned]
        return [Status(Level.OK, f"{node}: {name}", message, vehicle, known) for name, message, known in listed]

    def notices(self) -> list[Notice]:
        """Present notices of the learning."""
        if self.learner is None or self.mode == OFF:
            return []
        frozen, left_out = self.learner.frozen, self.learner.left_out
        text = f"learning is paused: {frozen}" if frozen else f"learning skips samples: {left_out}"
        return [Notice("LEARNING_FROZEN", text)] if frozen or left_out else []

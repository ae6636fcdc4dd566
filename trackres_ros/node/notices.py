# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Everything the live node can notice, with its level: one table for status, diagnostics and docs; and what notices failures."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import ParamSpec, TypeVar

from trackres_ros.estimator import columns as at
from trackres_ros.node.transport import Level

SHOWN_NS = 5_000_000_000  # since a part last failed
P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class NoticeKind:
    """A kind of notice."""

    level: Level
    meaning: str
    awaited: bool = False  # present at every start until the inputs have arrived
    of_start: bool = False  # about the start of the node: the log has it once, the diagnostics in the entry of the state


@dataclass(frozen=True, slots=True)
class Notice:
    """A present notice: its name in `KINDS`, and a sentence with the particulars."""

    name: str
    text: str

    @property
    def level(self) -> Level:
        """Level of its kind."""
        return KINDS[self.name].level


_ok, _warn, _error, _stale = (partial(NoticeKind, level) for level in Level)
LIVE_KINDS = {
    "NO_SPEED": _stale("no speed was accepted since the start: only the status is published", awaited=True),
    "SPEED_OLD": _stale(
        "the last accepted speed is older than `speed_max_age_s`: the outputs keep the last stamp and values, "
        "and the feed-forward fades to zero"
    ),
    "INACTIVE": _stale("the node is deactivated, or ends by request: the feed-forward goes to zero, then nothing is published"),
    "NO_CLOCK": _stale("`use_sim_time` is set and no /clock message has arrived, or it shows a time before 0", awaited=True),
    "TWO_SPEEDS": _stale(
        "publishers of the speed disagree: none is used, and the feed-forward goes to zero; the text names them"
    ),
    "TORQUE_CONTESTED": _stale(
        "another node publishes on a topic of the feed-forward: ours goes to zero, or was never begun; the text names the node"
    ),
    "INTERNAL_ERROR": _error("a bug made a message, a step or an output fail (details in the log): do not use the estimate"),
    "PART_FAILED": _warn("a bug made another part fail (details in the log); the estimate and its outputs continue"),
    "NOT_RECORDED": _warn("`--record` cannot write fast enough, or not at all; the text names the file and the losses"),
    "OUTPUT_FAILED": _error("the middleware rejected a message of an output topic; the others continue"),
    "REFUSED": _warn("more than 10 % of an input's messages were rejected in the last second"),
    "OVERRUN": _warn("messages arrived faster than they could be processed: the oldest were dropped and counted as `dropped`"),
    "NO_PUBLISHER": _warn("nobody publishes on the topic of an input", awaited=True),
    "WRONG_TYPE": _warn(
        "a publisher uses another message type on the topic of an input, or another definition; no message of the topic is used"
    ),
    "INCOMPATIBLE_QOS": _warn(
        "a publisher's quality of service is below what the input requests, or without ROS its definition of the type differs; "
        "it never connects"
    ),
    "NOT_LATCHED": _warn(
        "a publisher of load, ambient or passengers has sent nothing since the start, and keeps nothing for those who join later"
    ),
    "SEVERAL_PUBLISHERS": _warn(
        "more than one publisher on the topic of an input; of a speed one is used at a time, of others all, by their arrival"
    ),
    "CLOCK_OFFSET": _warn("the stamps of the speed differ from this machine's time by more than a second"),
    "MISMATCH": _warn("measured and expected torque differ by more than the estimate's uncertainty"),
    "DISTURBANCE": _ok("the vehicle file's intermittent torque is present now; the estimate does not include it"),
    "LEARNING_FROZEN": _ok("learning from the measured torque is paused, or skips many samples; its text says why"),
    "STATE_NOT_SAVED": _warn("the state file could not be written: a restart would use an older state or start cold"),
    "STATE_SHARED": _warn("another running node has this state file: this one does not write it until that one has ended"),
    "STATE_NOT_USED": _ok("the state file could not be used: cold start; its text says where the file is kept", of_start=True),
}
AWAITED = (
    at.Reason.LOAD_NOMINAL
    | at.Reason.AMBIENT_NOMINAL
    | at.Reason.EFFECT_LEFT_OUT
    | at.Reason.PLACE_UNKNOWN
    | at.Reason.ENABLE_OLD
)
KINDS: Mapping[str, NoticeKind] = MappingProxyType(
    {
        **LIVE_KINDS,
        **{
            str(reason.name): NoticeKind(Level.OK if reason & at.HARMLESS else Level.WARN, text, bool(reason & AWAITED))
            for reason, text in at.REASON_TEXT.items()
        },
    }
)


def of_reasons(reasons: at.Reason) -> list[Notice]:
    """The notices of an estimate."""
    return [Notice(str(reason.name), text) for reason, text in at.REASON_TEXT.items() if reason & reasons]


def level_of(notices: Sequence[Notice]) -> Level:
    """The heaviest level."""
    return max((notice.level for notice in notices), default=Level.OK)


@dataclass(slots=True)
class _Failure:
    """The last failure of a part."""

    text: str
    at_ns: int
    essential: bool


class Guard:
    """Calls the parts of the node, and keeps an exception in one of them from ending or silencing another.

    The failure of an essential part (reading a message, a step, publishing) is an error: there is no usable estimate. For
    any other part (the disk, the log, other nodes, learning, recording, the statuses) it is a warning.
    `report` logs a failure, once for each text while it lasts; `steady_ns` is a monotonic clock [ns].
    """

    def __init__(self, report: Callable[[str], None], steady_ns: Callable[[], int]) -> None:
        self._report, self._steady_ns = report, steady_ns
        self._failures: dict[str, _Failure] = {}

    def __call__(self, part: str, do: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """Call a part; return its result, or None if it fails."""
        try:
            return do(*args, **kwargs)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever a library raises to end a program must not end this one
            self.report(part, error, is_essential=False)
        return None

    def essential(self, part: str, do: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """Call a part that the estimate needs. Written out, as each message passes here: one more call costs 400 ns."""
        try:
            return do(*args, **kwargs)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # as above
            self.report(part, error, is_essential=True)
        return None

    def taking(self, part: str, take: Callable[[], Iterable[T]]) -> Callable[[], Sequence[T]]:
        """A function that takes the waiting messages of an input; none if it fails."""
        return lambda: self.essential(part, lambda: list(take())) or ()

    def report(self, part: str, error: BaseException, is_essential: bool) -> None:
        """Take note of a failure."""
        text, now_ns = f"{type(error).__name__}: {error}", self._steady_ns()
        last = self._failures.get(part)
        self._failures[part] = _Failure(text, now_ns, is_essential)
        if last is None or last.text != text or now_ns - last.at_ns > SHOWN_NS:
            self._report(f"{part} failed because of a bug: {''.join(traceback.format_exception(error))}")

    def notices(self, steady_ns: int) -> list[Notice]:
        """The parts that have failed recently."""
        return [
            Notice("INTERNAL_ERROR", f"{part} failed because of a bug: {failure.text}")
            if failure.essential
            else Notice("PART_FAILED", f"{part} failed because of a bug, and the estimate continues: {failure.text}")
            for part, failure in list(self._failures.items())
            if steady_ns - failure.at_ns < SHOWN_NS
        ]

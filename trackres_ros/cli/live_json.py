# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Prints the content of the live table as lines of JSON, for programs."""

import json
import math
from typing import Any

from trackres_ros.cli.common import to_nowhere
from trackres_ros.cli.live_display import LiveDisplay
from trackres_ros.node.status import Overview

PERIOD_S = 1.0


class LiveJson(LiveDisplay):
    """Prints an overview once a second, and at the end with `"final": true`."""

    def _run(self) -> None:
        over = False
        while not over:
            over = self._stop.wait(PERIOD_S)
            try:
                print(json.dumps(as_dict(self._overview(), over), allow_nan=False), flush=True)
            except BrokenPipeError:  # the output has no reader any more, which does not end the node
                to_nowhere()
                return
            except OSError:  # a full disk: the next line may fit again
                continue


def as_dict(seen: Overview, final: bool) -> dict[str, Any]:
    """The overview ready for JSON; torques [Nm] positive where they resist forward travel, unknown numbers are null."""
    comparison, disturbance = seen.mismatch, seen.disturbance
    return {
        "final": final,
        "level": seen.level.name.lower(),
        "remarks": [{"name": r.name, "level": r.level.name.lower(), "text": r.text} for r in seen.notices],
        "stamp_ns": seen.stamp_ns,
        "age_s": _known(seen.age_s),
        "rate_hz": _known(seen.steps_hz),
        "published": seen.published,
        "feedforward_published_nm": seen.feedforward_nm,
        "estimate": {name: _known(value) for name, value in seen.values.items() if name != "reasons"},
        "inputs": [
            {
                "role": given.role, "topic": given.topic, "value": _known(given.value), "rate_hz": _known(given.rate_hz),
                "age_s": _known(given.age_s), "counts": dict(given.counts),
            }
            for given in seen.inputs
        ],
        "comparison": {
            "parted": comparison.parted, "settled": comparison.settled, "mean_nm": _known(comparison.mean_nm),
            "text": comparison.text,
        },
        "learning": seen.learning or None,
        "disturbance": disturbance and {
            "form": disturbance.form, "there": _known(disturbance.there), "present": disturbance.present,
            "torque_nm": _known(disturbance.torque_nm), "text": disturbance.text,
        },
        "state": {"file": seen.state_file, "saved_s_ago": _known(seen.saved_s_ago), "error": seen.state_error},
    }  # fmt: skip


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None

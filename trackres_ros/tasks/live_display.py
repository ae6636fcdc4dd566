# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shows the running node from a thread of its own: as a table in the terminal, or as lines of JSON for programs."""

import json
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from trackres_ros.model.resistance import resistance_parts
from trackres_ros.node.status import Overview
from trackres_ros.node.transport import Level
from trackres_ros.recording.roles import ROLES, base_role
from trackres_ros.tasks.terminal import to_nowhere
from trackres_ros.text import decimals, figures
from trackres_ros.units import KMH_PER_MPS

END_PATIENCE_S = 2.0
JSON_PERIOD_S = 1.0
REFRESH_S = 0.5
PLAIN_PERIOD_S = 10.0
LONG_AGE_S = 100.0  # from here on whole seconds
COLOURS = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "red", Level.STALE: "magenta"}


class LiveDisplay(ABC):
    """Shows an overview again and again, until it is stopped."""

    def __init__(self, overview: Callable[[], Overview]) -> None:
        self._overview = overview
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)

    def start(self) -> None:
        """Begin to show."""
        self._thread.start()

    def stop(self) -> bool:
        """Show the last state and stop; return whether the thread ended: a reader may not take what is shown."""
        self._stop.set()
        self._thread.join(END_PATIENCE_S)
        return not self._thread.is_alive()

    @abstractmethod
    def _run(self) -> None:
        """Show the overview until `_stop` is set, and once more then."""


class LiveJson(LiveDisplay):
    """Prints an overview once a second, and at the end with `"final": true`."""

    def _run(self) -> None:
        is_final = False
        while not is_final:
            is_final = self._stop.wait(JSON_PERIOD_S)
            try:
                print(json.dumps(as_dict(self._overview(), is_final), allow_nan=False), flush=True)
            except BrokenPipeError:  # the output has no reader any more, which does not end the node
                to_nowhere()
                return
            except OSError:  # a full disk: the next line may fit again
                continue


def as_dict(overview: Overview, is_final: bool) -> dict[str, Any]:
    """The overview ready for JSON; torques [Nm] positive where they resist forward travel, unknown numbers are null."""
    comparison, disturbance = overview.mismatch, overview.disturbance
    return {
        "final": is_final,
        "level": overview.level.name.lower(),
        "remarks": [{"name": r.name, "level": r.level.name.lower(), "text": r.text} for r in overview.notices],
        "stamp_ns": overview.stamp_ns,
        "age_s": _json_number(overview.age_s),
        "rate_hz": _json_number(overview.steps_hz),
        "published": overview.published,
        "feedforward_published_nm": overview.feedforward_nm,
        "estimate": {name: _json_number(value) for name, value in overview.values.items() if name != "reasons"},
        "inputs": [
            {
                "role": state.role, "topic": state.topic, "value": _json_number(state.value),
                "rate_hz": _json_number(state.rate_hz), "age_s": _json_number(state.age_s), "counts": dict(state.counts),
            }
            for state in overview.inputs
        ],
        "comparison": {
            "parted": comparison.parted, "settled": comparison.settled, "mean_nm": _json_number(comparison.mean_nm),
            "text": comparison.text,
        },
        "learning": overview.learning or None,
        "disturbance": disturbance and {
            "form": disturbance.form, "there": _json_number(disturbance.there), "present": disturbance.present,
            "torque_nm": _json_number(disturbance.torque_nm), "text": disturbance.text,
        },
        "state": {"file": overview.state_file, "saved_s_ago": _json_number(overview.saved_s_ago), "error": overview.state_error},
    }  # fmt: skip


def _json_number(value: float) -> float | None:
    return value if math.isfinite(value) else None


class LiveTable(LiveDisplay):
    """Shows an overview as a table: redrawn in a terminal, else one line at intervals."""

    def __init__(self, title: Callable[[], str], overview: Callable[[], Overview]) -> None:
        super().__init__(overview)
        self._title = title

    def _run(self) -> None:
        console = Console()
        if not console.is_terminal:
            while True:
                is_final = self._stop.wait(PLAIN_PERIOD_S)
                with suppress(OSError):  # a full disk: the next line may fit again
                    console.print(line(self._overview()), soft_wrap=True, markup=False, highlight=False)
                if is_final:
                    return
        with Live(console=console, auto_refresh=False) as live:
            is_final = False
            while not is_final:
                live.update(table(self._title(), self._overview()), refresh=True)
                is_final = self._stop.wait(REFRESH_S)
            live.update(table(self._title(), self._overview()), refresh=True)


def table(title: str, overview: Overview) -> Panel:
    """The overview as a table for the terminal."""
    colour = COLOURS[overview.level]
    status = Text.assemble((f" {overview.level.name} ", f"bold reverse {colour}"), f"  {overview.message}")
    parts: list[RenderableType] = [status, Text(""), _inputs(overview)]
    if overview.values:
        side_by_side = Table.grid(padding=(0, 2))
        side_by_side.add_row(_torques(overview), *([_belts(overview)] if overview.assemblies else []))
        parts += [Text(""), side_by_side, Text("")]
    if any(state.role == "torque" for state in overview.inputs):
        parts.append(Text(f"measured torque: {overview.mismatch.text}"))
    if overview.disturbance is not None:
        parts.append(Text(f"disturbance: {overview.disturbance.text}"))
    if overview.learning:
        parts.append(Text(f"learning: {overview.learning}"))
    parts.append(Text(_foot(overview), style="dim"))
    return Panel(Group(*parts), title=title, border_style=colour)


def line(overview: Overview) -> str:
    """The overview in one line."""
    if not overview.values:
        return f"{overview.level.name}: {overview.message}"
    value = overview.values
    belts = [value[f"belt_degc/{name}"] for name in overview.assemblies]
    belts_text = f"belts {decimals(min(belts), 1)} to {decimals(max(belts), 1)} degC  " if belts else ""
    return (
        f"{_time(overview)}  {decimals(value['speed_mps'] * KMH_PER_MPS, 1):>5} km/h  "
        f"resistance {decimals(value['resistance_torque_nm']):>6} +- {decimals(value['resistance_std_nm'])} Nm  "
        f"feed-forward {decimals(overview.feedforward_nm):>6} Nm  "
        f"{belts_text}{overview.level.name}: {overview.message}"
    )


def _inputs(overview: Overview) -> Group:
    parts: list[Text] = []  # other counters have a separate line: their number is unknown
    grid = Table(expand=True, box=None, pad_edge=False, header_style="dim")
    grid.add_column("input", no_wrap=True)
    grid.add_column("topic", overflow="fold", ratio=1)
    for name in ("value", "Hz", "age s", "accepted"):
        grid.add_column(name, justify="right", no_wrap=True)
    for state in overview.inputs:
        counts = dict(state.counts)
        accepted_count = counts.pop("accepted", 0)
        unit = ROLES[base_role(state.role)].unit
        value = "" if math.isnan(state.value) else f"{figures(state.value, 5)} {unit}".removesuffix(" 1")
        rate = "" if math.isnan(state.rate_hz) else f"{state.rate_hz:.1f}"
        grid.add_row(state.role, state.topic, value, rate, _age(state.age_s), str(accepted_count))
        if counts:
            counts_text = ", ".join(f"{name} {number}" for name, number in counts.items())
            parts.append(Text(f"  {state.role}: {counts_text}", style="yellow"))
    return Group(grid, *parts)


def _torques(overview: Overview) -> Table:
    grid = Table(box=None, pad_edge=False, header_style="dim")
    grid.add_column("at sprockets" if overview.assemblies else "at wheels", no_wrap=True)
    grid.add_column("Nm", justify="right", no_wrap=True)
    values, std = overview.values, overview.values["resistance_std_nm"]
    for name, column in resistance_parts(bool(overview.assemblies)).items():
        grid.add_row(f"  {name}", decimals(values[column]))
    grid.add_row("[b]resistance[/b] (sum)", f"[b]{decimals(values['resistance_torque_nm'])}[/b] +- {decimals(std)}")
    grid.add_row("grade", decimals(values["grade_nm"]))
    grid.add_row("inertia", decimals(values["inertia_nm"]))
    grid.add_row("[b]feed-forward[/b]", f"[b]{decimals(overview.feedforward_nm)}[/b]")
    return grid


def _belts(overview: Overview) -> Table:
    grid = Table(box=None, pad_edge=False, header_style="dim")
    grid.add_column("assembly", overflow="fold")
    for name in ("belt degC", "kN", "Nm"):
        grid.add_column(name, justify="right", no_wrap=True)
    for name in overview.assemblies:
        values = {
            column: overview.values[f"{column}/{name}"]
            for column in ("belt_degc", "belt_std_k", "load_n", "resistance_torque_nm")
        }
        belt = f"{decimals(values['belt_degc'], 1)} +- {decimals(values['belt_std_k'], 1)}"
        grid.add_row(name, belt, decimals(values["load_n"] / 1e3, 1), decimals(values["resistance_torque_nm"]))
    return grid


def _foot(overview: Overview) -> str:
    speed = f"{decimals(overview.values['speed_mps'] * KMH_PER_MPS, 1)} km/h, " if overview.values else ""
    state = f"state in {overview.state_file}" if overview.state_file else "no state saved"
    if not math.isnan(overview.saved_s_ago):
        state += f", saved {overview.saved_s_ago:.0f} s ago"
    return f"{_time(overview)}: {speed}age {_age(overview.age_s) or 'none'} s, {overview.steps_hz:.1f} estimates/s, {state}"


def _time(overview: Overview) -> str:
    if overview.stamp_ns is None:
        return "no estimate yet"
    return datetime.fromtimestamp(overview.stamp_ns * 1e-9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _age(value: float) -> str:
    return (f"{value:.2f}" if value < LONG_AGE_S else f"{value:.0f}") if math.isfinite(value) else ""

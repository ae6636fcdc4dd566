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
        over = False
        while not over:
            over = self._stop.wait(JSON_PERIOD_S)
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


class LiveTable(LiveDisplay):
    """Shows an overview as a table: redrawn in a terminal, else one line at intervals."""

    def __init__(self, title: Callable[[], str], overview: Callable[[], Overview]) -> None:
        super().__init__(overview)
        self._title = title

    def _run(self) -> None:
        console = Console()
        if not console.is_terminal:
            while True:
                over = self._stop.wait(PLAIN_PERIOD_S)
                with suppress(OSError):  # a full disk: the next line may fit again
                    console.print(line(self._overview()), soft_wrap=True, markup=False, highlight=False)
                if over:
                    return
        with Live(console=console, auto_refresh=False) as live:
            over = False
            while not over:
                live.update(table(self._title(), self._overview()), refresh=True)
                over = self._stop.wait(REFRESH_S)
            live.update(table(self._title(), self._overview()), refresh=True)


def table(title: str, seen: Overview) -> Panel:
    """The overview as a table for the terminal."""
    colour = COLOURS[seen.level]
    status = Text.assemble((f" {seen.level.name} ", f"bold reverse {colour}"), f"  {seen.message}")
    parts: list[RenderableType] = [status, Text(""), _inputs(seen)]
    if seen.values:
        side_by_side = Table.grid(padding=(0, 2))
        side_by_side.add_row(_torques(seen), *([_belts(seen)] if seen.assemblies else []))
        parts += [Text(""), side_by_side, Text("")]
    if any(given.role == "torque" for given in seen.inputs):
        parts.append(Text(f"measured torque: {seen.mismatch.text}"))
    if seen.disturbance is not None:
        parts.append(Text(f"disturbance: {seen.disturbance.text}"))
    if seen.learning:
        parts.append(Text(f"learning: {seen.learning}"))
    parts.append(Text(_foot(seen), style="dim"))
    return Panel(Group(*parts), title=title, border_style=colour)


def line(seen: Overview) -> str:
    """The overview in one line."""
    if not seen.values:
        return f"{seen.level.name}: {seen.message}"
    value = seen.values
    belts = [value[f"belt_degc/{name}"] for name in seen.assemblies]
    shown = f"belts {decimals(min(belts), 1)} to {decimals(max(belts), 1)} degC  " if belts else ""
    return (
        f"{_time(seen)}  {decimals(value['speed_mps'] * KMH_PER_MPS, 1):>5} km/h  "
        f"resistance {decimals(value['resistance_torque_nm']):>6} +- {decimals(value['resistance_std_nm'])} Nm  "
        f"feed-forward {decimals(seen.feedforward_nm):>6} Nm  "
        f"{shown}{seen.level.name}: {seen.message}"
    )


def _inputs(seen: Overview) -> Group:
    parts: list[Text] = []  # other counters have a separate line: their number is unknown
    shown = Table(expand=True, box=None, pad_edge=False, header_style="dim")
    shown.add_column("input", no_wrap=True)
    shown.add_column("topic", overflow="fold", ratio=1)
    for name in ("value", "Hz", "age s", "accepted"):
        shown.add_column(name, justify="right", no_wrap=True)
    for given in seen.inputs:
        counts = dict(given.counts)
        accepted = counts.pop("accepted", 0)
        unit = ROLES[base_role(given.role)].unit
        value = "" if math.isnan(given.value) else f"{figures(given.value, 5)} {unit}".removesuffix(" 1")
        rate = "" if math.isnan(given.rate_hz) else f"{given.rate_hz:.1f}"
        shown.add_row(given.role, given.topic, value, rate, _age(given.age_s), str(accepted))
        if counts:
            listed = ", ".join(f"{name} {number}" for name, number in counts.items())
            parts.append(Text(f"  {given.role}: {listed}", style="yellow"))
    return Group(shown, *parts)


def _torques(seen: Overview) -> Table:
    shown = Table(box=None, pad_edge=False, header_style="dim")
    shown.add_column("at sprockets" if seen.assemblies else "at wheels", no_wrap=True)
    shown.add_column("Nm", justify="right", no_wrap=True)
    values, std = seen.values, seen.values["resistance_std_nm"]
    for name, column in resistance_parts(bool(seen.assemblies)).items():
        shown.add_row(f"  {name}", decimals(values[column]))
    shown.add_row("[b]resistance[/b] (sum)", f"[b]{decimals(values['resistance_torque_nm'])}[/b] +- {decimals(std)}")
    shown.add_row("grade", decimals(values["grade_nm"]))
    shown.add_row("inertia", decimals(values["inertia_nm"]))
    shown.add_row("[b]feed-forward[/b]", f"[b]{decimals(seen.feedforward_nm)}[/b]")
    return shown


def _belts(seen: Overview) -> Table:
    shown = Table(box=None, pad_edge=False, header_style="dim")
    shown.add_column("assembly", overflow="fold")
    for name in ("belt degC", "kN", "Nm"):
        shown.add_column(name, justify="right", no_wrap=True)
    for name in seen.assemblies:
        of = {column: seen.values[f"{column}/{name}"] for column in ("belt_degc", "belt_std_k", "load_n", "resistance_torque_nm")}
        belt = f"{decimals(of['belt_degc'], 1)} +- {decimals(of['belt_std_k'], 1)}"
        shown.add_row(name, belt, decimals(of["load_n"] / 1e3, 1), decimals(of["resistance_torque_nm"]))
    return shown


def _foot(seen: Overview) -> str:
    speed = f"{decimals(seen.values['speed_mps'] * KMH_PER_MPS, 1)} km/h, " if seen.values else ""
    kept = f"state in {seen.state_file}" if seen.state_file else "no state saved"
    if not math.isnan(seen.saved_s_ago):
        kept += f", saved {seen.saved_s_ago:.0f} s ago"
    return f"{_time(seen)}: {speed}age {_age(seen.age_s) or 'none'} s, {seen.steps_hz:.1f} estimates/s, {kept}"


def _time(seen: Overview) -> str:
    if seen.stamp_ns is None:
        return "no estimate yet"
    return datetime.fromtimestamp(seen.stamp_ns * 1e-9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _age(value: float) -> str:
    return (f"{value:.2f}" if value < LONG_AGE_S else f"{value:.0f}") if math.isfinite(value) else ""

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres coastdown` estimates parameters of a vehicle file from coast-downs."""

from __future__ import annotations

from pathlib import Path

import click

import trackres_ros as tr
from trackres_ros.cli.common import (
    SEEDS,
    Command,
    default_of,
    emit,
    json_option,
    method_options,
    progress,
    surroundings_option,
    topics_option,
    vehicle_option,
)
from trackres_ros.cli.partial_output import watch


@click.command("coastdown", cls=Command)
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@vehicle_option
@surroundings_option
@topics_option("which topic or column feeds which role.")
@method_options
@click.option("--seed", type=SEEDS, default=default_of(tr.coastdown, "seed"), show_default=True, help="Seed of all random draws.")
@click.option(
    "--save-vehicle",
    type=click.Path(path_type=Path),
    metavar="NEW.yaml",
    help="Vehicle file with the estimates; written only if it predicts the hold-out coast-downs better.",
)
@click.option(
    "--picture", type=click.Path(path_type=Path), metavar="P.png", help="Picture of the measured speed and of both predictions."
)
@json_option
def coastdown_command(
    recordings: tuple[Path, ...],
    vehicle: str,
    surroundings: Path | None,
    topics: str | None,
    method: str | None,
    thermal: str | None,
    seed: int,
    save_vehicle: Path | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Estimate parameters of a vehicle file, with ranges, from recordings of coast-downs.

    With a recorded torque, only stretches without torque are used; else all stretches of free deceleration. The mass is
    fixed, and all results scale with it. Without a recorded slope or altitude, coast down in both directions.

    \b
    trackres coastdown roll_1.csv roll_2.csv --vehicle xgd24d --picture rolls.png
    trackres coastdown roll.mcap --vehicle my.yaml --topics topics.yaml --save-vehicle rolled.yaml
    """
    watch(*(path for path in (save_vehicle, picture) if path))
    with progress("coast-down", None):
        found = tr.coastdown(
            recordings, vehicle, topics=topics, surroundings=surroundings, method=method, thermal=thermal, seed=seed
        )
    written = []
    if save_vehicle is not None and found.better:
        written += [str(path) for path in found.save_vehicle(save_vehicle)]
    if picture is not None:
        written.append(str(found.plot(picture)))

    def text() -> str:
        lines = [repr(found)]
        if save_vehicle is not None and not found.better:
            lines.append(f"Not written: {save_vehicle}")
        if written:
            lines.append(f"Written: {', '.join(written)}")
        return "\n".join(lines)

    emit({**found.as_dict(), "written": written}, as_json, text)

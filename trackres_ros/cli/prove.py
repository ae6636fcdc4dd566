# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`trackres prove`: the diagnosis on cases whose cause is concealed from it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import click

from trackres_ros import InputError
from trackres_ros.cli.common import emit, json_option, needs, output_folder

MINUTES = 15.0
QUICK_MINUTES = 12.0
REPORTED_SEED = 20260303
FOLLOWED, QUICK_FOLLOWED = 40, 8  # cases in which what was advised is driven
EXTRA = "proof", "numba", "matplotlib", "jinja2", "ruptures"
FOLDERS = ("cases", "results", "next", "results_next", "sealed")


folder_option = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    metavar="DIR",
    help="Folder for recordings and page.",
)


@click.group("prove", invoke_without_command=True)
@click.pass_context
@click.option("--level", "levels", multiple=True, metavar="L[=N]", help="Only this level, so many cases; may be repeated.")
@click.option("--cases", "count", type=click.IntRange(1), metavar="N", help="So many cases of each level without a number.")
@click.option("--seed", type=click.IntRange(0), default=REPORTED_SEED, show_default=True, help="Of all that is drawn.")
@click.option("--quick", is_flag=True, help="70 cases of shorter drives.")
@click.option("--fresh", is_flag=True, help="Begin anew instead of going on with what is in the folder.")
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), metavar="DIR", help="Folder for all of it.")
@json_option
def prove_command(
    context: click.Context,
    levels: tuple[str, ...],
    count: int | None,
    seed: int,
    quick: bool,
    fresh: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """How often the diagnosis is right on simulated drives, how often wrong, and how often it rightly cannot tell.

    \b
    trackres prove --quick -o proof
    trackres prove --level outside=18 --level none=6 --seed 31 -o development

    Three processes: one draws the cases, prints a hash of their labels and writes recordings; one diagnoses, given
    recordings and vehicle files and nothing else; one opens the labels and counts. An interrupted run goes on where it was.
    """
    if context.invoked_subcommand:
        return
    needs("trackres prove", *EXTRA, "sklearn", "pysindy")
    from trackres_ros.evaluation.sealed.cases import LEVELS, QUICK

    if output is None:
        raise InputError("-o", "no folder", "a folder for cases, results and scores")
    of = QUICK if quick else LEVELS
    counts = dict(_level_and_count(level, of, count) for level in (levels or of))
    output_folder(output)
    minutes = QUICK_MINUTES if quick else MINUTES
    asked = f"{seed} {minutes:g} {' '.join(f'{level}={n}' for level, n in counts.items())}"
    kept = output / "asked.txt"
    if not kept.exists() and any((output / name).exists() for name in FOLDERS):
        raise InputError("-o", str(output), f"a folder of its own; there are {', '.join(FOLDERS)} in it that are not of a proof")
    if kept.exists() and (fresh or kept.read_text(encoding="utf-8") != asked):
        for name in FOLDERS:
            shutil.rmtree(output / name, ignore_errors=True)
    kept.write_text(asked, encoding="utf-8")
    said_to = sys.stderr if as_json else None
    _process(said_to, "generate", str(output), *asked.split())
    _process(said_to, "blind", str(output / "cases"), str(output / "results"))
    _process(said_to, "follow", str(output), f"{minutes:g}", str(QUICK_FOLLOWED if quick else FOLLOWED))
    _process(said_to, "blind", str(output / "next"), str(output / "results_next"))
    _process(said_to, "score", str(output))
    if as_json:
        click.echo((output / "scores.json").read_text(encoding="utf-8"))


def _level_and_count(given: str, of: Mapping[str, int], count: int | None) -> tuple[str, int]:
    """A level, and how many cases of it: as given with it, else by `--cases`, else as many as there are in a run."""
    level, equals, number = given.partition("=")
    if level not in of or (equals and not (number.isdecimal() and int(number))):
        raise InputError("--level", given, f"{', '.join(of)}, or one of them with a number of cases, as outside=18")
    return level, int(number) if equals else count or of[level]


def _tell(path: Path, text: str, as_json: bool) -> None:
    path.write_text(text, encoding="utf-8")
    emit({"written": str(path), "text": text}, as_json, lambda: text)


def _process(said_to: IO[str] | None, module: str, *arguments: str) -> None:
    # Every core has a case of its own: threads within one would only be in each other's way.
    alone = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, "-m", f"trackres_ros.evaluation.sealed.{module}", *arguments]
    done = subprocess.run(command, env={**os.environ, **alone}, stdout=said_to, check=False)
    if done.returncode:
        raise click.ClickException(f"{module} ended with exit code {done.returncode}; what was done is kept")


@prove_command.command("real")
@click.option(
    "--data", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder with bmw_i3 and husky_warthog."
)
@folder_option
@json_option
def prove_real_command(data: Path, output: Path, as_json: bool) -> None:
    """The same on public recordings of real vehicles, with a measured channel concealed."""
    needs("trackres prove real", *EXTRA)
    from trackres_ros.evaluation.field.page import write_page
    from trackres_ros.evaluation.field.run import try_all

    output_folder(output)
    _tell(output / "proof-real.md", write_page(data, try_all(data, output), output), as_json)


@prove_command.command("paper")
@folder_option
@json_option
def prove_paper_command(output: Path, as_json: bool) -> None:
    """The paper's own test: laps of a circle on a tilted site, torque from the engine's, and what the diagnosis makes of it."""
    needs("trackres prove paper", *EXTRA)
    from trackres_ros.evaluation.paper import ask_all, page

    output_folder(output)
    _tell(output / "paper-test.md", page(ask_all(output)), as_json)


@prove_command.command("loop")
@folder_option
@json_option
def prove_loop_command(output: Path, as_json: bool) -> None:
    """The feed-forward of the vehicle file that a diagnosis leaves, on a drive that it never saw."""
    needs("trackres prove loop", *EXTRA)
    from trackres_ros.evaluation.closed_loop import close_loop, draw, page

    output_folder(output)
    closed = close_loop(output)
    draw(closed, output / "loop.png")
    _tell(output / "loop.md", page(closed, "loop.png"), as_json)

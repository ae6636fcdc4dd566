# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres prove`: the diagnosis on cases with a concealed cause."""

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
from trackres_ros.cli.common import SEEDS, Commands, emit, folder_option, json_option, needs, number, output_folder, whole

MINUTES = 15.0
QUICK_MINUTES = 12.0
REPORTED_SEED = 20261124
FOLLOWED, QUICK_FOLLOWED = 40, 8  # cases in which the advised manoeuvre is driven
EXTRA = "proof", "numba", "matplotlib", "jinja2", "ruptures"
FOLDERS = ("cases", "results", "results_earlier", "next", "results_next", "sealed")


into_folder = folder_option("Folder for recordings and page.")


@click.group("prove", cls=Commands, invoke_without_command=True)
@click.pass_context
@click.option("--level", "levels", multiple=True, metavar="L[=N]", help="Only N cases of this level; may be repeated.")
@click.option("--cases", "count", type=whole(1, 100_000), metavar="N", help="Number of cases of each level given without one.")
@click.option("--seed", type=SEEDS, default=REPORTED_SEED, show_default=True, help="Seed of all random draws.")
@click.option("--quick", is_flag=True, help="Run 81 cases of shorter drives.")
@click.option("--first", type=whole(1, 100_000), metavar="N", help="Diagnose and score N of the sealed cases, by drawn names.")
@click.option(
    "--earlier",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="CHECKOUT",
    help="Have an earlier version of this tool diagnose the same cases.",
)
@click.option(
    "--profiles",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Folder with bmw_i3 or ztbus: some vehicles drive with the speeds recorded there.",
)
@click.option("--fresh", is_flag=True, help="Start over instead of continuing with the results in the folder.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Folder for all results.",
)
@json_option
def prove_command(
    context: click.Context,
    levels: tuple[str, ...],
    count: int | None,
    seed: int,
    quick: bool,
    first: int | None,
    earlier: Path | None,
    profiles: Path | None,
    fresh: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """Count right, wrong and rightly empty diagnoses on simulated drives.

    \b
    trackres prove --quick -o proof
    trackres prove --level outside=18 --level none=6 --seed 31 -o development

    Separate processes do the work: one draws the cases, prints a hash of their labels and writes recordings; one
    diagnoses them from recordings and vehicle files only; one simulates the advised manoeuvres;
    the last opens the labels and counts. An interrupted run continues where it stopped.
    """
    if context.invoked_subcommand:
        return
    needs("trackres prove", *EXTRA, "sklearn", "pysindy")
    from trackres_ros.evaluation.sealed.cases import LEVELS, QUICK
    from trackres_ros.evaluation.sealed.profiles import profile_files

    if profiles is not None:
        profile_files(profiles)
    if output is None:
        raise InputError("-o", "no folder", "a folder for cases, results and scores")
    of = QUICK if quick else LEVELS
    counts = dict(_level_and_count(level, of, count) for level in (levels or of))
    output_folder(output)
    minutes = QUICK_MINUTES if quick else MINUTES
    drawn_by = [str(seed), f"{minutes:g}", *(f"{level}={n}" for level, n in counts.items())]
    drawn_by += [f"profiles={profiles.resolve()}"] if profiles else []
    settings = " ".join(drawn_by)
    settings_file = output / "asked.txt"
    if not settings_file.exists() and any((output / name).exists() for name in FOLDERS):
        raise InputError("-o", str(output), f"its own folder; this one has {', '.join(FOLDERS)} that belong to no proof")
    if settings_file.exists() and (fresh or settings_file.read_text(encoding="utf-8") != settings):
        for name in FOLDERS:
            shutil.rmtree(output / name, ignore_errors=True)
    settings_file.write_text(settings, encoding="utf-8")
    stream = sys.stderr if as_json else None
    _process(stream, "generate", str(output), *drawn_by)
    so_many = [] if first is None else [str(first)]
    _process(stream, "blind", str(output / "cases"), str(output / "results"), *so_many)
    if earlier is not None:
        _process(stream, "earlier", str(output / "cases"), str(output / "results_earlier"), str(earlier), *so_many)
    _process(stream, "follow", str(output), f"{minutes:g}", str(QUICK_FOLLOWED if quick else FOLLOWED), *so_many)
    _process(stream, "blind", str(output / "next"), str(output / "results_next"))
    _process(stream, "score", str(output), *so_many)
    if as_json:
        click.echo((output / "scores.json").read_text(encoding="utf-8"))


def _level_and_count(given: str, of: Mapping[str, int], count: int | None) -> tuple[str, int]:
    """A level and its number of cases: the one given with it, else that of `--cases`, else that of a whole run."""
    level, equals, number = given.partition("=")
    if level not in of or (equals and not (number.isdecimal() and int(number))):
        raise InputError("--level", given, f"{', '.join(of)}, or one of them with a number of cases, as outside=18")
    return level, int(number) if equals else count or of[level]


def _write_and_print(path: Path, text: str, as_json: bool) -> None:
    path.write_text(text, encoding="utf-8")
    emit({"written": str(path), "text": text}, as_json, lambda: text)


def _process(stream: IO[str] | None, module: str, *arguments: str, room: str = "sealed") -> None:
    # Every core works on a case of its own: threads within a case would only compete for cores.
    alone = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, "-m", f"trackres_ros.evaluation.{room}.{module}", *arguments]
    done = subprocess.run(command, env={**os.environ, **alone}, stdout=stream, check=False)
    if done.returncode:
        raise click.ClickException(f"{module} ended with exit code {done.returncode}; finished results are kept")


@prove_command.command("second")
@click.argument("cases", type=click.Path(path_type=Path, file_okay=False))
@click.option("--first", type=whole(1, 100_000), metavar="N", help="Diagnose and score only N of the cases.")
@into_folder
@json_option
def prove_second_command(cases: Path, first: int | None, output: Path, as_json: bool) -> None:
    """Diagnose and score cases from another simulator, with the same scores as the project's own.

    CASES holds labels.json, cases/NAME/session1.csv and so on; a case without a vehicle.yaml uses the vehicle xgd24d. The
    diagnosis runs in a process that sees only the recordings. An interrupted run continues where it stopped.
    """
    needs("trackres prove second", *EXTRA, "sklearn", "pysindy")
    from trackres_ros.evaluation.sealed.second import read_labels

    read_labels(cases)
    output_folder(output)
    asked, settings = output / "asked.txt", f"second {cases.resolve()}"
    if any(output.iterdir()) and (not asked.exists() or asked.read_text(encoding="utf-8") != settings):
        raise InputError("-o", str(output), "an empty folder, or one of a run with the same cases")
    asked.write_text(settings, encoding="utf-8")
    stream, so_many = sys.stderr if as_json else None, [] if first is None else [str(first)]
    _process(stream, "blind", str(cases / "cases"), str(output / "results"), *so_many)
    _process(stream, "second", str(cases), str(output), *so_many)
    if as_json:
        click.echo((output / "scores.json").read_text(encoding="utf-8"))


@prove_command.command("real")
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    required=True,
    metavar="DIR",
    help="Folder with any of bmw_i3, husky_warthog and ztbus.",
)
@into_folder
@json_option
def prove_real_command(data: Path, output: Path, as_json: bool) -> None:
    """Diagnose public recordings of real vehicles, with a measured channel concealed."""
    needs("trackres prove real", *EXTRA)
    from trackres_ros.evaluation.field.bus import try_bus
    from trackres_ros.evaluation.field.page import write_page
    from trackres_ros.evaluation.field.run import try_all

    output_folder(output)
    _write_and_print(output / "proof-real.md", write_page(data, try_all(data, output), try_bus(data), output), as_json)


@prove_command.command("learning")
@click.option("--seed", type=SEEDS, default=REPORTED_SEED, show_default=True, help="Seed of all random draws.")
@click.option("--vehicles", type=whole(0, 10_000), default=60, show_default=True, help="Number of vehicles with wrong files.")
@click.option(
    "--hostile", type=whole(0, 10_000), default=40, show_default=True, help="Number of vehicles with misleading disturbances."
)
@click.option("--first", type=whole(1, 100_000), metavar="N", help="Only N of the sealed vehicles, by drawn names.")
@click.option("--hours", type=number(0.0, 1e6), default=200.0, show_default=True, help="Hours of an ageing run; 0: none.")
@into_folder
@json_option
def prove_learning_command(
    seed: int, vehicles: int, hostile: int, first: int | None, hours: float, output: Path, as_json: bool
) -> None:
    """Learn vehicles with wrong files while driving, and compare with re-fits and the truth.

    One process draws and seals the recordings, a second learns from them alone, and a third scores the result.
    A folder serves one seed and one number of cases; an interrupted run continues where it stopped.
    """
    needs("trackres prove learning", *EXTRA)
    output_folder(output)
    stream = sys.stderr if as_json else None
    settings = f"learning {seed} {vehicles} {hostile}"
    settings_file = output / "asked.txt"
    if (settings_file.exists() and settings_file.read_text(encoding="utf-8") != settings) or (
        not settings_file.exists() and any((output / name).exists() for name in FOLDERS)
    ):
        raise InputError("-o", str(output), "a folder of its own for each seed and number of cases")
    settings_file.write_text(settings, encoding="utf-8")
    so_many = [] if first is None else [str(first)]
    _process(stream, "generate", str(output), str(seed), f"{MINUTES:g}", str(vehicles), str(hostile), *so_many, room="learned")
    _process(stream, "blind", str(output), *so_many, room="learned")
    _process(stream, "score", str(output), f"{hours:g}", room="learned")
    if as_json:
        click.echo((output / "scores.json").read_text(encoding="utf-8"))


@prove_command.command("delay")
@click.option("--seed", type=SEEDS, default=REPORTED_SEED, show_default=True, help="Seed of all random draws.")
@click.option(
    "--vehicles",
    type=whole(0, 10_000),
    default=100,
    show_default=True,
    help="Number of vehicles without misleading disturbances.",
)
@click.option(
    "--hostile", type=whole(0, 10_000), default=40, show_default=True, help="Number of vehicles with misleading disturbances."
)
@click.option("--minutes", type=number(1.0, 600.0), default=10.0, show_default=True, help="Length of a drive.")
@into_folder
@json_option
def prove_delay_command(seed: int, vehicles: int, hostile: int, minutes: float, output: Path, as_json: bool) -> None:
    """Learn the concealed delay of the torque behind the speed.

    One process draws, seals and records; a second learns from the recordings alone; the last opens the seal and compares.
    """
    needs("trackres prove delay", *EXTRA)
    output_folder(output)
    asked, settings = output / "asked.txt", f"delay {seed} {vehicles} {hostile} {minutes:g}"
    if any(output.iterdir()) and (not asked.exists() or asked.read_text(encoding="utf-8") != settings):
        raise InputError("-o", str(output), "an empty folder, or one of a run with the same options")
    asked.write_text(settings, encoding="utf-8")
    stream = sys.stderr if as_json else None
    drawn_by = [str(seed), f"{minutes:g}", str(vehicles), str(hostile)]
    _process(stream, "delay", "generate", str(output), *drawn_by, room="learned")
    _process(stream, "delay", "find", str(output), room="learned")
    _process(stream, "delay", "score", str(output), room="learned")
    if as_json:
        click.echo((output / "scores.json").read_text(encoding="utf-8"))


@prove_command.command("paper")
@into_folder
@json_option
def prove_paper_command(output: Path, as_json: bool) -> None:
    """Diagnose the paper's own test: circular laps on a tilted site, with torque computed from the engine torque."""
    needs("trackres prove paper", *EXTRA)
    from trackres_ros.evaluation.paper import diagnose_all, page

    output_folder(output)
    _write_and_print(output / "paper-test.md", page(diagnose_all(output)), as_json)


@prove_command.command("loop")
@into_folder
@json_option
def prove_loop_command(output: Path, as_json: bool) -> None:
    """Compare the feed-forward before and after a diagnosis, on an unused drive."""
    needs("trackres prove loop", *EXTRA)
    from trackres_ros.evaluation.closed_loop import close_loop, draw, page

    output_folder(output)
    loop = close_loop(output)
    draw(loop, output / "loop.png")
    _write_and_print(output / "loop.md", page(loop, "loop.png"), as_json)


@prove_command.command("fleet")
@click.option("--vehicles", type=whole(2, 10_000), default=24, show_default=True, help="How many; half of them change.")
@click.option("--days", type=whole(3, 3650), default=75, show_default=True, help="Over how many days they drive.")
@click.option("--every", type=number(0.1, 365.0), default=3.0, show_default=True, help="Days between recordings of a vehicle.")
@click.option("--minutes", type=number(3.0, 600.0), default=10.0, show_default=True, help="Length of a recording.")
@click.option("--seed", type=SEEDS, default=REPORTED_SEED, show_default=True, help="Seed of all random draws.")
@into_folder
@json_option
def prove_fleet_command(vehicles: int, days: int, every: float, minutes: float, seed: int, output: Path, as_json: bool) -> None:
    """Count found changes in a simulated fleet, their delay and the false alarms.

    One process draws, seals and records; trackres fleet sees recordings and fleet.yaml; the last opens the seal and counts.
    """
    needs("trackres prove fleet", "fleet", "distributed", "pyarrow", "fsspec", "jinja2")
    output_folder(output)
    asked, settings = output / "asked.txt", f"fleet {seed} {vehicles} {days} {every:g} {minutes:g}"
    if any(output.iterdir()) and (not asked.exists() or asked.read_text(encoding="utf-8") != settings):
        raise InputError("-o", str(output), "an empty folder, or one of a run with the same options")
    asked.write_text(settings, encoding="utf-8")
    stream = sys.stderr if as_json else None
    _process(stream, "prove", "generate", str(output), *settings.split()[1:], room="fleet")
    with (output / "found.json").open("w", encoding="utf-8") as into:
        words = ["fleet", str(output / "fleet" / "recordings"), "--vehicles", str(output / "fleet" / "fleet.yaml")]
        words += ["--period", "none", "-o", str(output / "results"), "--json"]
        done = subprocess.run([sys.executable, "-m", "trackres_ros", *words], stdout=into, check=False)
    if done.returncode:
        raise click.ClickException(f"trackres fleet ended with exit code {done.returncode}; finished results are kept")
    _process(stream, "prove", "score", str(output), room="fleet")
    if as_json:
        click.echo((output / "scores.json").read_text(encoding="utf-8"))

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The commands of `python -m proofs`, one for each proof, and one that draws the paper's figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from trackres_ros import InputError
from trackres_ros.tasks import options
from trackres_ros.tasks.main import SETTINGS
from trackres_ros.tasks.terminal import Commands, emit, needs, output_folder, progress, watch

if TYPE_CHECKING:
    from proofs.tables import Tables

COUNT = click.IntRange(1, 100_000)
MINUTES = 15.0
QUICK_MINUTES = 12.0
REPORTED_SEED = 20261124
GROOMERS = 6  # of each kind
FOLLOWED, QUICK_FOLLOWED = 40, 8  # cases in which the advised manoeuvre is driven
EXTRA = "proof", "matplotlib", "jinja2"
LEARNERS = "proof", "sklearn", "pysindy"
DIAGNOSIS = "sealed.diagnosing.answer"

hostile_option = click.option(
    "--hostile", type=click.IntRange(0, 10_000), default=40, help="Number of vehicles with misleading disturbances."
)
first_option = click.option("--first", type=COUNT, metavar="N", help="Record, diagnose and score only N of the cases.")
into_folder = options.folder("Folder for recordings and page.")


@click.group(cls=Commands, context_settings=SETTINGS)
def proofs() -> None:
    """Count how often the tool is right, wrong or silent where the truth is known.

    They run in a checkout: nothing of them is installed with the package.
    """


@proofs.command("own")
@click.option("--level", "levels", multiple=True, metavar="L[=N]", help="Only N cases of this level; may be repeated.")
@click.option("--cases", "count", type=COUNT, metavar="N", help="Number of cases of each level given without one.")
@options.seed(REPORTED_SEED)
@click.option("--quick", is_flag=True, help="Run 81 cases of shorter drives.")
@first_option
@click.option(
    "--earlier", type=options.FOLDER, metavar="CHECKOUT", help="Have an earlier version of this tool diagnose the same cases."
)
@click.option(
    "--profiles",
    type=options.FOLDER,
    metavar="DIR",
    help="Folder with bmw_i3 or ztbus: some vehicles drive with the speeds recorded there.",
)
@click.option("--fresh", is_flag=True, help="Start over instead of continuing with the results in the folder.")
@into_folder
@options.json
def own_command(
    levels: tuple[str, ...],
    count: int | None,
    seed: int,
    quick: bool,
    first: int | None,
    earlier: Path | None,
    profiles: Path | None,
    fresh: bool,
    output: Path,
    as_json: bool,
) -> None:
    """Count right, wrong and rightly empty diagnoses on simulated drives.

    \b
    python -m proofs own --quick -o proof
    python -m proofs own --level outside=18 --level none=6 --seed 31 -o development

    Separate processes do the work: one draws the cases, prints a hash of their labels and writes recordings; one
    diagnoses them from recordings and vehicle files only; one simulates the advised manoeuvres;
    the last opens the labels and counts. An interrupted run continues where it stopped.
    """
    needs("python -m proofs own", *LEARNERS)
    from proofs.pipeline import prove
    from proofs.sealed.cases import LEVELS, QUICK
    from proofs.sealed.drives import profile_files

    if profiles is not None:
        profile_files(profiles)
    numbers = QUICK if quick else LEVELS
    settings = {
        "seed": seed,
        "minutes": QUICK_MINUTES if quick else MINUTES,
        "counts": _counts("--level", levels, numbers, count),
        "profiles": profiles and str(profiles.resolve()),
        "followed": QUICK_FOLLOWED if quick else FOLLOWED,
    }
    cases, following = output / "cases", ("pipeline.answer", DIAGNOSIS, output / "next", output / "results_next")
    diagnosis = "pipeline.answer", DIAGNOSIS, cases, output / "results", first
    by_earlier = [("sealed.own.earlier", cases, output / "results_earlier", earlier, first)] if earlier else []
    steps = diagnosis, *by_earlier, ("sealed.own.follow", output, first), following
    prove("own", output, settings, *steps, first=first, fresh=fresh, as_json=as_json)


def _counts(option: str, words: Iterable[str], numbers: Mapping[str, int], count: int | None) -> dict[str, int]:
    """Number of cases of each kind: the one in its word, else that of `--cases`, else that of a whole run."""
    counts = {}
    for word in words or numbers:
        kind, equals, number = word.partition("=")
        if kind not in numbers or (equals and not (number.isdecimal() and int(number))):
            allowed = f"{', '.join(numbers)}, or one of them with a number of cases, as {list(numbers)[-1]}=18"
            raise InputError(option, word, allowed)
        counts[kind] = int(number) if equals else count or numbers[kind]
    return counts


def _finish(output: Path, tables: Tables, as_json: bool) -> None:
    """Write the tables of a run, and print them."""
    from proofs.tables import FOLDER, shown, write_tables

    write_tables(output / FOLDER, tables)
    emit({name: [dict(row) for row in rows] for name, rows in tables.items()}, as_json, lambda: shown(tables))


@proofs.command("second")
@click.argument("cases", type=options.FOLDER)
@first_option
@into_folder
@options.json
def second_command(cases: Path, first: int | None, output: Path, as_json: bool) -> None:
    """Diagnose and score cases from another simulator, with the same scores as the project's own.

    CASES holds labels.json, cases/NAME/session1.csv and so on; a case without a vehicle.yaml uses the vehicle xgd24d. The
    diagnosis runs in a process that sees only the recordings. An interrupted run continues where it stopped.
    """
    needs("python -m proofs second", *LEARNERS)
    from proofs.pipeline import prove
    from proofs.sealed.second import read_labels

    read_labels(cases)
    diagnosis = "pipeline.answer", DIAGNOSIS, cases / "cases", output / "results", first
    prove("second", output, {"source": str(cases.resolve())}, diagnosis, first=first, as_json=as_json)


@proofs.command("groomer")
@click.option("--hide", "kinds", multiple=True, metavar="KIND[=N]", help="Only N cases of this kind; may be repeated.")
@click.option("--cases", "count", type=COUNT, default=GROOMERS, metavar="N", help="Cases of each kind given without a number.")
@options.seed(REPORTED_SEED)
@first_option
@into_folder
@options.json
def groomer_command(kinds: tuple[str, ...], count: int, seed: int, first: int | None, output: Path, as_json: bool) -> None:
    """Diagnose and score drives of a snow groomer: another vehicle, another simulator, slow physics.

    \b
    none  nothing is hidden
    cold  a drag below an air temperature
    cool  a drag that grows below an air temperature
    load  a drag above 9.6 t
    late  a drag from 15 minutes after the start

    One process draws, seals and records; the diagnosis sees recordings, topics file and vehicle file; the last opens the
    labels and counts. An interrupted run continues where it stopped.
    """
    needs("python -m proofs groomer", *LEARNERS)
    from proofs.pipeline import prove
    from proofs.sealed.groomer import KINDS

    settings = {"seed": seed, "counts": _counts("--hide", kinds, dict.fromkeys(KINDS, count), None)}
    diagnosis = "pipeline.answer", DIAGNOSIS, output / "cases", output / "results", first
    prove("groomer", output, settings, diagnosis, first=first, as_json=as_json)


@proofs.command("real")
@click.option(
    "--data", type=options.PATH, required=True, metavar="DIR", help="Folder with any of bmw_i3, husky_warthog and ztbus."
)
@into_folder
@options.json
def real_command(data: Path, output: Path, as_json: bool) -> None:
    """Diagnose public recordings of real vehicles, with a measured channel concealed."""
    needs("python -m proofs real", *EXTRA)
    from proofs.field.results import tables_of
    from proofs.field.trials import try_all, try_bus

    output_folder(output)
    _finish(output, tables_of(data, try_all(data, output), try_bus(data)), as_json)


@proofs.command("emps")
@click.argument("recording", type=options.PATH)
@into_folder
@options.json
def emps_command(recording: Path, output: Path, as_json: bool) -> None:
    """Diagnose a carriage on a ball screw, whose missing friction is published; RECORDING is emps.csv.gz."""
    from proofs.field.emps import tables_of, try_slide

    _finish(output, tables_of(try_slide(recording, output_folder(output))), as_json)


@proofs.command("learning")
@options.seed(REPORTED_SEED)
@click.option("--vehicles", type=click.IntRange(0, 10_000), default=60, help="Number of vehicles with wrong files.")
@hostile_option
@first_option
@click.option("--hours", type=options.Number(0.0, 1e6), default=200.0, help="Hours of an ageing run; 0: none.")
@into_folder
@options.json
def learning_command(
    seed: int, vehicles: int, hostile: int, first: int | None, hours: float, output: Path, as_json: bool
) -> None:
    """Learn vehicles with wrong files while driving, and compare with re-fits and the truth.

    One process draws and seals the recordings, a second learns from them alone, and a third scores the result.
    A folder serves one seed and one number of cases; an interrupted run continues where it stopped.
    """
    needs("python -m proofs learning", *EXTRA)
    from proofs.pipeline import prove

    settings = {"seed": seed, "minutes": MINUTES, "vehicles": vehicles, "hostile": hostile}
    learning = "pipeline.answer", "learning.learn_and_fit", output / "cases", output / "results", first
    prove("learning", output, settings, learning, ("learning.grow_old", output, hours), first=first, as_json=as_json)


@proofs.command("delay")
@options.seed(REPORTED_SEED)
@click.option(
    "--vehicles", type=click.IntRange(0, 10_000), default=100, help="Number of vehicles without misleading disturbances."
)
@hostile_option
@click.option("--minutes", type=options.Number(1.0, 600.0), default=10.0, help="Length of a drive.")
@into_folder
@options.json
def delay_command(seed: int, vehicles: int, hostile: int, minutes: float, output: Path, as_json: bool) -> None:
    """Learn the concealed delay of the torque behind the speed.

    One process draws, seals and records; a second learns from the recordings alone; the last opens the seal and compares.
    """
    needs("python -m proofs delay", *EXTRA)
    from proofs.pipeline import prove

    settings = {"seed": seed, "minutes": minutes, "vehicles": vehicles, "hostile": hostile}
    prove("delay", output, settings, ("pipeline.answer", "delay.learn", output / "cases", output / "results"), as_json=as_json)


@proofs.command("paper")
@into_folder
@options.json
def paper_command(output: Path, as_json: bool) -> None:
    """Diagnose the paper's own test: circular laps on a tilted site, with torque computed from the engine torque."""
    from proofs.unsealed import diagnose_all, paper_tables

    _finish(output, paper_tables(diagnose_all(output_folder(output))), as_json)


@proofs.command("loop")
@into_folder
@options.json
def loop_command(output: Path, as_json: bool) -> None:
    """Compare the feed-forward before and after a diagnosis, on an unused drive."""
    needs("python -m proofs loop", *EXTRA)
    from proofs.tables import FOLDER
    from proofs.unsealed import close_loop, draw_loop, loop_tables

    loop = close_loop(output_folder(output))
    draw_loop(loop, output_folder(output / FOLDER) / "loop.png")
    _finish(output, loop_tables(loop), as_json)


@proofs.command("fleet")
@click.option("--vehicles", type=click.IntRange(2, 10_000), default=24, help="How many; half of them change.")
@click.option("--days", type=click.IntRange(3, 3650), default=75, help="Over how many days they drive.")
@click.option("--every", type=options.Number(0.1, 365.0), default=3.0, help="Days between recordings of a vehicle.")
@click.option("--minutes", type=options.Number(3.0, 600.0), default=10.0, help="Length of a recording.")
@options.seed(REPORTED_SEED)
@into_folder
@options.json
def fleet_command(vehicles: int, days: int, every: float, minutes: float, seed: int, output: Path, as_json: bool) -> None:
    """Count found changes in a simulated fleet, their delay and the false alarms.

    One process draws, seals and records; trackres fleet sees recordings and fleet.yaml; the last opens the seal and counts.
    """
    needs("python -m proofs fleet", "fleet", "distributed", "pyarrow", "fsspec", "jinja2")
    from proofs.pipeline import prove

    settings = {"seed": seed, "vehicles": vehicles, "days": days, "every": every, "minutes": minutes}
    prove("fleet", output, settings, ("fleet.analyse", output), as_json=as_json)


@proofs.command("reproduce")
@click.option("-o", "--output", type=options.FOLDER, required=True, help="Folder for pictures, tables and the page.")
@click.option(
    "--page", type=click.Path(path_type=Path, dir_okay=False), help="Write the page here, not to index.md in the folder."
)
@options.json
def reproduce_command(output: Path, page: Path | None, as_json: bool) -> None:
    """Reproduce the paper's Figures 6, 10, 11, 16, 24, 25, 26 and three tests, as PNG and CSV, with a page of checks.

    \b
    python -m proofs reproduce -o figures
    """
    needs("pictures", "plots", "matplotlib")
    from proofs.reproduce import reproduce

    if page is not None and not page.parent.is_dir():
        raise InputError("--page", str(page), "a file in a folder that exists")
    output_folder(output)
    watch(page)
    with progress("figures", 1.0) as advance:
        done = 0.0

        def report(_: str, share: float) -> None:
            nonlocal done
            advance(share - done)
            done = share

        summary: dict[str, Any] = reproduce(output, report, page=page)
    emit(summary, as_json, lambda: f"Figures and tables are in {output}, the page is {page or output / 'index.md'}")

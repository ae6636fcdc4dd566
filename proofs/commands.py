# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The commands of `python -m proofs`, one for each proof, and one that draws the paper's figures."""

import os
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from trackres_ros.errors import InputError
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.interpreter import python
from trackres_ros.files.own_files import write
from trackres_ros.tasks import options
from trackres_ros.tasks.main import SETTINGS
from trackres_ros.tasks.terminal import Commands, emit, needs, output_folder, progress, watch

COUNT = click.IntRange(1, 100_000)
MINUTES = 15.0
QUICK_MINUTES = 12.0
REPORTED_SEED = 20261124
GROOMERS = 6  # of each kind
FOLLOWED, QUICK_FOLLOWED = 40, 8  # cases in which the advised manoeuvre is driven
EXTRA = "proof", "matplotlib", "jinja2"
SAME_OPTIONS = "an empty folder, or one of a run with the same options"
FOLDERS = ("cases", "results", "results_earlier", "next", "results_next", "sealed")

hostile_option = click.option(
    "--hostile", type=click.IntRange(0, 10_000), default=40, help="Number of vehicles with misleading disturbances."
)
into_folder = options.folder("Folder for recordings and page.")
Step = tuple[object, ...]
"""A function of `proofs`, and its arguments."""


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
@click.option("--first", type=COUNT, metavar="N", help="Diagnose and score N of the sealed cases, by drawn names.")
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
@click.option("-o", "--output", type=options.FOLDER, metavar="DIR", help="Folder for all results.")
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
    output: Path | None,
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
    needs("python -m proofs own", *EXTRA, "sklearn", "pysindy")
    from proofs.sealed.cases import LEVELS, QUICK
    from proofs.sealed.profiles import profile_files

    if profiles is not None:
        profile_files(profiles)
    if output is None:
        raise InputError("-o", "no folder", "a folder for cases, results and scores")
    of = QUICK if quick else LEVELS
    counts = dict(_kind_and_count("--level", level, of, count) for level in (levels or of))
    output_folder(output)
    minutes = QUICK_MINUTES if quick else MINUTES
    drawn_by = [str(seed), f"{minutes:g}", *(f"{level}={n}" for level, n in counts.items())]
    drawn_by += [f"profiles={profiles.resolve()}"] if profiles else []
    settings = " ".join(drawn_by)
    settings_file = output / "asked.txt"
    if not settings_file.exists() and any((output / name).exists() for name in FOLDERS):
        raise InputError("-o", str(output), f"its own folder; this one has {', '.join(FOLDERS)} that belong to no proof")
    if settings_file.exists() and (fresh or settings_file.read_text(encoding="utf-8") != settings):
        import shutil

        for name in FOLDERS:
            shutil.rmtree(output / name, ignore_errors=True)
    settings_file.write_text(settings, encoding="utf-8")
    cases, so_many = output / "cases", () if first is None else (first,)
    steps: list[Step] = [("sealed.generate.main", output, *drawn_by), ("sealed.blind.main", cases, output / "results", *so_many)]
    if earlier is not None:
        steps.append(("sealed.earlier.main", cases, output / "results_earlier", earlier, *so_many))
    steps.append(("sealed.follow.main", output, f"{minutes:g}", QUICK_FOLLOWED if quick else FOLLOWED, *so_many))
    steps.append(("sealed.blind.main", output / "next", output / "results_next"))
    _score(output, as_json, *steps, ("sealed.score.main", output, *so_many))


def _kind_and_count(option: str, given: str, of: Mapping[str, int], count: int | None) -> tuple[str, int]:
    """A kind of cases and their number: the one given with it, else that of `--cases`, else that of a whole run."""
    kind, equals, number = given.partition("=")
    if kind not in of or (equals and not (number.isdecimal() and int(number))):
        raise InputError(option, given, f"{', '.join(of)}, or one of them with a number of cases, as {list(of)[-1]}=18")
    return kind, int(number) if equals else count or of[kind]


def _print(path: Path, text: str, as_json: bool) -> None:
    """Print a page that was written."""
    emit({"written": str(path), "text": text}, as_json, lambda: text)


def _settle(output: Path, settings: str, allowed: str, used: Iterable[str] = ()) -> None:
    """Make the folder of a run, and note its settings; refuse a folder with results of others."""
    output_folder(output)
    asked = output / "asked.txt"
    others = any((output / name).exists() for name in used) if used else any(output.iterdir())
    same = asked.read_text(encoding="utf-8") == settings if asked.exists() else not others
    if not same:
        raise InputError("-o", str(output), allowed)
    asked.write_text(settings, encoding="utf-8")


def _score(output: Path, as_json: bool, *steps: Step) -> None:
    """Run some steps, the last of which writes the scores; print these with `--json`."""
    for step in steps:
        _process(as_json, step)
    if as_json:
        click.echo((output / "scores.json").read_text(encoding="utf-8"))


def _process(as_json: bool, step: Step) -> None:
    """Run a step in a process of its own."""
    # Every core works on a case of its own: threads within a case would only compete for cores.
    alone = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    name, *words = map(str, step)
    started = python("proofs.processes", name, *words, **alone)
    _run(name.split(".")[-2], **started, stdout=sys.stderr if as_json else None)


def _run(name: str, **how: Any) -> None:
    """Run a process that ends with this one, and all that it starts too.

    `name`: for messages; `how`: for `subprocess.Popen`.
    """
    import signal
    import subprocess

    running = subprocess.Popen(**how, process_group=0)
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        code = running.wait()
    except BaseException:
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGTERM)
        running.wait()
        raise
    finally:
        signal.signal(signal.SIGTERM, before)
    if code:
        raise click.ClickException(f"{name} ended with exit code {code}; finished results are kept")


@proofs.command("second")
@click.argument("cases", type=options.FOLDER)
@click.option("--first", type=COUNT, metavar="N", help="Diagnose and score only N of the cases.")
@into_folder
@options.json
def second_command(cases: Path, first: int | None, output: Path, as_json: bool) -> None:
    """Diagnose and score cases from another simulator, with the same scores as the project's own.

    CASES holds labels.json, cases/NAME/session1.csv and so on; a case without a vehicle.yaml uses the vehicle xgd24d. The
    diagnosis runs in a process that sees only the recordings. An interrupted run continues where it stopped.
    """
    needs("python -m proofs second", *EXTRA, "sklearn", "pysindy")
    from proofs.sealed.second import read_labels

    read_labels(cases)
    _settle(output, f"second {cases.resolve()}", "an empty folder, or one of a run with the same cases")
    so_many = () if first is None else (first,)
    blind = ("sealed.blind.main", cases / "cases", output / "results", *so_many)
    _score(output, as_json, blind, ("sealed.second.main", cases, output, *so_many))


@proofs.command("groomer")
@click.option("--hide", "kinds", multiple=True, metavar="KIND[=N]", help="Only N cases of this kind; may be repeated.")
@click.option("--cases", "count", type=COUNT, default=GROOMERS, metavar="N", help="Cases of each kind given without a number.")
@options.seed(REPORTED_SEED)
@click.option("--first", type=COUNT, metavar="N", help="Diagnose and score only N of the cases.")
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
    needs("python -m proofs groomer", *EXTRA, "sklearn", "pysindy")
    from proofs.sealed.groomer_cases import KINDS

    counts = [_kind_and_count("--hide", kind, dict.fromkeys(KINDS, count), None) for kind in (kinds or KINDS)]
    drawn_by = [str(seed), *(f"{kind}={n}" for kind, n in dict(counts).items())]
    _settle(output, f"groomer {' '.join(drawn_by)}", SAME_OPTIONS)
    so_many = () if first is None else (first,)
    blind = ("sealed.blind.main", output / "cases", output / "results", *so_many)
    generate = ("sealed.groomer_cases.main", output, *drawn_by)
    _score(output, as_json, generate, blind, ("sealed.second.main", output, output, *so_many))


@proofs.command("real")
@click.option(
    "--data", type=options.PATH, required=True, metavar="DIR", help="Folder with any of bmw_i3, husky_warthog and ztbus."
)
@into_folder
@options.json
def real_command(data: Path, output: Path, as_json: bool) -> None:
    """Diagnose public recordings of real vehicles, with a measured channel concealed."""
    needs("python -m proofs real", *EXTRA)
    from proofs.field.bus import try_bus
    from proofs.field.page import write_page
    from proofs.field.run import try_all

    output_folder(output)
    tried = try_all(data, output), try_bus(data)
    with file_set():
        text = write_page(data, *tried, output)
        write(output / "proof-real.md", text.encode())
    _print(output / "proof-real.md", text, as_json)


@proofs.command("learning")
@options.seed(REPORTED_SEED)
@click.option("--vehicles", type=click.IntRange(0, 10_000), default=60, help="Number of vehicles with wrong files.")
@hostile_option
@click.option("--first", type=COUNT, metavar="N", help="Only N of the sealed vehicles, by drawn names.")
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
    allowed = "a folder of its own for each seed and number of cases"
    _settle(output, f"learning {seed} {vehicles} {hostile}", allowed, FOLDERS)
    so_many = () if first is None else (first,)
    generate = ("learned.generate.main", output, seed, f"{MINUTES:g}", vehicles, hostile, *so_many)
    _score(output, as_json, generate, ("learned.blind.main", output, *so_many), ("learned.score.main", output, f"{hours:g}"))


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
    _settle(output, f"delay {seed} {vehicles} {hostile} {minutes:g}", SAME_OPTIONS)
    generate = ("learned.delay.generate", output, seed, f"{minutes:g}", vehicles, hostile)
    _score(output, as_json, generate, ("learned.delay.find", output), ("learned.delay.score", output))


@proofs.command("paper")
@into_folder
@options.json
def paper_command(output: Path, as_json: bool) -> None:
    """Diagnose the paper's own test: circular laps on a tilted site, with torque computed from the engine torque."""
    needs("python -m proofs paper", *EXTRA)
    from proofs.paper import diagnose_all, page

    output_folder(output)
    text = page(diagnose_all(output))
    write(output / "paper-test.md", text.encode())
    _print(output / "paper-test.md", text, as_json)


@proofs.command("loop")
@into_folder
@options.json
def loop_command(output: Path, as_json: bool) -> None:
    """Compare the feed-forward before and after a diagnosis, on an unused drive."""
    needs("python -m proofs loop", *EXTRA)
    from proofs.closed_loop import close_loop, draw, page

    output_folder(output)
    loop = close_loop(output)
    with file_set():
        draw(loop, output / "loop.png")
        text = page(loop, "loop.png")
        write(output / "loop.md", text.encode())
    _print(output / "loop.md", text, as_json)


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
    drawn_by = (seed, vehicles, days, f"{every:g}", f"{minutes:g}")
    _settle(output, f"fleet {' '.join(map(str, drawn_by))}", SAME_OPTIONS)
    _process(as_json, ("fleet.prove.generate", output, *drawn_by))
    words = ["fleet", output / "fleet" / "recordings", "--vehicles", output / "fleet" / "fleet.yaml"]
    words += ["--period", "none", "-o", output / "results", "--json"]
    with (output / "found.json").open("w", encoding="utf-8") as into:
        _run("trackres fleet", **python("trackres_ros", *words), stdout=into)
    _score(output, as_json, ("fleet.prove.score", output))


@proofs.command("reproduce")
@click.option("-o", "--output", type=options.FOLDER, required=True, help="Folder for pictures, tables and the page.")
@click.option(
    "--page", type=click.Path(path_type=Path, dir_okay=False), help="Write the page here too, with links into the folder."
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
    emit(summary, as_json, lambda: f"Figures, tables and index.md are in {output}")

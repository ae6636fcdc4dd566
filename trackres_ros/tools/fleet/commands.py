# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres fleet` and `trackres trend`."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from trackres_ros.errors import InputError
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.output_files import output_file
from trackres_ros.tasks import options
from trackres_ros.tasks.terminal import Command, emit, needs, print_warnings, progress, to_nowhere, watch, with_written

EXTRA = "fsspec", "pyarrow", "distributed", "jinja2"
CHANGED, NOT_SENT = 3, 4  # exit codes


def alert_options(command: options.Decorated) -> options.Decorated:
    """`--webhook` and `--exit-code`: report changes to other programs."""
    command = click.option("--exit-code", is_flag=True, help=f"End with exit code {CHANGED} if a vehicle changed.")(command)
    text = f"Send changes, if any, to this address as JSON by POST; exit code {NOT_SENT} if that fails."
    return click.option("--webhook", metavar="URL", help=text)(command)


class FleetGroup(click.Group):
    """A group that runs its default command `run` for all words that name no other command."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Insert the word `run` before arguments that begin with no command."""
        if args and args[0] not in {*self.commands, "-h", "--help"}:
            args = ["run", *args]
        return super().parse_args(ctx, args)


@click.group("fleet", cls=FleetGroup)
def fleet_group() -> None:
    """Find which vehicles of a fleet changed, in which parameter and since when.

    \b
    trackres fleet RECORDINGS... --vehicles fleet.yaml -o results
    trackres fleet RECORDINGS... --vehicle xgd24d --engine tcp://scheduler:8786 -o results
    trackres fleet sample -o try                  a simulated fleet to try it on

    See trackres fleet run --help for all options.
    """


@fleet_group.command("run", cls=Command)
@click.argument("recordings", nargs=-1, required=True)
@click.option("--vehicle", metavar="FILE|NAME", help="Vehicle file, if all recordings are of one vehicle.")
@click.option("--vehicles", type=options.PATH, metavar="fleet.yaml", help="Vehicles, each with its file and recordings.")
@options.topics("with --vehicle, which topic or column feeds which role.", with_dbc=False)
@click.option("--engine", default="local", metavar="local|tcp://HOST:PORT", help="Address of the Dask scheduler to run on.")
@click.option("--workers", type=options.WORKERS, metavar="N", help="Processes of a local engine; default one per processor.")
@click.option("--hide", multiple=True, metavar="CHANNEL", help="Ignore a channel, but not speed or torque; may be repeated.")
@click.option("--period", type=click.Choice(["month", "none"]), default="month", help="Diagnose each vehicle by this period.")
@alert_options
@options.folder("Folder of all results.")
@options.json
def run_command(
    recordings: tuple[str, ...],
    vehicle: str | None,
    vehicles: Path | None,
    topics: str | None,
    engine: str,
    workers: int | None,
    hide: tuple[str, ...],
    period: str,
    webhook: str | None,
    exit_code: bool,
    output: Path,
    as_json: bool,
) -> int:
    """Analyse new recordings, then pool, compare and show all results.

    RECORDINGS are paths, folders, globs or URLs (s3://bucket/folder). DIR keeps finished results: a second run, or one after an
    interruption, processes only new recordings. DIR/alerts.csv has a row for each change of a vehicle.
    """
    needs("trackres fleet", "fleet", *EXTRA)
    if (vehicle is None) == (vehicles is None):
        raise InputError("--vehicle, --vehicles", "both" if vehicle else "neither", "one of them")
    if vehicles is not None and topics is not None:
        raise InputError("--vehicles, --topics", "both", "--topics with --vehicle alone", f"name it in {vehicles} as topics")
    from trackres_ros.tools.fleet.alerts import FILE, alerts, checked_url, write_alerts
    from trackres_ros.tools.fleet.dataset import FleetDataset
    from trackres_ros.tools.fleet.page.write import write_pages
    from trackres_ros.tools.fleet.periods import diagnose_periods, refuse_replaced
    from trackres_ros.tools.fleet.run import alone, check_limits, keep_limits, limits_of, run
    from trackres_ros.tools.fleet.trends import sentences, trends
    from trackres_ros.tools.fleet.vehicles import one_vehicle, read_fleet

    fleet = one_vehicle(vehicle, topics) if vehicle is not None else read_fleet(vehicles or Path())
    check_limits(fleet)
    if period != "none":
        refuse_replaced(output, fleet)
    if webhook is not None:
        checked_url(webhook)
    watch(output)
    dataset = FleetDataset(output)
    with alone(output), ExitStack() as bars:
        counts = run(
            recordings,
            fleet,
            dataset,
            engine,
            workers,
            hide,
            lambda total: bars.enter_context(progress("recordings", total)),
            lambda page: click.echo(f"the engine's own page: {page}", err=True),
        )
        bars.close()
        keep_limits(output, fleet)
        if period != "none":
            for line in diagnose_periods(dataset, fleet, counts.urls, engine, workers, hide, progress):
                click.echo(f"trackres: {line}", err=True)
        with print_warnings():
            fleet_trends = trends(dataset, limits_of(output, {}))
        fleet_trends["alerts"] = rows = alerts(fleet_trends)
        with file_set():
            write_alerts(output / FILE, rows)
            pages = write_pages(output, fleet_trends, dataset)
    run_counts = {"found": counts.found, "kept": counts.kept, "good": counts.good, "broken": counts.broken}

    def text() -> str:
        head = f"{counts.found} recordings: {counts.kept} unchanged, {counts.good} new, {counts.broken} unusable"
        return "\n".join([head, *sentences(fleet_trends), f"{pages}"])

    result = {"run": run_counts, **fleet_trends, "page": str(pages)}
    return _reported(_alerted(output, rows, webhook, exit_code), result, as_json, text)


@fleet_group.command("sample", cls=Command)
@click.option("--vehicles", type=click.IntRange(1, 10_000), default=20, help="How many.")
@click.option("--days", type=click.IntRange(1, 3650), default=90, help="Over how many days they drive.")
@click.option("--every", type=options.Number(0.1, 365.0), default=3.0, help="Days between recordings of a vehicle.")
@click.option("--minutes", type=options.Number(3.0, 600.0), default=10.0, help="Length of a recording.")
@options.seed(1)
@options.folder("Folder to write into.")
@options.json
def sample_command(output: Path, as_json: bool, **arguments: Any) -> None:
    """Write a simulated fleet in which up to three vehicles change; answers.json lists them, and the options.

    A vehicle needs two recordings to change, so give --days at least twice --every.

    \b
    trackres fleet sample -o try --vehicles 20 --days 90
    trackres fleet try/recordings --vehicles try/fleet.yaml -o results
    """
    from trackres_ros.tools.fleet.sample import write_sample

    watch(output)
    with ExitStack() as bars:
        fleet = write_sample(output, on_begin=lambda total: bars.enter_context(progress("driving", total)), **arguments)
    count, changes = sum(len(vehicle.days) for vehicle in fleet), sum(vehicle.hidden is not None for vehicle in fleet)
    emit(
        {"recordings": count, "vehicles": len(fleet), "changes": changes, "folder": str(output)},
        as_json,
        lambda: f"{count} recordings of {len(fleet)} vehicles in {output}; {changes} of the vehicles change",
    )


@click.command("trend", cls=Command)
@click.argument("folder", type=options.PATH, metavar="DIR")
@click.option("--name", metavar="VEHICLE", help="Look for changes of this vehicle alone.")
@click.option(
    "--limit", "limits", multiple=True, metavar="PARAMETER=VALUE", help="Limit of a parameter for the alarm; may be repeated."
)
@click.option("--false-alarms", type=options.Number(1e-4, 10.0), default=0.2, help="False alarms allowed per vehicle and year.")
@click.option("--alerts", "table", type=options.PATH, metavar="A.csv", help="Write a row for each change.")
@alert_options
@options.json
def trend_command(
    folder: Path,
    name: str | None,
    limits: tuple[str, ...],
    false_alarms: float,
    table: Path | None,
    webhook: str | None,
    exit_code: bool,
    as_json: bool,
) -> int:
    """Show changes over the months of a fleet, by vehicle and date, and when a limit is reached.

    DIR is the output folder of trackres fleet.

    \b
    trackres trend results --limit bearing_friction=0.012
    trackres trend results --alerts alerts.csv --webhook https://example.com/hook --exit-code
    """
    needs("trackres trend", "fleet", "pyarrow")
    from trackres_ros.tools.fleet.alerts import alerts, checked_url, write_alerts
    from trackres_ros.tools.fleet.dataset import FleetDataset
    from trackres_ros.tools.fleet.run import limits_of
    from trackres_ros.tools.fleet.trends import sentences, trends

    file = None if table is None else output_file(table, (".csv",))
    if webhook is not None:
        checked_url(webhook)
    watch(file)
    with print_warnings():
        result = trends(FleetDataset.existing(folder), limits_of(folder, dict(map(_limit, limits))), false_alarms, name)
    result["alerts"] = rows = alerts(result)
    if file is not None:
        write_alerts(file, rows)
    code = _alerted(folder, rows, webhook, exit_code)
    return _reported(code, result, as_json, lambda: with_written("\n".join(sentences(result)), [file] if file else []))


def _alerted(folder: Path, rows: Sequence[Mapping[str, Any]], webhook: str | None, exit_code: bool) -> int:
    """Send the alerts, and choose the exit code."""
    from trackres_ros.tools.fleet.alerts import post_alerts

    if webhook is not None and rows and (problem := post_alerts(webhook, folder, rows)):
        click.echo(f"trackres: the webhook failed: {problem}", err=True)
        return NOT_SENT
    return CHANGED if exit_code and rows else 0


def _reported(code: int, result: dict[str, Any], as_json: bool, text: Callable[[], str]) -> int:
    """Print the results after the alerts, whose exit code stays where nobody can read standard output."""
    try:
        emit(result, as_json, text)
    except OSError as error:
        if not code:
            raise
        click.echo(f"trackres: standard output: {error.strerror}", err=True)
        to_nowhere()
    return code


def _limit(text: str) -> tuple[str, float]:
    from trackres_ros.tools.fleet.vehicles import HIGHEST_LIMIT

    name, equals, value = text.partition("=")
    try:
        if not (equals and 0.0 <= float(value) <= HIGHEST_LIMIT):
            raise ValueError
        return name, float(value)
    except ValueError:
        raise InputError("--limit", text, "PARAMETER=VALUE with a finite VALUE from 0 on, as bearing_friction=0.012") from None

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds what the commands share: options, output and progress."""

from __future__ import annotations

import inspect
import json
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.shell_completion import CompletionItem

from trackres_ros import InputError, MissingExtraError
from trackres_ros.cli.partial_output import watch
from trackres_ros.errors import nearest
from trackres_ros.files.resources import shipped_road_vehicles, shipped_topics, shipped_vehicles
from trackres_ros.progress import listening

if TYPE_CHECKING:
    from trackres_ros.recording.bindings import Topics

Decorated = TypeVar("Decorated", bound=Callable[..., Any])

METHODS = click.Choice(["rainflow", "spectral"])
PATH, FOLDER = click.Path(path_type=Path), click.Path(path_type=Path, file_okay=False)
DISTRIBUTIONS = {"sklearn": "scikit-learn"}  # if its name is not that of the module
SHIPPED_TOPICS = shipped_topics()
DBC = f"{__name__}.dbc"
"""Key of a command's context under which the CAN databases are stored."""


class Number(click.FloatRange):
    """A finite number in a range; click's own accepts nan."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.FloatRange`."""
        converted = super().convert(value, param, ctx)
        if converted != converted:
            self.fail(f"{value} is not a number", param, ctx)
        return converted


class Command(click.Command):
    """A command whose errors name the option that the user typed."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run it."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            option_of = {p.name: p.opts[0] for p in self.params if isinstance(p, click.Option)}
            names = error.where.split(", ")
            if not all(name in option_of for name in names):
                raise
            raise InputError(", ".join(option_of[n] for n in names), error.given, error.allowed, error.remedy) from error


class Commands(click.Group):
    """A group of commands that suggests the closest one for an unknown name."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """See `click.Group`; newer versions of it guess too, and older ones do not."""
        name = args[0]
        if self.get_command(ctx, name) is None and not name.startswith("-"):
            guess = nearest(name, self.list_commands(ctx)) or f"one of {', '.join(self.list_commands(ctx))}"
            raise click.UsageError(f"No such command {name!r}: {guess}", ctx)
        return super().resolve_command(ctx, args)


def vehicles_to_complete(_context: click.Context, _option: click.Parameter, begun: str) -> list[CompletionItem]:
    """Shipped vehicles and files, for the shell."""
    return _to_complete([*shipped_vehicles(), *shipped_road_vehicles()], begun)


def topics_to_complete(_context: click.Context, _option: click.Parameter, begun: str) -> list[CompletionItem]:
    """Shipped topics files and files, for the shell."""
    return _to_complete(SHIPPED_TOPICS, begun)


def _to_complete(names: Iterable[str], begun: str) -> list[CompletionItem]:
    return [*(CompletionItem(name) for name in names if name.startswith(begun)), CompletionItem(begun, type="file")]


def option_of(
    function: Callable[..., Any], argument: str, kind: Any, text: str, metavar: str | None = None
) -> Callable[[Decorated], Decorated]:
    """The option of a function's argument, with its default."""
    default = inspect.signature(function).parameters[argument].default
    return click.option(f"--{argument.replace('_', '-')}", type=kind, default=default, metavar=metavar, help=text)


@contextmanager
def print_warnings() -> Iterator[None]:
    """Print the warnings of functions on standard error."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_: click.echo(f"trackres: {message}", err=True)
        yield


def folder_option(text: str) -> Callable[[Decorated], Decorated]:
    """`-o`, `--output`: the folder that a command writes into."""
    return click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help=text)


vehicle_option = click.option(
    "--vehicle",
    required=True,
    metavar="FILE|NAME",
    shell_complete=vehicles_to_complete,
    help=f"Vehicle file, or the name of a shipped one: {', '.join([*shipped_vehicles(), *shipped_road_vehicles()])}.",
)


def topics_option(text: str, with_dbc: bool = True) -> Callable[[Decorated], Decorated]:
    """`--topics`: a path or the name of a shipped topics file; with `--dbc` for recordings."""
    option = click.option(
        "--topics",
        metavar="FILE|NAME",
        shell_complete=topics_to_complete,
        callback=with_databases if with_dbc else None,
        help=f"Topics file, or the name of a shipped one ({', '.join(SHIPPED_TOPICS)}): {text}",
    )
    return (lambda command: dbc_option(option(command))) if with_dbc else option


def with_databases(context: click.Context, _option: click.Parameter | None, topics: str | None) -> Topics | Any:
    """The given topics file, or none, with the databases of `--dbc`."""
    files = context.meta.get(DBC, ())
    if not files:
        return topics
    from trackres_ros.recording.bindings import Topics

    loaded = Topics({}, "--dbc") if topics is None else Topics.load(topics)
    return loaded.with_databases(files)


dbc_option = click.option(
    "--dbc",
    multiple=True,
    type=PATH,
    is_eager=True,
    expose_value=False,
    callback=lambda context, _, files: context.meta.update({DBC: files}),
    help="Database of a CAN bus, for recorded frames; may be repeated. Overrides dbc in the topics file.",
)
params_option = click.option(
    "--params",
    type=PATH,
    metavar="P.yaml",
    help="Parameter file, flat or as the live node reads it; only settings of the estimator are used.",
)
surroundings_option = click.option(
    "--surroundings",
    type=PATH,
    metavar="S.yaml",
    help="Current effects of site, weather and ground, as trackres diagnose writes them; never fed forward.",
)
ambient_option = click.option(
    "--ambient-degc", type=Number(-60, 60), help="Ambient temperature [degC]; default the vehicle file's."
)
weight_option = click.option(
    "--weight-kn", type=Number(0.1, 1e5), help="Weight of the whole vehicle [kN]; default the vehicle file's."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")
SEEDS, WORKERS = click.IntRange(0, 2**32 - 1), click.IntRange(1, 1024)


def seed_option(default: int) -> Callable[[Decorated], Decorated]:
    """`--seed` of all random draws."""
    return click.option("--seed", type=SEEDS, default=default, help="Seed of all random draws.")


def method_options(command: Decorated) -> Decorated:
    """`--method` and `--thermal`: models instead of the vehicle file's."""
    command = click.option(
        "--thermal", type=click.Choice(["lumped", "core_surface"]), help="Thermal model instead of the vehicle file's."
    )(command)
    return click.option(
        "--method",
        type=METHODS,
        help="Hysteresis method instead of the vehicle file's: rainflow as in the paper, or the exact spectral one.",
    )(command)


def needs(feature: str, extra: str, *modules: str) -> None:
    """Check for an optional library before any work begins."""
    for module in modules:
        if find_spec(module) is None:
            raise MissingExtraError(feature, DISTRIBUTIONS.get(module, module), extra)


def output_folder(path: Path) -> Path:
    """An output folder, created if needed; an interrupted command lists its files."""
    watch(path)
    path.mkdir(parents=True, exist_ok=True)
    return path


def picture_beside(path: Path) -> Path:
    """Path of the picture that belongs to an output file."""
    name = path.name[: -len(".gz")] if path.name.lower().endswith(".csv.gz") else path.name
    return path.with_name(f"{Path(name).stem}.png")


def with_written(text: str, written: Iterable[object]) -> str:
    """A text, and the files that were written, if any."""
    files = ", ".join(map(str, written))
    return f"{text}\nWritten: {files}" if files else text


def emit(result: dict[str, Any], as_json: bool, text: Callable[[], str]) -> None:
    """Print a result as JSON or as text."""
    click.echo(json.dumps(result, indent=2, allow_nan=False) if as_json else text())


@contextmanager
def progress(label: str, total: float | None) -> Iterator[Callable[[float], None]]:
    """A progress bar on standard error, in a terminal; the function takes the increment."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    clock = TimeElapsedColumn() if total is None else TimeRemainingColumn()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), clock)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=total)

        def tell(what: str, _done: int, _total: int) -> None:
            bar.update(task, description=f"{label}: {what}")

        with listening(tell):
            yield lambda done: bar.update(task, advance=done)


@contextmanager
def stages() -> Iterator[Callable[[str], None]]:
    """One line on standard error per stage of long work; in a terminal with progress and duration."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda stage: click.echo(f"  {stage}", err=True)
        return
    left = TimeRemainingColumn(compact=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(20), TaskProgressColumn(), left)
    with Progress(*columns, console=console, transient=True) as bar:
        now: dict[str, Any] = {"stage": "", "since": 0.0, "task": None, "part": None}

        def over() -> None:
            if now["stage"]:
                console.print(f"  {now['stage']} ({time.monotonic() - now['since']:.0f} s)", highlight=False, markup=False)

        def begin(stage: str) -> None:
            over()
            if now["task"] is not None:
                bar.remove_task(now["task"])
            now.update(stage=stage, since=time.monotonic(), task=bar.add_task(stage, total=None), part=None)

        def tell(what: str, done: int, total: int) -> None:
            if now["task"] is None:
                begin("begins")
            if what != now["part"]:
                bar.reset(now["task"], total=total or None, description=f"{now['stage']}: {what}")
                now["part"] = what
            bar.update(now["task"], completed=done)

        with listening(tell):
            yield begin
        over()

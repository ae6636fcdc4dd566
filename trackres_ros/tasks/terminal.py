# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands with readable errors, and what all of them print: results, progress, warnings, and the files written so far."""

import os
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from trackres_ros.errors import InputError, MissingExtraError, nearest
from trackres_ros.files.file_sets import RepairWarning
from trackres_ros.files.own_files import remove
from trackres_ros.progress import listening
from trackres_ros.text import some_of

SHOWN = 8  # files in a message
CLOCK_TICK_NS = 20_000_000  # a file's time may be that of the kernel's last tick

_places: list[Path] = []
_began_ns = 0


class Command(click.Command):
    """A command whose errors name the option that the user typed."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run it."""
        try:
            with print_warnings(RepairWarning):
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


@contextmanager
def print_warnings(kind: type[Warning] = Warning) -> Iterator[None]:
    """Print the warnings of a kind on standard error; leave others to whoever listens."""
    with warnings.catch_warnings():
        show = warnings.showwarning
        warnings.simplefilter("always", kind)

        def show_warning(message: Warning | str, category: type[Warning], *args: Any, **kwargs: Any) -> None:
            if issubclass(category, kind):
                click.echo(f"trackres: {message}", err=True)
            else:
                show(message, category, *args, **kwargs)

        warnings.showwarning = show_warning
        yield


def needs(feature: str, extra_name: str, *modules: str) -> None:
    """Check for an optional library before any work begins."""
    for module in modules:
        if find_spec(module) is None:
            raise MissingExtraError(feature, module, extra_name)


def begin_command() -> None:
    """Mark the start of a command, before any output."""
    global _began_ns
    _places.clear()
    _began_ns = time.time_ns()


def watch(*places: Path | None) -> None:
    """Register the files or folders that a command writes."""
    _places.extend(place for place in places if place)


def places() -> str:
    """The output places of the command, for error messages."""
    return ", ".join(str(place) for place in _places[:SHOWN])


def written_so_far() -> str:
    """The files written since the command started, in words."""
    paths = sorted({str(path) for place in _places for path in _files(place) if _is_new(path)})
    if not paths:
        return "nothing was written"
    return f"written so far: {some_of(paths, SHOWN)}"


def _files(place: Path) -> Iterator[Path]:
    if not place.is_dir():
        yield place
    for folder, _, names in os.walk(place):
        yield from (Path(folder) / name for name in names)


def _is_new(path: Path) -> bool:
    try:
        return path.stat().st_mtime_ns >= _began_ns - CLOCK_TICK_NS
    except OSError:
        return False


def output_folder(path: Path) -> Path:
    """An output folder, created if needed; an interrupted command lists its files."""
    watch(path)
    path.mkdir(parents=True, exist_ok=True)
    return path


def picture_beside(path: Path) -> Path:
    """Path of the picture that belongs to an output file."""
    name = path.name[: -len(".gz")] if path.name.lower().endswith(".csv.gz") else path.name
    return path.with_name(f"{Path(name).stem}.png")


def with_written(text: str, outputs: Iterable[object]) -> str:
    """A text, and the files that were written, if any."""
    files = ", ".join(map(str, outputs))
    return f"{text}\nWritten: {files}" if files else text


def emit(result: dict[str, Any], as_json: bool, text: Callable[[], str]) -> None:
    """Print a result as JSON or as text."""
    import json  # not for a help text, which it would delay

    output = json.dumps(result, indent=2, allow_nan=False) if as_json else text()
    try:
        click.echo(output)
    except OSError as error:  # it names no file, and those of the command are written
        error.filename = "standard output"
        raise


def to_nowhere() -> None:
    """Have standard output go nowhere from now on, also what it still holds: Python writes that at its end."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def picture_if_possible(picture: Path) -> Iterator[None]:
    """Draw a picture of results that are of use without it. If a library is missing, say so and remove an earlier picture."""
    try:
        yield
    except MissingExtraError as error:
        was_there = picture.is_file()
        with suppress(OSError):
            remove(picture)
        click.echo(f"trackres: no picture{f', the earlier {picture} is removed' if was_there else ''}: {error}", err=True)


@contextmanager
def progress(label: str, total: float | None) -> Iterator[Callable[[float], None]]:
    """A progress bar on standard error, in a terminal; the function takes the increment."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    clock = TimeElapsedColumn() if total is None else TimeRemainingColumn()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), clock)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=total)

        def show_progress(part: str, _count: int, _total: int) -> None:
            bar.update(task, description=f"{label}: {part}")

        with listening(show_progress):
            yield lambda count: bar.update(task, advance=count)


@contextmanager
def stage_progress() -> Iterator[Callable[[str], None]]:
    """One line on standard error per stage of long work; in a terminal with progress and duration."""
    if not sys.stderr.isatty():
        yield lambda stage: click.echo(f"  {stage}", err=True)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    time_column = TimeRemainingColumn(compact=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(20), TaskProgressColumn(), time_column)
    with Progress(*columns, console=console, transient=True) as bar:
        state: dict[str, Any] = {"stage": "", "since": 0.0, "task": None, "part": None}

        def print_stage() -> None:
            if state["stage"]:
                console.print(f"  {state['stage']} ({time.monotonic() - state['since']:.0f} s)", highlight=False, markup=False)

        def begin(stage: str) -> None:
            print_stage()
            if state["task"] is not None:
                bar.remove_task(state["task"])
            state.update(stage=stage, since=time.monotonic(), task=bar.add_task(stage, total=None), part=None)

        def show_progress(part: str, count: int, total: int) -> None:
            if state["task"] is None:
                begin("begins")
            if part != state["part"]:
                bar.reset(state["task"], total=total or None, description=f"{state['stage']}: {part}")
                state["part"] = part
            bar.update(state["task"], completed=count)

        with listening(show_progress):
            yield begin
        print_stage()

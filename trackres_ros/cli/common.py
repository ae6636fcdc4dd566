"""What the commands share: options, output and progress."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import click

from trackres_ros.cli.written import watch
from trackres_ros.errors import InputError, MissingExtraError
from trackres_ros.resources import shipped_vehicles

Command = TypeVar("Command", bound=Callable[..., Any])

TABLE_SUFFIXES = (".csv", ".csv.gz", ".parquet")
OUTPUT_SUFFIXES = (*TABLE_SUFFIXES, ".mcap")
WRITTEN_WITH = {".parquet": ("writing Parquet", "parquet", "pyarrow"), ".mcap": ("writing bags", "bags", "rosbags")}
DISTRIBUTIONS = {"sklearn": "scikit-learn"}  # where its name is not that of the module


def vehicle_option(command: Command) -> Command:
    """`--vehicle`: a path or the name of a shipped vehicle."""
    return click.option(
        "--vehicle",
        required=True,
        metavar="FILE|NAME",
        help=f"Vehicle file, or the name of a shipped one: {', '.join(shipped_vehicles())}.",
    )(command)


def surroundings_option(command: Command) -> Command:
    """`--surroundings`: a file of the site, the weather and the ground, as `trackres diagnose` writes it."""
    return click.option(
        "--surroundings",
        "surroundings_file",
        type=click.Path(path_type=Path),
        metavar="S.yaml",
        help="Effects of site, weather and ground that hold here and now, as trackres diagnose writes them; never fed forward.",
    )(command)


def json_option(command: Command) -> Command:
    """`--json`: the same facts for programs."""
    return click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")(command)


def method_options(command: Command) -> Command:
    """`--method` and `--thermal`: other models than the vehicle file names."""
    command = click.option(
        "--thermal", type=click.Choice(["lumped", "core_surface"]), help="Thermal model instead of the vehicle file's."
    )(command)
    return click.option(
        "--method",
        type=click.Choice(["rainflow", "spectral"]),
        help="Way from strain to heat instead of the vehicle file's: the paper's count, or exact.",
    )(command)


def number(low: float, high: float) -> click.FloatRange:
    """A finite number in a range; click's own accepts nan."""
    return _Finite(low, high)


class _Finite(click.FloatRange):
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        converted = super().convert(value, param, ctx)
        if converted != converted:
            self.fail(f"{value} is not a number", param, ctx)
        return converted


def needs(feature: str, extra: str, *modules: str) -> None:
    """Refuse before any work what would end without an optional library."""
    for module in modules:
        if find_spec(module) is None:
            raise MissingExtraError(feature, DISTRIBUTIONS.get(module, module), extra)


def output_path(path: Path, suffixes: tuple[str, ...] = OUTPUT_SUFFIXES) -> Path:
    """The path, if its suffix says how to write it, what writes it is installed, and its folder is there."""
    if not path.name.lower().endswith(suffixes):
        raise InputError("-o", str(path), f"a file name that ends in {', '.join(suffixes)}")
    if not path.parent.is_dir():
        raise InputError("-o", str(path), "a file in a folder that exists", f"make it first: mkdir -p {path.parent}")
    if path.is_dir():
        raise InputError("-o", str(path), "a file; there is a folder of that name")
    if path.suffix.lower() in WRITTEN_WITH:
        needs(*WRITTEN_WITH[path.suffix.lower()])
    watch(path)
    return path


def output_folder(path: Path) -> Path:
    """The path, if it is a folder or may become one."""
    if path.exists() and not path.is_dir():
        raise InputError("-o", str(path), "a folder; there is a file of that name")
    watch(path)
    return path


def without_suffix(path: Path) -> Path:
    """The path without its suffix, of which `.csv.gz` is one."""
    return path.with_name(
        next(path.name[: -len(s)] for s in sorted(OUTPUT_SUFFIXES, key=len, reverse=True) if path.name.lower().endswith(s))
    )


def emit(result: dict[str, Any], as_json: bool, text: Callable[[], str]) -> None:
    """Print a result: as JSON, or as the text made for people."""
    click.echo(json.dumps(result, indent=2, allow_nan=False) if as_json else text())


@contextmanager
def progress(label: str, total: float | None) -> Iterator[Callable[[float], None]]:
    """A progress bar on standard error where that is a terminal; the function takes how much more is done."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda done: bar.update(task, advance=done)

# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options that several commands have, and the types of their values."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.shell_completion import CompletionItem

from trackres_ros.errors import InputError
from trackres_ros.files.resources import shipped_road_vehicles, shipped_topics, shipped_vehicles
from trackres_ros.tasks.arguments import LIMITS

if TYPE_CHECKING:
    from trackres_ros.recording.bindings import Topics

Decorated = TypeVar("Decorated", bound=Callable[..., Any])

METHODS = click.Choice(["rainflow", "spectral"])
PATH, FOLDER = click.Path(path_type=Path), click.Path(path_type=Path, file_okay=False)
SEEDS, WORKERS = click.IntRange(0, 2**32 - 1), click.IntRange(1, 1024)
SHIPPED_TOPICS = shipped_topics()
AMBIENT = "Ambient temperature [degC]; default the vehicle file's."
WEIGHT = "Weight of the whole vehicle [kN]; default the vehicle file's."
DBC = f"{__name__}.dbc"
"""Key of a command's context under which the CAN databases are stored."""


class Number(click.FloatRange):
    """A finite number in a range; click's own accepts nan."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.FloatRange`."""
        number = super().convert(value, param, ctx)
        if number != number:
            self.fail(f"{value} is not a number", param, ctx)
        return number


def vehicles_to_complete(_context: click.Context, _option: click.Parameter, beginning: str) -> list[CompletionItem]:
    """Shipped vehicles and files, for the shell."""
    return _to_complete([*shipped_vehicles(), *shipped_road_vehicles()], beginning)


def topics_to_complete(_context: click.Context, _option: click.Parameter, beginning: str) -> list[CompletionItem]:
    """Shipped topics files and files, for the shell."""
    return _to_complete(SHIPPED_TOPICS, beginning)


def _to_complete(names: Iterable[str], beginning: str) -> list[CompletionItem]:
    return [*(CompletionItem(name) for name in names if name.startswith(beginning)), CompletionItem(beginning, type="file")]


def argument_option(
    function: Callable[..., Any], argument: str, text: str, kind: Any = None, metavar: str | None = None
) -> Callable[[Decorated], Decorated]:
    """The option of a function's argument, with its default; without a kind, a number within its limits."""
    if kind is None:
        low, high, _ = LIMITS[function.__name__][argument]
        kind = click.IntRange(low, high) if isinstance(low, int) and isinstance(high, int) else Number(low, high)
    default = inspect.signature(function).parameters[argument].default
    is_required = default is inspect.Parameter.empty
    name = f"--{argument.replace('_', '-')}"
    return click.option(
        name, type=kind, default=None if is_required else default, required=is_required, metavar=metavar, help=text
    )


def folder(text: str) -> Callable[[Decorated], Decorated]:
    """`-o`, `--output`: the folder that a command writes into."""
    return click.option("-o", "--output", type=FOLDER, required=True, metavar="DIR", help=text)


vehicle = click.option(
    "--vehicle",
    required=True,
    metavar="FILE|NAME",
    shell_complete=vehicles_to_complete,
    help=f"Vehicle file, or the name of a shipped one: {', '.join([*shipped_vehicles(), *shipped_road_vehicles()])}.",
)


def topics(text: str, with_dbc: bool = True) -> Callable[[Decorated], Decorated]:
    """`--topics`: a path or the name of a shipped topics file; with `--dbc` for recordings."""
    option = click.option(
        "--topics",
        metavar="FILE|NAME",
        shell_complete=topics_to_complete,
        callback=with_databases if with_dbc else None,
        help=f"Topics file, or the name of a shipped one ({', '.join(SHIPPED_TOPICS)}): {text}",
    )
    return (lambda command: dbc(option(command))) if with_dbc else option


def with_databases(context: click.Context, _option: click.Parameter | None, topics: str | None) -> Topics | Any:
    """The given topics file, or none, with the databases of `--dbc`."""
    files = context.meta.get(DBC, ())
    if not files:
        return topics
    from trackres_ros.recording.bindings import Topics

    bindings = Topics({}, "--dbc") if topics is None else Topics.load(topics)
    return bindings.with_databases(files)


dbc = click.option(
    "--dbc",
    multiple=True,
    type=PATH,
    is_eager=True,
    expose_value=False,
    callback=lambda context, _, files: context.meta.update({DBC: files}),
    help="Database of a CAN bus, for recorded frames; may be repeated. Overrides dbc in the topics file.",
)
params = click.option(
    "--params",
    type=PATH,
    metavar="P.yaml",
    help="Parameter file, flat or as the live node reads it; only settings of the estimator are used.",
)
surroundings = click.option(
    "--surroundings",
    type=PATH,
    metavar="S.yaml",
    help="Current effects of site, weather and ground, as trackres diagnose writes them; never fed forward.",
)
json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")


def seed(default: int) -> Callable[[Decorated], Decorated]:
    """`--seed` of all random draws."""
    return click.option("--seed", type=SEEDS, default=default, help="Seed of all random draws.")


def methods(command: Decorated) -> Decorated:
    """`--method` and `--thermal`: models instead of the vehicle file's."""
    command = click.option(
        "--thermal", type=click.Choice(["lumped", "core_surface"]), help="Thermal model instead of the vehicle file's."
    )(command)
    return click.option(
        "--method",
        type=METHODS,
        help="Hysteresis method instead of the vehicle file's: rainflow as in the paper, or the exact spectral one.",
    )(command)


def name_options(command: Decorated) -> Decorated:
    """`--name` and `--namespace` of the node."""
    command = click.option("--namespace", default="/", help="Namespace of the node.")(command)
    return click.option("--name", default="trackres", help="Name of the node.")(command)


def check_names(name: str, namespace: str) -> None:
    """Refuse an invalid node name or namespace."""
    if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
        raise InputError("--name", name, "letters, digits and underscores, not beginning with a digit")
    if not re.fullmatch(r"/|(/[A-Za-z_]\w*)+", namespace, re.ASCII):
        raise InputError("--namespace", namespace, "a path such as /left/rear")

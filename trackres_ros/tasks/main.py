# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gathers the commands of `trackres`, and turns bad input into exit codes."""

import os
import select
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import entry_points

import click

from trackres_ros import InputError, __version__
from trackres_ros.errors import one_line
from trackres_ros.tasks import partial_output
from trackres_ros.tasks.diagnose_command import diagnose_command, effects_command
from trackres_ros.tasks.explain_command import explain_command
from trackres_ros.tasks.interrupts import INTERRUPTED, interrupt_handled
from trackres_ros.tasks.layouts import layouts_command
from trackres_ros.tasks.live import live_command
from trackres_ros.tasks.play import play_command
from trackres_ros.tasks.record_sample_command import record_sample_command
from trackres_ros.tasks.recover_command import recover_command
from trackres_ros.tasks.replay_command import replay_command
from trackres_ros.tasks.simulate_command import simulate_command
from trackres_ros.tasks.terminal import Commands, to_nowhere
from trackres_ros.tasks.topics_command import topics_group
from trackres_ros.tasks.vehicle_command import vehicle_group

BAD_INPUT = 2
PLUG_INS = "trackres_ros.commands"
"""The group of entry points that bring commands."""


SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 110, "show_default": True}


class Program(Commands):
    """The commands of the package, and those of its plug-ins, which are loaded when they are asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """See `click.Group`."""
        return sorted({*super().list_commands(ctx), *entry_points(group=PLUG_INS).names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """See `click.Group`."""
        if cmd_name not in self.commands:
            for point in entry_points(group=PLUG_INS, name=cmd_name):
                self.add_command(point.load(), cmd_name)
        return super().get_command(ctx, cmd_name)


@click.group(cls=Program, context_settings=SETTINGS)
@click.version_option(__version__, package_name="trackres_ros")
def cli() -> None:
    """Rolling-resistance torque and temperature of rubber tracks.

    \b
    Start here:
      trackres record-sample -o lap.mcap                       make a sample recording
      trackres replay lap.mcap --vehicle xgd24d -o out.csv     torque and temperature over time, and a picture
      trackres live --vehicle xgd24d --topics topics.yaml      the same while driving
      trackres diagnose day1.mcap day2.mcap --vehicle xgd24d -o report    find missing physics
      trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15    one operating point by its parts
    """


for command in (
    live_command,
    replay_command,
    play_command,
    layouts_command,
    simulate_command,
    explain_command,
    diagnose_command,
    effects_command,
    record_sample_command,
    recover_command,
    vehicle_group,
    topics_group,
):
    cli.add_command(command)


def main(arguments: Sequence[str] | None = None, commands: click.Group = cli, program: str = "trackres") -> None:
    """Run a command line; bad input ends with exit code 2 and one line that says what to do, with --json as JSON."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller; progress bars and libraries expect a stream
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))
    partial_output.begin()
    given = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in given
    try:
        _refuse_empty(given)
        result = commands.main(args=given, prog_name=program, standalone_mode=False)
    except click.ClickException as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # click 8.2 and newer: the help is the message
            click.echo(error.format_message())
            sys.exit(BAD_INPUT)
        context = getattr(error, "ctx", None)
        path = context.command_path if context else program
        text = " ".join(error.format_message().split())
        _fail(InputError(path, " ".join(given), text, f"see {path} --help"), f"{text} (see {path} --help)", as_json)
    except InputError as error:
        _fail(error, str(error), as_json)
    except SystemExit as ended:  # click ends with 1 where a pipe is closed, such as one to head
        if ended.code == 1 and _nobody_reads():
            to_nowhere()
            sys.exit(0)
        raise
    except OSError as error:
        where, why = str(error.filename or partial_output.places() or "system"), str(error.strerror or error)
        _fail(InputError(where, why, "a usable file or device"), one_line(f"{where}: {why}"), as_json)
    except (click.Abort, KeyboardInterrupt):
        interrupt_handled()
        click.echo(f"trackres: interrupted; {partial_output.so_far()}", err=True)
        sys.exit(INTERRUPTED)
    sys.exit(result if isinstance(result, int) else 0)


def _refuse_empty(given: Sequence[str]) -> None:
    """Refuse an empty text: as a path it would mean the current folder. Raises InputError for an empty text, with its option."""
    for before, argument in zip(["trackres", *given], given, strict=False):
        option, equals, value = argument.partition("=")
        if not argument.strip() or (equals and not value.strip() and option.startswith("--")):
            where = option or (before if before.startswith("-") else "trackres")
            raise InputError(where, "", "a text that is not empty", "if it comes from a shell variable, that variable is not set")


def _nobody_reads() -> bool:
    """Whether standard output is a pipe whose reader has closed it."""
    watched = select.poll()
    watched.register(sys.stdout.fileno(), 0)  # errors alone
    return bool(watched.poll(0))


def _fail(error: InputError, text: str, as_json: bool) -> None:
    try:
        if as_json:
            import json

            click.echo(json.dumps({"error": error.as_dict()}))
            sys.exit(BAD_INPUT)
        sys.stdout.flush()
    except OSError:  # such as a full disk: at least one line on standard error says so
        to_nowhere()
    with suppress(OSError):
        click.echo(f"trackres: error: {text}", err=True)
    sys.exit(BAD_INPUT)


if __name__ == "__main__":
    main()

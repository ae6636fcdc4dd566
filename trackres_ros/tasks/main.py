# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lists the commands of `trackres`, loads the one that is asked for, and turns bad input into exit codes."""

import os
import select
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from importlib.metadata import entry_points

import click
from click.shell_completion import CompletionItem

from trackres_ros.errors import InputError, one_line
from trackres_ros.tasks import terminal
from trackres_ros.tasks.interrupts import INTERRUPTED, interrupt_handled
from trackres_ros.tasks.terminal import Commands, to_nowhere
from trackres_ros.version import __version__

BAD_INPUT = 2
COMMANDS = {
    "diagnose": (
        "diagnose",
        "Find where measurement and simulation differ and which physics is missing; write a vehicle file with it.",
    ),
    "effects": ("vehicle", "List the catalogue of effects with descriptions and parameters."),
    "explain": ("explain", "Show the parts of the torque at one operating point, computed by the exact methods."),
    "layouts": (
        "layouts",
        "Write layouts of PlotJuggler and Foxglove for a vehicle: torque by part and assembly, feed-forward, belts, residual.",
    ),
    "live": ("live", "Run the live estimate until interrupted."),
    "play": ("play", "Play a ROS 2 bag with its /clock, or one of its log times, to a live node."),
    "record-sample": (
        "record_sample",
        "Make a recording like a vehicle bus log: the paper's lap test, speed in steps of 1 km/h, load, air temperature.",
    ),
    "recover": ("recordings", "Repair an MCAP recording that a kill, a crash or a power cut left unfinished."),
    "replay": ("replay", "Compute resistance torque and belt temperature over a recording."),
    "simulate": ("simulate", "Compute torque and belt temperature along a speed profile."),
    "topics": ("recordings", "Topics files: which topic or column feeds which role."),
    "vehicle": ("vehicle", "Vehicle files."),
}
"""Module and first sentence of each command; of `record-sample` the module has `record_sample_command`."""
PLUG_INS = "trackres_ros.commands"
"""The group of entry points that bring commands."""
SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 110, "show_default": True}


class Program(Commands):
    """The commands of the package and those of its plug-ins. A list has their sentences; only a command that is run is loaded."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """See `click.Group`."""
        return sorted({*COMMANDS, *super().list_commands(ctx), *entry_points(group=PLUG_INS).names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """See `click.Group`."""
        if cmd_name not in self.commands:
            if cmd_name in COMMANDS:  # and no look at what is installed
                module = import_module(f"trackres_ros.tasks.{COMMANDS[cmd_name][0]}")
                self.add_command(getattr(module, f"{cmd_name.replace('-', '_')}_command"), cmd_name)
            else:
                for point in entry_points(group=PLUG_INS, name=cmd_name):
                    self.add_command(point.load(), cmd_name)
        return super().get_command(ctx, cmd_name)

    def _command_table(self, ctx: click.Context) -> dict[str, click.Command]:
        """What a list shows of each command."""
        commands = {name: click.Command(name, help=sentence) for name, (_, sentence) in COMMANDS.items()}
        plugins = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx) if name not in commands)
        return commands | {name: command for name, command in plugins if command}

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """See `click.Group`."""
        click.Group(commands=self._command_table(ctx)).format_commands(ctx, formatter)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """See `click.Group`."""
        entries = sorted((name, command) for name, command in self._command_table(ctx).items() if name.startswith(incomplete))
        items = [CompletionItem(name, help=command.get_short_help_str()) for name, command in entries]
        return [*items, *click.Command.shell_complete(self, ctx, incomplete)]


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


def main(arguments: Sequence[str] | None = None, commands: click.Group = cli, program: str = "trackres") -> None:
    """Run a command line; bad input ends with exit code 2 and one line that says what to do, with --json as JSON."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller; progress bars and libraries expect a stream
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))
    terminal.begin_command()
    words = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in words
    try:
        _refuse_empty(words)
        result = commands.main(args=words, prog_name=program, standalone_mode=False)
    except click.ClickException as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # click 8.2 and newer: the help is the message
            click.echo(error.format_message())
            sys.exit(BAD_INPUT)
        context = getattr(error, "ctx", None)
        path = context.command_path if context else program
        text = " ".join(error.format_message().split())
        _fail(InputError(path, " ".join(words), text, f"see {path} --help"), f"{text} (see {path} --help)", as_json)
    except InputError as error:
        _fail(error, str(error), as_json)
    except SystemExit as end:  # click ends with 1 where a pipe is closed, such as one to head
        if end.code == 1 and _nobody_reads():
            to_nowhere()
            sys.exit(0)
        raise
    except OSError as error:
        place, cause = str(error.filename or terminal.places() or "system"), str(error.strerror or error)
        _fail(InputError(place, cause, "a usable file or device"), one_line(f"{place}: {cause}"), as_json)
    except (click.Abort, KeyboardInterrupt):
        interrupt_handled()
        click.echo(f"trackres: interrupted; {terminal.written_so_far()}", err=True)
        sys.exit(INTERRUPTED)
    sys.exit(result if isinstance(result, int) else 0)


def _refuse_empty(words: Sequence[str]) -> None:
    """Refuse an empty text: as a path it would mean the current folder. Raises InputError for an empty text, with its option."""
    for last_word, argument in zip(["trackres", *words], words, strict=False):
        option, equals, value = argument.partition("=")
        if not argument.strip() or (equals and not value.strip() and option.startswith("--")):
            place = option or (last_word if last_word.startswith("-") else "trackres")
            raise InputError(place, "", "a text that is not empty", "if it comes from a shell variable, that variable is not set")


def _nobody_reads() -> bool:
    """Whether standard output is a pipe whose reader has closed it."""
    poll = select.poll()
    poll.register(sys.stdout.fileno(), 0)  # errors alone
    return bool(poll.poll(0))


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

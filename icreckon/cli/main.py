"""List of the commands; the file of a command is imported when it is called."""

import logging
import sys
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any, Literal

import typer
from typer import Option
from typer.core import TyperCommand
from typer.main import get_command_from_info
from typer.models import CommandInfo

from icreckon import __version__
from icreckon.cli.common.stopping import Stop, stopped_in_one_line, warned_in_one_line

app = typer.Typer(
    help="Dead reckoning for tracked and skid-steer robots whose ICRs move with inertia.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

DEBUG = "--debug"
LogLevel = Literal["debug", "info", "warning", "error"]
# First line of the help of each command. Its function is `command` in the file of its name, which takes
# up to a second to import.
COMMANDS = {
    "demo": "Simulate a bag of Auriga-alpha, read it back, compare variants.",
    "simulate": "Simulate a run and write it as a bag of standard messages.",
    "replay": "Run all filter variants over a log, or several, and score them.",
    "inspect": "List what a log holds, and propose a robot file for it.",
    "robots": "List the robots that ship with icreckon, for --robot.",
    "check": "Check a robot file against a log: units, signs, latency.",
    "calibrate": "Calibrate a robot from logs with a ground truth.",
    "export": "Write the filter of a robot in C, for microcontrollers and C++.",
    "paper": "Reproduce the paper: its numbers, its Table II, its figures.",
    "prepare": "Compile all filters ahead, for an image or a first drive.",
    "study": "Simulate many runs over a sweep of parameters; summarise them.",
    "ros2-node": "Run as a ROS 2 node: odometry, tf and diagnostics, live.",
}


def load(name: str) -> TyperCommand:
    """Import a command with its options from its file."""
    module = import_module(f"icreckon.cli.{name.replace('-', '_')}")
    settings = getattr(module, "CONTEXT_SETTINGS", None)
    info = CommandInfo(name, callback=module.command, context_settings=settings)
    command = get_command_from_info(info, pretty_exceptions_short=False, rich_markup_mode=None)
    assert isinstance(command, TyperCommand)  # noqa: S101 - no other class is asked for
    return command


class _Listed(TyperCommand):
    """Command of which only name and first line of the help are loaded."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        """Make the context of the command itself; a terminal shows that it is loaded."""
        if shown := sys.stderr.isatty():
            typer.echo(f"loading icreckon {self.name} ...", nl=False, err=True)
        command = load(str(self.name))
        if shown:
            typer.echo("\r\x1b[2K", nl=False, err=True)  # erases the line
        return command.make_context(info_name, args, parent, **extra)


# The functions are never called: `_Listed` calls those of the commands' files.
for _name, _help in COMMANDS.items():
    app.command(_name, cls=_Listed, help=_help)(lambda: None)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"icreckon {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    _debug: Annotated[bool, Option(DEBUG, help="Show tracebacks of errors.")] = False,
    log_level: Annotated[
        LogLevel | None, Option(help="Print what is logged to stderr, from this level on.")
    ] = None,
) -> None:
    if log_level is not None:
        logging.basicConfig(format="%(asctime)s %(levelname)s %(name)s: %(message)s")
        logging.getLogger("icreckon").setLevel(log_level.upper())


def main() -> None:
    """Entry point; errors are one line and a non-zero exit, tracebacks by --debug."""
    debug = DEBUG in sys.argv
    # Removed from the arguments, so that it may stand before or after the command.
    sys.argv = [word for word in sys.argv if word != DEBUG]
    for stream in (sys.stdout, sys.stderr):
        # Of characters that the terminal lacks question marks are shown.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    with warned_in_one_line(), stopped_in_one_line():
        try:
            app()
        except Exception as problem:
            if debug or Stop.number:
                raise
            from icreckon.cli.common.console import explain

            sys.exit(explain(problem))

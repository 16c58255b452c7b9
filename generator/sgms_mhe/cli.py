"""Command line `sgms-mhe`: the table of commands, exit codes, and the form of errors and interrupts.

Results go to stdout, messages and progress to stderr. Exit codes: 0 done, 1 done and the answer is no, 2 bad input, 130
and 143 interrupted. Every command is a module of its own, in `commands` or in a distribution that adds it, imported
when it is asked for.
"""

import gc
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from types import FrameType
from typing import Any, Final, NoReturn, cast

import click

from sgms_mhe import __version__
from sgms_mhe.commands.common import note
from sgms_mhe.support.errors import BuildError, InputError, MachineWarning, speak_to_command_line
from sgms_mhe.support.names import did_you_mean, name_distribution

COMMANDS: Final = (
    "start generate export inspect simulate predict estimate watch compare identify tune diagnose fleet plan check ci "
    "effects schema"
).split()
"""Modules of `sgms_mhe.commands` whose `command` each is, in the order of --help."""
ENTRY_POINTS: Final = "sgms_mhe.commands"
"""Group of entry points by which installed distributions add commands; the names above stay the product's."""
WORKBENCH: Final = ("bench", "bench-diagnosis", "compensate", "experiment", "target")
"""Commands that `bench/` of a checkout adds."""

GARBAGE_THRESHOLDS: Final = (50_000, 20, 50)
"""Of the interpreter's three generations of objects: how many more of the youngest, and how often the others."""
INTERRUPTED: Final = 128 + signal.SIGINT
TERMINATED: Final = 128 + signal.SIGTERM
PIPE_CLOSED: Final = 128 + signal.SIGPIPE


class BadInput(click.ClickException):
    """Error a user can correct: exit code 2."""

    exit_code = 2


class Commands(click.Group):
    """The group of commands: imports each when it is named, and turns errors into messages and exit codes."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of --help."""
        return command_names()

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command's module."""
        if cmd_name in COMMANDS:
            command: click.Command = importlib.import_module(f"sgms_mhe.commands.{cmd_name}").command
            return command
        entry = added_commands().get(cmd_name)
        return None if entry is None else _load(entry)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the options before the command's name; --quiet means the same behind it."""
        own = args[: args.index("--")] if "--" in args else args
        if "--quiet" in own[1:] or "-q" in own[1:]:
            rest = [arg for arg in own if arg not in ("--quiet", "-q")]
            args = ["--quiet", *rest, *args[len(own) :]]
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command the arguments name; the error of an unknown one has the nearest."""
        name = args[0]
        if name in COMMANDS or name.startswith("-") or ctx.resilient_parsing or name in added_commands():
            return super().resolve_command(ctx, args)
        if name in WORKBENCH:
            raise click.UsageError(
                f"{name!r} belongs to the workbench, which is in a checkout of the repository and not in the installed "
                "package: `make venv` there, then .venv/bin/sgms-mhe",
                ctx,
            )
        raise click.UsageError(f"No such command {name!r}{did_you_mean(name, command_names()) or '.'}", ctx)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command the arguments name."""
        with speak_to_command_line(), warnings.catch_warnings(), _outcomes(ctx):
            warnings.simplefilter("once", MachineWarning)
            warnings.showwarning = _tell
            result = super().invoke(ctx)
            sys.stdout.flush()  # here, where a closed pipe can still be told from success
            return result


def added_commands() -> Mapping[str, EntryPoint]:
    """Return the commands that other installed distributions add, by name."""
    return {entry.name: entry for entry in entry_points(group=ENTRY_POINTS) if entry.name not in COMMANDS}


def _load(entry: EntryPoint) -> click.Command:
    """The command of an entry point; of one that cannot be imported a command that says so, not to spoil --help."""
    try:
        return cast(click.Command, entry.load())
    except Exception as error:
        why = f"{name_distribution(entry)}: command {entry.name} = {entry.value}: {error}; repair or remove it"

    def refuse() -> NoReturn:
        raise BadInput(why)

    anything = {"allow_extra_args": True, "ignore_unknown_options": True}
    return click.Command(entry.name, anything, refuse, short_help="cannot be imported")


def command_names() -> list[str]:
    """Return the names of all commands: the product's in the order of a user's work, then those that are added."""
    return [*COMMANDS, *sorted(added_commands())]


def _tell(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """Print a warning on stderr, of a library with its kind."""
    note(str(message) if category is MachineWarning else f"{category.__name__}: {message}")


@contextmanager
def _outcomes(ctx: click.Context) -> Iterator[None]:
    try:
        yield
    except (InputError, BuildError) as error:
        raise BadInput(str(error)) from None
    except KeyboardInterrupt as interrupt:
        click.echo("Interrupted: nothing was left half-written.", err=True)
        ctx.exit(TERMINATED if interrupt.args == (signal.SIGTERM,) else INTERRUPTED)
    except BrokenPipeError:
        # Whoever read the output has enough. What is still buffered must not fail again when the interpreter ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        ctx.exit(PIPE_CLOSED)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="\b\nExample:\n  sgms-mhe simulate etel_xy --out axis.csv\n  sgms-mhe estimate etel_xy axis.csv --out e.csv",
)
@click.option("-q", "--quiet", is_flag=True, help="Say nothing but results and errors.")
@click.version_option(__version__, prog_name="sgms-mhe")
def cli(quiet: bool) -> None:
    """Friction observers for motion control: from a machine file to embedded C, and its trials on a host.

    MACHINE is a machine file (TOML), or the name of one in machines/. LOG is a measured or simulated log with the
    columns time_s, position_m, force_N; a text, NPZ, NPY, MAT, HDF5, Parquet or MDF file.

    Exit codes: 0 done, 1 done and the answer is no, 2 bad input.
    """
    # `quiet` is read where something would be said: commands/common.py.


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    # As an interrupt, so that files under way are taken back.
    raise KeyboardInterrupt(signal.SIGTERM)


def main() -> None:
    """Entry point of the console script."""
    # Modules and symbolic models are many objects that stay: to look through them as often as the usual thresholds ask
    # for finds nothing and takes time.
    gc.set_threshold(*GARBAGE_THRESHOLDS)
    signal.signal(signal.SIGTERM, _terminate)
    cli(prog_name="sgms-mhe")

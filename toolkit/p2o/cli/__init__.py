"""The command line. Commands are imported when they are called, and heavy packages inside them."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import Any

import click

from p2o.errors import LONGEST, InputError, P2OError, one_line
from p2o.native import keep_freed_memory

_COMMANDS = {
    "run": "Calibrate frames: find the transform from the LiDAR to the camera.",
    "check": "Say whether an extrinsic that is in use still holds, axis by axis, or since when not.",
    "methods": "List the methods that are installed, or explain one with all its options.",
    "plugins": "List the plugins as JSON: name, version, methods; the broken ones with reasons.",
    "plugin": "Write a plugin of your own to begin with: a package with one method.",
    "check-plugin": "Check that methods keep the contracts of their slots.",
    "data": "List, check, show or choose the frames of a dataset, or list the topics of a bag.",
    "ablate": "Run a study: methods x frames x starts, as a table that can be resumed and gated.",
    "basin": "Show which wrong starts methods still correct, as heat maps.",
    "report": "Write tables, figures and one page about the studies in a folder.",
    "labels": "Write what frames teach a method that learns, one file a frame.",
    "train": "Train a method on frames, or go on with a training.",
    "view": "Look at a frame in space, and find a start by hand, on a page in the browser.",
    "pick": "Pick points in image and sweep by hand, on a page in the browser.",
    "convert": "Convert a calibration file: ROS 2, Autoware, Kalibr, COLMAP, OpenCV, KITTI and others.",
    "doctor": "Look whether this installation can do its job, and what is missing.",
    "simulate": "Write synthetic streets in the layout of a real dataset.",
}
"""Name and one-line help of every command; the code of `a-b` is in the module `p2o.cli.a_b`, as `command`."""

INTERRUPTED = 130
CRASHED = 70


class _Commands(click.Group):
    """A group that imports a command's module when the command is called, not to list it."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module = importlib.import_module(f"p2o.cli.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as problem:  # click would write an empty line
            raise click.Abort from problem

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


def _show_version(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        from importlib.metadata import version

        click.echo(f"p2o {version('p2o-calib')}")
        ctx.exit()


@click.command(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_version, help="Show it.")
def group() -> None:
    """Find the rigid transform between a camera and a LiDAR from ordinary scenes, and compare methods that do.

    `p2o run` alone calibrates a synthetic scene. Exit status: 0 solved, 1 some calibration was refused or failed,
    2 wrong usage or input, 70 a defect, 130 interrupted.
    """


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status; errors are one line on stderr (P2O_DEBUG=1: a traceback)."""
    debug = os.environ.get("P2O_DEBUG", "") not in ("", "0")
    if argv is None:
        _be_a_program(debug)
    words = sys.argv[1:] if argv is None else list(argv)
    try:
        _check_readable(words)
        with _terminated_as_interrupted():
            status = group.main(words, prog_name="p2o", standalone_mode=False)
        sys.stdout.flush()
    except (click.Abort, KeyboardInterrupt):
        click.echo("p2o: interrupted", err=True)
        return INTERRUPTED
    except click.exceptions.NoArgsIsHelpError as problem:
        problem.show()
        return 2
    except BrokenPipeError:
        # The reader (head, less) has seen enough. Python would complain again when it closes stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as problem:
        if debug:
            raise
        return _tell(problem)
    return status if isinstance(status, int) else 0


def _be_a_program(debug: bool) -> None:
    """Set what belongs to the whole process, and is not for who calls `main` from Python."""
    for stream in (sys.stdout, sys.stderr):
        # A name that the terminal's encoding lacks is shown as an escape.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    keep_freed_memory()
    # Warnings of NumPy and others speak to who wrote the code; what users have to know is in results and errors.
    if not (debug or sys.warnoptions):
        warnings.simplefilter("ignore")


def _check_readable(words: Sequence[str]) -> None:
    """Raise InputError for words that are no text: nothing that is written could hold them."""
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError as problem:
            raise InputError(
                "the command holds bytes that are not UTF-8", got=word, hint="rename the file or folder"
            ) from problem


@contextlib.contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Let a request to end (SIGTERM, a closed terminal) do what Ctrl-C does, unless somebody cares for it already."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    taken = []
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # Ignored (nohup) stays ignored; outside the main thread there are no handlers.
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            with contextlib.suppress(ValueError):
                signal.signal(number, interrupt)
                taken.append(number)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def _tell(problem: Exception) -> int:
    """Say in one line what went wrong and return the exit status."""
    if isinstance(problem, P2OError):
        click.echo(f"p2o: error: {problem}", err=True)
        return problem.exit_code
    if isinstance(problem, click.UsageError):
        command = problem.ctx.command_path if problem.ctx is not None else "p2o"
        text, status = f"{problem.format_message()}; see {command} --help", problem.exit_code
    elif isinstance(problem, click.ClickException):
        text, status = problem.format_message(), problem.exit_code
    elif isinstance(problem, OSError):
        text, status = f"{problem.filename or 'system'}: {problem.strerror or problem}", 2
    elif isinstance(problem, MemoryError):
        text, status = "there is not enough memory; take fewer frames at once, or smaller ones", 2
    else:
        text = f"unexpected {type(problem).__name__}: {problem}; set P2O_DEBUG=1 to see where, and report it"
        status = CRASHED
    click.echo("p2o: error: " + one_line(text, LONGEST), err=True)
    return status

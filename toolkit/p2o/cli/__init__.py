"""The command line. Modules of commands are imported on demand, heavy packages inside their functions."""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.metadata import entry_points
from typing import Any

import click

from p2o.cli.completion import VARIABLE, answer_shell
from p2o.cli.json_output import STDOUT, reserved_stdout, wants_json
from p2o.errors import LONGEST, InputError, P2OError, one_line, terminate
from p2o.runtime.native import keep_freed_memory

_COMMANDS = {
    "run": "Calibrate frames: estimate the transform from the LiDAR to the camera.",
    "check": "Check whether an extrinsic in use is still valid, by axis, or since when it is not.",
    "methods": "List the installed methods, or explain one with all its options.",
    "plugin": "List the installed plugins, create a package for your own, or check one.",
    "data": "List, check, show or select the frames of a dataset, or list the topics of a bag.",
}
"""Name and one-line help of the commands of this package; the code of `a-b` is in `p2o.cli.a_b`, as `command`."""
COMMAND_GROUP = "p2o.commands"
"""Entry points of packages that add commands: each names a mapping of names to one-line helps in `PACKAGE.commands`."""

_SYSTEM_HINTS = {
    errno.EMFILE: "this process may open {limit} files: raise the limit, e.g. `ulimit -n 1024`, or use fewer --jobs",
    errno.ENFILE: "the system has no more open files: end other programs, or use fewer --jobs",
    errno.ENOSPC: "free some space there, and run the same command again",
    errno.EROFS: "make it writable, or choose another folder with --out, P2O_CACHE or TMPDIR",
}
"""The next step for errors of the operating system, by number."""
INTERRUPTED = 130
CRASHED = 70


@cache
def added_commands() -> dict[str, tuple[str, str]]:
    """Return help and module of the commands that other packages add, by name ("a" or "a b", a command of group a).

    A package that fails to import costs its own commands and one line on stderr.
    """
    added: dict[str, tuple[str, str]] = {}
    for entry in sorted(entry_points(group=COMMAND_GROUP), key=lambda entry: entry.name):
        package = entry.module.rpartition(".")[0]
        try:
            commands = entry.load()
        except KeyboardInterrupt:
            raise
        except BaseException as problem:
            text = one_line(problem, LONGEST)
            print(f"p2o: warning: commands of {package} left out: {text}", file=sys.stderr)
            continue
        for name, text in commands.items():
            module = name.replace("-", "_").replace(" ", "_")
            added.setdefault(name, (text, f"{package}.cli.{module}"))
    return added


def command_helps() -> dict[str, str]:
    """Return the one-line help of every command by name."""
    added = {name: text for name, (text, _) in added_commands().items() if " " not in name}
    return _COMMANDS | {name: text for name, text in added.items() if name not in _COMMANDS}


def load_command(module: str) -> click.Command:
    """Return the command that a module defines as `command`."""
    command: click.Command = importlib.import_module(module).command
    return command


class SubGroup(click.Group):
    """A group with the commands that other packages add to it."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        word = f"{self.name} "
        added = [name.removeprefix(word) for name in added_commands() if name.startswith(word)]
        return [*super().list_commands(ctx), *added]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        added = added_commands().get(f"{self.name} {cmd_name}")
        return super().get_command(ctx, cmd_name) if added is None else load_command(added[1])


class _ClosedPipeError(Exception):
    """The reader of stdout (head, less) has ended."""


class _Commands(click.Group):
    """A group that imports the module of a command when it is called, not to list it."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(command_helps())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in _COMMANDS:
            return load_command(f"p2o.cli.{cmd_name.replace('-', '_')}")
        added = added_commands().get(cmd_name)
        return None if added is None else load_command(added[1])

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as problem:  # click would print an empty line
            raise click.Abort from problem
        except BrokenPipeError as problem:  # click would exit with status 1
            raise _ClosedPipeError from problem

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(command_helps().items()))


def _show_version(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        from importlib.metadata import version

        click.echo(f"p2o {version('p2o-calib')}")
        ctx.exit()


@click.command(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_show_version, help="Show the version."
)
def group() -> None:
    """Estimate the extrinsic of camera and LiDAR from scenes without targets, and compare methods.

    `p2o run` without options calibrates a built-in frame. Exit status: 0 solved, 1 a calibration was refused or
    failed, 2 wrong usage or input, 70 a defect, 130 interrupted.
    """


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status; errors are one line on stderr (P2O_DEBUG=1: a traceback)."""
    debug = os.environ.get("P2O_DEBUG", "") not in ("", "0")
    if argv is None:
        _set_up_process(debug)
    words = sys.argv[1:] if argv is None else list(argv)
    try:
        if instruction := os.environ.get(VARIABLE):
            return answer_shell(group, instruction)
        _check_readable(words)
        reserved = reserved_stdout(restored=argv is not None) if wants_json(words) else contextlib.nullcontext()
        with reserved, _terminated_by_signals():
            status = group.main(words, prog_name="p2o", standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()
    except (click.Abort, KeyboardInterrupt):
        click.echo("p2o: interrupted", err=True)
        return INTERRUPTED
    except click.exceptions.NoArgsIsHelpError as problem:
        problem.show()
        return 2
    except (BrokenPipeError, _ClosedPipeError):
        # The reader (head, less) has closed the pipe; Python would raise again when it closes stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), STDOUT)
        return 0
    except BaseException as problem:  # SystemExit of a plugin would look like success
        if debug and isinstance(problem, Exception):
            raise
        return _report(problem)
    return status if isinstance(status, int) else 0


def _set_up_process(debug: bool) -> None:
    """Change process-wide settings, which must not happen when Python code calls `main`."""
    for stream in (sys.stdout, sys.stderr):
        # Characters that the terminal cannot encode are printed as escapes.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    keep_freed_memory()
    # Warnings of libraries are for developers; results and errors contain everything for users.
    if not (debug or sys.warnoptions):
        warnings.simplefilter("ignore")
    if not debug:
        threading.excepthook = _report_thread


def _report_thread(ended: threading.ExceptHookArgs) -> None:
    """Print in one line what a thread of a plugin raised."""
    text = f"a thread ended with {ended.exc_type.__name__}: {one_line(ended.exc_value, LONGEST)}"
    click.echo(f"p2o: warning: {text}; P2O_DEBUG=1 shows where", err=True)


def _check_readable(words: Sequence[str]) -> None:
    """Raise InputError for words that are not valid UTF-8, which cannot be written to files."""
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError as problem:
            text = "the command contains bytes that are not UTF-8"
            raise InputError(text, got=word, hint="rename the file or folder") from problem


@contextlib.contextmanager
def _terminated_by_signals() -> Iterator[None]:
    """Raise Terminated for Ctrl-C, SIGTERM and SIGHUP, unless they have a handler."""
    replaced = {}
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # Ignored signals (nohup) stay ignored; handlers can only be set in the main thread.
        if number is not None and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            with contextlib.suppress(ValueError):
                replaced[number] = signal.signal(number, terminate)
    try:
        yield
    finally:
        for number, handler in replaced.items():
            signal.signal(number, handler)


def _system_hint(number: int | None) -> str:
    """Return the next step for an error number of the operating system, empty if there is none."""
    try:
        from resource import RLIMIT_NOFILE, getrlimit

        limit = str(getrlimit(RLIMIT_NOFILE)[0])
    except ImportError:  # Windows, or no file may be opened to import it
        limit = "no more"
    return _SYSTEM_HINTS.get(number or 0, "").format(limit=limit)


def _package_of(problem: ModuleNotFoundError) -> str:
    """Return the requirement of p2o or of one of its extras that has a missing module, empty if there is none."""
    from p2o.host.registry import DISTRIBUTION, requirement_named

    return requirement_named((problem.name or "").partition(".")[0], DISTRIBUTION)


def _report(problem: BaseException) -> int:
    """Print an error in one line and return the exit status."""
    if isinstance(problem, P2OError):
        click.echo(f"p2o: error: {problem}", err=True)
        return problem.exit_code
    if isinstance(problem, click.UsageError):
        command = problem.ctx.command_path if problem.ctx is not None else "p2o"
        text, status = f"{problem.format_message().rstrip('.')}; see {command} --help", problem.exit_code
    elif isinstance(problem, click.ClickException):
        text, status = problem.format_message(), problem.exit_code
    elif isinstance(problem, OSError):
        text = f"{problem.filename or 'system'}: {problem.strerror or problem}"
        text, status = "; ".join(filter(None, (text, _system_hint(problem.errno)))), 2
    elif isinstance(problem, ModuleNotFoundError) and (package := _package_of(problem)):
        text, status = f"needs the package {problem.name}, which is not installed; run: pip install {package}", 2
    elif isinstance(problem, MemoryError):
        text, status = "not enough memory; use fewer or smaller frames", 2
    else:
        text = (
            f"unexpected {type(problem).__name__}: {one_line(problem)}; set P2O_DEBUG=1 for a traceback, and report it"
        )
        status = CRASHED
    click.echo("p2o: error: " + one_line(text, LONGEST), err=True)
    return status

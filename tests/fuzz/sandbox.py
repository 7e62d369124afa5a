"""One command in a forked process: with limits on time and memory, and an eye on every file that it touches."""

from __future__ import annotations

import contextlib
import os
import resource
import select
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CPU_S = 30
"""A case may compute this long; the longest one that is right takes a tenth of it."""
WALL_S = 150
"""And last this long, on a machine that does other things, too: what waits for a pipe waits for ever."""
PEAK_BYTES = 1_500_000_000
_FILE_BYTES = 256 << 20

WRITABLE = ("out", "cache", "home", "tmp")
"""The folders of a case that a command may write to; `in` and everything else it may not."""
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGES = {"os.mkdir", "os.rmdir", "os.remove", "os.rename", "os.link", "os.symlink", "os.truncate", "os.chmod"}
_FORBIDDEN = {"os.system", "os.exec", "os.posix_spawn", "os.fork", "subprocess.Popen", "socket.connect", "socket.bind"}


@dataclass(frozen=True)
class Outcome:
    """How a command ended: `status` is None where a signal ended it; `trespass` names what it must not touch.

    `interrupted` states that it was interrupted because it announced to hang; `hung`, that it did not end in time.
    """

    status: int | None
    signal: int
    hung: bool
    interrupted: bool
    cpu_s: float
    peak_bytes: int
    stdout: bytes
    stderr: bytes
    trespass: tuple[str, ...]


def run(command: Callable[[], int], folder: Path, hangs: str = "") -> Outcome:
    """Run a command in a fork of this process, inside `folder`, and return how it ended.

    If the command writes the file `hangs`, its process group is sent a SIGINT, as Ctrl-C does.
    """
    for name in WRITABLE:
        (folder / name).mkdir(exist_ok=True)
    files = [folder / "stdout", folder / "stderr", folder / "trespass"]
    handles = [os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644) for file in files]
    child = os.fork()
    if child == 0:
        _inside(command, folder, *handles)
    for handle in handles:
        os.close(handle)
    interrupted, hung = _waited(child, folder / hangs if hangs else None)
    if hung:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    _, state, used = os.wait4(child, 0)
    stdout, stderr, trespass = (file.read_bytes() for file in files)
    killed = os.WTERMSIG(state) if os.WIFSIGNALED(state) else 0
    return Outcome(
        status=os.WEXITSTATUS(state) if os.WIFEXITED(state) else None,
        signal=killed,
        interrupted=interrupted,
        hung=hung or killed == signal.SIGXCPU,
        cpu_s=used.ru_utime + used.ru_stime,
        peak_bytes=used.ru_maxrss * 1024,
        stdout=stdout,
        stderr=stderr,
        trespass=tuple(trespass.decode(errors="replace").splitlines()),
    )


def _waited(child: int, hangs: Path | None) -> tuple[bool, bool]:
    """Wait for a process; return whether it was interrupted, and whether it still runs."""
    handle, interrupted, end_s = os.pidfd_open(child), False, time.monotonic() + WALL_S
    try:
        while (left_s := end_s - time.monotonic()) > 0:
            watched = hangs is not None and not interrupted
            if select.select([handle], [], [], min(left_s, 0.1) if watched else left_s)[0]:
                return interrupted, False
            if watched and hangs is not None and hangs.exists():
                os.killpg(child, signal.SIGINT)
                interrupted = True
        return interrupted, True
    finally:
        os.close(handle)


def _inside(command: Callable[[], int], folder: Path, stdout: int, stderr: int, trespass: int) -> None:
    """Run the command and end the process with its status; 255 for an error that nobody caught."""
    status = 255
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        os.chdir(folder)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(stdout, 1)
        os.dup2(stderr, 2)
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
        sys.dont_write_bytecode = True
        os.environ.update(
            HOME=str(folder / "home"),
            P2O_CACHE=str(folder / "cache"),
            TMPDIR=str(folder / "tmp"),
            MPLCONFIGDIR=str(folder / "home"),
        )
        warnings.resetwarnings()
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        _limit()
        with _watched(folder, trespass):
            status = command()
    except SystemExit as problem:
        status = problem.code if isinstance(problem.code, int) else 254
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _limit() -> None:
    with open("/proc/self/statm", encoding="ascii") as file:
        taken = int(file.read().split()[0]) * resource.getpagesize()
    spent = resource.getrusage(resource.RUSAGE_SELF)
    cpu = int(spent.ru_utime + spent.ru_stime) + CPU_S
    resource.setrlimit(resource.RLIMIT_AS, (taken + 2 * PEAK_BYTES,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 2))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_BYTES,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


@contextlib.contextmanager
def _watched(folder: Path, trespass: int) -> Iterator[None]:
    """Note every file that is changed outside the writable folders, and every program or connection that is begun."""
    allowed = tuple(str((folder / name).resolve()) for name in WRITABLE)
    busy = False

    def hook(event: str, args: tuple[Any, ...]) -> None:
        nonlocal busy
        if busy:
            return
        busy = True
        try:
            if event == "open":
                path, _, flags = args
                if isinstance(flags, int) and flags & _WRITES:
                    check(event, path)
            elif event in _CHANGES:
                two = event in ("os.rename", "os.link")
                for number, path in enumerate(args[:2] if two else args[:1]):
                    check(event, path, args[2 + number] if two else args[-1])
            elif event == "subprocess.Popen" and args[0] == sys.executable:
                pass  # a process of p2o's own, such as the one that unpacks .laz files
            elif event in _FORBIDDEN:
                os.write(trespass, f"{event} {args!r}\n".encode(errors="replace"))
        finally:
            busy = False

    def check(event: str, path: Any, folder_handle: Any = -1) -> None:
        if isinstance(path, int) or path is None:
            return
        text = os.fsdecode(path)
        if isinstance(folder_handle, int) and folder_handle >= 0 and event not in ("os.truncate", "os.symlink"):
            text = os.path.join(os.readlink(f"/proc/self/fd/{folder_handle}"), text)
        real = os.path.realpath(text) if event == "open" else os.path.join(_real_parent(text), os.path.basename(text))
        if real != os.devnull and not any(real == root or real.startswith(root + os.sep) for root in allowed):
            os.write(trespass, f"{event} {text!r}\n".encode(errors="replace"))

    sys.addaudithook(hook)
    yield


def _real_parent(text: str) -> str:
    return os.path.realpath(os.path.dirname(os.path.abspath(text)))

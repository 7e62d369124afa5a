"""The viser server of both pages: protection, the list of frames, status lines, errors."""

from __future__ import annotations

import asyncio
import contextlib
import io
import socket
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from html import escape
from typing import Any, Protocol, Self

from p2o.errors import InputError, P2OError, printable
from p2o.runtime.packages import optional_package

HOST = "127.0.0.1"
_MAX_LISTED_FRAMES = 500
"""Number of frames in the dropdown: those around the current frame."""
_POLL_S = 0.2


class FrameSession(Protocol):
    """State of a page that shows one frame at a time; `number` indexes `names`."""

    names: tuple[str, ...]
    number: int

    def look_at(self, number: int) -> None:
        """Show another frame; raises InputError if it cannot be read, and then changes nothing."""


class PageServer(ABC):
    """Serves one page of viser on `host` until `close`; use it in a `with`. `url` is the address of the page.

    Connections from pages of other origins are refused, and viser's share function is off. All clients see one state.
    Raises MethodUnavailable if viser is not installed, InputError if the port is in use or not permitted.
    """

    def __init__(self, command: str, session: FrameSession, host: str = HOST, port: int = 0) -> None:
        viser = require_viser(command)
        self.host, self.port = host, _free_port(host, port)

        class _Server(viser.ViserServer):  # type: ignore[name-defined, misc]
            """A server that refuses to publish its page through viser's relay."""

            def request_share_url(self, verbose: bool = True) -> str | None:
                return None

        with _silent(), _same_origin(host, self.port):
            self._viser = _Server(host=host, port=self.port, label=command, verbose=False)
        if self._viser.get_port() != self.port:
            self.close()
            raise _port_error(host, self.port)
        self._viser.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large", dark_mode=True)
        self.session, self._lock, self._notice = session, threading.RLock(), ""
        self.done = threading.Event()
        if len(session.names) > 1:
            self.frames = self._viser.gui.add_dropdown(
                "frame", self._frame_labels(), initial_value=self._frame_label(session.number)
            )
            self.frames.on_update(lambda _: self._open_frame(_number_of(self.frames.value)))
        self.status = self._viser.gui.add_html("")

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://{'localhost' if self.host in ('0.0.0.0', '::') else self.host}:{self.port}/"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving."""
        with _silent():
            self._viser.stop()

    def serve(self, text: str, browser: bool) -> None:
        """Print a text and wait for `done` or Ctrl-C; `browser` opens the page in the browser of the user, if any."""
        import webbrowser

        with contextlib.suppress(KeyboardInterrupt):
            print(text, flush=True)
            if browser:
                with contextlib.suppress(webbrowser.Error, OSError):
                    webbrowser.open(self.url)
            while not self.done.wait(_POLL_S):
                pass

    @abstractmethod
    def show(self, *, frame: bool = False) -> None:
        """Show the state of the session; with `frame` also the image and points of a new frame."""

    @abstractmethod
    def lines(self) -> list[str]:
        """Return the lines of the status: name of the frame, then sentences."""

    def tell(self, text: str) -> None:
        """Show a message below the status lines."""
        with self._lock:
            self._notice = text
            self._show_status()

    def _show_status(self) -> None:
        self.status.content = _html([*self.lines(), *([self._notice] if self._notice else [])])

    def _succeeds(self, change: Callable[[], Any]) -> bool:
        """Change the session; on an error show its message instead and return False."""
        self._notice = ""
        try:
            change()
        except P2OError as problem:
            self.tell(str(problem))
        except Exception as problem:
            self.tell(f"unexpected {type(problem).__name__}: {problem}")
        else:
            return True
        return False

    # ---- the list of frames

    def _open_frame(self, number: int) -> None:
        """Show another frame, and mark it in the list; the current one stays there if the other cannot be read."""
        with self._lock:
            if number == self.session.number or not 0 <= number < len(self.session.names):
                return
            if self._succeeds(lambda: self.session.look_at(number)):
                self.show(frame=True)
            self._list_frames()

    def _list_frames(self) -> None:
        """Update the list of frames."""
        if len(self.session.names) > 1:
            # In this order: viser selects the first option if the value is not among new options.
            self.frames.value = self._frame_label(self.session.number)
            self.frames.options = self._frame_labels()

    def _frame_labels(self) -> list[str]:
        count = len(self.session.names)
        first = max(min(self.session.number - _MAX_LISTED_FRAMES // 2, count - _MAX_LISTED_FRAMES), 0)
        return [self._frame_label(number) for number in range(first, min(first + _MAX_LISTED_FRAMES, count))]

    def _frame_label(self, number: int) -> str:
        """Return the text of a frame in the list, which begins with its number and a colon."""
        return f"{number}: {printable(self.session.names[number])}"


def _number_of(label: str) -> int:
    """Return the number in a text of the list of frames, -1 for other texts, as a foreign client may send."""
    number = label.partition(":")[0]
    return int(number) if number.isascii() and number.isdigit() and len(number) < 10 else -1


def require_viser(command: str) -> Any:
    """Return the package viser; raises MethodUnavailable if it is not installed."""
    return optional_package("viser", command, '"viser>=1.1"')


def _html(lines: Sequence[str]) -> str:
    first, *rest = (escape(printable(line, 500)) for line in lines)
    style = "margin:2px 0;font-size:0.8em;line-height:1.3;overflow-wrap:anywhere"
    texts = "".join(f'<p style="{style}">{text}</p>' for text in rest)
    return f'<div style="padding:0 0.8em"><b>{first}</b>{texts}</div>'


def _free_port(host: str, port: int) -> int:
    """Return the port, or any free one for 0; viser itself would silently use the next free port instead."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as problem:
        raise _port_error(host, port, problem) from problem


def _port_error(host: str, port: int, problem: Exception | None = None) -> InputError:
    return InputError(
        "the port cannot be used",
        where=f"{host}:{port}",
        got=getattr(problem, "strerror", None) or problem,
        hint="leave --port out, or name another",
    )


@contextlib.contextmanager
def _same_origin(host: str, port: int) -> Iterator[None]:
    """Make the server that viser starts within this context accept requests of its own page only, without tracebacks.

    viser does not check the origin of a connection: any other page in the same browser could read images and clouds.
    """
    import re

    from websockets.asyncio import server

    addresses = {f"{name}:{port}" for name in ("localhost", HOST, host)}
    origins: list[Any] = [f"http://{address}" for address in addresses]
    is_local = host in (HOST, "localhost")
    if not is_local:
        # Other machines reach it by names that are unknown here.
        origins.append(re.compile(rf"http://[^/]+:{port}"))
    serve = server.serve

    def guarded_serve(handler: Any, *words: Any, process_request: Any = None, **options: Any) -> Any:
        def respond(connection: Any, request: Any) -> Any:
            # A page of another name that resolves to this machine (DNS rebinding) has its own name here.
            if is_local and not {*request.headers.get_all("Host")} <= addresses:
                return connection.respond(403, "unknown Host\n")
            response = process_request(connection, request) if process_request else None
            if response is not None:
                response.headers["Content-Security-Policy"] = _POLICY.format(port=port)
                response.headers["X-Content-Type-Options"] = "nosniff"
            return response

        return serve(_one_line_errors(handler), *words, process_request=respond, origins=origins, **options)

    server.serve = guarded_serve
    try:
        yield
    finally:
        server.serve = serve


_POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' data: blob: ws://*:{port}; "
    "frame-ancestors 'none'; form-action 'none'; base-uri 'none'"
)
"""Content security policy of the client of viser, which unpacks itself in scripts: nothing is loaded from outside."""


def _one_line_errors(handler: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a handler of connections that reports a malformed message in one line and closes its connection."""

    def report(_: object, context: dict[str, Any]) -> None:
        problem = context.get("exception") or context.get("message", "")
        print(f"p2o: ignored a malformed message of the page: {printable(repr(problem), 200)}", file=sys.stderr)

    async def handle(connection: Any) -> None:
        asyncio.get_running_loop().set_exception_handler(report)
        try:
            await handler(connection)
        except Exception as problem:
            report(None, {"exception": problem})
            await connection.close(1007)

    return handle


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Discard what viser prints to the terminal."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield

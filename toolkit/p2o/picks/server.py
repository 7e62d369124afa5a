"""The page of `p2o pick` over HTTP: for this machine only, behind an address that nobody can guess."""

from __future__ import annotations

import base64
import hashlib
import hmac
import importlib.resources
import json
import secrets
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from p2o.errors import InputError, P2OError
from p2o.files.parsed_text import parse_json
from p2o.picks.session import Session

HOST = "127.0.0.1"
MOST_BYTES = 4 << 20
"""No body of a request is larger: some thousand pairs are a tenth of it."""
_SILENT_S = 30.0


class PickServer:
    """Serves one session on 127.0.0.1 until `done` is set or it is closed; use it in a `with`.

    `url` holds a secret of 128 bits: without it everything is answered by 404. Requests for another host (a page of the
    web whose name leads here) and from another origin are refused.

    Raises InputError where the port is taken or not allowed.
    """

    def __init__(self, session: Session, port: int = 0) -> None:
        self.session = session
        self.done = threading.Event()
        self.token = secrets.token_urlsafe(16)
        try:
            self._http = _Server((HOST, port), _handler(self))
        except (OSError, OverflowError) as problem:
            raise InputError(
                "the port cannot be used",
                where=f"{HOST}:{port}",
                got=getattr(problem, "strerror", None) or problem,
                hint="leave --port out, or name another",
            ) from problem
        self.port = int(self._http.server_address[1])
        self._thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)

    @property
    def origin(self) -> str:
        """What the address begins with."""
        return f"http://{HOST}:{self.port}"

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"{self.origin}/{self.token}/"

    def __enter__(self) -> PickServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._http.shutdown()
        self._thread.join()
        self._http.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    # Another program may not listen on the same port beside this one.
    allow_reuse_address = False

    def handle_error(self, *_: object) -> None:
        """Say nothing of a browser that went away."""


class _Refused(Exception):  # noqa: N818  (an answer, not a defect)
    def __init__(self, status: HTTPStatus, text: str = "") -> None:
        super().__init__(text)
        self.status, self.text = status, text


def _handler(server: PickServer) -> type[BaseHTTPRequestHandler]:
    """Return the class that answers requests for one server."""
    session, page = server.session, _page()

    def number(word: str) -> int:
        if not word.isascii() or not word.isdigit() or len(word) > 9 or int(word) >= len(session.names):
            raise _Refused(HTTPStatus.NOT_FOUND)
        return int(word)

    def place(word: str) -> float:
        # Digits and a point alone: not nan, inf, 1e999 or digits of other scripts.
        if len(word) > 16 or not word or not set(word) <= set("0123456789."):
            raise _Refused(HTTPStatus.NOT_FOUND)
        try:
            return float(word)
        except ValueError as problem:
            raise _Refused(HTTPStatus.NOT_FOUND) from problem

    class Handler(BaseHTTPRequestHandler):
        timeout = _SILENT_S
        protocol_version = "HTTP/1.1"
        server_version, sys_version = "p2o", ""

        def do_GET(self) -> None:
            self._answer(self._got)

        def do_POST(self) -> None:
            self._answer(self._posted)

        def log_message(self, *_: Any) -> None:
            """Say nothing: the terminal is for what the user has to know."""

        def _answer(self, make: Callable[[list[str]], tuple[str, bytes]]) -> None:
            try:
                words = self._path()
                # The page hears of the end before it comes.
                ending = self.command == "POST" and words == ["done"]
                kind, body = make(words)
                self._send(HTTPStatus.OK, kind, body)
                if ending:
                    server.done.set()
            except _Refused as refused:
                self._send(refused.status, *_as_json({"error": refused.text or refused.status.phrase}))
            except P2OError as problem:
                self._send(HTTPStatus.BAD_REQUEST, *_as_json({"error": str(problem)}))
            except Exception as problem:
                text = f"unexpected {type(problem).__name__}: {problem}"
                self._send(HTTPStatus.INTERNAL_SERVER_ERROR, *_as_json({"error": text}))

        def _path(self) -> list[str]:
            """Return the words of the address after the token; refuse who does not know it."""
            if self.headers.get("Host") != f"{HOST}:{server.port}":
                raise _Refused(HTTPStatus.FORBIDDEN, "another host")
            first, *words = self.path.removeprefix("/").split("/")
            if not hmac.compare_digest(first.encode("utf-8", "replace"), server.token.encode()):
                raise _Refused(HTTPStatus.NOT_FOUND)
            return words

        def _got(self, words: list[str]) -> tuple[str, bytes]:
            match words:
                case [""]:
                    return "text/html; charset=utf-8", page[0]
                case ["overview"]:
                    return _as_json(session.overview())
                case ["frame", at]:
                    return _as_json(session.described(number(at)))
                case ["picture", at, layer]:
                    try:
                        return "image/png", session.picture(number(at), layer)
                    except KeyError as problem:
                        raise _Refused(HTTPStatus.NOT_FOUND) from problem
                case ["point", at, column, row]:
                    return _as_json(session.point(number(at), place(column), place(row)))
            raise _Refused(HTTPStatus.NOT_FOUND)

        def _posted(self, words: list[str]) -> tuple[str, bytes]:
            # Whatever is refused, a body that was not read must not be taken for the next request.
            self.close_connection = True
            if self.headers.get("Origin") not in (None, server.origin):
                raise _Refused(HTTPStatus.FORBIDDEN, "another origin")
            if self.headers.get_content_type() != "application/json":
                raise _Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE)
            length = self.headers.get("Content-Length", "")
            if not length.isascii() or not length.isdigit() or len(length) > 9:
                raise _Refused(HTTPStatus.LENGTH_REQUIRED)
            if int(length) > MOST_BYTES:
                raise _Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
            try:
                body = self.rfile.read(int(length))
            except TimeoutError as problem:
                raise _Refused(HTTPStatus.REQUEST_TIMEOUT) from problem
            values = parse_json(body, "request")
            match words:
                case ["pairs", at]:
                    return _as_json({"count": session.keep(number(at), values), "path": str(session.path)})
                case ["solve"]:
                    return _as_json(session.solve())
                case ["done"]:
                    return _as_json({"count": session.count, "path": str(session.path)})
            raise _Refused(HTTPStatus.NOT_FOUND)

        def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
            self.send_response(status)
            headers = {
                "Content-Type": kind,
                "Content-Length": str(len(body)),
                "Content-Security-Policy": page[1],
                "Cache-Control": "no-store",
                "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer",
                "Cross-Origin-Resource-Policy": "same-origin",
                "Cross-Origin-Opener-Policy": "same-origin",
            }
            if self.close_connection:
                headers["Connection"] = "close"
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

    return Handler


def _as_json(value: Any) -> tuple[str, bytes]:
    return "application/json", json.dumps(value, allow_nan=False).encode()


def _page() -> tuple[bytes, str]:
    """Return the page and its content security policy: its own script and style, its own server, nothing else."""
    html, style, script = (_part(f"page.{kind}") for kind in ("html", "css", "js"))
    policy = f"default-src 'none'; script-src {_source_hash(script)}; style-src {_source_hash(style)}; "
    policy += "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    return html.replace("{{style}}", style).replace("{{script}}", script).encode(), policy


def _part(name: str) -> str:
    return importlib.resources.files("p2o.picks").joinpath(name).read_text(encoding="utf-8")


def _source_hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

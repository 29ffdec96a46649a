"""The local page of a reduced model: a small server, the page, answers to its requests."""

import errno
import json
import secrets
import webbrowser
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from myork.console import ProgressCallback, silent
from myork.errors import InputError, MyorkError
from myork.report.frame import render
from myork.view.answers import Answers

T = TypeVar("T")
#: Parameters of a request, by name
Asked = dict[str, str]

#: Serve this machine only
_HOST = "127.0.0.1"
#: Host names under which a browser on this machine, or at the end of a tunnel to it, reaches it
_NAMES = ("127.0.0.1", "localhost", "[::1]")
#: Replaces missing numbers among the values; the page draws it grey
_NONE = 1e38
#: Timeout of a connection that waits for a request or for its answer to be read [s]
_IDLE = 10.0


def serve(
    path: str | Path,
    *,
    port: int = 0,
    browser: bool = True,
    threads: int = 1,
    progress: ProgressCallback = silent,
) -> None:
    """Serve the page of a reduced model until Ctrl-C, SIGTERM or, for the command, SIGHUP.

    - `path`: reduced model (.rom.h5)
    - `port`: port of this machine; 0 takes a free one
    - `browser`: open the page in a browser
    - `threads`: threads of a batch
    - `progress`: called with the address when the page can be opened; without the token in
      it, requests are refused
    - raises InputError: the port is in use
    """
    try:
        server = _Server(port)
    except OSError as reason:
        if reason.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        taken = "is in use" if reason.errno == errno.EADDRINUSE else "is not allowed"
        raise InputError(
            f"--port {port}: {taken}; choose another, or omit --port to use a free one"
        ) from None
    with server, Answers(Path(path), threads) as server.answers:
        progress(f"view: {server.address}  (Ctrl-C ends it)")
        if browser:
            webbrowser.open(server.address)
        try:
            server.serve_forever(poll_interval=0.1)
        except KeyboardInterrupt:
            progress("view ended")
        finally:
            # no answer is computed while the scene closes
            server.turn.shutdown(cancel_futures=True)


class _Refused(Exception):
    """A request that is refused, with its status and the reason."""


class _Server(ThreadingHTTPServer):
    """A thread for each connection, and one that computes for all of them in order of arrival.

    Its address contains a token known only to the user who started the server.
    """

    answers: Answers  #: Answers to the requests

    def __init__(self, port: int) -> None:
        super().__init__((_HOST, port), _Handler)
        port = self.server_address[1]
        self.token = secrets.token_urlsafe(16)
        self.address = f"http://{_HOST}:{port}/{self.token}/"
        #: Allowed hosts of a request: a foreign page whose name resolves to here has another host
        self.hosts = {f"{name}:{port}" for name in _NAMES} | set(_NAMES if port == 80 else ())
        self.turn = ThreadPoolExecutor(max_workers=1)  #: The computing thread

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that disconnects in the middle of an answer is not an error."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    # otherwise the second packet of an answer waits 40 ms for the client to acknowledge the first
    disable_nagle_algorithm = True
    timeout = _IDLE
    server: _Server

    def do_GET(self) -> None:
        """Answer a request of the page."""
        status, kind = HTTPStatus.OK, "text/plain; charset=utf-8"
        try:
            kind, body = self._answer()
        except _Refused as refused:
            status, text = refused.args
            body = text.encode()
        except MyorkError as reason:
            status, body = HTTPStatus.BAD_REQUEST, str(reason).encode()
        except Exception as reason:
            status = HTTPStatus.INTERNAL_SERVER_ERROR
            text = f"internal error, please report it: {type(reason).__name__}: {reason}"
            body = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """No log: there may be hundreds of requests per second."""

    def computed(self, work: Callable[[], T]) -> T:
        """Result of the work, computed by the one computing thread."""
        return self.server.turn.submit(work).result()

    def _answer(self) -> tuple[str, bytes]:
        """Type and content of the answer to this request."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or hosts[0].lower() not in self.server.hosts:
            raise _Refused(
                HTTPStatus.FORBIDDEN,
                f"Host: {', '.join(hosts) or 'missing'}; this page answers as "
                f"{', '.join(sorted(self.server.hosts))} only; a tunnel to it needs the same port "
                "at both ends",
            )
        url = urlsplit(self.path)
        token, _, page = url.path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.server.token.encode()):
            raise _Refused(
                HTTPStatus.FORBIDDEN,
                "this address lacks the token: open the whole address that `myork view` printed",
            )
        answers = {"": _page, "surface": _surface, "state": _state, "curves": _curves}
        if page not in answers:
            raise _Refused(HTTPStatus.NOT_FOUND, f"{page}: no such page")
        return answers[page](self, dict(parse_qsl(url.query)))


def _page(handler: _Handler, asked: Asked) -> tuple[str, bytes]:
    about = handler.server.answers.about()
    text = render("view.html", title=about["title"], about=about, held=None)
    return "text/html; charset=utf-8", text.encode()


def _surface(handler: _Handler, asked: Asked) -> tuple[str, bytes]:
    answers = handler.server.answers
    return _numbers(
        {"corners": len(answers.rest), "triangles": len(answers.triangles)},
        answers.rest.astype("<f4"),
        answers.triangles.astype("<u4"),
    )


def _state(handler: _Handler, asked: Asked) -> tuple[str, bytes]:
    answers = handler.server.answers
    values = _asked(asked, "p", float)
    shown = handler.computed(partial(answers.state, values, asked.get("field", "")))
    # shaders need not handle missing numbers
    numbers = np.nan_to_num(shown.values, nan=_NONE)
    return _numbers(shown.facts, shown.positions.astype("<f4"), numbers.astype("<f4"))


def _curves(handler: _Handler, asked: Asked) -> tuple[str, bytes]:
    answers = handler.server.answers
    count = len(answers.rom.parameters)
    of = _asked(asked, "of", int) if "of" in asked else list(range(count))
    if not all(0 <= k < count for k in of):
        raise InputError(f"of: numbers of parameters from 0 to {count - 1} are needed")
    values, (probe, *_) = _asked(asked, "p", float), _asked(asked, "probe", int)
    # one by one, so that other clients have their turn in between
    found = [handler.computed(partial(answers.curve, values, probe, k)) for k in of]
    return "application/json", json.dumps(found).encode()


def _asked(asked: Asked, key: str, kind: Callable[[str], T]) -> list[T]:
    """Numbers of a request, separated by commas.

    - raises InputError: the key is missing, or a number is not finite
    """
    if key not in asked:
        raise InputError(f"{key}: is missing")
    try:
        found = [kind(word) for word in asked[key].split(",")]
    except ValueError:
        raise InputError(f"{key}: '{asked[key][:40]}' is not a list of numbers") from None
    if not np.isfinite(np.array(found, float)).all():
        raise InputError(f"{key}: finite numbers are needed")
    return found


def _numbers(facts: dict[str, Any], *arrays: np.ndarray) -> tuple[str, bytes]:
    """JSON preceded by its length, padded to four bytes, then arrays of four bytes per number."""
    head = json.dumps(facts).encode()
    head += b" " * (-len(head) % 4)
    size = np.array([len(head)], "<u4").tobytes()
    return "application/octet-stream", size + head + b"".join(a.tobytes() for a in arrays)

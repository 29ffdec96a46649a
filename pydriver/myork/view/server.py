"""The local page of a reduced model: a small server, the page, answers to its questions."""

import contextlib
import errno
import json
import math
import secrets
import socket
import time
import webbrowser
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import parse_qs, urlsplit

import numpy as np

from myork.console import ProgressCallback, silent
from myork.errors import InputError, MyorkError
from myork.report.frame import render
from myork.view.answers import Answers

T = TypeVar("T")
#: What a question says, by name
Asked = dict[str, str]

#: Only this machine is served
_HOST = "127.0.0.1"
#: Names under which a browser on this machine, or at the end of a tunnel to it, knows it
_NAMES = ("127.0.0.1", "localhost", "[::1]")
#: Stands for no number among the values; the page draws it grey
_NONE = 1e38
#: Time after which a connection ends that waits for a question or for its answer to be read [s]
_IDLE = 10.0
#: Time after which a client that was answered and does not hang up sends nothing more [s]
_SILENT = 1.0
#: Bytes that are sent or dropped at a time
_CHUNK = 1 << 16
#: Connections at a time; of more, those end first that have waited longest
_CONNECTIONS = 100
#: Widths of a trained range beyond which no value is taken: powers of such values overflow
_FAR = 100.0


def serve(
    path: str | Path,
    *,
    port: int = 0,
    browser: bool = True,
    threads: int = 1,
    progress: ProgressCallback = silent,
) -> None:
    """Serve the page of a reduced model until Ctrl-C, SIGTERM or, by the command, SIGHUP.

    - `path`: reduced model (.rom.h5)
    - `port`: port of this machine; 0 takes a free one
    - `browser`: open the page in a browser
    - `threads`: threads of a batch
    - `progress`: called with the address when the page can be opened; who does not know the token
      in it gets no answer
    - raises InputError: the port is in use
    """
    with _server(port) as server, Answers(Path(path), threads) as server.answers:
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


def _server(port: int) -> "_Server":
    """A server that has its port."""
    try:
        return _Server(port)
    except OSError as reason:
        if reason.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        taken = "is in use" if reason.errno == errno.EADDRINUSE else "is not allowed"
        raise InputError(f"--port {port}: {taken}; name another, or none for a free one") from None


class _Refused(Exception):
    """A question that gets no answer, with its status and the reason."""


class _Server(ThreadingHTTPServer):
    """A thread for each connection, and one that computes for all of them, first come first served.

    Its address has a token that only who started the server knows.
    """

    answers: Answers  #: What is asked
    # the kernel keeps connections of a crowd until each has its thread
    request_queue_size = 128

    def __init__(self, port: int) -> None:
        super().__init__((_HOST, port), _Handler)
        port = self.server_address[1]
        self.token = secrets.token_urlsafe(16)
        self.address = f"http://{_HOST}:{port}/{self.token}/"
        #: Of which a request may ask: a page elsewhere whose name leads here has another host
        self.hosts = {f"{name}:{port}" for name in _NAMES} | set(_NAMES if port == 80 else ())
        self.turn = ThreadPoolExecutor(max_workers=1)  #: The thread that computes
        # since when open connections wait, the longest first; endless while one has a question
        self._since: dict[socket.socket, float] = {}

    def process_request(self, request: Any, client_address: Any) -> None:
        """Give a connection its thread."""
        self.waits(request)
        super().process_request(request, client_address)

    def waits(self, request: socket.socket) -> None:
        """From now on a connection waits for its client."""
        self._since.pop(request, None)
        self._since[request] = time.monotonic()

    def works(self, request: socket.socket) -> None:
        """From now on the client of a connection waits."""
        self._since[request] = math.inf

    def service_actions(self) -> None:
        """End connections that wait too long, or longest of too many."""
        waiting = [(r, since) for r, since in list(self._since.items()) if since < math.inf]
        more = len(self._since) - _CONNECTIONS
        for number, (request, since) in enumerate(waiting):
            if number < more or time.monotonic() - since > _IDLE:
                # its thread wakes and closes it
                with contextlib.suppress(OSError):
                    request.shutdown(socket.SHUT_RDWR)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection after what is still sent: else its client might lose the answer."""
        end = time.monotonic() + _IDLE
        with contextlib.suppress(OSError):
            request.settimeout(_SILENT)
            request.shutdown(socket.SHUT_WR)
            while time.monotonic() < end and request.recv(_CHUNK):
                pass
        self._since.pop(request, None)
        self.close_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that hangs up in the middle of an answer is no error."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    # else the second packet of an answer waits 40 ms for the client's receipt of the first
    disable_nagle_algorithm = True
    server: _Server

    def do_GET(self) -> None:
        """Answer a question of the page."""
        self.server.works(self.connection)
        status = HTTPStatus.OK
        try:
            kind, body = self._answer()
        except ConnectionError:
            raise
        except Exception as reason:
            kind = "text/plain; charset=utf-8"
            text = str(reason)
            if isinstance(reason, _Refused):
                status, text = reason.args
            elif isinstance(reason, (MyorkError, ValueError)):
                status = HTTPStatus.BAD_REQUEST
            else:
                status = HTTPStatus.INTERNAL_SERVER_ERROR
                text = f"internal error, please report it: {type(reason).__name__}: {text}"
            body = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        if self._has_body():
            self.send_header("Connection", "close")
        self.end_headers()
        for start in range(0, len(body), _CHUNK):
            self.server.waits(self.connection)
            self.wfile.write(body[start : start + _CHUNK])
        self.server.waits(self.connection)

    do_POST = do_PUT = do_PATCH = do_DELETE = do_GET

    def log_message(self, format: str, *args: Any) -> None:
        """Hundreds of questions a second are not worth a line each."""

    def computed(self, work: Callable[[], T]) -> T:
        """What the one thread that computes finds, unless the client has left before its turn."""
        return self.server.turn.submit(lambda: self._unless_left(work)).result()

    def _unless_left(self, work: Callable[[], T]) -> T:
        with contextlib.suppress(BlockingIOError):
            if not self.connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT):
                raise ConnectionAbortedError
        return work()

    def _has_body(self) -> bool:
        length = self.headers.get("Content-Length", "0")
        return length != "0" or "Transfer-Encoding" in self.headers

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
        if self.command != "GET" or self._has_body():
            raise InputError(
                f"{self.command} {page}: ask by GET, without a body and with numbers in the "
                "address: state?p=0.5,0.1&field=J"
            )
        answers = {"": _page, "surface": _surface, "state": _state, "curves": _curves}
        if page not in answers:
            raise _Refused(HTTPStatus.NOT_FOUND, f"{page}: no such page")
        asked = {}
        for key, values in parse_qs(url.query, keep_blank_values=True).items():
            if len(values) > 1:
                raise InputError(f"{key}: is given {len(values)} times; once is enough")
            asked[key] = values[0]
        return answers[page](self, asked)


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
    values, field = _values(answers, asked), _given(asked, "field")
    shown = handler.computed(partial(answers.state, values, field))
    # shaders need not know what is not a number
    numbers = np.nan_to_num(shown.values, nan=_NONE)
    return _numbers(shown.facts, shown.positions.astype("<f4"), numbers.astype("<f4"))


def _curves(handler: _Handler, asked: Asked) -> tuple[str, bytes]:
    answers = handler.server.answers
    every = range(len(answers.rom.parameters))
    of = _whole(asked, "of") if "of" in asked else list(every)
    if not set(of) <= set(every):
        raise InputError(f"of: parameters have numbers from 0 to {len(every) - 1}")
    if len(set(of)) < len(of):
        raise InputError(f"of: has {len(of)} numbers; name each parameter once")
    values, probe = _values(answers, asked), _whole(asked, "probe")
    if len(probe) != 1:
        raise InputError("probe: one number is needed")
    family = asked.get("family") == "1"
    found = []
    # one by one: other clients have their turn in between
    for k in of:
        found += handler.computed(partial(answers.curves, values, probe[0], [k], family=family))
    return "application/json", json.dumps(found).encode()


def _given(asked: Asked, key: str) -> str:
    if key not in asked:
        raise InputError(f"{key}: is missing")
    return asked[key]


def _whole(asked: Asked, key: str) -> list[int]:
    """Whole numbers of a question."""
    words = _given(asked, key).split(",")
    for word in words:
        if not (word.isascii() and word.isdecimal() and len(word) < 10):
            raise InputError(f"{key}: {_short(word)} is not a number from 0 on")
    return [int(word) for word in words]


def _values(answers: Answers, asked: Asked) -> list[float]:
    """Values of all parameters of a question."""
    words, parameters = _given(asked, "p").split(","), answers.rom.parameters
    if len(words) != len(parameters):
        raise InputError(f"p: {len(parameters)} finite numbers are needed, not {len(words)}")
    values = []
    for p, word in zip(parameters, words, strict=True):
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f"p: {p.key} = {_short(word)} is not a finite number")
        far = _FAR * (p.high - p.low)
        if not p.low - far <= value <= p.high + far:
            raise InputError(
                f"p: {p.key} = {value:g} is far from the trained range {p.low:g} to {p.high:g}"
            )
        values.append(value)
    return values


def _short(word: str) -> str:
    """A word of a question for a message."""
    return repr(word if len(word) <= 20 else f"{word[:20]}...")


def _numbers(facts: dict[str, Any], *arrays: np.ndarray) -> tuple[str, bytes]:
    """JSON with its length before it, filled up to four bytes, then arrays of four bytes each."""
    head = json.dumps(facts).encode()
    head += b" " * (-len(head) % 4)
    size = np.array([len(head)], "<u4").tobytes()
    return "application/octet-stream", size + head + b"".join(a.tobytes() for a in arrays)

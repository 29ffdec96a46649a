"""The local page of a reduced model: a small server, the page, answers to its questions."""

from __future__ import annotations

import errno
import json
import webbrowser
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from myork.console import ProgressCallback, silent
from myork.errors import InputError, MyorkError
from myork.report.frame import render
from myork.view.answers import Answers

__all__ = ["serve"]

#: Only this machine is served
_HOST = "127.0.0.1"
#: Stands for no number among the values; the page draws it grey
_NONE = 1e38


def serve(
    path: str | Path,
    *,
    port: int = 0,
    browser: bool = True,
    threads: int = 1,
    progress: ProgressCallback = silent,
) -> None:
    """Serve the page of a reduced model until Ctrl-C or SIGTERM.

    Parameters
    ----------
    path : str or Path
        Reduced model (.rom.h5).
    port : int
        Port of this machine; 0 takes a free one.
    browser : bool
        Open the page in a browser.
    threads : int
        Threads of a batch.
    progress : callable
        Called with the address when the page can be opened.

    Raises
    ------
    InputError
        The port is in use.
    """
    with Answers(Path(path), threads) as answers:
        try:
            server = _Server((_HOST, port), answers)
        except OSError as reason:
            if reason.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
            taken = "is in use" if reason.errno == errno.EADDRINUSE else "is not allowed"
            raise InputError(
                f"--port {port}: {taken}; name another, or none for a free one"
            ) from None
        with server:
            address = f"http://{_HOST}:{server.server_address[1]}/"
            progress(f"view: {address}  (Ctrl-C ends it)")
            if browser:
                webbrowser.open(address)
            try:
                server.serve_forever(poll_interval=0.1)
            except KeyboardInterrupt:
                progress("view ended")


class _Server(ThreadingHTTPServer):
    def __init__(self, address: tuple[str, int], answers: Answers) -> None:
        self.answers = answers
        super().__init__(address, _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that hangs up in the middle of an answer is no error."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _Server

    def do_GET(self) -> None:
        """Answer a question of the page."""
        url = urlsplit(self.path)
        asked = {key: value[-1] for key, value in parse_qs(url.query).items()}
        answers = {"/": _page, "/surface": _surface, "/state": _state, "/curves": _curves}
        if url.path not in answers:
            self._send("text/plain", b"no such page", HTTPStatus.NOT_FOUND)
            return
        try:
            self._send(*answers[url.path](self.server.answers, asked))
        except (MyorkError, KeyError, ValueError) as reason:
            text = f"{url.path}: {reason}".encode()
            self._send("text/plain; charset=utf-8", text, HTTPStatus.BAD_REQUEST)

    def log_message(self, format: str, *args: Any) -> None:
        """Hundreds of questions a second are not worth a line each."""

    def _send(self, kind: str, body: bytes, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)


def _page(answers: Answers, asked: dict[str, str]) -> tuple[str, bytes]:
    about = answers.about()
    text = render("view.html", title=about["title"], about=about)
    return "text/html; charset=utf-8", text.encode()


def _surface(answers: Answers, asked: dict[str, str]) -> tuple[str, bytes]:
    return _numbers(
        {"corners": len(answers.rest), "triangles": len(answers.triangles)},
        answers.rest.astype("<f4"),
        answers.triangles.astype("<u4"),
    )


def _state(answers: Answers, asked: dict[str, str]) -> tuple[str, bytes]:
    shown = answers.state(_values(answers, asked), asked["field"])
    # shaders need not know what is not a number
    values = np.nan_to_num(shown.values, nan=_NONE)
    return _numbers(shown.told, shown.positions.astype("<f4"), values.astype("<f4"))


def _curves(answers: Answers, asked: dict[str, str]) -> tuple[str, bytes]:
    every = range(len(answers.rom.parameters))
    of = [int(word) for word in asked["of"].split(",")] if "of" in asked else list(every)
    if not set(of) <= set(every):
        raise InputError(f"of: parameters have numbers from 0 to {len(every) - 1}")
    found = answers.curves(
        _values(answers, asked), int(asked["probe"]), of, family=asked.get("family") == "1"
    )
    return "application/json", json.dumps(found).encode()


def _values(answers: Answers, asked: dict[str, str]) -> list[float]:
    values = [float(word) for word in asked["p"].split(",")]
    if len(values) != len(answers.rom.parameters) or not np.isfinite(values).all():
        raise InputError(f"p: {len(answers.rom.parameters)} finite numbers are needed")
    return values


def _numbers(told: dict[str, Any], *arrays: np.ndarray) -> tuple[str, bytes]:
    """JSON with its length before it, filled up to four bytes, then arrays of four bytes each."""
    head = json.dumps(told).encode()
    head += b" " * (-len(head) % 4)
    size = np.array([len(head)], "<u4").tobytes()
    return "application/octet-stream", size + head + b"".join(a.tobytes() for a in arrays)

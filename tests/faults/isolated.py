"""Calls in a process of their own, which may crash, hang or ask for all memory without harm."""

import contextlib
import io
import multiprocessing
import os
import resource
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from myork.errors import MyorkError

#: Address space of the process [bytes]
ROOM = 4 << 30


class Verdict(NamedTuple):
    """`right`, `refused`, `ended`, `crash`, `internal`, `hang` or what a check says, and why."""

    outcome: str
    said: str = ""


class Worker:
    """A process that answers one call after the other; a new one where a call has ended it."""

    def __init__(self, limit: float = 60.0) -> None:
        self.limit = limit
        self.child: Any = None

    def ask(self, check: Callable[[Any], Any], item: Any) -> Verdict:
        """How `check(item)` ends, both of which have to be picklable: a verdict it returns, `right`
        for anything else; an error with exit status 2 is `refused`, with 1 `ended`."""
        wait = self.limit
        if self.child is None:
            context = multiprocessing.get_context("spawn")
            self.pipe, there = context.Pipe()
            self.child = context.Process(target=_serve, args=(there,), daemon=True)
            self.child.start()
            there.close()
            wait += 60.0  # imports
        self.pipe.send((check, item))
        try:
            if self.pipe.poll(wait):
                return Verdict(*self.pipe.recv())
            end = Verdict("hang", f"no end within {self.limit:g} s")
        except EOFError:
            self.child.join()
            end = Verdict("crash", f"the process ended with {self.child.exitcode}")
        self.close()
        return end

    def close(self) -> None:
        if self.child is not None:
            self.child.kill()
            self.child.join()
            self.pipe.close()
            self.child = None


def _serve(pipe: Connection) -> None:
    # what libraries say of damaged files belongs to no report of tests
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (ROOM, ROOM))
    while True:
        check, item = pipe.recv()
        try:
            with contextlib.redirect_stderr(io.StringIO()):
                found = check(item)
            end = found if isinstance(found, Verdict) else Verdict("right")
        except MyorkError as error:
            end = Verdict({1: "ended", 2: "refused"}.get(error.exit_code, "internal"), str(error))
        except BaseException:
            end = Verdict("internal", traceback.format_exc())
        pipe.send(tuple(end))

"""Calls in a process of its own, which may crash or hang without harm to the caller."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from myork.errors import MyorkError

__all__ = ["Verdict", "isolated"]


class Verdict(NamedTuple):
    """How a call ended.

    Attributes
    ----------
    outcome : str
        `right`, `refused`, `ended`, `crash`, `internal`, `hang`, `lost` or `nonsense`.
    said : str
        Message that goes with it.
    """

    outcome: str
    said: str = ""


def isolated(check: Callable[[Any], Verdict], items: Sequence[Any], limit: float) -> list[Verdict]:
    """Verdict on each item, from a process that is started again when an item ends it.

    Parameters
    ----------
    check : callable
        Function of a module; an error of the package with exit status 2 is `refused`, one with
        status 1 `ended`, anything else it raises `internal`.
    items : sequence
        Its arguments.
    limit : float
        Time after which an item hangs [s].
    """
    context = multiprocessing.get_context("spawn")
    verdicts: list[Verdict] = []
    while len(verdicts) < len(items):
        here, there = context.Pipe()
        child = context.Process(target=_serve, args=(check, items[len(verdicts) :], there))
        child.start()
        there.close()
        try:
            # imports come before the first verdict
            wait = limit + 60.0
            while len(verdicts) < len(items):
                if not here.poll(wait):
                    verdicts.append(Verdict("hang", f"no end within {limit:g} s"))
                    break
                verdicts.append(Verdict(*here.recv()))
                wait = limit
        except EOFError:
            child.join()
            verdicts.append(Verdict("crash", f"the process ended with {child.exitcode}"))
        finally:
            child.kill()
            child.join()
            here.close()
    return verdicts


def _serve(check: Callable[[Any], Verdict], items: Sequence[Any], pipe: Connection) -> None:
    # what libraries say of damaged files belongs to no table
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    for item in items:
        try:
            with contextlib.redirect_stderr(io.StringIO()):
                verdict = check(item)
        except MyorkError as error:
            outcomes = {1: "ended", 2: "refused"}
            verdict = Verdict(outcomes.get(error.exit_code, "internal"), str(error))
        except BaseException:
            verdict = Verdict("internal", traceback.format_exc())
        pipe.send(tuple(verdict))

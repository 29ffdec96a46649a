"""A benchmark in a process of its own, which may take a limited time only."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from myork.bench import find_study
from myork.console import ProgressCallback

__all__ = ["run_limited"]


def run_limited(
    name: str, out: Path, progress: ProgressCallback, quick: bool, limit: float
) -> dict[str, Any]:
    """Result of a benchmark; one that fails or takes too long says so in `ended`.

    Parameters
    ----------
    name : str
        From `BENCHES`.
    out : Path
        Folder of its files.
    progress : callable
        Called with every line of progress.
    quick : bool
        Small cases only.
    limit : float
        Time after which it is ended [s].
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    child = context.Process(target=_run, args=(name, str(out), quick, there))
    begin = time.monotonic()
    child.start()
    there.close()
    found: dict[str, Any] = {"title": name, "ended": f"not done within {limit:g} s"}
    try:
        while here.poll(max(0.0, begin + limit - time.monotonic())):
            kind, said = here.recv()
            if kind == "line":
                progress(said)
                continue
            found = said
            break
    except EOFError:
        child.join()
        found["ended"] = f"its process ended with {child.exitcode}"
    finally:
        # with what it has started: it leads a group of its own
        with suppress(ProcessLookupError, PermissionError):
            if child.pid is not None and os.getpgid(child.pid) == child.pid:
                os.killpg(child.pid, signal.SIGKILL)
        child.kill()
        child.join()
        here.close()
    found["seconds"] = time.monotonic() - begin
    return found


def _run(name: str, out: str, quick: bool, pipe: Connection) -> None:
    """The process: lines of progress, then the result, through a pipe."""
    os.setpgrp()
    try:
        result = find_study(name)(Path(out), lambda line: pipe.send(("line", line)), quick)
    except Exception as reason:
        result = {"title": name, "ended": f"{type(reason).__name__}: {reason}"}
    pipe.send(("result", result))

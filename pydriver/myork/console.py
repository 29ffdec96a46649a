"""Progress of a long task: a bar on a terminal, plain lines in a log or a notebook.

Every function with a `progress` argument calls it with one line of text at a time. A line that
starts with ``name n/total`` (``step  3/10  load 0.3``) advances the bar.
"""

import os
import re
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

ProgressCallback = Callable[[str], None]

_COUNTED = re.compile(r"\s*(?P<name>\w+)\s+(?P<done>\d+)\s*/\s*(?P<total>\d+)\s*(?P<rest>.*)")


def silent(line: str) -> None:
    """Progress callback that shows nothing."""


def say(line: str, *, error: bool = False) -> None:
    """Print a line; if the reader of the output has gone (`head`), drop it and all later ones.

    - `error`: to standard error instead of standard output
    """
    stream = sys.stderr if error else sys.stdout
    try:
        print(line, file=stream, flush=True)
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


class Console(AbstractContextManager["Console"]):
    """Progress callback of the commands and of notebooks; use it as a context manager.

    - `verbosity`: -1 shows nothing, 0 and 1 show all lines that arrive; their number depends on
      the task

    >>> with Console() as progress:  # doctest: +SKIP
    ...     states = scene.solve(progress=progress)
    """

    def __init__(self, verbosity: int = 0) -> None:
        self._quiet = verbosity < 0
        self._bar: Any = None  # a Progress of rich, loaded when a bar is drawn
        self._tasks: dict[str, Any] = {}

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def __call__(self, line: str) -> None:
        """Show one line of progress."""
        if self._quiet:
            return
        counted = _COUNTED.match(line)
        if counted is None or not sys.stdout.isatty():
            # lines are printed above a bar that is being drawn
            say(line)
            return
        if self._bar is None:
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            self._bar = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(bar_width=24),
                TextColumn("{task.completed:.0f}/{task.total:.0f}"),
                TimeElapsedColumn(),
                TextColumn("{task.fields[rest]}", markup=False),
            )
            self._bar.start()
        name, total = counted["name"], int(counted["total"])
        if name not in self._tasks:
            self._tasks[name] = self._bar.add_task(name, total=total, rest="")
        self._bar.update(
            self._tasks[name], completed=int(counted["done"]), total=total, rest=counted["rest"]
        )

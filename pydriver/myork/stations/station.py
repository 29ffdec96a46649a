"""Common part of the stations before a solve: deck in, files and parts of the summary out."""

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import myork
from myork.console import ProgressCallback, silent
from myork.core.deck import load_deck
from myork.core.threads import core_threads
from myork.errors import FileError, InputError
from myork.summary import ASKED, renewing, update_summary, with_others

#: Work of a station: effective deck, folder of the results, progress -> parts of the summary
Work = Callable[[Mapping[str, Any], Path, ProgressCallback], dict[str, Any]]


def station(command: str, *parts: str) -> Callable[[Work], Callable[..., dict[str, Any]]]:
    """Make a station from its work.

    - `command`: command for which the deck is read
    - `parts`: entries of `summary.json` made by the work; the head of the summary is added
    """

    def made(work: Work) -> Callable[..., dict[str, Any]]:
        def run(
            deck: str | Path | Mapping[str, Any],
            out: str | Path,
            *,
            overrides: Sequence[str] = (),
            threads: int | None = None,
            progress: ProgressCallback = silent,
        ) -> dict[str, Any]:
            """Do the work.

            - `deck`: deck file, or its tables as data
            - `overrides`: overrides of the deck, `"table.key=value"`
            - `threads`: number of threads of the compiled core; default all cores
            - returns what was added to `summary.json`
            """
            values, folder = load_deck(deck, overrides, command), Path(out)
            with renewing(folder, *parts), core_threads(threads):
                try:
                    found = work(values, folder, progress)
                except (FileError, InputError) as reason:
                    raise type(reason)(_placed(str(reason), values)) from reason
                grid = found.pop("grid")
                found |= {
                    name: found[name] | {ASKED: list(overrides)}
                    for name in parts
                    if found.get(name)
                }
                lists = {"resampled": grid.moved, "damaged_slices": grid.damaged}
                summary = {
                    "title": values["title"],
                    "deck_sha256": values["sha256"],
                    "overrides": list(overrides),
                    "version": myork.__version__,
                    "units": dict(values["result_units"]),
                    **found,
                    **{k: with_others(folder, k, command, own) for k, own in lists.items()},
                }
                update_summary(folder, summary)
            return summary

        run.__name__ = run.__qualname__ = work.__name__
        run.__module__ = work.__module__
        _, _, common = (inspect.getdoc(run) or "").partition("\n\n")
        run.__doc__ = f"{inspect.getdoc(work)}\n\n{common}"
        return run

    return made


def _placed(message: str, deck: Mapping[str, Any]) -> str:
    """Message preceded by the line of the deck with the first key that it names.

    - `deck`: effective deck; keys of `--set` and of data have no line
    """
    path = Path(deck["path"])
    if not path.is_file():
        return message
    lines = path.read_text(encoding="utf-8").splitlines()
    # a file may be named like a key: then its folder or suffix stands beside it, or the deck has
    # its name as a value
    for key in re.finditer(r"(?<![\w/\\.-])([a-z]+)\.([a-z_]+)\b(?![/\\.-]\w)", message):
        quoted = re.compile(rf"""["'/\\]{re.escape(key[0])}["']""")
        if not isinstance(deck.get(key[1]), Mapping) or any(map(quoted.search, lines)):
            continue
        table = ""
        for number, line in enumerate(lines, start=1):
            head = re.match(r"\s*\[\[?\s*(\w+)", line)
            table = head[1] if head else table
            own = re.match(r"\s*(?:(\w+)\.)?(\w+)\s*=", line)
            if own and (own[1] or table, own[2]) == (key[1], key[2]):
                return f"{path}:{number}: {message}"
        break
    return message

"""The file `summary.json` of an output folder, to which each station adds its part."""

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import myork
from myork.errors import FileError, InputError
from myork.files import alone_in, read_json, write_json

#: Entries of stations before a solve; others belong to a solution (`rk_summary` has the same)
_BEFORE = ("segmentation", "tissue", "model", "resampled", "damaged_slices")
#: Entry of the part of a station: the overrides of the deck that it had
ASKED = "overrides"
#: Summary of the last finished solution until a later run has one (`rk_summary` has the same)
WAITING = "summary.json.previous"


@contextmanager
def asked(folder: Path) -> Iterator[None]:
    """Record in the summary of a folder why a run ended before its solve wrote it.

    Refused input does not replace the summary of a solution.

    - `folder`: output folder; left alone if another process has locked it
    """
    try:
        yield
    except BaseException as reason:
        solved = isinstance(reason, InputError | FileError) and readable_summary(folder).get(
            "steps"
        )
        with suppress(FileError):
            if folder.is_dir() and not solved:
                with alone_in(folder):
                    _write_refusal(folder, str(reason) or type(reason).__name__)
        raise


def _write_refusal(folder: Path, message: str) -> None:
    summary = _set_aside(folder)
    verdict = {"state": "refused", "reasons": [message]}
    refusal = {
        "version": myork.__version__, "converged": False, "message": message,
        "verdict": verdict, "steps": [], "cpu_s": time.process_time(), "warnings": [],
    }  # fmt: skip
    write_json(folder / "summary.json", {**_before(summary), **refusal})


def _set_aside(folder: Path) -> dict[str, Any]:
    """Rename the summary of a finished solution; returns its content."""
    summary = readable_summary(folder)
    verdict = summary.get("verdict") or {}
    if summary.get("converged") and verdict.get("state") != "refused":
        try:
            (folder / "summary.json").rename(folder / WAITING)
        except OSError as reason:
            raise FileError(f"{folder}: its summary cannot be set aside: {reason}") from None
        write_json(folder / "summary.json", _before(summary))
    return summary


def _before(summary: Mapping[str, Any]) -> dict[str, Any]:
    return {name: summary[name] for name in _BEFORE if name in summary}


@contextmanager
def renewing(folder: Path, *parts: str) -> Iterator[None]:
    """Lock a folder while a station renews its parts of the summary.

    The summary of a finished solution based on earlier versions of such parts is set aside. If the
    station fails, parts of an earlier run remain, with an entry `failed`.

    - `folder`: output folder; created if it is missing
    - `parts`: entries of `summary.json` that the station writes
    """
    with alone_in(folder):
        if {"segmentation", "model"}.intersection(parts):
            _set_aside(folder)
        try:
            yield
        except BaseException as reason:
            old = readable_summary(folder)
            failed = str(reason) or type(reason).__name__
            marked = {
                name: {**old[name], "failed": failed}
                for name in parts
                if isinstance(old.get(name), dict)
            }
            with suppress(FileError):
                if marked:
                    update_summary(folder, marked)
            raise


def failures(summary: Mapping[str, Any]) -> list[str]:
    """Results of earlier runs left in a folder because a later run failed, one sentence each."""
    found = []
    for name, part in summary.items():
        if isinstance(part, Mapping) and isinstance(part.get("failed"), str):
            found.append(f"The {name} is that of an earlier run; the last one: {part['failed']}")
    return found


def printed(step: Mapping[str, Any]) -> dict[str, Any]:
    """Probes of a step of the summary as the solver prints them: 0 if far below an error bar."""
    return {**(step.get("probes") or {}), **(step.get("printed") or {})}


def with_bar(step: Mapping[str, Any], name: str, unit: str, digits: int = 5) -> str:
    """Value of a probe in a step of the summary with its error bar and its unit."""
    parts = []
    for values, count in ((printed(step), digits), (step.get("probe_errors") or {}, 2)):
        value = values.get(name)
        if value is not None:
            several = value if isinstance(value, list) else [value]
            parts.append(", ".join("-" if v is None else f"{v:.{count}g}" for v in several))
    return f"{' +- '.join(parts)} {unit}".rstrip()


def update_summary(folder: Path, part: Mapping[str, Any]) -> None:
    """Put entries into `summary.json`, replacing entries of the same names.

    - `folder`: output folder
    - `part`: entries: text, numbers, lists and mappings of them; non-finite numbers become null
    """
    write_json(folder / "summary.json", {**readable_summary(folder), **part})


def with_others(folder: Path, name: str, station: str, entries: Iterable[Any]) -> list[Any]:
    """A list of the summary shared by several stations: entries of other stations are kept.

    - `folder`: output folder
    - `name`: name of the list
    - `station`: station that owns these entries; it is noted in each
    - `entries`: new entries
    """
    kept = [own for own in readable_summary(folder).get(name, ()) if own.get("station") != station]
    return [*kept, *({**own, "station": station} for own in entries)]


def read_summary(folder: Path) -> dict[str, Any]:
    """Entries of `summary.json`; empty where it is missing.

    - raises FileError: the file is not a JSON object, or cannot be read
    """
    path = folder / "summary.json"
    return read_json(path) if path.exists() else {}


def readable_summary(folder: Path) -> dict[str, Any]:
    """As `read_summary`, but a broken file of an earlier run is ignored."""
    try:
        return read_summary(folder)
    except FileError:
        return {}

"""The file `summary.json` of an output folder, to which each station adds its part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from myork.errors import FileError
from myork.files import claimed, read_json, write_json

__all__ = ["failures", "read_summary", "renewing", "update_summary"]


@contextmanager
def renewing(folder: Path, *parts: str) -> Iterator[None]:
    """Have a folder alone while a station renews its parts of the summary.

    If the station fails, parts of an earlier run stay and say so in an entry `failed`.

    Parameters
    ----------
    folder : Path
        Output folder; made if it is missing.
    parts : str
        Entries of `summary.json` that the station writes.
    """
    with claimed(folder):
        try:
            yield
        except BaseException as reason:
            old = _read(folder)
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
    """What a folder holds of earlier runs because a later one failed, a sentence each."""
    found = []
    if isinstance(summary.get("failed"), str):
        found.append(f"The solution is that of an earlier run; the last one: {summary['failed']}")
    for name, part in summary.items():
        if isinstance(part, Mapping) and isinstance(part.get("failed"), str):
            found.append(f"The {name} is that of an earlier run; the last one: {part['failed']}")
    return found


def update_summary(folder: Path, part: Mapping[str, Any]) -> None:
    """Put entries into `summary.json`, in place of entries of the same names.

    Parameters
    ----------
    folder : Path
        Output folder.
    part : mapping
        Entries: text, numbers, lists and mappings of them; what is not finite becomes null.
    """
    write_json(folder / "summary.json", {**_read(folder), **part})


def read_summary(folder: Path) -> dict[str, Any]:
    """Entries of `summary.json`; nothing where it is missing.

    Raises
    ------
    FileError
        The file is not a JSON object, or cannot be read.
    """
    path = folder / "summary.json"
    return read_json(path) if path.exists() else {}


def _read(folder: Path) -> dict[str, Any]:
    """Entries of the file; a broken one of an earlier run is no reason to lose this run."""
    try:
        return read_summary(folder)
    except FileError:
        return {}

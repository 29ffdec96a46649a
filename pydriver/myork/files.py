"""Files that are there whole or not at all."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from myork.errors import FileError

__all__ = ["whole_file", "write_json", "write_text"]


@contextmanager
def whole_file(path: Path, *, by_suffix: bool = False) -> Iterator[Path]:
    """Path to write to in a block; the file takes its name when the block has ended well.

    Parameters
    ----------
    path : Path
        The file; it stays as it was until the new one is whole.
    by_suffix : bool
        Whether what writes looks at the suffix: then `part.` stands before the name, else `.part`
        behind it.

    Raises
    ------
    FileError
        The file cannot be written.
    """
    unfinished = path.with_name(f"part.{path.name}" if by_suffix else f"{path.name}.part")
    try:
        yield unfinished
        os.replace(unfinished, path)
    except OSError as reason:
        raise FileError(f"{path}: cannot be written: {reason.strerror or reason}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file, in UTF-8, by `whole_file`."""
    with whole_file(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write mappings, lists, texts and numbers as JSON; what is not finite becomes null."""
    write_text(path, json.dumps(_finite(value), indent=1, ensure_ascii=False) + "\n")


def _finite(value: Any) -> Any:
    """The same value with None for numbers that JSON does not know."""
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

"""The file `summary.json` of an output folder, to which each station adds its part."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from myork.errors import FileError

__all__ = ["update_summary"]


def update_summary(folder: Path, part: Mapping[str, Any]) -> None:
    """Put entries into `summary.json`, in place of entries of the same names.

    Parameters
    ----------
    folder : Path
        Output folder.
    part : mapping
        Entries: text, numbers, lists and mappings of them; what is not finite becomes null.
    """
    path = folder / "summary.json"
    try:
        old = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except ValueError:
        old = {}  # a broken summary of an earlier run is no reason to lose this one
    text = json.dumps(_finite({**old, **part}), indent=1, ensure_ascii=False)
    unfinished = path.with_name(path.name + ".part")
    try:
        unfinished.write_text(text + "\n", encoding="utf-8")
        os.replace(unfinished, path)
    except OSError as reason:
        raise FileError(f"{path}: cannot be written: {reason}") from None


def _finite(value: Any) -> Any:
    """The same value with None for numbers that JSON does not know."""
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

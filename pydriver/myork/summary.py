"""The file `summary.json` of an output folder, to which each station adds its part."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from myork.files import write_json

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
    write_json(path, {**(old if isinstance(old, dict) else {}), **part})

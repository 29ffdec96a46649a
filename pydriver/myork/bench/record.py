"""The file `bench.json`, and the machine on which its numbers were measured."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import myork
from myork.errors import FileError

__all__ = ["finite", "machine", "write_record"]


def machine() -> dict[str, Any]:
    """Version, date, processor and number of cores."""
    model = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line[:10] == "model name")
    except (OSError, StopIteration):
        pass
    return {
        "version": myork.__version__,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "processor": model,
        "cores": os.cpu_count(),
        "load_average": os.getloadavg()[0],
    }


def write_record(path: Path, record: Mapping[str, Any]) -> None:
    """Write JSON under a temporary name and rename it when it is whole."""
    unfinished = path.with_name(path.name + ".part")
    text = json.dumps(finite(record), indent=1, ensure_ascii=False)
    try:
        unfinished.write_text(text + "\n", encoding="utf-8")
        os.replace(unfinished, path)
    except OSError as reason:
        raise FileError(f"{path}: cannot be written: {reason}") from None


def finite(value: Any) -> Any:
    """The same value with None for numbers that JSON does not know."""
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

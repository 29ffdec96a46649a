"""The table of a sweep: kept a line a point while it runs, written as CSV and Parquet."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from myork.errors import InputError
from myork.files import whole_file, write_text

__all__ = ["Store", "has_parquet"]


class Store:
    """Finished points in a folder; an interrupted sweep goes on where it ended.

    Parameters
    ----------
    folder : Path
        Folder of the sweep.
    head : mapping
        What the sweep is of: deck, keys, points. Another one in the same folder is refused.
    """

    def __init__(self, folder: Path, head: Mapping[str, Any]) -> None:
        self._path = folder / "points.jsonl"
        self._folder = folder
        self.rows: dict[int, dict[str, Any]] = {}
        line = json.dumps({"sweep": head}, sort_keys=True)
        if not self._path.exists():
            self._path.write_text(line + "\n", encoding="utf-8")
            return
        lines = self._path.read_text(encoding="utf-8", errors="replace").splitlines()
        if not lines or lines[0] != line:
            raise InputError(
                f"{self._path}: is of another sweep: another deck, other overrides, keys or "
                "points; take another folder, or remove the file"
            )
        whole = lines[:1]
        for text in lines[1:]:
            try:
                row = json.loads(text)
                self.rows[int(row["point"])] = row
            except (ValueError, KeyError, TypeError):
                # a killed run may leave half a line
                continue
            whole.append(text)
        write_text(self._path, "\n".join(whole) + "\n")

    def add(self, row: dict[str, Any]) -> None:
        """Keep a finished point; it is on the disk when this returns."""
        self.rows[int(row["point"])] = row
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def write_table(
        self, keys: Sequence[str], points: Sequence[tuple[Any, ...]], units: Mapping[str, str]
    ) -> Path:
        """Write `sweep.csv`, and with pyarrow `sweep.parquet`, of what is finished."""
        rows = [self.rows[number] for number in sorted(self.rows)]
        probes = _ordered(name for row in rows for name in row["probes"])
        bars = [name for name in probes if any(name in row["errors"] for row in rows)]
        columns: dict[str, list[Any]] = {
            key: [points[row["point"]][j] for row in rows] for j, key in enumerate(keys)
        }
        columns |= {name: [row["probes"].get(name, math.nan) for row in rows] for name in probes}
        columns |= {
            f"{name}_error": [row["errors"].get(name, math.nan) for row in rows] for name in bars
        }
        for name in ("verdict", "message", "cpu_s"):
            columns[name] = [row[name] for row in rows]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
        write_text(self._folder / "sweep.csv", text.getvalue())
        _write_parquet(self._folder / "sweep.parquet", columns, units)
        return self._folder / "sweep.csv"


def has_parquet() -> bool:
    """Whether tables are written as Parquet as well."""
    return find_spec("pyarrow") is not None


def _ordered(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))


def _write_parquet(path: Path, columns: Mapping[str, list[Any]], units: Mapping[str, str]) -> None:
    if not has_parquet():
        return
    import pyarrow
    from pyarrow import parquet

    plain = {}
    for name, values in columns.items():
        mixed = len({isinstance(value, str) for value in values}) > 1
        plain[name] = [str(value) for value in values] if mixed else values
    table = pyarrow.table(plain).replace_schema_metadata(
        {f"unit_{name}": unit for name, unit in units.items()}
    )
    with whole_file(path) as unfinished:
        parquet.write_table(table, unfinished)

"""The table of a sweep: stored one line per point while it runs, written as CSV and Parquet."""

import json
import math
import os
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from myork.errors import InputError
from myork.files import open_output, whole_file, write_csv, write_json, write_text
from myork.sweeps.plan import LAST_COLUMNS, refusal


def read_head(path: Path) -> Any:
    """Identity of the sweep whose points are in a file; None without the file."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return json.loads(file.readline())["sweep"]
    except (OSError, ValueError, LookupError, TypeError):
        return None


#: Data of every finished point
_KEYS = {"probes", "errors", "verdict", "message", "cpu_s"}


def read_points(path: Path, head: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    """Finished points of a file by number; none if there is no file.

    - `head`: identity of the sweep
    - raises InputError: the points belong to another sweep, or a line was not written by a sweep
    """
    text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    # a killed run may leave half a line at the end
    lines = text[: text.rfind("\n") + 1].split("\n")[1:-1]
    if lines and (reason := refusal(head, read_head(path), path)):
        raise InputError(reason)
    rows: dict[int, dict[str, Any]] = {}
    for number, line in enumerate(lines, 2):
        try:
            row = json.loads(line)
            point = row["point"]
            whole = type(point) is int and 0 <= point < len(head["points"]) and point not in rows
            if not whole or not row.keys() >= _KEYS:
                raise ValueError
            rows[point] = row
        except (ValueError, LookupError, TypeError, AttributeError):
            raise InputError(
                f"{path}:{number}: is not what a sweep wrote; remove the line, and its point is "
                "solved again"
            ) from None
    return rows


class Store:
    """Finished points in a folder; an interrupted sweep continues where it stopped.

    Nothing is written before the first point.

    - `folder`: folder of the sweep
    - `head`: identity of the sweep. Points of another one in the same folder are refused.
    - `about`: its description in `sweep.json`
    """

    def __init__(self, folder: Path, head: Mapping[str, Any], about: Mapping[str, Any]) -> None:
        self._path = folder / "points.jsonl"
        self._folder = folder
        self._head = head
        self._about = about
        self._begun = False
        self.rows = read_points(self._path, head)

    def add(self, row: dict[str, Any]) -> None:
        """Store a finished point; it is on disk when this returns."""
        if not self._begun:
            lines = [{"sweep": self._head}, *self.rows.values()]
            write_text(self._path, "".join(f"{json.dumps(line)}\n" for line in lines))
            write_json(self._folder / "sweep.json", self._about)
            self._begun = True
        self.rows[row["point"]] = row
        with os.fdopen(open_output(self._path, new=False), "a", encoding="utf-8") as file:
            file.write(f"{json.dumps(row)}\n")
            file.flush()
            os.fsync(file.fileno())

    def write_table(self, keys: Sequence[str], points: Sequence[tuple[Any, ...]]) -> Path:
        """Write `sweep.csv`, and with pyarrow `sweep.parquet`, of the finished points."""
        rows = [self.rows[number] for number in sorted(self.rows)]
        probes = list(dict.fromkeys(name for row in rows for name in row["probes"]))
        bars = [name for name in probes if any(name in row["errors"] for row in rows)]
        columns: dict[str, list[Any]] = {
            key: [points[row["point"]][j] for row in rows] for j, key in enumerate(keys)
        }
        columns |= {name: [row["probes"].get(name, math.nan) for row in rows] for name in probes}
        columns |= {
            f"{name}_error": [row["errors"].get(name, math.nan) for row in rows] for name in bars
        }
        for name in LAST_COLUMNS:
            columns[name] = [row[name] for row in rows]
        table = (map(_cell, values) for values in zip(*columns.values(), strict=True))
        write_csv(self._folder / "sweep.csv", map(_cell, columns), table)
        _write_parquet(self._folder / "sweep.parquet", columns, self._about["units"])
        return self._folder / "sweep.csv"


def has_parquet() -> bool:
    """Whether tables are also written as Parquet."""
    return find_spec("pyarrow") is not None


def _cell(value: Any) -> Any:
    """The value, with an apostrophe before text that a spreadsheet would read as a formula."""
    formula = isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r", "\n"))
    return f"'{value}" if formula else value


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

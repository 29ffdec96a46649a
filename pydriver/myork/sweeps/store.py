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
from myork.files import open_output, whole_file, write_json, write_text
from myork.sweeps.inputs import LAST_COLUMNS, Inputs

__all__ = ["Store", "has_parquet", "read_points"]


#: What a point can end in
_VERDICTS = ("accepted", "doubtful", "refused", "failed")


def read_points(path: Path, inputs: Inputs) -> dict[int, dict[str, Any]]:
    """Finished points of a file by their numbers; none where there is no file.

    Raises
    ------
    InputError
        The points are of another sweep, or a line is not what a sweep writes.
    """
    text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    # a killed run may leave half a line at the end
    first, *lines = text[: text.rfind("\n") + 1].split("\n")[:-1] or [""]
    if not lines:
        return {}
    head = _parsed(first)
    refusal = inputs.refusal(path, head.get("sweep") if isinstance(head, dict) else None)
    if refusal:
        raise InputError(refusal)
    rows: dict[int, dict[str, Any]] = {}
    for number, line in enumerate(lines, 2):
        row = _parsed(line)
        fault = _fault(row, inputs) or ("the point is there twice" * (row["point"] in rows))
        if fault:
            raise InputError(
                f"{path}:{number}: is not what a sweep writes: {fault}; remove the line, and its "
                "point is solved again"
            )
        rows[row["point"]] = row
    return rows


def _parsed(line: str) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


def _fault(row: Any, inputs: Inputs) -> str:
    """What is wrong with a point that was read back; "" where nothing is."""
    if not isinstance(row, dict):
        return "not an object of JSON"
    if missing := sorted({"point", "probes", "errors", *LAST_COLUMNS} - row.keys()):
        return f"no {missing[0]}"
    count = len(inputs.head["points"])
    point, probes, errors = row["point"], row["probes"], row["errors"]
    if type(point) is not int or not 0 <= point < count:
        return f"point {point!r}, but the points are 0 to {count - 1}"
    if row["verdict"] not in _VERDICTS:
        return f"verdict {row['verdict']!r}, but only {', '.join(_VERDICTS)} are possible"
    if not isinstance(row["message"], str):
        return f"message {row['message']!r}, which is not a text"
    if not isinstance(probes, dict) or not isinstance(errors, dict):
        return "probes or errors are not by name"
    named = {"cpu_s": row["cpu_s"], **errors, **probes}
    if wrong := [name for name, value in named.items() if type(value) not in (int, float)]:
        return f"{wrong[0]} {named[wrong[0]]!r}, which is not a number"
    without = not probes and row["verdict"] in ("failed", "refused")
    if not without and tuple(probes) not in inputs.columns:
        return f"probes {', '.join(probes) or 'are missing'}, which are not those of the deck"
    if errors and errors.keys() != probes.keys():
        return "error bars of other probes"
    return ""


class Store:
    """Finished points in a folder; an interrupted sweep goes on where it ended.

    Nothing is written before the first point.

    Parameters
    ----------
    folder : Path
        Folder of the sweep.
    inputs : Inputs
        What the sweep is of. Points of another one in the same folder are refused.
    about : mapping
        What `sweep.json` says of it.
    """

    def __init__(self, folder: Path, inputs: Inputs, about: Mapping[str, Any]) -> None:
        self._path = folder / "points.jsonl"
        self._folder = folder
        self._inputs = inputs
        self._about = about
        self._begun = False
        self.rows = read_points(self._path, inputs)

    def add(self, row: dict[str, Any]) -> None:
        """Keep a finished point; it is on the disk when this returns.

        Raises
        ------
        InputError
            A file that points read is not what it was when the sweep began.
        """
        self._inputs.check()
        if not self._begun:
            before = [{"sweep": self._inputs.head}, *self.rows.values()]
            write_text(self._path, "".join(_line(entry) for entry in before))
            write_json(self._folder / "sweep.json", self._about)
            self._begun = True
        self.rows[row["point"]] = row
        with os.fdopen(open_output(self._path, new=False), "a", encoding="utf-8") as file:
            file.write(_line(row))
            file.flush()
            os.fsync(file.fileno())

    def write_table(self, keys: Sequence[str], points: Sequence[tuple[Any, ...]]) -> Path:
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
        for name in LAST_COLUMNS:
            columns[name] = [row[name] for row in rows]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(map(_cell, columns))
        writer.writerows(map(_cell, values) for values in zip(*columns.values(), strict=True))
        write_text(self._folder / "sweep.csv", text.getvalue())
        _write_parquet(self._folder / "sweep.parquet", columns, self._about["units"])
        return self._folder / "sweep.csv"


def has_parquet() -> bool:
    """Whether tables are written as Parquet as well."""
    return find_spec("pyarrow") is not None


def _line(entry: Mapping[str, Any]) -> str:
    return json.dumps(entry) + "\n"


def _cell(value: Any) -> Any:
    """The value, with an apostrophe before text that a spreadsheet would take for a formula."""
    formula = isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r", "\n"))
    return f"'{value}" if formula else value


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

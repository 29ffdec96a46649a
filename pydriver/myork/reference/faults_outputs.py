"""Damaged output folders, made anew from a sound one wherever they are wanted."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

__all__ = ["output_fault"]

#: Files that a report reads, those more often that have more in them
_FILES = ("summary.json", "results.vtkhdf", "history.csv", "summary.json", "segmentation.nii.gz",
          "results.vtkhdf", "summary.json", "anatomy.nii.gz", "segmentation.json")  # fmt: skip
_VALUES: tuple[Any, ...] = (None, True, -1, 0, 1e308, 10**300, 1e-300, "x", "", [], [None], {},
                            {"a": 1}, [[1]], "é" * 100)  # fmt: skip
_CONTENTS = (b"[]", b"{", b"null", b"[" * 100_000, b'{"steps": NaN}', b"\xff\xfe\0", b"1e999",
             b'{"a":' * 50_000)  # fmt: skip
_ENTRIES = ("", "x", "1e400", "nan,1", '"', "-inf", "0x1", "\0", "1" * 200_000)

Random = np.random.Generator


def output_fault(seed: int, number: int, folder: Path) -> tuple[str, str, bool]:
    """Damage one file of a folder and remove what is not read with it.

    Parameters
    ----------
    seed, number : int
        Start of the random numbers, and which folder of the corpus; the same numbers give the
        same damage to the same folder.
    folder : Path
        Copy of a sound output folder, of `solve` and `segment`.

    Returns
    -------
    tuple of str, str and bool
        What was done, the name of the file, and whether a command that reads it must refuse it.
    """
    random = np.random.default_rng((seed, number))
    name = _FILES[number % len(_FILES)]
    path = folder / name
    kept = {name, "segmentation.nii.gz"} if name.startswith(("anat", "segm")) else {name}
    for other in folder.iterdir():
        if other.name not in kept:
            other.unlink()
    how = number // len(_FILES) % 6
    content = path.read_bytes()
    must = False
    if how == 0 and number < 2 * len(_FILES):
        what, content, must = "empty", b"", True
    elif how < 2:
        what, must = "truncated", True
        content = content[: int(random.integers(len(content) * 9 // 10))]
    elif how < 3:
        what, content = "bytes", _bytes(random, content)
    elif path.suffix == ".json":
        what, content = _json(random, content)
    elif path.suffix == ".csv":
        what, content = _csv(random, content)
    elif path.suffix == ".vtkhdf":
        return f"{number} {name} {_hdf5(random, path)}", name, False
    else:
        what, content = "bytes", _bytes(random, content)
    path.write_bytes(content)
    return f"{number} {name} {what}", name, must


def _bytes(random: Random, content: bytes) -> bytes:
    changed = bytearray(content)
    # headers stand at the front and between the data
    last = min(4096, len(changed)) if random.random() < 0.5 else len(changed)
    for place in random.integers(0, last, int(random.integers(1, 33))):
        changed[place] = int(random.integers(256))
    return bytes(changed)


def _json(random: Random, content: bytes) -> tuple[str, bytes]:
    if random.random() < 0.15:
        other = _CONTENTS[int(random.integers(len(_CONTENTS)))]
        return f"is {other[:20]!r}", other
    tree = json.loads(content)
    places = [place for place in _places(tree) if place]
    *way, last = places[int(random.integers(len(places)))]
    parent = tree
    for key in way:
        parent = parent[key]
    where = ".".join(str(key) for key in (*way, last))
    if random.random() < 0.25:
        del parent[last]
        return f"{where} missing", json.dumps(tree).encode()
    value = _VALUES[int(random.integers(len(_VALUES)))]
    parent[last] = value
    return f"{where} is {str(value)[:20]}", json.dumps(tree).encode()


def _places(tree: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Keys and indices that lead to every entry."""
    yield way
    entries: Any = ()
    if isinstance(tree, dict):
        entries = tree.items()
    elif isinstance(tree, list):
        entries = enumerate(tree)
    for key, entry in entries:
        yield from _places(entry, (*way, key))


def _csv(random: Random, content: bytes) -> tuple[str, bytes]:
    rows = [line.split(",") for line in content.decode().splitlines()]
    row = rows[int(random.integers(len(rows)))]
    entry = _ENTRIES[int(random.integers(len(_ENTRIES)))]
    row[int(random.integers(len(row)))] = entry
    return f"one is {entry[:20]!r}", ("\n".join(",".join(row) for row in rows) + "\n").encode()


def _hdf5(random: Random, path: Path) -> str:
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = names[int(random.integers(len(names)))]
        if random.random() < 0.4 or isinstance(file[name], h5py.Group):
            del file[name]
            return f"{name} missing"
        values = file[name][()]
        others: dict[str, Any] = {
            "empty": values[:0],
            "scalar": 1.0,
            "one less": values[:-1],
            "deep": values.reshape((1,) * 3 + values.shape),
            "texts": np.array([b"a"] * max(len(values), 1)),
            "not finite": np.full(values.shape, np.nan),
            "huge": np.full(values.shape, 1e300),
            "negative": np.full(values.shape, -7),
        }
        what = list(others)[int(random.integers(len(others)))]
        del file[name]
        file[name] = others[what]
    return f"{name} {what}"

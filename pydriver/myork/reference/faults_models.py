"""Damaged model files, made anew from a small block wherever they are wanted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from myork.model_file import write_model
from myork.records import PointCloud

__all__ = ["MODEL_DECK", "block_cloud", "model_fault"]

#: Deck of the block, its left end held and its right end pulled
MODEL_DECK: dict[str, Any] = {
    "title": "Block from a model file",
    "scene": {"dimension": 3, "method": "rkcm"},
    "geometry": {"kind": "model", "file": "model.h5"},
    "material": [{"name": "tissue", "label": 1, "model": "polynomial", "A10": 3.0, "K": 100.0}],
    "boundary": [
        {"set": "left", "u_x": 0, "u_y": 0, "u_z": 0},
        {"set": "right", "u_x": 0.1, "u_y": 0, "u_z": 0},
    ],
    "load": {"steps": 1},
}

_DATASETS = ("source", "spacing", "points", "label", "fiber", "volume", "boundary_point",
             "boundary_set", "normal", "area", "set_names", "label_names")  # fmt: skip
_VALUES = (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e300, -1e300, 1e-300, 2.0**31 - 1, 2.0**40)
_WHOLE = (-1, -(2**31), 2**31 - 1, 2**31 - 2, 64, 1000)


def block_cloud(n: int = 4) -> PointCloud:
    """A unit cube of n source points an edge; collocation points stand between them as well."""
    source = np.stack(np.meshgrid(*[np.linspace(0, 1, n)] * 3, indexing="ij"), -1).reshape(-1, 3)
    m = 2 * n - 1
    points = np.stack(np.meshgrid(*[np.linspace(0, 1, m)] * 3, indexing="ij"), -1).reshape(-1, 3)
    faces = [
        (np.flatnonzero(points[:, axis] == end), np.eye(3)[axis] * (2 * end - 1))
        for axis in range(3)
        for end in (0.0, 1.0)
    ]
    number = [0, 1, 2, 2, 2, 2]
    count = [len(face) for face, _ in faces]
    return PointCloud(
        source=source,
        spacing=np.full((len(source), 3), 1 / (n - 1)),
        points=points,
        label=np.ones(len(points), np.int32),
        fiber=np.zeros((len(points), 3)),
        volume=np.full(len(points), 1 / len(points)),
        boundary_point=np.concatenate([face for face, _ in faces]).astype(np.int32),
        boundary_set=np.repeat(number, count).astype(np.int32),
        normal=np.repeat([normal for _, normal in faces], count, axis=0),
        area=np.repeat(1.0 / m**2, sum(count)),
        set_names=("left", "right", "side"),
        label_names={1: "tissue"},
        length_unit="cm",
        source_images="",
    )


def model_fault(seed: int, number: int, path: Path) -> str:
    """Write a damaged model; what was done to it.

    Parameters
    ----------
    seed, number : int
        Start of the random numbers, and which model of the corpus; the same numbers give the same
        damage.
    path : Path
        File to be written.
    """
    random = np.random.default_rng((seed, number))
    path.unlink(missing_ok=True)
    write_model(path, block_cloud())
    how = number % 10
    if how < 3:
        return f"{number} {_spoil_bytes(random, path, how)}"
    name = _DATASETS[int(random.integers(len(_DATASETS)))]
    with h5py.File(path, "r+") as file:
        if how == 9:
            return f"{number} attribute {_change_attribute(random, file)}"
        values = file[name][()]
        what = _change_value(random, values) if how < 6 else ""
        if what:
            file[name][...] = values
        else:
            what = _change_shape(random, file, name, values)
    return f"{number} {name} {what}"


def _spoil_bytes(random: np.random.Generator, path: Path, how: int) -> str:
    content = bytearray(path.read_bytes())
    if how == 0:
        path.write_bytes(content[: int(random.integers(len(content)))])
        return "truncated"
    # headers stand at the front and between the data
    last = 4096 if how == 1 else len(content)
    for place in random.integers(0, last, int(random.integers(1, 33))):
        content[place] = int(random.integers(256))
    path.write_bytes(content)
    return "bytes"


def _change_value(random: np.random.Generator, values: np.ndarray) -> str:
    """Change one entry of an array in place; nothing for texts."""
    if values.dtype == np.uint8:
        return ""
    choices: tuple[float, ...] = _WHOLE if values.dtype.kind == "i" else _VALUES
    value = choices[int(random.integers(len(choices)))]
    values.flat[int(random.integers(values.size))] = value
    return f"one is {value:g}"


def _change_shape(
    random: np.random.Generator, file: h5py.File, name: str, values: np.ndarray
) -> str:
    """Replace a dataset by one of another shape or type."""
    huge = np.frombuffer(b"s" * 300_000, np.uint8)
    many = np.frombuffer("\n".join(f"set {i}" for i in range(20_000)).encode(), np.uint8)
    others: dict[str, Any] = {
        "missing": None,
        "empty": values[:0],
        "scalar": values.flat[0],
        "one less": values[:-1],
        "one more": np.concatenate([values, values[:1]]),
        "flat": values.reshape(-1),
        "deep": values.reshape((1,) * 6 + values.shape),
        "32 axes": values.reshape((1,) * (32 - values.ndim) + values.shape),
        "transposed": values.T,
        "texts": np.array([b"a"] * len(values)),
        "long integers": values.astype(np.int64) + 2**33,
        "single precision": values.astype(np.float32),
        "complex": values.astype(np.complex128),
        "compound": np.zeros(len(values), [("a", "f8"), ("b", "i4")]),
        "group": {},
        "many names": many,
        "a long name": huge,
        "no text": np.frombuffer(b"\xff\xfe\0\0", np.uint8),
        "doubled": np.repeat(values[:1], len(values), axis=0),
    }
    what = list(others)[int(random.integers(len(others)))]
    del file[name]
    if what == "group":
        file.create_group(name)
    elif what != "missing":
        file[name] = others[what]
    return what


def _change_attribute(random: np.random.Generator, file: h5py.File) -> str:
    others: dict[str, Any] = {
        "missing": None,
        "number": 3.0,
        "empty": np.bytes_(b""),
        "several": np.array([b"myork-model 3"] * 1000),
        "texts of any length": np.array(["x" * 5000] * 3, dtype=h5py.string_dtype()),
        "long": np.bytes_(b"m" * 60_000),
        "other": "Länge",
        "none": h5py.Empty("S5"),
    }
    name = ("format", "length_unit", "source_images")[int(random.integers(3))]
    what = list(others)[int(random.integers(len(others)))]
    del file.attrs[name]
    if what != "missing":
        file.attrs[name] = others[what]
    return f"{name} {what}"

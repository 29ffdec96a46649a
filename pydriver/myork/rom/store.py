"""The file `.rom.h5`: arrays of a reduced model by name, with a head that says what they are."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from myork.errors import FileError, InputError
from myork.files import whole_file

__all__ = ["read_arrays", "write_arrays"]

FORMAT = "myork-rom 3"


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays and texts; the file is there whole or not at all."""
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs["format"] = np.bytes_(FORMAT)
        for name, value in arrays.items():
            file[name] = _stored(value)
        file.attrs["sha256"] = np.bytes_(_checksum(file))
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content.getvalue())


def read_arrays(path: Path) -> dict[str, Any]:
    """Read what `write_arrays` wrote.

    Raises
    ------
    FileError
        There is no such file, or its content is not what was written.
    InputError
        It is of another format.
    """
    if not path.is_file():
        raise FileError(f"{path}: there is no such reduced model; `myork rom train` writes one")
    try:
        with h5py.File(path, "r") as file:
            stamp = bytes(file.attrs.get("format", b"")).decode()
            if stamp != FORMAT:
                raise InputError(
                    f"{path}: its format is '{stamp}', '{FORMAT}' is wanted; train it again"
                )
            if bytes(file.attrs["sha256"]).decode() != _checksum(file):
                raise FileError(f"{path}: its content is damaged; train it again")
            found: dict[str, Any] = {}
            file.visititems(lambda name, item: _collect(found, name, item))
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as reason:
        raise FileError(f"{path}: is not a readable reduced model: {reason}") from None
    return found


def _stored(value: Any) -> Any:
    if isinstance(value, str):
        return np.bytes_(value.encode())
    return np.ascontiguousarray(value)


def _collect(found: dict[str, Any], name: str, item: Any) -> None:
    if isinstance(item, h5py.Dataset):
        value = item[()]
        found[name] = value.decode() if isinstance(value, bytes) else value


def _checksum(file: h5py.File) -> str:
    total = hashlib.sha256()
    names: list[str] = []
    file.visititems(
        lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
    )
    for name in sorted(names):
        total.update(name.encode())
        total.update(np.ascontiguousarray(file[name][()]).tobytes())
    return total.hexdigest()

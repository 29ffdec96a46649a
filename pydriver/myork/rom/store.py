"""The file `.rom.h5`: arrays of a reduced model by name, with a head that describes them.

Its checksum covers names, types, shapes and numbers, so that a training is read as written.
"""

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from myork.arrays import UNREADABLE, attribute, dataset
from myork.errors import FileError, InputError
from myork.files import whole_file

FORMAT = "myork-rom 7"


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write the arrays of a reduced model; the file is written completely or not at all."""
    values = {name: np.asarray(v) for name, v in arrays.items() if name != "head"}
    values["head"] = np.asarray(np.bytes_(arrays["head"].encode()))
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs["format"] = np.bytes_(FORMAT)
        file.attrs["sha256"] = np.bytes_(_checksum(values))
        for name, value in values.items():
            file[name] = value
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content.getvalue())


def read_arrays(path: Path) -> dict[str, Any]:
    """Read what `write_arrays` wrote.

    - raises FileError: there is no such file, or its content is not what was written
    - raises InputError: it has another format
    """
    if not path.is_file():
        raise FileError(f"{path}: there is no such reduced model; `myork rom train` writes one")
    try:
        with h5py.File(path, "r") as file:
            stamp = attribute(file, "format")
            if stamp != FORMAT:
                raise InputError(f"its format is '{stamp[:40]}', not '{FORMAT}'")
            names: list[str] = []
            file.visititems(
                lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
            )
            found = {name: dataset(file, name) for name in names}
            # nothing is compressed
            if sum(item.nbytes for item in found.values()) > path.stat().st_size:
                raise FileError("the shapes of its arrays declare more numbers than it contains")
            values = {name: np.asarray(item[()]) for name, item in found.items()}
            if attribute(file, "sha256") != _checksum(values):
                raise FileError("its content is damaged")
            return {**values, "head": bytes(values["head"][()]).decode()}
    except (FileError, InputError) as reason:
        raise type(reason)(f"{path}: {reason}; train it again") from None
    except UNREADABLE as reason:
        raise FileError(f"{path}: is not a reduced model of `myork rom train`: {reason}") from None


def _checksum(values: Mapping[str, NDArray[Any]]) -> str:
    """Checksum of names, types, shapes and numbers."""
    total = hashlib.sha256()
    for name, value in sorted(values.items()):
        total.update(f"{name} {value.dtype.str} {value.shape} ".encode())
        total.update(np.ascontiguousarray(value).tobytes())
    return total.hexdigest()

"""Fields of reduced models beside the full one, in the file `reduced_fields.npz` of a folder."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from myork.errors import FileError
from myork.files import whole_file
from myork.types import F64, I32, I64

__all__ = ["REDUCED_FILE", "ReducedFields", "read_reduced", "write_reduced"]


REDUCED_FILE = "reduced_fields.npz"


class ReducedFields(NamedTuple):
    """One state of the full model and of reduced ones; the full model is the first everywhere.

    Attributes
    ----------
    points : NDArray
        Undeformed points, shape `(n, 3)` [length].
    modes : NDArray
        Number of modes of each reduced model, shape `(m,)`.
    displacement : NDArray
        Displacements, shape `(m + 1, n, 3)` [length].
    stress : NDArray
        Largest principal Cauchy stresses, not a number where J <= 0, shape `(m + 1, n)`
        [force/length^2].
    surface : NDArray
        Points at the corners of the surface's triangles, as in `Results.surface`, shape `(t, 3)`.
    """

    points: F64
    modes: I64
    displacement: F64
    stress: F64
    surface: I32


def write_reduced(folder: Path, fields: ReducedFields) -> None:
    """Write the file of a folder."""
    with whole_file(folder / REDUCED_FILE) as unfinished, unfinished.open("wb") as stream:
        np.savez_compressed(stream, **fields._asdict())


def read_reduced(path: Path) -> ReducedFields:
    """Read the file.

    Raises
    ------
    FileError
        It is damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            return ReducedFields(*(np.asarray(content[name]) for name in ReducedFields._fields))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as reason:
        raise FileError(f"{path}: cannot be read: {reason}; run `myork rom` again") from None

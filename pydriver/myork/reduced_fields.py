"""Fields of reduced models beside the full one, in the file `reduced_fields.npz` of a folder."""

import zipfile
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from myork.errors import FileError
from myork.files import whole_file
from myork.types import F64, I32, I64

REDUCED_FILE = "reduced_fields.npz"
_DAMAGES = (OSError, ValueError, KeyError, EOFError, TypeError, MemoryError, OverflowError,
            RuntimeError, zipfile.BadZipFile, zlib.error)  # fmt: skip
#: Beyond this a number is damage, or of no use in a picture
_LARGEST = 1e150


class ReducedFields(NamedTuple):
    """One state of the full model and of reduced ones; the full model is the first everywhere."""

    points: F64  #: Undeformed points, shape `(n, 3)` [length]
    modes: I64  #: Number of modes of each reduced model, shape `(m,)`
    displacement: F64  #: Displacements, shape `(m + 1, n, 3)` [length]
    #: Largest principal Cauchy stresses, not a number where J <= 0, shape `(m + 1, n)`
    #: [force/length^2]
    stress: F64
    #: Points at the corners of the surface's triangles, as in `Results.surface`, shape `(t, 3)`
    surface: I32


def write_reduced(folder: Path, fields: ReducedFields) -> None:
    """Write the file of a folder."""
    with whole_file(folder / REDUCED_FILE) as unfinished, unfinished.open("wb") as stream:
        np.savez_compressed(stream, **fields._asdict())


def read_reduced(path: Path) -> ReducedFields:
    """Read the file.

    - raises FileError: it is damaged
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            found = ReducedFields(*(np.asarray(content[name]) for name in ReducedFields._fields))
    except _DAMAGES as reason:
        raise FileError(f"{path}: cannot be read: {reason}; run `myork rom` again") from None
    n, m = len(np.atleast_1d(found.points)), np.size(found.modes)
    shapes = ((n, 3), (m,), (m + 1, n, 3), (m + 1, n), (len(np.atleast_1d(found.surface)), 3))
    for (name, values), shape in zip(found._asdict().items(), shapes, strict=True):
        whole = name in ("modes", "surface")
        right = values.shape == shape and values.dtype.kind in ("iu" if whole else "f")
        if right and name == "surface":
            right = bool(((values >= 0) & (values < n)).all())
        elif right:
            size = np.abs(np.nan_to_num(values) if name == "stress" else values)
            right = bool((size <= _LARGEST).all())
        if not right:
            raise FileError(
                f"{path}: {name}: finite numbers of shape {shape} are needed; run `myork rom` again"
            )
    return found

"""NRRD and MetaImage by SimpleITK, an extra of the package.

In its world, x points left and y backwards; in this package, right, anterior, superior.
"""

import re
from pathlib import Path

import numpy as np

from myork.console import ProgressCallback
from myork.errors import FileError, InputError, optional

ITK_SUFFIXES = (".nrrd", ".nhdr", ".mha", ".mhd")

_NRRD = (".nrrd", ".nhdr")
# Header fields of MetaImage and NRRD that give sizes and directions of voxels
_GEOMETRY = (
    re.compile(r"(?is)(?=.*^ElementSpacing)(?=.*^(TransformMatrix|Rotation|Orientation))", re.M),
    re.compile(r"(?im)^space directions:"),
)
# Converts world axes of SimpleITK to those of this package, and back
_FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
# Largest length of a header [bytes].
_LONGEST_HEADER = 1 << 20
# Units of a NRRD header, in mm
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "microns": 0.001}


def load_itk(path: Path, note: ProgressCallback) -> tuple[np.ndarray, np.ndarray]:
    """Values as stored, shape `(ni, nj, nk)` or with more axes, and the affine [mm].

    - `note`: called with messages about missing header fields
    """
    itk = optional("SimpleITK", "formats", path)
    try:
        image = itk.ReadImage(str(path))
    except Exception as reason:
        raise FileError(
            f"{path}: cannot be read: {_said(reason)}; it was cut off, its data file is "
            "not there or its header is damaged: copy or write it again"
        ) from None
    header = _header(path)
    if not _GEOMETRY[path.suffix in _NRRD].search(header):
        note(
            f"{path}: its header gives no size of voxels or no directions of their axes; cubes of "
            "1 mm along left, posterior, superior are assumed where they are missing: write the "
            "file with its geometry"
        )
    dimension = image.GetDimension()
    vectors = image.GetNumberOfComponentsPerPixel() > 1
    # Axes are in the order (..., k, j, i), with the components of a voxel last.
    order = [*reversed(range(dimension)), *([dimension] if vectors else [])]
    data = itk.GetArrayFromImage(image).transpose(order)
    size = np.array(image.GetSpacing())
    direction = np.array(image.GetDirection()).reshape(dimension, dimension)
    affine = np.eye(4)
    n = min(dimension, 3)
    affine[:n, :n] = (direction * size)[:n, :n]
    affine[:n, 3] = image.GetOrigin()[:n]
    affine[:3] *= _nrrd_unit(path, header)
    if dimension == 2 and vectors:
        data = data[:, :, np.newaxis, :]
    return data, _FLIP @ affine


def save_itk(path: Path, data: np.ndarray, affine: np.ndarray) -> None:
    """Write values of shape `(ni, nj, nk)` or `(ni, nj, nk, nvalue)` and their affine [mm]."""
    itk = optional("SimpleITK", "formats", path)
    order = (2, 1, 0, 3)[: data.ndim]
    image = itk.GetImageFromArray(np.ascontiguousarray(data.transpose(order)), data.ndim == 4)
    turned = _FLIP @ affine
    size = np.linalg.norm(turned[:3, :3], axis=0)
    image.SetSpacing(size.tolist())
    image.SetDirection((turned[:3, :3] / size).ravel().tolist())
    image.SetOrigin(turned[:3, 3].tolist())
    try:
        itk.WriteImage(image, str(path), True)
    except RuntimeError as reason:
        raise FileError(f"{path}: cannot be written: {_said(reason)}") from None


def _said(reason: Exception) -> str:
    """The relevant line of SimpleITK's long error message."""
    lines = str(reason).strip().splitlines() or [type(reason).__name__]
    named = [line for line in lines if "ERROR: " in line or line.startswith("[nrrd]")]
    text = (named or lines)[-1].rpartition("ERROR: ")[2]
    return (text.partition("): ")[2] or text).strip()


def _header(path: Path) -> str:
    """Header text before the values of a file."""
    with path.open("rb") as file:
        text = file.read(_LONGEST_HEADER)
    end = b"\n\n" if path.suffix in _NRRD else b"ElementDataFile"
    return text.split(end, 1)[0].decode("latin-1")


def _nrrd_unit(path: Path, header: str) -> float:
    """Length unit of a NRRD header [mm], 1 by default; SimpleITK ignores it."""
    found = re.search(r"(?im)^space units:(.*)$", header)
    if found is None:
        return 1.0
    words = found[1].replace('"', " ").split()
    known = {_UNITS[word] for word in words if word in _UNITS}
    if len(known) != 1:
        raise InputError(
            f"{path}: space units {words} are not understood; one of "
            f"{', '.join(_UNITS)} for all axes is needed"
        )
    return known.pop()

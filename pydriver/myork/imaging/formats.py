"""NRRD and MetaImage by SimpleITK, an extra of the package.

Its world has x to the left and y backwards; here it is right, anterior, superior. What its
readers take for granted is asked here before: they allocate what a header promises, and the one
of MetaImage goes astray on numbers of axes, sizes and types that there are not.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from myork.errors import FileError, InputError, InstallationError, MyorkError
from myork.imaging.promises import DEFLATE_RATIO, check_promise, check_stream

__all__ = ["FLIP", "ITK_SUFFIXES", "library", "load_itk", "save_itk"]

_META_SUFFIXES = (".mha", ".mhd")
ITK_SUFFIXES = (".nrrd", ".nhdr", *_META_SUFFIXES)

#: Turns the axes of the world of SimpleITK and DICOM into those of this package, and back
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
# No header is longer [bytes].
_LONGEST_HEADER = 1 << 20
# Of an image: x, y, z and time
_MOST_AXES = 4
# Keys of the file that holds the data
_DATA_KEYS = ("elementdatafile", "data file", "datafile")
# Bytes of the types of MetaImage that are plain numbers
_META_BYTES = {
    "MET_CHAR": 1,
    "MET_UCHAR": 1,
    "MET_SHORT": 2,
    "MET_USHORT": 2,
    "MET_INT": 4,
    "MET_UINT": 4,
    "MET_LONG": 4,
    "MET_ULONG": 4,
    "MET_LONG_LONG": 8,
    "MET_ULONG_LONG": 8,
    "MET_FLOAT": 4,
    "MET_DOUBLE": 8,
}
# Units of a NRRD header, in mm
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "microns": 0.001}


def load_itk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values as they are stored, shape `(ni, nj, nk)` or with more axes, and the affine [mm]."""
    itk = library("SimpleITK", "formats", path)
    header, length = _header(path)
    if path.suffix in _META_SUFFIXES:
        _check_metaimage(path, header, length)
    unit, stored = _nrrd_unit(path, header), _stored(path, header, length)
    reader = itk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
        shape = [int(n) for n in (*reader.GetSize(), reader.GetNumberOfComponents())]
        check_promise(str(path), shape, math.prod(shape), DEFLATE_RATIO * stored)
        image = reader.Execute()
    except MyorkError:
        raise
    except Exception as reason:
        raise FileError(f"{path}: cannot be read: {_last_line(reason)}") from None
    dimension = image.GetDimension()
    data = itk.GetArrayFromImage(image)
    vectors = image.GetNumberOfComponentsPerPixel() > 1
    # Axes come as (..., k, j, i), the components of a voxel last.
    order = [*reversed(range(dimension)), *([dimension] if vectors else [])]
    size = np.array(image.GetSpacing())
    direction = np.array(image.GetDirection()).reshape(dimension, dimension)
    affine = np.eye(4)
    n = min(dimension, 3)
    affine[:n, :n] = (direction * size)[:n, :n]
    affine[:n, 3] = image.GetOrigin()[:n]
    affine[:3] *= unit
    data = data.transpose(order)
    _check_data(path, header, length, stored, data)
    if dimension == 2 and vectors:
        data = data[:, :, np.newaxis, :]
    return data, FLIP @ affine


def save_itk(path: Path, data: np.ndarray, affine: np.ndarray) -> None:
    """Write values of shape `(ni, nj, nk)` or `(ni, nj, nk, nvalue)` and their affine [mm]."""
    itk = library("SimpleITK", "formats", path)
    order = (2, 1, 0, 3)[: data.ndim]
    image = itk.GetImageFromArray(np.ascontiguousarray(data.transpose(order)), data.ndim == 4)
    turned = FLIP @ affine
    size = np.linalg.norm(turned[:3, :3], axis=0)
    image.SetSpacing(size.tolist())
    image.SetDirection((turned[:3, :3] / size).ravel().tolist())
    image.SetOrigin(turned[:3, 3].tolist())
    try:
        itk.WriteImage(image, str(path), True)
    except RuntimeError as reason:
        raise FileError(f"{path}: cannot be written: {_last_line(reason)}") from None


def _last_line(reason: Exception) -> str:
    """What SimpleITK says at the end of its many lines."""
    return (str(reason).strip() or type(reason).__name__).splitlines()[-1].strip()


def _header(path: Path) -> tuple[dict[str, str], int]:
    """Keys and values at the beginning of a file, and their length with the line that ends them."""
    sign, last = ("=", "elementdatafile") if path.suffix in _META_SUFFIXES else (":", "")
    found: dict[str, str] = {}
    length = 0
    with path.open("rb") as file:
        for line in file.read(_LONGEST_HEADER).split(b"\n"):
            length += len(line) + 1
            text = line.decode("latin-1").strip()
            if not text:
                break
            key, _, value = text.partition(sign)
            found[key.strip().lower()] = value.strip()
            if key.strip().lower() == last:
                break
    return found, length


def _stored(path: Path, header: Mapping[str, str], length: int) -> int:
    """Length of the data after a header, or in the file that it names [bytes].

    A list or pattern of files counts as all files of the folder.
    """
    name = next((header[key] for key in _DATA_KEYS if key in header), "")
    if name.lower() in ("", "local"):
        return max(path.stat().st_size - length, 0)
    data = path.parent / name
    if re.search(r"%|^list", name, re.IGNORECASE):
        return sum(file.stat().st_size for file in path.parent.iterdir() if file.is_file())
    if data.is_file() and not data.samefile(path):
        return data.stat().st_size
    raise FileError(
        f"{path}: cannot be read: its header names the data file {name[:80]!r}, which is not "
        "there; copy both files"
    )


def _check_data(
    path: Path, header: Mapping[str, str], length: int, stored: int, data: np.ndarray
) -> None:
    """Refuse more plain data than the header promises, and compressed ones that are damaged."""
    if {"byte skip", "line skip", "headersize"} & set(header):
        return
    name = next((header[key] for key in _DATA_KEYS if key in header), "local")
    place = path if name.lower() == "local" else path.parent / name
    if not place.is_file():  # a list or a pattern
        return
    start = length if place == path else 0
    if header.get("encoding") in ("gzip", "gz") or _true(header, "compresseddata"):
        check_stream(place, data.nbytes, start)
        return
    plain = header.get("encoding", "raw") == "raw" and _true(header, "binarydata", "true")
    plane = data.nbytes // max(data.shape[2] if data.ndim > 2 else 1, 1)
    if plain and stored - data.nbytes >= max(plane, 1):
        raise FileError(
            f"{path}: holds {stored - data.nbytes} bytes more than its header promises (shape "
            f"{data.shape}, {data.dtype}); the header is damaged: write the file again"
        )


def _true(header: Mapping[str, str], key: str, default: str = "") -> bool:
    return header.get(key, default)[:1].lower() == "t"


def _check_metaimage(path: Path, header: Mapping[str, str], length: int) -> None:
    """Refuse a MetaImage whose header does not go with itself or with its data."""

    def numbers(key: str, count: int | None, least: float) -> list[float]:
        try:
            found = [float(word) for word in header[key].split()]
        except (KeyError, ValueError):
            found = []
        if len(found) != (count or 1) or not all(least <= value < 1e18 for value in found):
            raise FileError(
                f"{path}: cannot be read: the header gives {key} = "
                f"{header.get(key, 'nothing')[:80]!r}; it is damaged: write the file again"
            )
        return found

    axes = int(numbers("ndims", None, 1.0)[0])
    if axes > _MOST_AXES:
        raise FileError(f"{path}: cannot be read: the header gives {axes} axes; it is damaged")
    shape = [int(n) for n in numbers("dimsize", axes, 1.0)]
    for key, count in (("elementspacing", axes), ("elementsize", axes), ("offset", axes),
                       ("position", axes), ("origin", axes), ("transformmatrix", axes**2),
                       ("rotation", axes**2), ("orientation", axes**2)):  # fmt: skip
        if key in header:
            numbers(key, count, 1e-30 if key.startswith("element") else -1e18)
    channels = int(numbers("elementnumberofchannels", None, 1.0)[0]) if (
        "elementnumberofchannels" in header) else 1  # fmt: skip
    if "elementdatafile" not in header:
        raise FileError(f"{path}: cannot be read: the header names no ElementDataFile")
    kind = header.get("elementtype", "").upper()
    if kind not in _META_BYTES:
        raise InputError(
            f"{path}: values of type {kind[:40] or 'nothing'} are not read; save one plain number "
            "a voxel"
        )
    packed, text = _true(header, "compresseddata"), not _true(header, "binarydata", "true")
    stored = _stored(path, header, length)
    # A number in text has two characters at least.
    room = DEFLATE_RATIO * stored if packed else 4 * stored if text else stored
    check_promise(str(path), shape, math.prod(shape) * channels * _META_BYTES[kind], room)


def _nrrd_unit(path: Path, header: Mapping[str, str]) -> float:
    """Length of the unit in which a NRRD header gives its axes [mm]; 1 for other formats."""
    text = header.get("space units")
    if path.suffix in _META_SUFFIXES or text is None:
        return 1.0
    words = text.replace('"', " ").split()
    known = {_UNITS[word] for word in words if word in _UNITS}
    if len(known) != 1:
        raise InputError(
            f"{path}: space units {words} are not understood; one of "
            f"{', '.join(_UNITS)} for all axes is needed"
        )
    return known.pop()


def library(name: str, extra: str, path: Path) -> Any:
    """An optional library, or an error that names the extra."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InstallationError(
            f"{path}: this format needs {name}: pip install 'myork[{extra}]'"
        ) from None

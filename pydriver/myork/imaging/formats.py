"""NRRD and MetaImage by SimpleITK, an extra of the package.

Its world has x to the left and y backwards; here it is right, anterior, superior. What its
readers do not refuse themselves is refused here: data that are longer than the header says or
packed and damaged, and numbers of axes that the reader of MetaImage does not survive.
"""

from __future__ import annotations

import importlib
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from myork.errors import FileError, InputError, InstallationError

__all__ = ["FLIP", "ITK_SUFFIXES", "library", "load_itk", "save_itk"]

_META_SUFFIXES = (".mha", ".mhd")
ITK_SUFFIXES = (".nrrd", ".nhdr", *_META_SUFFIXES)

#: Turns the axes of the world of SimpleITK and DICOM into those of this package, and back
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
# No header is longer [bytes].
_LONGEST_HEADER = 1 << 20
# No field of a NRRD header is longer; SimpleITK does not survive a thousand [characters].
_LONGEST_FIELD = 500
# Of an image: x, y, z and time
_MOST_AXES = 4
# Keys of the file that holds the data
_DATA_KEYS = ("elementdatafile", "data file", "datafile")
# Units of a NRRD header, in mm
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "microns": 0.001}


def load_itk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values as they are stored, shape `(ni, nj, nk)` or with more axes, and the affine [mm]."""
    itk = library("SimpleITK", "formats", path)
    header, length = _header(path)
    if path.suffix in _META_SUFFIXES:
        _check_metaimage(path, header)
    else:
        _check_nrrd(path, header)
    unit = _nrrd_unit(path, header)
    try:
        image = itk.ReadImage(str(path))
    except Exception as reason:
        raise FileError(
            f"{path}: cannot be read: {_said(reason)}; it was cut off, its data file is "
            "not there or its header is damaged: copy or write it again"
        ) from None
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
    _check_data(path, header, length, data)
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
        raise FileError(f"{path}: cannot be written: {_said(reason)}") from None


def _said(reason: Exception) -> str:
    """The one of SimpleITK's many lines that says what is wrong."""
    lines = str(reason).strip().splitlines() or [type(reason).__name__]
    named = [line for line in lines if "ERROR: " in line or line.startswith("[nrrd]")]
    text = (named or lines)[-1].rpartition("ERROR: ")[2]
    return (text.partition("): ")[2] or text).strip()


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


def _check_metaimage(path: Path, header: Mapping[str, str]) -> None:
    """Refuse numbers of axes on which the reader ends the process, and a sign that it drops."""
    axes, size = header.get("ndims", ""), header.get("elementspacing", "")
    if axes not in map(str, range(1, _MOST_AXES + 1)) or "-" in size.replace("e-", ""):
        raise FileError(
            f"{path}: cannot be read: the header gives NDims = {axes[:40]!r}, ElementSpacing = "
            f"{size[:80]!r}; it is damaged: write the file again"
        )


def _check_nrrd(path: Path, header: Mapping[str, str]) -> None:
    """Refuse lines that the reader cannot repeat in a message: it writes beyond the end of it."""
    for key, value in header.items():
        length = len(key) + len(value)
        free = key.startswith("#") or value.startswith("=") or key == "content"
        if length > _LONGEST_FIELD and not free:
            raise FileError(
                f"{path}: cannot be read: the header's line {key[:40]!r} has {length} characters; "
                "it is damaged: write the file again"
            )


def _check_data(path: Path, header: Mapping[str, str], length: int, data: np.ndarray) -> None:
    """Refuse data that are in no file, damaged packed ones, and more than the header promises."""
    if {"byte skip", "line skip", "headersize"} & set(header):
        return
    name = next((header[key] for key in _DATA_KEYS if key in header), "local")
    own = name.lower() == "local"
    place = path if own else path.parent / name
    if not place.exists():  # a list or a pattern
        return
    if not place.is_file() or (place.samefile(path) and not own):
        raise FileError(f"{path}: cannot be read: {name[:80]!r} is no file of data")
    stored = place.stat().st_size - (length if own else 0)
    if header.get("compresseddata", "f")[:1] in "tT":
        content = place.read_bytes()[-stored:]
        stream = zlib.decompressobj(zlib.MAX_WBITS | 32)  # zlib or gzip
        try:
            stored = len(stream.decompress(content, data.nbytes + 1))
        except zlib.error:
            stored = -1
        if stored != data.nbytes or not stream.eof:
            raise FileError(
                f"{path}: cannot be read: the compressed data are damaged; copy the file again"
            )
    plain = header.get("encoding", "raw") == "raw" and header.get("binarydata", "t")[:1] in "tT"
    plane = data.nbytes // max(data.shape[2] if data.ndim > 2 else 1, 1)
    if plain and stored - data.nbytes >= max(plane, 1):
        raise FileError(
            f"{path}: holds {stored - data.nbytes} bytes more than its header promises (shape "
            f"{data.shape}, {data.dtype}); the header is damaged: write the file again"
        )


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

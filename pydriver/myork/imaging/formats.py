"""NRRD and MetaImage by SimpleITK, an extra of the package.

Its world has x to the left and y backwards; here it is right, anterior, superior. What its
readers do not refuse themselves is refused here.
"""

import os
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from myork.errors import FileError, InputError, optional

_META_SUFFIXES = (".mha", ".mhd")
ITK_SUFFIXES = (".nrrd", ".nhdr", *_META_SUFFIXES)

#: Turns the axes of the world of SimpleITK and DICOM into those of this package, and back
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
# No header is longer [bytes].
_LONGEST_HEADER = 1 << 20
# No field of a NRRD header is longer; SimpleITK does not survive a thousand [characters].
_LONGEST_FIELD = 500
# Keys of the file with the data
_DATA_KEYS = ("elementdatafile", "data file", "datafile")
# Units of a NRRD header, in mm
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "microns": 0.001}


def load_itk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values as they are stored, shape `(ni, nj, nk)` or with more axes, and the affine [mm]."""
    itk = optional("SimpleITK", "formats", path)
    header, length = _header(path)
    # SimpleITK does not survive other numbers of axes, and drops the sign of a size.
    if path.suffix in _META_SUFFIXES:
        size_text = header.get("elementspacing", "").replace("e-", "")
        wrong = header.get("ndims") not in ("1", "2", "3", "4") or "-" in size_text
    else:
        wrong = any(
            len(key) + len(value) > _LONGEST_FIELD
            for key, value in header.items()
            if not (key.startswith("#") or value.startswith("=") or key == "content")
        )
    if wrong:
        raise FileError(f"{path}: cannot be read: its header is damaged; write the file again")
    place = _data_file(path, header)
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
    if place is not None:
        _check_stored(path, header, place, length if place == path else 0, data)
    if dimension == 2 and vectors:
        data = data[:, :, np.newaxis, :]
    return data, FLIP @ affine


def save_itk(path: Path, data: np.ndarray, affine: np.ndarray) -> None:
    """Write values of shape `(ni, nj, nk)` or `(ni, nj, nk, nvalue)` and their affine [mm]."""
    itk = optional("SimpleITK", "formats", path)
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
            key, _, value = line.decode("latin-1").strip().partition(sign)
            key = key.strip().lower()
            if key or value:
                found[key] = value.strip()
            if key == last:
                break
    return found, length


def _data_file(path: Path, header: Mapping[str, str]) -> Path | None:
    """The file with the data; None for a list or a pattern of several."""
    name = next((header[key] for key in _DATA_KEYS if key in header), "local")
    own = name.lower() == "local"
    place = path if own else path.parent / name
    if not os.path.exists(place):
        return None
    if not place.is_file() or (place.samefile(path) and not own):
        raise FileError(f"{path}: cannot be read: {name[:80]!r} is not a data file")
    return place


def _check_stored(
    path: Path, header: Mapping[str, str], place: Path, begin: int, data: np.ndarray
) -> None:
    """Refuse damaged packed data, and more of them than the header promises."""
    if {"byte skip", "line skip", "headersize"} & set(header):
        return
    more = place.stat().st_size - begin - data.nbytes
    if header.get("compresseddata", "f")[:1] in "tT":
        stream = zlib.decompressobj(zlib.MAX_WBITS | 32)  # zlib or gzip
        try:
            whole = len(stream.decompress(place.read_bytes()[begin:], data.nbytes + 1))
        except zlib.error:
            whole = -1
        if whole != data.nbytes or not stream.eof:
            raise FileError(
                f"{path}: cannot be read: the compressed data are damaged; copy the file again"
            )
        return
    plain = header.get("encoding", "raw") == "raw" and header.get("binarydata", "t")[:1] in "tT"
    plane = data.nbytes // max(data.shape[2] if data.ndim > 2 else 1, 1)
    if plain and more >= max(plane, 1):
        raise FileError(
            f"{path}: has {more} bytes more than its header promises (shape {data.shape}, "
            f"{data.dtype}); the header is damaged: write the file again"
        )


def _nrrd_unit(path: Path, header: Mapping[str, str]) -> float:
    """Length of the unit in which a NRRD header gives its axes [mm]; 1 where it gives none."""
    words = header.get("space units", "").replace('"', " ").split()
    known = {_UNITS[word] for word in words if word in _UNITS}
    if words and len(known) != 1:
        raise InputError(
            f"{path}: space units {words} are not understood; one of "
            f"{', '.join(_UNITS)} for all axes is needed"
        )
    return known.pop() if known else 1.0

"""Other formats than NIfTI: NRRD and MetaImage by SimpleITK, DICOM series by pydicom.

Both libraries are extras of the package. Their world has x to the left and y backwards; here it
is right, anterior, superior.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from myork.errors import FileError, InputError, InstallationError

__all__ = ["ITK_SUFFIXES", "load_dicom", "load_itk", "save_itk"]

ITK_SUFFIXES = (".nrrd", ".nhdr", ".mha", ".mhd")

_FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
# Units of a NRRD header, in mm
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "microns": 0.001}


def load_itk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values as they are stored, shape `(ni, nj, nk)` or with more axes, and the affine [mm]."""
    itk = _library("SimpleITK", "formats", path)
    try:
        image = itk.ReadImage(str(path))
    except RuntimeError as reason:
        raise FileError(f"{path}: cannot be read: {str(reason).splitlines()[-1].strip()}") from None
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
    affine[:3] *= _nrrd_unit(path)
    data = data.transpose(order)
    if dimension == 2 and vectors:
        data = data[:, :, np.newaxis, :]
    return data, _FLIP @ affine


def save_itk(path: Path, data: np.ndarray, affine: np.ndarray) -> None:
    """Write values of shape `(ni, nj, nk)` or `(ni, nj, nk, nvalue)` and their affine [mm]."""
    itk = _library("SimpleITK", "formats", path)
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
        raise FileError(
            f"{path}: cannot be written: {str(reason).splitlines()[-1].strip()}"
        ) from None


def load_dicom(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """A series of slices in a folder, sorted by position: values, shape `(ni, nj, nk)`, and affine.

    Rescale slope and intercept are applied. Files that are no DICOM images are passed over.
    """
    dicom = _library("pydicom", "dicom", folder)
    slices = []
    for path in sorted(folder.iterdir()):
        if path.is_file():
            try:
                data = dicom.dcmread(path)
            except (dicom.errors.InvalidDicomError, OSError):
                continue
            if "PixelData" in data:
                slices.append((path, data))
    if not slices:
        raise FileError(f"{folder}: holds no DICOM images")
    _check_series(folder, slices)
    first = slices[0][1]
    along_row, along_column = np.array(first.ImageOrientationPatient, float).reshape(2, 3)
    normal = np.cross(along_row, along_column)
    height = [float(np.dot(normal, np.array(d.ImagePositionPatient, float))) for _, d in slices]
    order = np.argsort(height)
    gaps = np.diff(np.array(height)[order])
    if len(gaps) and gaps.min() <= 0.01 * gaps.max():
        same = [slices[order[int(np.argmin(gaps)) + step]][0].name for step in (0, 1)]
        raise InputError(
            f"{folder}: {same[0]} and {same[1]} lie at the same position, so the folder mixes "
            "echoes, times, or magnitude and phase; keep the files of one image in a folder"
        )
    if len(gaps) and np.ptp(gaps) > 0.05 * gaps.mean():
        raise InputError(
            f"{folder}: the distances of the slices run from {gaps.min():.3g} to {gaps.max():.3g} "
            "mm; a slice is missing, or the series must be resampled"
        )
    try:
        stack = [_values(slices[index][1]) for index in order]
    except Exception as reason:  # pydicom's decoders raise what they like
        raise FileError(f"{folder}: the pixels cannot be decoded: {reason}") from None
    affine = np.eye(4)
    rows, columns = (float(value) for value in first.PixelSpacing)
    affine[:3, 0], affine[:3, 1] = along_row * columns, along_column * rows
    affine[:3, 2] = normal * (gaps.mean() if len(gaps) else float(first.get("SliceThickness", 1.0)))
    affine[:3, 3] = np.array(slices[order[0]][1].ImagePositionPatient, float)
    return np.stack(stack, axis=-1), _FLIP @ affine


def _check_series(folder: Path, slices: list[tuple[Path, Any]]) -> None:
    """Refuse files that do not make one stack."""
    for path, data in slices:
        for key in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"):
            if key not in data:
                raise InputError(f"{path}: has no {key}; only plain series of slices are read")
    reference = slices[0]
    questions: tuple[tuple[str, Callable[[Any], Any]], ...] = (
        ("series", lambda d: str(d.get("SeriesInstanceUID", ""))),
        ("sizes", lambda d: (int(d.Rows), int(d.Columns))),
        (
            "orientations",
            lambda d: np.round(np.array(d.ImageOrientationPatient, float), 3).tolist(),
        ),
        ("pixel sizes", lambda d: np.round(np.array(d.PixelSpacing, float), 4).tolist()),
    )
    for word, answer in questions:
        wanted = answer(reference[1])
        other = [path for path, data in slices if answer(data) != wanted]
        if other:
            raise InputError(
                f"{folder}: holds different {word}: {reference[0].name} has {wanted}, "
                f"{other[0].name} has not ({len(other)} of {len(slices)} files); keep one series "
                "in a folder"
            )


def _values(data: Any) -> np.ndarray:
    """Pixels of a slice, columns first, with slope and intercept applied."""
    pixels = data.pixel_array.T
    slope, intercept = float(data.get("RescaleSlope", 1)), float(data.get("RescaleIntercept", 0))
    return pixels if (slope, intercept) == (1.0, 0.0) else pixels * slope + intercept


def _nrrd_unit(path: Path) -> float:
    """Length of the unit in which a NRRD header gives its axes [mm]; 1 for other formats."""
    if path.suffix not in (".nrrd", ".nhdr"):
        return 1.0
    with path.open("rb") as file:
        for line in file:
            text = line.decode("latin-1").strip()
            if not text:
                break
            if text.lower().startswith("space units:"):
                words = [word for word in text.split(":", 1)[1].replace('"', " ").split() if word]
                known = {_UNITS[word] for word in words if word in _UNITS}
                if len(known) != 1:
                    raise InputError(
                        f"{path}: space units {words} are not understood; one of "
                        f"{', '.join(_UNITS)} for all axes is wanted"
                    )
                return known.pop()
    return 1.0


def _library(name: str, extra: str, path: Path) -> Any:
    """An optional library, or an error that names the extra."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InstallationError(
            f"{path}: this format needs {name}: pip install 'myork[{extra}]'"
        ) from None

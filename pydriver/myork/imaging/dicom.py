"""DICOM series by pydicom, an extra of the package: a folder of slices as one image."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.errors import FileError, InputError
from myork.imaging.dicom_choice import DicomFile, chosen_files
from myork.imaging.formats import FLIP, library
from myork.types import F64

# Names that promise a DICOM file
_SUFFIXES = (".dcm", ".dicom", ".ima")


class _Slice(NamedTuple):
    """A file of a series."""

    path: Path
    place: F64  # of the first pixel, shape (3,) [mm]
    axes: F64  # unit vectors along rows and columns, shape (2, 3) [-]
    pixel: F64  # distance of rows and of columns, shape (2,) [mm]
    rows: int
    columns: int
    data: Any


def load_dicom(folder: Path, choice: str = "") -> tuple[np.ndarray, np.ndarray]:
    """A series of slices in a folder, sorted by position: values, shape `(ni, nj, nk)`, and affine.

    Rescale slope and intercept are applied. Files that are no DICOM images are passed over. Where
    the folder itself holds none, all folders below it are searched.

    - `choice`: which of several images, see `chosen_files`
    """
    slices = [_slice(*file) for file in series_files(folder, choice)]
    _check_series(folder, slices)
    first = slices[0]
    along_row, along_column = first.axes
    normal = np.cross(along_row, along_column)
    height = [float(np.dot(normal, slice_.place)) for slice_ in slices]
    order = np.argsort(height)
    gaps = np.diff(np.array(height)[order])
    if len(gaps) and gaps.min() <= 0.01 * gaps.max():
        same = [slices[order[int(np.argmin(gaps)) + step]].path.name for step in (0, 1)]
        raise InputError(
            f"{folder}: {same[0]} and {same[1]} lie at the same position, so there are "
            "several times, diffusion weightings or the like (those are for image.dwi), which "
            "their headers do not distinguish; keep the files of one image in a folder"
        )
    if len(gaps) and np.ptp(gaps) > 0.05 * gaps.mean():
        raise InputError(
            f"{folder}: the distances of the slices run from {gaps.min():.3g} to {gaps.max():.3g} "
            "mm; a slice is missing, or the series must be resampled"
        )
    stack = [_values(slices[index]) for index in order]
    affine = np.eye(4)
    rows, columns = first.pixel
    affine[:3, 0], affine[:3, 1] = along_row * columns, along_column * rows
    affine[:3, 2] = normal * (gaps.mean() if len(gaps) else _thickness(first))
    affine[:3, 3] = slices[order[0]].place
    return np.stack(stack, axis=-1), FLIP @ affine


def dicom_files(folder: Path) -> list[DicomFile]:
    """All DICOM images of a folder, one at least; of the folders below where it holds none."""
    dicom = library("pydicom", "dicom", folder)
    for paths in (folder.iterdir(), folder.rglob("*")):
        found = [_read(dicom, path) for path in sorted(paths) if path.is_file()]
        files = [file for file in found if file is not None]
        if files:
            return files
    raise FileError(f"{folder}: holds no DICOM images")


def series_files(folder: Path, choice: str = "") -> list[DicomFile]:
    """Files of the image of a folder that a choice leaves, see `chosen_files`."""
    return chosen_files(folder, dicom_files(folder), choice)


def _read(dicom: Any, path: Path) -> DicomFile | None:
    """A file with pixels, None for one that is not a DICOM image."""
    try:
        with path.open("rb") as file:
            file.seek(128)
            marked = file.read(4) == b"DICM"
    except OSError as reason:
        raise FileError(f"{path}: cannot be read: {reason.strerror}") from None
    if not marked:
        if path.suffix.lower() in _SUFFIXES:
            raise FileError(
                f"{path}: is not a DICOM file, though its name says so; copy it again, or take "
                "it out of the folder"
            )
        return None
    try:
        data = dicom.dcmread(path)
        kinds = [getattr(head.get(key), "name", "") for head, key in (
            (data, "SOPClassUID"), (data.file_meta, "MediaStorageSOPClassUID"))]  # fmt: skip
        pixels = "PixelData" in data
    except Exception as reason:  # for each kind of damage pydicom raises another
        raise FileError(
            f"{path}: is a damaged DICOM file: {reason}; copy it again, or take it out of the "
            "folder"
        ) from None
    if not pixels:
        if len(data) and not any("Image Storage" in str(kind) for kind in kinds):
            return None
        what = "is an image without pixels" if len(data) else "has no data behind its header"
        raise FileError(f"{path}: {what}; the file was cut off, copy it again")
    return DicomFile(path, data)


def _slice(path: Path, data: Any) -> _Slice:
    """A slice of one grey value a pixel."""
    for key in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"):
        if key not in data:
            raise InputError(f"{path}: has no {key}; only plain series of slices are read")
    place = _numbers(path, data, "ImagePositionPatient", 3)
    axes = _numbers(path, data, "ImageOrientationPatient", 6).reshape(2, 3)
    pixel = _numbers(path, data, "PixelSpacing", 2)
    rows, columns, samples, frames = (
        int(_numbers(path, data, key, 1, default)[0])
        for key, default in (("Rows", None), ("Columns", None), ("SamplesPerPixel", 1),
                             ("NumberOfFrames", 1))
    )  # fmt: skip
    if samples != 1 or frames != 1:
        what = f"{samples} values (colours)" if samples != 1 else f"{frames} frames"
        raise InputError(f"{path}: has {what} a pixel; one grey value a pixel is needed")
    if min(rows, columns) < 1:
        raise InputError(f"{path}: has {rows} rows and {columns} columns; the header is damaged")
    return _Slice(path, place, axes, pixel, rows, columns, data)


def _numbers(path: Path, data: Any, key: str, count: int, default: float | None = None) -> F64:
    """Finite numbers of an element, shape `(count,)`."""
    try:
        value = data.get(key, default) if default is not None else data[key].value
        found = np.atleast_1d(np.array(default if value is None else value, float))
    except Exception as reason:  # pydicom converts when asked
        raise InputError(f"{path}: {key} cannot be read: {reason}") from None
    if found.shape != (count,) or not np.isfinite(found).all():
        raise InputError(
            f"{path}: {key} is {found.tolist()}, {count} finite numbers are needed; the header is "
            "damaged"
        )
    return found


def _check_series(folder: Path, slices: list[_Slice]) -> None:
    """Refuse files that do not make one stack."""
    reference = slices[0]
    questions: tuple[tuple[str, Callable[[_Slice], Any]], ...] = (
        ("sizes", lambda s: (s.rows, s.columns)),
        ("orientations", lambda s: np.round(s.axes, 3).ravel().tolist()),
        ("pixel sizes", lambda s: np.round(s.pixel, 4).tolist()),
    )
    for word, answer in questions:
        wanted = answer(reference)
        other = [slice_.path for slice_ in slices if answer(slice_) != wanted]
        if other:
            raise InputError(
                f"{folder}: holds different {word}: {reference.path.name} has {wanted}, "
                f"{other[0].name} has not ({len(other)} of {len(slices)} files); keep one series "
                "in a folder"
            )


def _thickness(slice_: _Slice) -> float:
    """Thickness of a slice that stands alone [mm]."""
    return float(_numbers(slice_.path, slice_.data, "SliceThickness", 1, 1.0)[0])


def _values(slice_: _Slice) -> np.ndarray:
    """Pixels of a slice, columns first, with slope and intercept applied."""
    slope, intercept = (
        float(_numbers(slice_.path, slice_.data, key, 1, default)[0])
        for key, default in (("RescaleSlope", 1.0), ("RescaleIntercept", 0.0))
    )
    try:
        pixels = np.asarray(slice_.data.pixel_array)
    except Exception as reason:  # pydicom's decoders raise what they like
        raise FileError(f"{slice_.path}: the pixels cannot be decoded: {reason}") from None
    if pixels.shape != (slice_.rows, slice_.columns):
        raise FileError(
            f"{slice_.path}: holds {pixels.shape} pixels, its header says "
            f"{(slice_.rows, slice_.columns)}"
        )
    return pixels.T if (slope, intercept) == (1.0, 0.0) else pixels.T * slope + intercept

"""Files in the formats of scanners and converters: slices of DICOM series, gradient tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

from myork.imaging.geometry import Grid
from myork.imaging.gradients import GradientTable, fsl_axes
from myork.types import F64

#: Writes a b value [s/mm^2] and a direction in the world frame into a slice
Writer = Callable[[FileDataset, float, F64], None]
#: Directions of the axes in DICOM's world and in that of this package
_TURN = np.array([-1.0, -1.0, 1.0])


def slice_file(uid: str, rows: int, columns: int) -> FileDataset:
    """A slice of a series without position, pixels and scanner-specific elements."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = pydicom.uid.MRImageStorage
    meta.MediaStorageSOPInstanceUID = generate_uid()
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data = FileDataset("", {}, file_meta=meta, preamble=bytes(128))
    data.SOPClassUID, data.SOPInstanceUID = meta.MediaStorageSOPClassUID, generate_uid()
    data.SeriesInstanceUID = uid
    data.Rows, data.Columns, data.PixelSpacing = rows, columns, [2.0, 1.5]
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 0
    return data


def mr_file(
    maker: str,
    uid: str,
    number: int,
    instance: int,
    rows: int = 16,
    columns: int = 12,
    **elements: Any,
) -> FileDataset:
    """A slice as a scanner writes it, without pixels."""
    data = slice_file(uid, rows, columns)
    data.Manufacturer, data.Modality, data.PatientPosition = maker, "MR", "HFS"
    data.ImageType = ["ORIGINAL", "PRIMARY", "M", "ND"]
    data.StudyInstanceUID = "1.2.3"
    data.SeriesNumber, data.AcquisitionNumber, data.InstanceNumber = number, instance, instance
    data.SliceThickness = data.SpacingBetweenSlices = 5.0
    data.MagneticFieldStrength, data.EchoTime, data.RepetitionTime = 3.0, 60.0, 3000.0
    for key, value in elements.items():
        setattr(data, key, value)
    return data


def siemens(data: FileDataset, b: float, g: F64) -> None:
    """Private elements; none for an image without gradient."""
    block = data.private_block(0x0019, "SIEMENS MR HEADER", create=True)
    block.add_new(0x0C, "IS", int(b))
    if b:
        block.add_new(0x0E, "FD", list(g * _TURN))


def philips(data: FileDataset, b: float, g: F64) -> None:
    """Private elements, a component each."""
    data.private_block(0x2001, "Philips Imaging DD 001", create=True).add_new(0x03, "FL", b)
    block = data.private_block(0x2005, "Philips MR Imaging DD 001", create=True)
    for element, value in zip((0xB0, 0xB1, 0xB2), g * _TURN, strict=True):
        block.add_new(element, "FL", value)


def standard(data: FileDataset, b: float, g: F64) -> None:
    """Standard elements, which all manufacturers may use."""
    data.DiffusionBValue = b
    data.DiffusionGradientOrientation = list(g * _TURN)


def ge(data: FileDataset, b: float, g: F64) -> None:
    """Columns are phase-encoded; components are along rows, columns and slices."""
    data.InPlanePhaseEncodingDirection = "COL"
    data.private_block(0x0043, "GEMS_PARM_01", create=True).add_new(0x39, "IS", [int(b), 0, 0, 0])
    block = data.private_block(0x0019, "GEMS_ACQU_01", create=True)
    row, column = np.reshape(data.ImageOrientationPatient, (2, 3)).astype(float)
    own = (np.array([row, column, np.cross(row, column)]) @ (g * _TURN)) * _TURN
    for element, value in zip((0xBB, 0xBC, 0xBD), own, strict=True):
        block.add_new(element, "DS", f"{value:.6f}")


#: Manufacturers, and where they write b values and directions
MAKERS: dict[str, tuple[str, Writer]] = {
    "Siemens": ("SIEMENS", siemens),
    "Philips": ("Philips Medical Systems", philips),
    "GE": ("GE MEDICAL SYSTEMS", ge),
    "standard elements": ("SIEMENS", standard),
}

#: Distance of rows, columns and slices [mm]
_SPACING = (2.0, 1.5, 5.0)


def stack(
    folder: Path,
    values: F64,
    axes: F64,
    *,
    maker: str = "Siemens",
    first: Sequence[float] = (-10.0, -20.0, 0.0),
    number: int = 1,
    weighting: GradientTable | None = None,
    **elements: Any,
) -> None:
    """Write a series: slices; for a diffusion series one volume after another.

    - `values`: shape `(nrow, ncolumn, nslice, nvolume)`, or without the last axis
    - `axes`: directions of rows, columns and slices in DICOM's world, as columns, shape `(3, 3)`
    - `maker`: one of `MAKERS`
    - `first`: position of the first pixel in DICOM's world, shape `(3,)` [mm]
    - `number`: number of the series
    - `weighting`: b values and directions of the volumes, in the world of this package
    - `elements`: other elements, by their keywords
    """
    folder.mkdir(exist_ok=True, parents=True)
    name, write = MAKERS[maker]
    uid, volumes = generate_uid(), values.reshape(*values.shape[:3], -1)
    rows, columns, slices, count = volumes.shape
    for volume, k in np.ndindex(count, slices):
        data = mr_file(name, uid, number, slices * volume + k + 1, rows, columns, **elements)
        data.PixelSpacing = list(_SPACING[:2])
        data.SliceThickness = data.SpacingBetweenSlices = _SPACING[2]
        data.ImageOrientationPatient = [*axes[:, 0], *axes[:, 1]]
        data.ImagePositionPatient = list(axes[:, 2] * _SPACING[2] * k + first)
        if weighting is not None:
            write(data, float(weighting.b[volume]), weighting.direction[volume])
        data.PixelData = np.rint(volumes[..., k, volume]).astype(np.uint16).tobytes()
        data.save_as(folder / f"{number}_{volume}_{k}.dcm", enforce_file_format=True)


def weighted(still: F64, tensor: F64, table: GradientTable) -> F64:
    """Diffusion images, shape `(..., nvolume)`.

    - `still`: signal without gradient, shape `(...)`
    - `tensor`: xx, yy, zz, xy, xz, yz, shape `(..., 6)` or `(6,)` [mm^2/s]
    """
    return np.asarray(still[..., np.newaxis] * np.exp(-tensor @ table.design().T))


def gradient_table(directions: int) -> GradientTable:
    """An image without gradient followed by evenly spread directions."""
    vectors = np.vstack([np.zeros(3), even_directions(directions)])
    return GradientTable(np.array([0.0, *[500.0] * directions]), vectors)


def reordered(
    image: Grid, axes: Sequence[int] = (2, 0, 1), flipped: Sequence[int] = (0, 2)
) -> Grid:
    """The same image in the world, with voxels in another order.

    - `axes`: axes of the image that become the first, the second and the third
    - `flipped`: axes of the image whose direction is reversed
    """
    data: Any = image.data
    affine = image.affine.copy()
    for axis in flipped:
        affine[:3, 3] += affine[:3, axis] * (data.shape[axis] - 1)
        affine[:3, axis] *= -1
        data = np.flip(data, axis)
    affine[:3, :3] = affine[:3, list(axes)]
    data = np.transpose(data, [*axes, *range(3, data.ndim)])
    return replace(image, data=np.ascontiguousarray(data), affine=affine, name="other")


def even_directions(n: int) -> F64:
    """Directions spread evenly over a half sphere along a spiral, shape `(n, 3)` [-]."""
    height = (np.arange(n) + 0.5) / n
    turn = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)


def write_gradients(folder: Path, name: str, table: GradientTable, affine: F64) -> None:
    """Write b values and directions in FSL's convention for images with this affine."""
    np.savetxt(folder / f"{name}.bval", table.b[np.newaxis], fmt="%g")
    np.savetxt(folder / f"{name}.bvec", (table.direction @ fsl_axes(affine)).T, fmt="%.9f")

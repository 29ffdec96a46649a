"""NIfTI files in and out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from nibabel.imageglobals import LoggingOutputSuppressor
from nibabel.openers import ImageOpener

from myork.errors import FileError, InputError
from myork.imaging.geometry import check_affine
from myork.imaging.plain import check_kind, unpacked_length

__all__ = ["load_nifti", "save_nifti"]

_TO_MM = {"meter": 1000.0, "micron": 0.001}


def load_nifti(path: Path, raw: bool) -> tuple[np.ndarray, np.ndarray]:
    """Values as they are stored, or scaled as the header says, and the affine [mm]."""
    try:
        with LoggingOutputSuppressor():  # what it mends in a header is refused below
            file: Any = nibabel.load(path)
            with ImageOpener(str(path)) as stream:
                written = type(file.header)(stream.read(file.header.sizeof_hdr), check=False)
    except Exception as reason:  # for each kind of damage nibabel raises another
        raise FileError(f"{path}: is not a readable NIfTI file: {_said(reason)}") from None
    if not isinstance(file, nibabel.Nifti1Image):
        raise InputError(f"{path}: is {type(file).__name__}; convert it to NIfTI (.nii, .nii.gz)")
    _check_written(path, written)
    proxy: Any = file.dataobj
    affine = np.array(file.affine, dtype=float)
    try:
        unit = file.header.get_xyzt_units()[0]
    except KeyError:
        raise InputError(
            f"{path}: the unit of length {int(file.header['xyzt_units']) & 7} of its header is "
            "none that NIfTI knows; set xyzt_units to 2 (mm)"
        ) from None
    affine[:3] *= _TO_MM.get(unit, 1.0)
    check_affine(affine, str(path))
    _check_length(path, file)
    try:
        with np.errstate(all="ignore"):
            values = proxy.get_unscaled() if raw else file.get_fdata(dtype=np.float64)
            return np.asarray(values), affine
    except Exception as reason:
        raise FileError(f"{path}: cannot be read: {_said(reason)}") from None


def save_nifti(path: Path, data: np.ndarray, affine: np.ndarray) -> None:
    """Write values and their affine [mm]."""
    file = nibabel.Nifti1Image(data, affine)
    file.header.set_xyzt_units("mm")
    file.set_sform(affine, code=1)
    file.set_qform(affine, code=1)
    nibabel.save(file, path)


def _check_written(path: Path, header: Any) -> None:
    """Refuse what nibabel would mend without a word."""
    offset, slope = float(header["vox_offset"]), float(header["scl_slope"])
    kind, bits = header.get_data_dtype(), int(header["bitpix"])
    size = header["pixdim"][1:4]
    wrong = None
    if offset != 0 and not offset >= header.sizeof_hdr:
        wrong = f"the values start at byte {offset:g}, inside of the header (vox_offset)"
    elif 8 * kind.itemsize != bits:
        wrong = f"values of type {kind} have {bits} bits (datatype, bitpix)"
    elif np.isinf(slope):
        wrong = f"the scale of the values is {slope:g} (scl_slope)"
    elif header["sform_code"] == 0 and not (size != 0).all():
        wrong = f"the affine is singular, voxels have the size {size} (pixdim)"
    if wrong is not None:
        raise FileError(
            f"{path}: the header says that {wrong}; it is damaged: write the file again"
        )


def _check_length(path: Path, file: Any) -> None:
    """Refuse values that are no numbers, and more of them than the header promises.

    Fewer are refused by nibabel, which does not look at what is behind those that it wants.
    """
    kind = file.get_data_dtype()
    check_kind(str(path), kind)
    if path.suffix.lower() in (".bz2", ".zst"):
        return
    shape = tuple(int(n) for n in file.shape)
    plane = kind.itemsize * max(1, int(np.prod(shape[:2], dtype=object)))
    promised = int(file.dataobj.offset) + kind.itemsize * int(np.prod(shape, dtype=object))
    packed = path.suffix.lower() == ".gz"
    stored = unpacked_length(path, promised) if packed else path.stat().st_size
    if stored - promised >= plane:
        raise FileError(
            f"{path}: holds {stored - promised} bytes more than its header promises (shape "
            f"{shape}, {kind}); the header is damaged or not the file's own: write it again"
        )


def _said(reason: Exception) -> str:
    """What an exception says, in one line."""
    return " ".join(str(reason).split()) or type(reason).__name__

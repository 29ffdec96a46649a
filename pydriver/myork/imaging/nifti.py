"""NIfTI files in and out."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from nibabel.imageglobals import LoggingOutputSuppressor

from myork.errors import FileError, InputError
from myork.imaging.geometry import check_affine
from myork.imaging.plain import check_kind

__all__ = ["load_nifti", "save_nifti"]

_TO_MM = {"meter": 1000.0, "micron": 0.001}


def load_nifti(path: Path, raw: bool) -> tuple[np.ndarray, np.ndarray]:
    """Values as they are stored, or scaled as the header says, and the affine [mm]."""
    try:
        with LoggingOutputSuppressor():
            file: Any = nibabel.load(path)
    except Exception as reason:  # for each kind of damage nibabel raises another
        raise FileError(f"{path}: is not a readable NIfTI file: {_said(reason)}") from None
    if not isinstance(file, nibabel.Nifti1Image):
        raise InputError(f"{path}: is {type(file).__name__}; convert it to NIfTI (.nii, .nii.gz)")
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
    check_kind(str(path), file.get_data_dtype())
    try:
        if path.suffix.lower() == ".gz":  # the check sum stands behind what nibabel reads
            with gzip.open(path) as stream:
                while stream.read(1 << 20):
                    pass
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


def _said(reason: Exception) -> str:
    """What an exception says, in one line."""
    return " ".join(str(reason).split()) or type(reason).__name__

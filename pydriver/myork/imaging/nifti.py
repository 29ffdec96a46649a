"""NIfTI files in and out."""

import gzip
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from nibabel.imageglobals import LoggingOutputSuppressor
from nibabel.openers import ImageOpener

from myork.errors import FileError, InputError
from myork.imaging.geometry import check_affine
from myork.imaging.plain import check_kind

# Scales (scl_slope) below are of values that were spread; larger ones of images
_SPREAD = 0.25
_TO_MM = {"meter": 1000.0, "micron": 0.001}


def load_nifti(path: Path, raw: bool) -> tuple[np.ndarray, np.ndarray]:
    """Values as they are stored, or scaled as the header says, and the affine [mm].

    Stored ones that a small scale makes whole numbers come scaled as well: so floating point masks
    are written under the header of an image, spread over all values of its type.
    """
    try:
        with LoggingOutputSuppressor():  # what it mends in a header is refused below
            file: Any = nibabel.load(path)
            with ImageOpener(str(path)) as stream:
                written = type(file.header)(stream.read(file.header.sizeof_hdr), check=False)
    except Exception as reason:  # for each kind of damage nibabel raises another
        raise FileError(f"{path}: is not a readable NIfTI file: {_said(reason)}") from None
    if not isinstance(file, nibabel.Nifti1Image):
        raise InputError(f"{path}: is {type(file).__name__}; convert it to NIfTI (.nii, .nii.gz)")
    _check_written(path, written, file.header)
    proxy: Any = file.dataobj
    affine = np.array(file.affine, dtype=float)
    try:
        unit = file.header.get_xyzt_units()[0]
    except KeyError:
        raise InputError(
            f"{path}: the unit of length {int(file.header['xyzt_units']) & 7} of its header is "
            "not one that NIfTI defines; set xyzt_units to 2 (mm)"
        ) from None
    affine[:3] *= _TO_MM.get(unit, 1.0)
    check_affine(affine, str(path))
    kind = file.get_data_dtype()
    check_kind(str(path), kind)
    count, plane = (int(np.prod(file.shape[:n], dtype=object)) for n in (None, 2))
    promised = int(proxy.offset) + kind.itemsize * count
    try:
        more = _length(path, promised) - promised
        with np.errstate(all="ignore"):
            values = np.asarray(_whole_numbers(proxy) if raw else file.get_fdata(dtype=np.float64))
    except Exception as reason:
        raise FileError(f"{path}: cannot be read: {_said(reason)}") from None
    if more >= max(kind.itemsize * plane, 1):
        raise FileError(
            f"{path}: has {more} bytes more than its header promises (shape {file.shape}, {kind}); "
            "the header is damaged or not the file's own: write it again"
        )
    return values, affine


def _whole_numbers(proxy: Any) -> np.ndarray:
    """Values as they are stored, or the whole numbers of which they are multiples."""
    stored: np.ndarray = proxy.get_unscaled()
    if stored.dtype.kind not in "iu" or not 0 < proxy.slope < _SPREAD:
        return stored
    scaled = stored * proxy.slope + proxy.inter
    whole = np.rint(scaled)
    near = np.abs(scaled - whole).max(initial=0.0) <= 0.51 * proxy.slope
    return whole if near else stored


def save_nifti(path: Path, data: np.ndarray, affine: np.ndarray) -> None:
    """Write values and their affine [mm]."""
    file = nibabel.Nifti1Image(data, affine)
    file.header.set_xyzt_units("mm")
    file.set_sform(affine, code=1)
    file.set_qform(affine, code=1)
    nibabel.save(file, path)


def _check_written(path: Path, written: Any, mended: Any) -> None:
    """Refuse a header in which nibabel changes what matters."""
    names = ("bitpix", "qform_code", "sform_code")
    wrong = [name for name in names if written[name] != mended[name]]
    if written["sform_code"] == 0 and 0 in written["pixdim"][1:4]:
        wrong.append("pixdim")
    if np.isinf(written["scl_slope"]):
        wrong.append("scl_slope")
    if wrong:
        raise FileError(
            f"{path}: the header says {', '.join(f'{name} = {written[name]}' for name in wrong)}; "
            "it is damaged: write the file again"
        )


def _length(path: Path, promised: int) -> int:
    """Bytes of a file, of an unpacked one up to about twice those that its header promises."""
    suffix = path.suffix.lower()
    if suffix != ".gz":
        return promised if suffix in (".bz2", ".zst") else path.stat().st_size
    total = 0
    with gzip.open(path) as stream:  # the check sum stands behind what nibabel reads
        while total <= 2 * promised and (block := stream.read(1 << 20)):
            total += len(block)
    return total


def _said(reason: Exception) -> str:
    """What an exception says, in one line."""
    return " ".join(str(reason).split()) or type(reason).__name__

"""Reading and writing of images and label maps. Faults of files are detected and reported here.

NIfTI is read and written here; NRRD, MetaImage and DICOM series need extras (`formats`).
"""

import csv
import gzip
import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from nibabel.imageglobals import LoggingOutputSuppressor

from myork.console import ProgressCallback, silent
from myork.errors import FileError, InputError
from myork.files import read_text, whole_file, write_text
from myork.imaging.dicom import converted, split_choice, stack_files
from myork.imaging.formats import ITK_SUFFIXES, load_itk, save_itk
from myork.imaging.geometry import check_affine
from myork.imaging.headers import bids_name
from myork.records import Image, Labels

# Larger values are not measurements; squares of smaller ones can be summed.
_LARGEST = 1e30
_WHOLE = 1e-3  # tolerance within which labels count as whole numbers
_LAST_LABEL = int(np.iinfo(np.int32).max)
# Scales (scl_slope) below this spread values over the integer range; larger ones belong to images
_SPREAD = 0.25
# sform and qform that differ by more than this part of a voxel are different geometries
_APART = 0.5
_TO_MM = {"meter": 1000.0, "micron": 0.001}
#: Longest edge below which an image without a unit is probably in metres [mm]
_TINY = 2.0


def read_image(path: Path, values: int | None = 1, note: ProgressCallback = silent) -> Image:
    """Read an image.

    - `path`: NIfTI, NRRD or MetaImage file, or folder of DICOM images; one of several is selected
      by `DIR:series=5,echo=2,kind=phase` or a part of it
    - `values`: values per voxel: 1 for a 3-D image, whose values must be finite; more for the last
      axis of a 4-D one, where a voxel may be not-a-number (the user of a tensor decides); None for
      any number of them, one for a 3-D image
    - `note`: called with irregularities of the file
    - returns values as floating point numbers; a single slice has shape `(ni, nj, 1)`
    """
    data, affine = _load(path, raw=False, note=note)
    data = _grid(path, data.astype(np.float64, copy=False), values)
    if values == 1:
        bad = np.argwhere(~np.isfinite(data))
        if len(bad):
            raise InputError(
                f"{path}: {len(bad)} voxels are not finite, the first at voxel "
                f"{tuple(bad[0].tolist())}; replace them (background is usually 0)"
            )
    bad = np.argwhere((np.abs(data) > _LARGEST) & np.isfinite(data))
    if len(bad):
        raise InputError(
            f"{path}: {len(bad)} values are beyond {_LARGEST:g}, the first at voxel "
            f"{tuple(bad[0].tolist())}; the file or its scale (scl_slope) is damaged"
        )
    return Image(data, affine, str(path))


def read_labels(path: Path, note: ProgressCallback = silent) -> Labels:
    """Read a label map: whole numbers as stored, regardless of the header's scale.

    They may be stored as nearly whole floating point numbers, with not-a-number for the background.
    Names are read from a file with the same stem beside it (`legs.nii.gz` and `legs.json`),
    `{"name": label}`, if there is one; those of BIDS (`legs_dseg.nii.gz`) from `legs_dseg.tsv`.

    - `path`: label map
    - `note`: called with irregularities of the file
    """
    data, affine = _load(path, raw=True, note=note)
    if data.dtype == np.bool_:
        data = data.astype(np.uint8)
    data = _grid(path, data, 1)
    if data.dtype.kind == "f":
        unknown = np.isnan(data)
        if unknown.any():
            note(f"{path}: voxels that are not numbers become background: {int(unknown.sum())}")
        whole = np.rint(np.where(unknown, 0.0, data))
        with np.errstate(invalid="ignore"):
            broken = np.argwhere(~unknown & ~(np.abs(data - whole) < _WHOLE))
        if len(broken):
            first = tuple(broken[0].tolist())
            raise InputError(
                f"{path}: a label map must contain integers, but {len(broken)} voxels contain "
                f"other values, the first is {data[first]:.10g} in voxel {first}; threshold a "
                "probability map first"
            )
        data = whole
    if data.min() < 0:
        raise InputError(f"{path}: labels must not be negative, the lowest is {data.min()}")
    if data.max() > _LAST_LABEL:
        raise InputError(
            f"{path}: labels must not exceed {_LAST_LABEL}, the highest is {data.max()}; the file "
            "is not a label map or damaged"
        )
    names = _read_dseg(path) if bids_name(path)[1] == "dseg" else _read_names(_names_path(path))
    return Labels(data.astype(np.int32), affine, names, str(path))


def read_reference(
    path: Path, progress: ProgressCallback, note: ProgressCallback = silent
) -> Labels:
    """Read an external label map; one without names takes those of its folder.

    - `path`: label map; data sets may have one `labels.json` for all maps of a folder
    - `progress`: called with a warning if that file has other content, which is then ignored
    - `note`: as in `read_labels`
    """
    labels, own = read_labels(path, note), _names_path(path)
    if own.is_file():
        return labels
    try:
        return replace(labels, names=_read_names(own.with_name("labels.json")))
    except InputError as reason:
        progress(f"warning: no names for {path}: {reason}")
        return labels


def write_image(path: Path, image: Image) -> None:
    """Write an image in single precision, lengths in mm; the suffix selects the format."""
    _write(path, image.data.astype(np.float32), image.affine)


def renew_images(folder: Path, **images: Image | None) -> None:
    """Write images as `NAME.nii.gz`; files of images that are None are removed."""
    for name, image in images.items():
        path = folder / f"{name}.nii.gz"
        if image is None:
            path.unlink(missing_ok=True)
        else:
            write_image(path, image)


def write_labels(path: Path, labels: Labels) -> None:
    """Write a label map and, beside it, the names of its labels."""
    small = labels.data.max(initial=0) <= np.iinfo(np.uint8).max
    _write(path, labels.data.astype(np.uint8 if small else np.int32), labels.affine)
    names = {name: label for label, name in labels.names.items()}
    write_text(_names_path(path), json.dumps(names, indent=1) + "\n")


def _load(path: Path, raw: bool, note: ProgressCallback) -> tuple[np.ndarray, np.ndarray]:
    """Values (as stored, or scaled as the header says) and affine in mm."""
    folder, choice = split_choice(path)
    if folder.is_dir():
        # voxels in the order of the files, values scaled as they specify; slices of any echo
        options = ("-y", "n", "-p", "n", "-m", "y")
        with converted(folder, stack_files(folder, choice), ".nii", *options) as file:
            data, affine = load_nifti(file, raw, note)
    elif not path.is_file():
        what = "is not a regular file" if path.exists() else "there is no such file"
        raise FileError(f"{path}: {what}")
    elif path.suffix in ITK_SUFFIXES:
        data, affine = load_itk(path, note)
    else:
        data, affine = load_nifti(path, raw, note)
    _check_kind(path, data.dtype)
    check_affine(affine, str(path))
    return data, affine


def _check_kind(path: Path, kind: np.dtype) -> None:
    """Refuse data whose values are not single plain numbers."""
    if kind.kind == "c":
        raise InputError(
            f"{path}: the values are complex ({kind}); save their magnitude (or one of the "
            "parts) as a separate image"
        )
    if kind.kind not in "biuf":
        raise InputError(
            f"{path}: the values are {'colours' if kind.names else 'no numbers'} ({kind}); save "
            "one grey value per voxel"
        )


def _grid(path: Path, data: np.ndarray, values: int | None) -> np.ndarray:
    """Array of shape `(ni, nj, nk)`, or `(ni, nj, nk, values)`."""
    shape = data.shape
    if values != 1 and data.ndim == 5 and shape[3] == 1:  # vectors in the NIfTI convention
        data = data[:, :, :, 0]
    if values is None and data.ndim in (2, 3):
        data = data.reshape(*shape, *[1] * (4 - data.ndim))
    if values == 1:
        while data.ndim > 3 and data.shape[-1] == 1:
            data = data[..., 0]
        if data.ndim == 2:
            data = data[..., np.newaxis]
        if data.ndim != 3:
            raise InputError(
                f"{path}: a 3-D image is needed, this one has shape {shape}; "
                "extract one of its volumes"
            )
    elif data.ndim != 4 or values not in (None, data.shape[-1]):
        raise InputError(
            f"{path}: a 4-D image with {values or 'some'} volumes is needed, this one has shape "
            f"{shape}"
        )
    if 0 in data.shape:
        raise InputError(f"{path}: the image is empty, its shape is {shape}")
    return data


def _names_path(path: Path) -> Path:
    """`legs.json` for `legs.nii.gz`."""
    return path.with_name(path.name.removesuffix(".gz")).with_suffix(".json")


def _read_names(path: Path) -> dict[int, str]:
    """Names of labels from `{"name": label}`; none without the file."""
    if not path.is_file():
        return {}
    try:
        table = json.loads(read_text(path), object_pairs_hook=_once)
    except (ValueError, RecursionError) as reason:
        raise InputError(f'{path}: must contain {{"name": label}}: {reason}') from None
    labels = list(table.values()) if isinstance(table, dict) else [None]
    right = all(type(label) is int and 0 <= label <= _LAST_LABEL for label in labels)
    if not right or len(set(labels)) < len(labels):
        raise InputError(
            f'{path}: must contain {{"name": label}}, each name with a different label from 0 to '
            f"{_LAST_LABEL}"
        )
    return {label: name for name, label in table.items()}


def _read_dseg(path: Path) -> dict[int, str]:
    """Names of labels from the table beside a BIDS map: columns `index` and `name`."""
    file = path.with_name(path.name.split(".")[0] + ".tsv")
    if not file.is_file():
        return {}
    rows = list(csv.DictReader(read_text(file).splitlines(), delimiter="\t"))
    try:
        names = {int(row["index"]): row["name"].strip() for row in rows}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(f"{file}: columns index and name are needed, separated by tabs") from None
    return {label: name for label, name in names.items() if label > 0}


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Entries of a table in which every name occurs once."""
    table = dict(pairs)
    if len(table) < len(pairs):
        raise ValueError("a name occurs twice")
    return table


def _write(path: Path, data: np.ndarray, affine: np.ndarray) -> None:
    """Write a file in the format selected by its suffix."""
    if not path.name.endswith((".nii", ".nii.gz", *ITK_SUFFIXES)):
        known = ", ".join((".nii.gz", ".nii", *ITK_SUFFIXES))
        raise InputError(f"{path}: no image format has this suffix; one of {known}")
    with whole_file(path, by_suffix=True) as unfinished:
        if path.suffix in ITK_SUFFIXES:
            save_itk(unfinished, data, affine)
        else:
            save_nifti(unfinished, data, affine)


def load_nifti(path: Path, raw: bool, note: ProgressCallback) -> tuple[np.ndarray, np.ndarray]:
    """Values as stored, or scaled by the header, and the affine [mm].

    Stored values that are integers after scaling by a small factor are also scaled: floating point
    masks are written like that under the header of an image, spread over all values of its type.
    """
    try:
        # messages about repaired headers, and about their numbers
        with LoggingOutputSuppressor(), np.errstate(all="ignore"):
            file: Any = nibabel.load(path)
    except Exception as reason:  # nibabel raises a different exception for each kind of damage
        raise FileError(f"{path}: is not a readable NIfTI file: {_said(reason)}") from None
    if not isinstance(file, nibabel.Nifti1Image):
        raise InputError(f"{path}: is {type(file).__name__}; convert it to NIfTI (.nii, .nii.gz)")
    if not (file.header["sform_code"] or file.header["qform_code"]):
        note(
            f"{path}: sform and qform of its header have code 0, so that left and right are not "
            "known and only guessed; set them from the scanner's geometry"
        )
    _check_kind(path, file.get_data_dtype())
    try:
        unit = file.header.get_xyzt_units()[0]
        if path.suffix == ".gz":  # nibabel stops before the checksum
            with gzip.open(path) as stream:
                while stream.read(1 << 20):
                    pass
        with np.errstate(all="ignore"):
            values = np.asarray(
                _whole_numbers(file.dataobj) if raw else file.get_fdata(dtype=np.float64)
            )
    except Exception as reason:
        raise FileError(f"{path}: cannot be read: {_said(reason)}") from None
    affine = np.array(file.affine, dtype=float)
    affine[:3] *= _TO_MM.get(unit, 1.0)
    edges = np.linalg.norm(affine[:3, :3], axis=0) * np.array((*values.shape, 1, 1)[:3])
    if unit == "unknown" and edges.max() < _TINY:
        large = " x ".join(f"{edge:.2g}" for edge in edges.tolist())
        note(
            f"{path}: the header has no unit of length, and in mm the image is {large} mm large; "
            "set the metre if that is its unit"
        )
    shift = _forms_apart(file) * _TO_MM.get(unit, 1.0)
    if shift > _APART * np.linalg.norm(affine[:3, :3], axis=0).min():
        note(
            f"{path}: sform and qform of its header place voxels up to {shift:.3g} mm apart; the "
            "sform is used here, but other programs use the qform: check which one is right"
        )
    return values, affine


def _forms_apart(file: Any) -> float:
    """Largest distance between sform and qform at a corner; 0 without one of them [its unit]."""
    header = file.header
    if not (header["sform_code"] and header["qform_code"]):
        return 0.0
    try:
        difference = header.get_sform() - header.get_qform()
    except (nibabel.spatialimages.HeaderDataError, ValueError):  # not a unit quaternion
        return 0.0
    shape = (*file.shape, 1, 1, 1)[:3]
    ends = np.array([[*place, 1.0] for place in product(*((0, n - 1) for n in shape))])
    return float(np.linalg.norm(ends @ difference[:3].T, axis=1).max())


def _whole_numbers(proxy: Any) -> np.ndarray:
    """Values as stored, or the integers of which they are multiples."""
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


def _said(reason: Exception) -> str:
    """Message of an exception, in one line."""
    return " ".join(str(reason).split()) or type(reason).__name__

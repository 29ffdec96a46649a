"""The file `model.h5`: a point cloud as the Fortran core reads it.

Datasets have the names of the record's arrays.
"""

import io
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from myork.arrays import UNREADABLE, dataset, fitted, holds, index, real, whole
from myork.errors import FileError, InputError
from myork.files import whole_file
from myork.records import PointCloud, Voxels

FORMAT = "myork-model 4"
#: Distance of a point from the centre of its voxel, in edges: `build` moves points onto the
#: surface, at shallow ends by up to three edges
_MOVED = 10.0
#: Arrays of every cloud; fortran/scene/rk_cloud.f90 requires the same of its input
_ARRAYS = {
    "source": real("source points", 3),
    "spacing": real("source points", 3),
    "points": real("points", 3),
    "label": whole("points"),
    "fiber": real("points", 3),
    "volume": real("points", least=0.0),
    "boundary_point": index("boundary points", of="points"),
    "boundary_set": index("boundary points", of="sets"),
    "normal": real("boundary points", 3),
    "area": real("boundary points", least=0.0),
}
#: Optional arrays of a cloud; those of voxels are given all or none
_GRID = ("voxels/index", "voxels/size", "voxels/origin")
_OTHERS = {
    "fraction": real("points", "labels"),
    "fraction_label": whole("labels"),
    "activation": real("points", least=0.0, most=1.0),
    "voxels/index": whole("points", 3, least=-(10**6), most=10**6),
    "voxels/size": real(3, least=np.nextafter(0.0, 1.0)),
    "voxels/origin": real(3),
}


def write_model(path: Path, cloud: PointCloud) -> None:
    """Write a model."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(model_bytes(cloud))


def model_bytes(cloud: PointCloud) -> bytes:
    """Content of the file of a model."""
    labels = "\n".join(f"{label} {name}" for label, name in sorted(cloud.label_names.items()))
    texts = {
        "format": FORMAT, "length_unit": cloud.length_unit, "source_images": cloud.source_images,
        "set_names": "\n".join(cloud.set_names), "label_names": labels,
    }  # fmt: skip
    # HDF5 cannot handle a full disk, so the file is made in memory
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        arrays = _arrays_of(cloud)
        arrays |= {name: np.frombuffer(text.encode(), np.uint8) for name, text in texts.items()}
        for name, array in arrays.items():
            # a check sum, by which every reader notices damage; an empty array cannot have one
            file.create_dataset(name, data=array, fletcher32=array.size > 0)
    return content.getvalue()


def read_model(path: Path) -> PointCloud:
    """Read a model.

    - raises FileError: there is no such file, or it cannot be read
    - raises InputError: it has another format, or its content is not a model
    """
    if not path.is_file():
        raise FileError(f"{path}: there is no such model; `myork build` writes one")
    return _read(path, f"{path}")


def model_of_bytes(content: bytes, name: str) -> PointCloud:
    """As `read_model`, for the content of a file; errors use the name."""
    return _read(io.BytesIO(content), name)


def _read(source: Path | io.BytesIO, name: str) -> PointCloud:
    try:
        with h5py.File(source, "r") as file:
            return _cloud_of(file)
    except InputError as reason:
        raise InputError(f"{name}: {reason}; run `myork build` again") from None
    except UNREADABLE as reason:
        raise FileError(
            f"{name}: is not a readable model: {reason}; run `myork build` again"
        ) from None


def _cloud_of(file: h5py.File) -> PointCloud:
    stamp = _text(file, "format")
    if stamp != FORMAT:
        raise InputError(f"its format is '{stamp[:40]}', not '{FORMAT}'")
    sets = _lines(file, "set_names")
    labels = dict(_label(line) for line in _lines(file, "label_names"))
    names = [*_ARRAYS, *(name for name in _OTHERS if holds(file, name.split("/")[0]))]
    found = {name: dataset(file, name) for name in names}
    if "fraction" in found and not labels:
        raise InputError("'label_names' is empty: the tissues of 'fraction' have no names")
    arrays = _fitted(found, {"sets": len(sets), "labels": len(labels)})
    if not np.all(arrays["spacing"] > 0):
        raise InputError("'spacing' must be positive everywhere")
    columns = arrays.pop("fraction_label", np.zeros(0, np.int32))
    if "fraction" in arrays and columns.tolist() != sorted(labels):
        raise InputError("'fraction_label' must contain the labels of 'label_names', ascending")
    return PointCloud(
        **_with_voxels(arrays),
        set_names=tuple(sets),
        label_names=labels,
        length_unit=_text(file, "length_unit"),
        source_images=_text(file, "source_images"),
    )


def checked_cloud(cloud: PointCloud) -> PointCloud:
    """A cloud with arrays of the types that the core takes.

    - raises InputError: they are inconsistent, or have indices out of range
    """
    arrays = _arrays_of(cloud)
    arrays.pop("fraction_label", None)
    return replace(cloud, **_with_voxels(arrays))


def _arrays_of(cloud: PointCloud) -> dict[str, Any]:
    """Arrays of a cloud by their names in the file, checked."""
    found = {name: getattr(cloud, name) for name in _ARRAYS}
    if np.shape(cloud.spacing) == (3,):
        found["spacing"] = np.broadcast_to(cloud.spacing, (len(cloud.source), 3))
    if cloud.fraction is not None:
        found |= {"fraction": cloud.fraction, "fraction_label": sorted(cloud.label_names)}
    if cloud.activation is not None:
        found["activation"] = cloud.activation
    if cloud.voxels is not None:
        found |= {name: getattr(cloud.voxels, name.split("/")[1]) for name in _GRID}
    found = {name: np.asarray(value) for name, value in found.items()}
    try:
        return _fitted(found, {"sets": len(cloud.set_names), "labels": len(cloud.label_names)})
    except InputError as reason:
        raise InputError(f"cloud: {reason}") from None


def _with_voxels(arrays: dict[str, Any]) -> dict[str, Any]:
    """Arrays with those of the voxel grid as one record, which may be missing."""
    grid = [arrays.pop(name) for name in _GRID if name in arrays]
    return {**arrays, "voxels": Voxels(*grid) if grid else None}


def _fitted(found: Mapping[str, Any], sizes: Mapping[str, int]) -> dict[str, Any]:
    """Arrays that satisfy the rules, of a body that has volume and lies in its voxels."""
    rules = _ARRAYS | {name: rule for name, rule in _OTHERS.items() if name in found}
    arrays = fitted(rules, found, sizes)
    if not arrays["volume"].any():
        raise InputError("'volume' must not be 0 everywhere")
    if _GRID[0] in arrays:
        place, size, origin = (arrays[name] for name in _GRID)
        with np.errstate(all="ignore"):
            far = np.abs(arrays["points"] - (origin + place * size)).max(axis=1)
            near = far <= _MOVED * size.max()
        if not near.all():
            entry = int(np.argmin(near))
            raise InputError(
                f"'voxels/index', 'voxels/size' and 'voxels/origin' place the voxel of point "
                f"{entry} {far[entry]:g} away from it"
            )
    return arrays


def _label(line: str) -> tuple[int, str]:
    """Label and name from a line of `label_names`."""
    number, _, name = line.partition(" ")
    if not re.fullmatch(r"-?\d{1,10}", number) or abs(int(number)) >= 2**31:
        raise InputError(f"'label_names' has the line {line[:40]!r}: a label and a name are needed")
    return int(number), name


def _text(file: h5py.File, name: str) -> str:
    """A text, stored as bytes, which needs no string type in HDF5."""
    found = dataset(file, name)
    if found.dtype.kind not in "iu" or found.ndim != 1:
        raise InputError(f"'{name}' is not a text")
    text = bytes(found[()].astype(np.uint8)).decode()
    if "\0" in text:
        raise InputError(f"'{name}' contains a null character")
    return text


def _lines(file: h5py.File, name: str) -> list[str]:
    return [line for line in _text(file, name).split("\n") if line]

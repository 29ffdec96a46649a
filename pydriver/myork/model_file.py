"""The file `model.h5`: a point cloud as the Fortran core reads it.

Datasets have the names of the record's arrays.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from myork.errors import FileError, InputError
from myork.files import whole_file
from myork.records import PointCloud, Voxels

__all__ = ["read_model", "write_model"]

FORMAT = "myork-model 3"
#: The format before, which is read as well, and the names that it has for the arrays
FORMAT_2 = "myork-model 2"
_NAMES_2 = {
    "source": "source/points",
    "spacing": "source/spacing",
    "points": "collocation/points",
    "label": "collocation/label",
    "fiber": "collocation/fiber",
    "volume": "collocation/volume",
    "boundary_point": "boundary/point",
    "boundary_set": "boundary/set",
    "normal": "boundary/normal",
    "area": "boundary/area",
    "set_names": "boundary/names",
    "label_names": "labels/names",
}
_INTEGERS = ("label", "boundary_point", "boundary_set")
_REALS = ("source", "points", "fiber", "volume", "normal", "area")


def write_model(path: Path, cloud: PointCloud) -> None:
    """Write a model."""
    labels = "\n".join(f"{label} {name}" for label, name in sorted(cloud.label_names.items()))
    arrays = {
        "spacing": np.broadcast_to(cloud.spacing, cloud.source.shape),
        **{name: np.asarray(getattr(cloud, name), float) for name in _REALS},
        **{name: np.asarray(getattr(cloud, name), np.int32) for name in _INTEGERS},
        "set_names": _bytes("\n".join(cloud.set_names)),
        "label_names": _bytes(labels),
    }
    if cloud.voxels is not None:
        arrays["voxels/index"] = np.asarray(cloud.voxels.index, np.int32)
        arrays["voxels/size"] = cloud.voxels.size
        arrays["voxels/origin"] = cloud.voxels.origin
    with whole_file(path) as unfinished, h5py.File(unfinished, "w") as file:
        file.attrs["format"] = np.bytes_(FORMAT)
        file.attrs["length_unit"] = np.bytes_(cloud.length_unit)
        file.attrs["source_images"] = np.bytes_(cloud.source_images.encode())
        for name, array in arrays.items():
            file[name] = array


def read_model(path: Path) -> PointCloud:
    """Read a model, of this format or the one before."""
    if not path.is_file():
        raise FileError(f"{path}: there is no such model; `myork build` writes one")
    try:
        with h5py.File(path, "r") as file:
            stamp = _text(file.attrs.get("format", b""))
            if stamp not in (FORMAT, FORMAT_2):
                raise InputError(
                    f"{path}: its format is '{stamp}', '{FORMAT}' is wanted; build it anew"
                )
            names = {name: name for name in _NAMES_2} if stamp == FORMAT else _NAMES_2
            labels = _text(file[names["label_names"]]).splitlines()
            arrays = {name: file[names[name]][:] for name in ("spacing", *_REALS, *_INTEGERS)}
            return PointCloud(
                **arrays,
                set_names=tuple(_text(file[names["set_names"]]).splitlines()),
                label_names={int(line.split(" ", 1)[0]): line.split(" ", 1)[1] for line in labels},
                length_unit=_text(file.attrs["length_unit"]),
                source_images=_text(file.attrs["source_images"]),
                voxels=_voxels(file) if stamp == FORMAT else _recovered(file, arrays),
            )
    except (OSError, KeyError) as reason:
        raise FileError(f"{path}: is no readable model: {reason}") from None


def _voxels(file: h5py.File) -> Voxels | None:
    """Grid of the voxels, where the model has one."""
    if "voxels" not in file:
        return None
    return Voxels(*(file[f"voxels/{name}"][:] for name in ("index", "size", "origin")))


def _recovered(file: h5py.File, arrays: dict[str, NDArray[Any]]) -> Voxels | None:
    """Grid of a model of format 2, which has centres only; None where they are no grid.

    The smallest distance along each direction is the size of a voxel; points with other volumes
    are no voxels. The core's reader, fortran/h5/rk_model_file.f90, does the same.
    """
    centre, spacing, volume = file["collocation/centre"][:], arrays["spacing"], arrays["volume"]
    size = spacing.min(axis=0)
    for axis in range(3):
        gaps = np.diff(np.unique(centre[:, axis]))
        gaps = gaps[gaps > 1e-6 * size[axis]]
        if len(gaps):
            size[axis] = gaps.min()
    if not np.allclose(volume, size.prod(), rtol=1e-6, atol=0.0):
        return None
    origin = centre.min(axis=0)
    return Voxels(np.rint((centre - origin) / size).astype(np.int32), size, origin)


def _bytes(text: str) -> np.ndarray:
    """Text as bytes, shape `(n,)`: needs no string type in HDF5."""
    return np.frombuffer(text.encode(), dtype=np.uint8)


def _text(value: bytes | h5py.Dataset) -> str:
    return (value if isinstance(value, bytes) else bytes(value[:])).decode()

"""The file `model.h5`: a point cloud as the Fortran core reads it.

Datasets have the names of the record's arrays.
"""

from __future__ import annotations

import io
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
    if cloud.fraction is not None:
        arrays["fraction"] = cloud.fraction
        arrays["fraction_label"] = np.array(sorted(cloud.label_names), np.int32)
    if cloud.activation is not None:
        arrays["activation"] = cloud.activation
    # HDF5 does not survive a full disk: it makes the file in memory
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs["format"] = np.bytes_(FORMAT)
        file.attrs["length_unit"] = np.bytes_(cloud.length_unit)
        file.attrs["source_images"] = np.bytes_(cloud.source_images.encode())
        for name, array in arrays.items():
            file[name] = array
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content.getvalue())


def read_model(path: Path) -> PointCloud:
    """Read a model, of this format or the one before."""
    if not path.is_file():
        raise FileError(f"{path}: there is no such model; `myork build` writes one")
    try:
        with h5py.File(path, "r") as file:
            stamp = _text(file.attrs.get("format", b""))
            if stamp not in (FORMAT, FORMAT_2):
                raise InputError(
                    f"{path}: its format is '{stamp}', '{FORMAT}' is wanted; build it again"
                )
            names = {name: name for name in _NAMES_2} if stamp == FORMAT else _NAMES_2
            labels = _text(file[names["label_names"]]).splitlines()
            reals = ("spacing", *_REALS)
            arrays = {name: _numbers(file, names[name]) for name in reals}
            arrays |= {name: _indices(file, names[name]) for name in _INTEGERS}
            _check(path, arrays)
            cloud = PointCloud(
                **arrays,
                set_names=tuple(_text(file[names["set_names"]]).splitlines()),
                label_names={int(line.split(" ", 1)[0]): line.split(" ", 1)[1] for line in labels},
                length_unit=_text(file.attrs["length_unit"]),
                source_images=_text(file.attrs["source_images"]),
                voxels=_voxels(file) if stamp == FORMAT else _recovered(file, arrays),
                fraction=_numbers(file, "fraction") if "fraction" in file else None,
                activation=_numbers(file, "activation") if "activation" in file else None,
            )
    except (OSError, KeyError, ValueError, TypeError, IndexError, RuntimeError) as reason:
        # what h5py raises on damaged files is any of these
        raise FileError(
            f"{path}: is not a readable model: {reason}; run `myork build` again"
        ) from None
    wanted = (len(cloud.points), len(cloud.label_names))
    if cloud.fraction is not None and cloud.fraction.shape != wanted:
        raise InputError(
            f"{path}: 'fraction' has shape {cloud.fraction.shape}, but {wanted} is needed; "
            "run `myork build` again"
        )
    if cloud.activation is not None and (
        cloud.activation.shape != (len(cloud.points),)
        or not ((cloud.activation >= 0) & (cloud.activation <= 1)).all()
    ):
        raise InputError(
            f"{path}: 'activation' must hold {len(cloud.points)} numbers from 0 to 1; "
            "run `myork build` again"
        )
    for name, index, count in (
        ("boundary_point", cloud.boundary_point, len(cloud.points)),
        ("boundary_set", cloud.boundary_set, len(cloud.set_names)),
    ):
        if not ((index >= 0) & (index < count)).all():
            raise InputError(
                f"{path}: '{name}' must hold indices from 0 to {count - 1}; run `myork build` again"
            )
    return cloud


def _check(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Refuse arrays that do not fit together, as the Fortran core does."""
    counts = {"source": len(arrays["source"]), "spacing": len(arrays["source"])}
    entries = len(arrays["boundary_point"])
    counts |= dict.fromkeys(("boundary_point", "boundary_set", "normal", "area"), entries)
    what = "" if len(arrays["label"]) and len(arrays["source"]) else "it has no points"
    for name, values in arrays.items():
        length = counts.get(name, len(arrays["label"]))
        flat = name in ("label", "volume", "boundary_point", "boundary_set", "area")
        wanted = (length,) if flat else (length, 3)
        if what:
            break
        if values.shape != wanted:
            what = f"'{name}' has shape {values.shape}, but {wanted} is needed"
        elif not np.isfinite(values).all():
            what = f"'{name}' has a number that is not finite"
        elif name in ("volume", "area") and (values < 0).any():
            what = f"'{name}' has a negative number"
    if what:
        raise InputError(f"{path}: {what}; run `myork build` again")


def _numbers(file: h5py.Group, name: str, kinds: str = "iuf") -> NDArray[Any]:
    """Dataset of numbers; TypeError where it holds others, ValueError where it claims too much."""
    found = file[name]
    if not isinstance(found, h5py.Dataset) or found.dtype.kind not in kinds or not found.ndim:
        raise TypeError(f"'{name}' must hold {'numbers' if 'f' in kinds else 'integers'}")
    # Deflate shrinks by a factor of 1032 at the most; a damaged header may claim any shape
    if found.nbytes > 1100 * found.id.get_storage_size():
        raise ValueError(f"the shape of '{name}' claims far more numbers than the file holds")
    return np.asarray(found[()], dtype=float)


def _indices(file: h5py.Group, name: str) -> NDArray[Any]:
    """Dataset of whole numbers; those beyond 32 bits become the last ones, which nothing has."""
    return _numbers(file, name, "iu").clip(-(2**31), 2**31 - 1).astype(np.int32)


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


def _text(value: bytes | str | h5py.Dataset) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, bytes):
        return value.decode()
    if not isinstance(value, h5py.Dataset) or value.dtype != np.uint8:
        raise TypeError("a text is of another type")
    return _numbers(value.parent, value.name).astype(np.uint8).tobytes().decode()

"""The file `model.h5`: a point cloud as the Fortran core reads it."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from myork.errors import FileError, InputError
from myork.files import whole_file
from myork.records import PointCloud

__all__ = ["read_model", "write_model"]

FORMAT = "myork-model 2"


def write_model(path: Path, cloud: PointCloud) -> None:
    """Write a model."""
    labels = "\n".join(f"{label} {name}" for label, name in sorted(cloud.label_names.items()))
    arrays = {
        "source/points": cloud.source,
        "source/spacing": np.broadcast_to(cloud.spacing, cloud.source.shape),
        "collocation/points": cloud.points,
        "collocation/centre": cloud.centre,
        "collocation/label": cloud.label.astype(np.int32),
        "collocation/fiber": cloud.fiber,
        "collocation/volume": cloud.volume,
        "boundary/point": cloud.boundary_point.astype(np.int32),
        "boundary/set": cloud.boundary_set.astype(np.int32),
        "boundary/normal": cloud.normal,
        "boundary/area": cloud.area,
        "boundary/names": _bytes("\n".join(cloud.set_names)),
        "labels/names": _bytes(labels),
    }
    with whole_file(path) as unfinished, h5py.File(unfinished, "w") as file:
        file.attrs["format"] = np.bytes_(FORMAT)
        file.attrs["length_unit"] = np.bytes_(cloud.length_unit)
        file.attrs["source_images"] = np.bytes_(cloud.source_images.encode())
        for name, array in arrays.items():
            file[name] = array


def read_model(path: Path) -> PointCloud:
    """Read a model."""
    if not path.is_file():
        raise FileError(f"{path}: there is no such model; `myork build` writes one")
    try:
        with h5py.File(path, "r") as file:
            stamp = _text(file.attrs.get("format", b""))
            if stamp != FORMAT:
                raise InputError(
                    f"{path}: its format is '{stamp}', '{FORMAT}' is wanted; build it anew"
                )
            labels = (line.split(" ", 1) for line in _text(file["labels/names"]).splitlines())
            return PointCloud(
                source=file["source/points"][:],
                spacing=file["source/spacing"][:],
                points=file["collocation/points"][:],
                centre=file["collocation/centre"][:],
                label=file["collocation/label"][:],
                fiber=file["collocation/fiber"][:],
                volume=file["collocation/volume"][:],
                boundary_point=file["boundary/point"][:],
                boundary_set=file["boundary/set"][:],
                normal=file["boundary/normal"][:],
                area=file["boundary/area"][:],
                set_names=tuple(_text(file["boundary/names"]).splitlines()),
                label_names={int(number): name for number, name in labels},
                length_unit=_text(file.attrs["length_unit"]),
                source_images=_text(file.attrs["source_images"]),
            )
    except (OSError, KeyError) as reason:
        raise FileError(f"{path}: is no readable model: {reason}") from None


def _bytes(text: str) -> np.ndarray:
    """Text as bytes, shape `(n,)`: needs no string type in HDF5."""
    return np.frombuffer(text.encode(), dtype=np.uint8)


def _text(value: bytes | h5py.Dataset) -> str:
    return (value if isinstance(value, bytes) else bytes(value[:])).decode()

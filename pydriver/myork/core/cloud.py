"""Points that a scene takes from outside: from the model file of a deck, or from arrays."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from myork import errors
from myork.model_file import checked_cloud, read_model
from myork.records import PointCloud, Voxels

# One unused point: the wrapper cannot infer the shape of an empty array.
_AT, _NUMBER = np.zeros((1, 3)), np.zeros(1, np.int32)
NO_CLOUD = PointCloud(
    _AT, np.ones((1, 3)), _AT, _NUMBER, _AT, np.ones(1), _NUMBER, _NUMBER, np.eye(1, 3),
    np.zeros(1), ("none",), {}, "", "",
)  # fmt: skip


def model_of(deck: dict[str, Any], folder: Path, out: Path | None) -> PointCloud | None:
    """Points of the model file of a deck; None where the deck has its own geometry."""
    path = model_path(deck, folder, out)
    return None if path is None else read_model(path)


def model_path(deck: Mapping[str, Any], folder: Path, out: Path | None) -> Path | None:
    """Model file of a deck, in the output folder or beside the deck; None if it has none."""
    geometry = deck["geometry"]
    if geometry["kind"] != "model":
        return None
    name = Path(geometry["file"])
    for place in (out, folder):
        if place is not None and (place / name).is_file():
            return place / name
    raise errors.FileError(
        f"geometry.file: no model {name} in {out or folder} or beside the deck: "
        "run `myork build` first"
    )


def with_cloud(tables: Mapping[str, Any], cloud: PointCloud) -> dict[str, Any]:
    """Tables of a scene with a given cloud; refuse tables with their own geometry."""
    if not isinstance(cloud, PointCloud):
        raise errors.InputError(
            f"cloud: a PointCloud is needed, not {type(cloud).__name__}: "
            "myork.records.PointCloud(source=..., spacing=..., points=..., ...)"
        )
    geometry = tables.get("geometry", {})
    for key, value in geometry.items() if isinstance(geometry, Mapping) else ():
        if (key, value) != ("kind", "model"):
            raise errors.InputError(
                f"tables: geometry.{key}: {value!r}, but a cloud was given: the geometry is its "
                "points; leave the table geometry out, or the cloud"
            )
    units = {"force": "N", "length": cloud.length_unit or "cm"}
    return {"units": units, **tables, "geometry": {"kind": "model"}}


def packed(cloud: PointCloud) -> tuple[Any, ...]:
    """The cloud as arrays for the core: one by source point, two by point, two by entry."""
    n = len(cloud.points)
    parts = np.zeros((n, 1)) if cloud.fraction is None else cloud.fraction
    active = -np.ones(n) if cloud.activation is None else cloud.activation
    # a size of zero means no voxels
    voxels = cloud.voxels or Voxels(np.zeros((n, 3), np.int32), np.zeros(3), np.zeros(3))
    return (
        np.stack([cloud.source.T, cloud.spacing.T], axis=1),
        np.vstack([cloud.points.T, cloud.fiber.T, cloud.volume, active, parts.T]),
        np.vstack([cloud.label, voxels.index.T]),
        np.vstack([cloud.normal.T, cloud.area]),
        np.vstack([cloud.boundary_point, cloud.boundary_set]),
        np.stack([voxels.size, voxels.origin], axis=1),
        [0] if cloud.fraction is None else sorted(cloud.label_names),
        np.char.ljust(np.array([name.encode() for name in cloud.set_names]), 32),
        cloud.length_unit.encode() or b" ",
    )


def check_cloud(deck: Mapping[str, Any], cloud: PointCloud) -> PointCloud:
    """The cloud as the core takes it; an error if it is inconsistent or does not fit the deck."""
    if deck["geometry"]["kind"] != "model":
        raise errors.InputError(
            f"--set geometry.kind={deck['geometry']['kind']}: a cloud was given, whose points are "
            "the geometry"
        )
    return checked_cloud(cloud)

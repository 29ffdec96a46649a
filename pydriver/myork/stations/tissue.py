"""Part of station one: materials of a whole leg, `tissue.nii.gz`, and the fibers of its muscle."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.core.level_sets import evolve_level_sets
from myork.errors import InputError
from myork.imaging.geometry import length_factor
from myork.imaging.io import read_image, read_labels, write_image, write_labels
from myork.model.fibers import fiber_field
from myork.records import Image
from myork.segmentation.leg import LegImages, leg_tissues, outer_boundary
from myork.segmentation.scores import dice

__all__ = ["find_tissues"]

_MUSCLE = 1


def find_tissues(
    deck: Mapping[str, Any],
    folder: Path,
    out: Path,
    anatomy: Image,
    tensor: Image | None,
    body: NDArray[np.bool_] | None = None,
    region: NDArray[np.bool_] | None = None,
) -> dict[str, Any]:
    """Label the materials of a leg and write them and the muscle's fibers.

    Parameters
    ----------
    deck : mapping
        Effective deck; the tables `tissue`, `image` and `units` are read.
    folder : Path
        Where the deck's relative paths start.
    out : Path
        Folder of the results, in which the phantom's images lie where it is used.
    anatomy : Image
        MR image.
    tensor : Image or None
        Diffusion tensors.
    body : NDArray, optional
        What the user calls body, shape `(ni, nj, nk)`; without it, it is found.
    region : NDArray, optional
        What belongs to the body wherever that is found, same shape.

    Returns
    -------
    dict
        Voxels and volume of each material, and the Dice coefficients with the phantom's truth.
    """
    table = deck["tissue"]
    phantom = "anatomy" not in deck["image"]
    special: dict[str, Image | None] = {"fat": None, "connective": None}
    for name in special:
        if phantom:
            special[name] = read_image(out / f"{name}.nii.gz")
        elif name in table:
            special[name] = read_image(folder / table[name])
    images = LegImages(anatomy, special["fat"], special["connective"], tensor)
    if body is None and region is not None:
        body = outer_boundary(anatomy, evolve_level_sets) | region
    found = leg_tissues(images, evolve_level_sets, table, body)
    if not (found.data == _MUSCLE).any():
        raise InputError(f"{anatomy.name}: no muscle was found; check the images of [tissue]")
    write_labels(out / "tissue.nii.gz", found)
    (out / "tissue_fibers.nii.gz").unlink(missing_ok=True)
    if tensor is not None:
        keys = deck["image"]
        fibers, filled, far, distance, _ = fiber_field(
            tensor, found.data == _MUSCLE, keys.get("fiber_smoothing"), keys["tensor_frame"]
        )
        write_image(out / "tissue_fibers.nii.gz", fibers)
    voxel = float(np.prod(found.spacing * length_factor(deck["units"]["length"])))
    count = {name: int((found.data == label).sum()) for label, name in found.names.items()}
    record: dict[str, Any] = {
        "labels": {name: {"pixels": n, "volume": n * voxel} for name, n in count.items()}
    }
    if tensor is not None:
        record["fibers"] = {"filled": filled, "far": far, "distance_mm": distance}
    if phantom:
        truth = read_labels(out / "true_tissue.nii.gz").data
        record["scores"] = {
            name: {"dice": dice(found.data == label, truth == label)}
            for label, name in found.names.items()
        }
    return record

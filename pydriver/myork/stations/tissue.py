"""Part of station one: materials of a whole leg, `tissue.nii.gz`, and the fibers of its muscle.

Memberships in the fuzzy clusters are `membership_fat.nii.gz` and, where there is an image of it,
`membership_connective_tissue.nii.gz`; with `image.partial` parts of the materials in each voxel are
`tissue_fractions.nii.gz`.
"""

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
from myork.segmentation.channels import scaled_values
from myork.segmentation.leg import LegImages, leg_tissues, outer_boundary
from myork.segmentation.scores import dice
from myork.stations.partial import write_parts

__all__ = ["find_tissues"]

_MUSCLE = 1
# Skin, between fat and air, is as grey as both mixed; bone is dark and bright.
_UNMIXED = (0, 4)


def find_tissues(
    deck: Mapping[str, Any],
    folder: Path,
    out: Path,
    anatomy: Image,
    tensor: Image | None,
    body: NDArray[np.bool_] | None = None,
    region: NDArray[np.bool_] | None = None,
    fraction: Image | None = None,
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
    fraction : Image, optional
        Fraction of fat; stands in for `tissue.fat` where the deck names none.

    Returns
    -------
    dict
        Voxels and volume of each material, and the Dice coefficients with the phantom's truth.
    """
    table = deck["tissue"]
    phantom = "anatomy" not in deck["image"] and fraction is None
    special: dict[str, Image | None] = {"fat": None, "connective": None}
    for name in special:
        if phantom:
            special[name] = read_image(out / f"{name}.nii.gz")
        elif name in table:
            special[name] = read_image(folder / table[name])
    fat = fraction if special["fat"] is None else special["fat"]
    images = LegImages(anatomy, fat, special["connective"], tensor)
    if body is None and region is not None:
        body = outer_boundary(anatomy, evolve_level_sets) | region
    memberships: dict[str, NDArray[np.float64]] = {}
    found = leg_tissues(images, evolve_level_sets, table, body, memberships)
    if not (found.data == _MUSCLE).any():
        raise InputError(f"{anatomy.name}: no muscle was found; check the images of [tissue]")
    write_labels(out / "tissue.nii.gz", found)
    for name in ("tissue_fibers", "tissue_fractions"):
        (out / f"{name}.nii.gz").unlink(missing_ok=True)
    maps = {}
    for name in ("fat", "connective_tissue"):
        path = out / f"membership_{name}.nii.gz"
        path.unlink(missing_ok=True)
        if name in memberships:
            write_image(path, Image(memberships[name], anatomy.affine))
            maps[f"membership_{name}"] = path.name
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
    if deck["image"]["partial"]:
        maps["fractions"] = "tissue_fractions.nii.gz"
        shown = [one for one in (anatomy, images.fat, images.connective) if one is not None]
        values = np.stack([scaled_values(one, found.data > 0) for one in shown], axis=-1)
        kinds = np.zeros_like(found.data)
        held = write_parts(out / maps["fractions"], found, kinds, values, _UNMIXED)
        for name, part in held.items():
            record["labels"][name]["volume_of_parts"] = part * voxel
    record["maps"] = maps
    if tensor is not None:
        record["fibers"] = {"filled": filled, "far": far, "distance_mm": distance}
    if phantom:
        truth = read_labels(out / "true_tissue.nii.gz").data
        record["scores"] = {
            name: {"dice": dice(found.data == label, truth == label)}
            for label, name in found.names.items()
        }
    return record

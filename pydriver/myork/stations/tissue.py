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

from myork.errors import InputError
from myork.imaging.geometry import length_factor
from myork.imaging.io import read_image, read_labels, renew_images, write_labels
from myork.model.fibers import fiber_field
from myork.records import Image
from myork.segmentation.channels import scaled_values
from myork.segmentation.images import Segmentation
from myork.segmentation.leg import leg_tissues, outer_boundary
from myork.segmentation.partial import parts_of_labels
from myork.segmentation.scores import dice

__all__ = ["find_tissues"]

_MUSCLE = 1
# Skin, between fat and air, is as grey as both mixed; bone is dark and bright.
_UNMIXED = (0, 4)


def find_tissues(
    deck: Mapping[str, Any], folder: Path, out: Path, segmented: Segmentation
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
    segmented : Segmentation
        Images without shading; the fraction of fat stands in for `tissue.fat` where the deck names
        none.

    Returns
    -------
    dict
        Voxels and volume of each material, and the Dice coefficients with the phantom's truth.
    """
    table, keys, images = deck["tissue"], deck["image"], segmented.images
    phantom = "anatomy" not in keys and segmented.fraction is None
    special: dict[str, Image | None] = {"fat": segmented.fraction, "connective": None}
    for name in special:
        if phantom:
            special[name] = read_image(out / f"{name}.nii.gz")
        elif name in table:
            special[name] = read_image(folder / table[name])
    anatomy, body, tensor = images.whole, images.body, images.tensor
    if body is None and images.region is not None:
        body = outer_boundary(anatomy) | (images.region.data > 0)
    least = table["least_diffusivity"]
    found, memberships = leg_tissues(
        anatomy, **special, tensor=tensor, body=body, least_diffusivity=least
    )
    muscle = found.data == _MUSCLE
    if not muscle.any():
        raise InputError(f"{anatomy.name}: no muscle was found; check the images of [tissue]")
    made: dict[str, Image | None] = dict.fromkeys(
        ("tissue_fibers", "tissue_fractions", "membership_fat", "membership_connective_tissue")
    )
    made |= {f"membership_{k}": Image(v, found.affine) for k, v in memberships.items()}
    voxel = float(np.prod(found.spacing * length_factor(deck["units"]["length"])))
    count = {name: int((found.data == label).sum()) for label, name in found.names.items()}
    record: dict[str, Any] = {
        "labels": {name: {"pixels": n, "volume": n * voxel} for name, n in count.items()},
        "maps": {name: f"{name}.nii.gz" for name, one in made.items() if one is not None},
    }
    if tensor is not None:
        way = fiber_field(tensor, muscle, keys.get("fiber_smoothing"))
        made["tissue_fibers"] = way.fibers
        record["fibers"] = {"filled": way.filled, "far": way.far, "distance_mm": way.distance}
    if keys["partial"]:
        shown = [one for one in (anatomy, *special.values()) if one is not None]
        values = np.stack([scaled_values(one, found.data > 0) for one in shown], axis=-1)
        parts, filled = parts_of_labels(found, np.zeros_like(found.data), values, _UNMIXED)
        made["tissue_fractions"] = parts
        record["maps"]["fractions"] = "tissue_fractions.nii.gz"
        for name, part in filled.items():
            record["labels"][name]["volume_of_parts"] = part * voxel
    write_labels(out / "tissue.nii.gz", found)
    renew_images(out, **made)
    if phantom:
        truth = read_labels(out / "true_tissue.nii.gz").data
        record["scores"] = {
            name: {"dice": dice(found.data == label, truth == label)}
            for label, name in found.names.items()
        }
    return record

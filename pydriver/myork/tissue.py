"""Part of station one: the materials of a whole leg, `tissue.nii.gz`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from myork.core_image import evolve_two_phase
from myork.errors import InputError
from myork.imaging.geometry import length_factor
from myork.imaging.io import read_image, read_labels, write_labels
from myork.records import Image
from myork.segmentation.leg import LegImages, leg_tissues
from myork.segmentation.scores import dice

__all__ = ["find_tissues"]

_WEIGHTS = ("mu", "nu", "lambda1", "lambda2", "epsilon", "dt", "tolerance", "iterations")


def find_tissues(
    deck: Mapping[str, Any], folder: Path, out: Path, anatomy: Image, tensor: Image | None
) -> dict[str, Any]:
    """Label the materials of a leg and write them to `tissue.nii.gz`.

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
    weights = {key: deck["image"][key] for key in _WEIGHTS}
    found = leg_tissues(images, evolve_two_phase, weights, table)
    write_labels(out / "tissue.nii.gz", found)
    voxel = float(np.prod(found.spacing * length_factor(deck["units"]["length"])))
    count = {name: int((found.data == label).sum()) for label, name in found.names.items()}
    record: dict[str, Any] = {
        "labels": {name: {"pixels": n, "volume": n * voxel} for name, n in count.items()}
    }
    if phantom:
        truth = read_labels(out / "true_tissue.nii.gz").data
        record["scores"] = {
            name: {"dice": dice(found.data == label, truth == label)}
            for label, name in found.names.items()
        }
    if not count["muscle"]:
        raise InputError(f"{anatomy.name}: no muscle was found; check the images of [tissue]")
    return record

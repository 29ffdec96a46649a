"""Part of station one: materials of a whole leg, `tissue.nii.gz`, and the fibers of its muscle.

Memberships in the fuzzy clusters are `membership_fat.nii.gz` and, where there is an image of it,
`membership_connective_tissue.nii.gz`; with `image.partial` parts of the materials in each voxel are
`tissue_fractions.nii.gz`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork.errors import InputError
from myork.imaging.geometry import length_factor
from myork.imaging.io import read_image, read_labels, renew_images, write_labels
from myork.model.fibers import fibers_of_labels
from myork.records import Image, Labels
from myork.segmentation.channels import scaled_values
from myork.segmentation.images import Segmentation
from myork.segmentation.leg import leg_tissues, outer_boundary
from myork.segmentation.partial import parts_of_labels
from myork.segmentation.scores import dice
from myork.stations.data import DeckFiles, OneGrid
from myork.types import F64, I32

_MUSCLE = 1
# Skin, between fat and air, is as grey as both mixed; bone is dark and bright.
_UNMIXED = (0, 4)


class LabelRecord(dict[str, Any]):
    """Entry of the summary about a label map.

    - `labels`: the map
    - `deck`: table `units`: volumes are in its unit of length, cubed
    """

    def __init__(self, labels: Labels, deck: Mapping[str, Any]) -> None:
        self._labels = labels
        self._voxel = float(np.prod(labels.spacing * length_factor(deck["units"]["length"])))
        count = {name: int((labels.data == n).sum()) for n, name in labels.names.items()}
        entries = {name: {"pixels": n, "volume": n * self._voxel} for name, n in count.items()}
        super().__init__(labels=entries)

    def parts(self, kinds: I32, values: F64, unmixed: Sequence[int], file: str) -> Image:
        """Parts of the labels in each voxel; their volumes and file are noted.

        - `kinds`, `values`, `unmixed`: as of `parts_of_labels`
        - `file`: name of the file of the parts
        """
        parts, filled = parts_of_labels(self._labels, kinds, values, unmixed)
        for name, voxels in filled.items():
            self["labels"][name]["volume_of_parts"] = voxels * self._voxel
        self.setdefault("maps", {})["fractions"] = file
        return parts


def find_tissues(
    deck: Mapping[str, Any], out: Path, segmented: Segmentation, grid: OneGrid
) -> LabelRecord:
    """Label the materials of a leg and write them and the muscle's fibers.

    - `deck`: effective deck; the tables `tissue`, `image` and `units` are read
    - `out`: folder of the results, in which the phantom's images lie where it is used
    - `segmented`: images without shading; the fraction of fat stands in for `tissue.fat` where the
      deck names none
    - `grid`: brings images onto the grid of the segmented ones
    - returns voxels and volume of each material, and the Dice coefficients with the phantom's truth
    """
    files, keys, images = DeckFiles(deck, "tissue", grid), deck["image"], segmented.images
    phantom = "anatomy" not in keys and segmented.fraction is None
    fat: Image | None
    connective: Image | None
    if phantom:
        fat, connective = (read_image(out / f"{name}.nii.gz") for name in ("fat", "connective"))
    else:
        fat = files.image("fat", images.anatomy) or segmented.fraction
        connective = files.image("connective", images.anatomy)
    anatomy, body, tensor = images.whole, images.body, images.tensor
    if body is None and images.region is not None:
        body = outer_boundary(anatomy) | (images.region.data > 0)
    found, memberships, doubts = leg_tissues(
        anatomy, fat=fat, connective=connective, others=images.others, tensor=tensor, body=body,
        least_diffusivity=files.table["least_diffusivity"],
    )  # fmt: skip
    muscle = found.data == _MUSCLE
    if not muscle.any():
        raise InputError(f"{anatomy.name}: no muscle was found; check the images of [tissue]")
    made: dict[str, Image | None] = dict.fromkeys(
        ("tissue_fibers", "tissue_fractions", "membership_fat", "membership_connective_tissue")
    )
    made |= {f"membership_{k}": Image(v, found.affine) for k, v in memberships.items()}
    record = LabelRecord(found, deck)
    record["warnings"] = doubts
    record["maps"] = {name: f"{name}.nii.gz" for name, one in made.items() if one is not None}
    if tensor is not None:
        own = Labels(muscle.astype(np.int32), found.affine, {}, found.name)
        way = fibers_of_labels(images.measured or tensor, own, keys.get("fiber_smoothing"))
        made["tissue_fibers"] = way.fibers
        record["fibers"] = {"filled": way.filled, "far": way.far, "distance_mm": way.distance}
    if keys["partial"]:
        shown = [one for one in (anatomy, fat, connective) if one is not None]
        values = np.stack([scaled_values(one, found.data > 0) for one in shown], axis=-1)
        made["tissue_fractions"] = record.parts(
            np.zeros_like(found.data), values, _UNMIXED, "tissue_fractions.nii.gz"
        )
    write_labels(out / "tissue.nii.gz", found)
    renew_images(out, **made)
    if phantom:
        truth = read_labels(out / "true_tissue.nii.gz").data
        record["scores"] = {
            name: {"dice": dice(found.data == label, truth == label)}
            for label, name in found.names.items()
        }
    return record

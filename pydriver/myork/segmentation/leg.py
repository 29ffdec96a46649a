"""The materials of a whole leg from its images (thesis section 4.1.2).

The outer boundary and the bones come from the anatomy by two-phase level sets; fat and connective
tissue are clustered in images of their own sequences; of what is left, voxels with a diffusion
tensor are muscle and all others fat. Without tensors only the skin is taken from the muscle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.diffusion import mean_diffusivity
from myork.imaging.geometry import check_same_grid
from myork.imaging.phantom import TISSUES
from myork.records import Image, Labels
from myork.segmentation.channels import scaled_values
from myork.segmentation.fuzzy import fuzzy_c_means
from myork.segmentation.level_sets import Evolve, LevelSets, segment_regions, wanted_phase
from myork.segmentation.regions import large_pieces
from myork.types import F64, Mask

__all__ = ["LegImages", "check_disjoint", "find_bones", "leg_tissues", "outer_boundary"]


# Marrow: at least this large in the slice [mm^2]; cortex is as thick as this at most [mm].
_LEAST_MARROW = 15.0
_CORTEX = 6.0
_COVERED = 0.6
# The bright cluster of the special sequence is connective tissue only if it is so many times as
# bright as the other: without any, the two would be muscle and fat.
_STANDS_OUT = 2.5
# Skin, and pixels of fat and air mixed, are as grey as muscle, no deeper than this [mm].
_SKIN = 3.0
# Two phases of a slice. The choice is this method's own: a leg has no keys for it.
_PHASES = LevelSets(
    regions=2, start="otsu", mu=0.01, lambdas=(1.0,), tolerance=1e-4, iterations=300
)


@dataclass(frozen=True)
class LegImages:
    """Images of a leg, all on the grid of the anatomy; those that are missing are None.

    Attributes
    ----------
    anatomy : Image
        T1-like MR image, shape `(ni, nj, nk)`.
    fat, connective : Image or None
        Images in which fat, or connective tissue, is bright; without the first the anatomy shows
        fat, without the second no connective tissue is found.
    tensor : Image or None
        Diffusion tensors; without them all that is left is muscle but for the skin.
    """

    anatomy: Image
    fat: Image | None = None
    connective: Image | None = None
    tensor: Image | None = None


def leg_tissues(
    images: LegImages,
    evolve: Evolve,
    table: Mapping[str, Any],
    body: Mask | None = None,
    memberships: dict[str, F64] | None = None,
) -> Labels:
    """Label every voxel of a leg with its material.

    Parameters
    ----------
    images : LegImages
        What there is.
    evolve : callable
        Evolution of the level sets, as `myork.core.level_sets.evolve_level_sets`.
    table : mapping
        Table `tissue` of the deck: `least_diffusivity`.
    body : NDArray, optional
        Voxels to label, shape `(ni, nj, nk)`; without it those inside the skin.
    memberships : dict, optional
        Gets the memberships of voxels in `fat` and, where there is an image of it, in
        `connective_tissue`, 0 to 1, zero in bone and outside of the body, shape `(ni, nj, nk)`.

    Returns
    -------
    Labels
        Materials as in `TISSUES`.
    """
    for other in (images.fat, images.connective, images.tensor):
        if other is not None:
            check_same_grid(other, images.anatomy)
    body = outer_boundary(images.anatomy, evolve) if body is None else body
    bone = find_bones(images.anatomy, body, evolve)
    soft = body & ~bone

    def clustered(name: str, image: Image, clusters: int, contrast: float = 0.0) -> Mask:
        found = fuzzy_c_means(image.data, soft, clusters)
        if found.centre[-1, 0] < contrast * found.centre[-2, 0]:
            return np.zeros(soft.shape, dtype=bool)
        if memberships is not None:
            memberships[name] = np.zeros(soft.shape)
            memberships[name][soft] = found.membership[:, -1]
        return found.place(soft, -1)

    connective = np.zeros(body.shape, dtype=bool)
    if images.connective is not None:
        connective = clustered("connective_tissue", images.connective, 2, _STANDS_OUT)
    # Fat, muscle and what is darker still stand apart in the anatomy; in a fat image there are two.
    if images.fat is not None:
        fat = clustered("fat", images.fat, 2)
    else:
        fat = clustered("fat", images.anatomy, 3)
    # A voxel that is bright in both images lies between fat and connective tissue.
    connective &= ~fat
    rest = soft & ~fat & ~connective
    muscle = rest & ~_skin(body, images.anatomy.spacing[:2])
    if images.tensor is not None:
        components = images.tensor.data
        usable = np.asarray(np.isfinite(components).all(axis=-1, keepdims=True))
        mean = mean_diffusivity(np.where(usable, components, 0.0))
        muscle = rest & (mean > table["least_diffusivity"])
        if not muscle.any():
            raise InputError(
                f"{images.tensor.name}: no voxel has a mean diffusivity above "
                f"tissue.least_diffusivity = {table['least_diffusivity']:g}; check its unit"
            )
    masks = {"muscle": muscle, "fat": fat | (rest & ~muscle), "connective_tissue": connective,
             "bone": bone}  # fmt: skip
    check_disjoint(masks, body)
    data = np.zeros(body.shape, dtype=np.int32)
    for label, name in TISSUES.items():
        data[masks[name]] = label
    return Labels(data, images.anatomy.affine, TISSUES, "tissue")


def outer_boundary(anatomy: Image, evolve: Evolve) -> Mask:
    """Voxels inside the skin: the bright phase of the whole image with its holes filled."""
    inside = _phase(_even(anatomy), np.ones(anatomy.data.shape, bool), evolve, "bright")
    slices = np.moveaxis(inside, -1, 0)
    body = np.stack([ndimage.binary_fill_holes(section) for section in slices], axis=-1)
    return large_pieces(body, anatomy.name)


def find_bones(anatomy: Image, body: Mask, evolve: Evolve) -> Mask:
    """Bones: bright marrow that a ring of very dark cortex closes off in every slice.

    Two level sets one after the other: bright (fat, marrow) against dark, and of the dark phase
    muscle against what is darker still.
    """
    bright = _phase(anatomy, body, evolve, "bright")
    dark = body & ~bright
    if not dark.any():
        return np.zeros(body.shape, dtype=bool)
    darkest = _phase(anatomy, dark, evolve, "dark")
    pixel = float(anatomy.spacing[:2].prod())
    bone = np.zeros(body.shape, dtype=bool)
    for k in range(body.shape[2]):
        cortex = darkest[:, :, k]
        # One pixel of cortex and fat mixed may look like muscle: the ring is closed over it.
        ring = (
            ndimage.binary_closing(np.pad(cortex, 2), np.ones((3, 3)))[2:-2, 2:-2] & body[:, :, k]
        )
        pieces, n = ndimage.label(ndimage.binary_fill_holes(ring) & ~ring)
        for piece in range(1, n + 1):
            marrow = pieces == piece
            large = marrow.sum() * pixel >= _LEAST_MARROW
            if large and bright[:, :, k][marrow].mean() > 0.5:
                bone[:, :, k] |= marrow | _wall(marrow, ring, anatomy.spacing[:2])
    return bone


def _wall(marrow: Mask, ring: Mask, pixel: F64) -> Mask:
    """Cortex around marrow, shell by shell while most of a shell is dark.

    Fascia that touches the bone is as dark, but covers little of a shell.
    """
    away = ndimage.distance_transform_edt(~marrow, sampling=pixel)
    shell = np.ceil(away / pixel.max()).astype(int)
    wall = np.zeros(ring.shape, dtype=bool)
    for number in range(1, int(_CORTEX / pixel.max()) + 1):
        here = shell == number
        if ring[here].mean() < _COVERED:
            break
        wall |= here & ring
    return wall


def check_disjoint(masks: Mapping[str, Mask], body: Mask) -> None:
    """Refuse materials that share a voxel or leave one of the body without any."""
    count = np.sum(list(masks.values()), axis=0, dtype=np.int32)
    shared = np.argwhere(count > 1)
    if len(shared):
        first = tuple(shared[0].tolist())
        both = [name for name, mask in masks.items() if mask[first]]
        raise InputError(
            f"materials overlap in {len(shared)} voxels, the first is {first}: {' and '.join(both)}"
        )
    lost = np.argwhere((count == 1) != body)
    if len(lost):
        raise InputError(
            f"{len(lost)} voxels are in the body or in a material but not in both, the first is "
            f"{tuple(lost[0].tolist())}"
        )


def _skin(body: Mask, pixel: F64) -> Mask:
    """Band of the body along the air in every slice; where the picture ends there is no air."""
    skin = np.zeros(body.shape, dtype=bool)
    for k in range(body.shape[2]):
        if body[:, :, k].all():
            continue  # SciPy's distances to nothing are those to a place outside of the array
        depth = ndimage.distance_transform_edt(
            np.pad(body[:, :, k], 1, mode="edge"), sampling=pixel
        )
        skin[:, :, k] = body[:, :, k] & (depth[1:-1, 1:-1] <= _SKIN)
    return skin


def _even(anatomy: Image) -> Image:
    """Grey values by their square roots, so that muscle is nearer to fat than to air."""
    return Image(np.sqrt(np.maximum(anatomy.data, 0.0)), anatomy.affine, anatomy.name)


def _phase(image: Image, region: Mask, evolve: Evolve, phase: str) -> Mask:
    """Dark or bright phase of a region, by a level set in every slice."""
    grey = scaled_values(image, region)
    found = segment_regions(
        grey[..., np.newaxis],
        region,
        evolve,
        _PHASES,
        spacing=image.spacing,
        name=image.name,
    )
    return wanted_phase(found, grey, phase)

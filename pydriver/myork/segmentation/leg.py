"""The materials of a whole leg from its images (thesis section 4.1.2).

The outer boundary and the bones come from the anatomy by two-phase level sets; fat and connective
tissue are clustered in images of their own sequences; of what is left, voxels with a diffusion
tensor are muscle and all others fat. Without tensors only the skin is taken from the muscle.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.diffusion import mean_diffusivity
from myork.imaging.geometry import check_same_grid
from myork.imaging.phantom import TISSUES
from myork.records import Image, Labels
from myork.segmentation.channels import scaled_values
from myork.segmentation.fuzzy import fuzzy_c_means
from myork.segmentation.level_sets import LevelSets, segment_regions, wanted_phase
from myork.segmentation.regions import large_pieces
from myork.types import F64, Mask

__all__ = ["find_bones", "leg_tissues", "outer_boundary"]


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


def leg_tissues(
    anatomy: Image,
    *,
    fat: Image | None = None,
    connective: Image | None = None,
    tensor: Image | None = None,
    body: Mask | None = None,
    least_diffusivity: float = 0.0,
) -> tuple[Labels, dict[str, F64]]:
    """Label every voxel of a leg with its material.

    Parameters
    ----------
    anatomy : Image
        T1-like MR image, shape `(ni, nj, nk)`; the others lie on its grid.
    fat, connective : Image, optional
        Images in which fat, or connective tissue, is bright; without the first the anatomy shows
        fat, without the second no connective tissue is found.
    tensor : Image, optional
        Diffusion tensors; without them all that is left is muscle but for the skin.
    body : NDArray, optional
        Voxels to label, shape `(ni, nj, nk)`; without it those inside the skin.
    least_diffusivity : float
        Mean diffusivity of muscle, in the unit of the tensors.

    Returns
    -------
    tuple
        Materials as in `TISSUES`; memberships of voxels in `fat` and, where there is an image of
        it, in `connective_tissue`, 0 to 1, zero in bone and outside of the body, shape
        `(ni, nj, nk)`.
    """
    for other in (fat, connective, tensor):
        if other is not None:
            check_same_grid(other, anatomy)
    body = outer_boundary(anatomy) if body is None else body
    bone = find_bones(anatomy, body)
    soft = body & ~bone
    memberships: dict[str, F64] = {}

    def clustered(name: str, image: Image, clusters: int, contrast: float = 0.0) -> Mask:
        found = fuzzy_c_means(image.data, soft, clusters)
        if found.centre[-1, 0] < contrast * found.centre[-2, 0]:
            return np.zeros(soft.shape, dtype=bool)
        memberships[name] = np.zeros(soft.shape)
        memberships[name][soft] = found.membership[:, -1]
        return found.place(soft, -1)

    sheets = np.zeros(body.shape, dtype=bool)
    if connective is not None:
        sheets = clustered("connective_tissue", connective, 2, _STANDS_OUT)
    # Fat, muscle and what is darker still stand apart in the anatomy; in a fat image there are two.
    fatty = clustered("fat", anatomy, 3) if fat is None else clustered("fat", fat, 2)
    # A voxel that is bright in both images lies between fat and connective tissue.
    sheets &= ~fatty
    rest = soft & ~fatty & ~sheets
    muscle = rest & ~_skin(body, anatomy.spacing[:2])
    if tensor is not None:
        usable = np.asarray(np.isfinite(tensor.data).all(axis=-1, keepdims=True))
        mean = mean_diffusivity(np.where(usable, tensor.data, 0.0))
        muscle = rest & (mean > least_diffusivity)
        if not muscle.any():
            raise InputError(
                f"{tensor.name}: no voxel has a mean diffusivity above "
                f"tissue.least_diffusivity = {least_diffusivity:g}; check its unit"
            )
    masks = {"muscle": muscle, "fat": fatty | (rest & ~muscle), "connective_tissue": sheets,
             "bone": bone}  # fmt: skip
    data = np.zeros(body.shape, dtype=np.int32)
    for label, name in TISSUES.items():
        data[masks[name]] = label
    return Labels(data, anatomy.affine, TISSUES, "tissue"), memberships


def outer_boundary(anatomy: Image) -> Mask:
    """Voxels inside the skin: the bright phase of the whole image with its holes filled."""
    inside = _phase(_even(anatomy), np.ones(anatomy.data.shape, bool), "bright")
    slices = np.moveaxis(inside, -1, 0)
    body = np.stack([ndimage.binary_fill_holes(section) for section in slices], axis=-1)
    return large_pieces(body, anatomy.name)


def find_bones(anatomy: Image, body: Mask) -> Mask:
    """Bones: bright marrow that a ring of very dark cortex closes off in every slice.

    Two level sets one after the other: bright (fat, marrow) against dark, and of the dark phase
    muscle against what is darker still.
    """
    bright = _phase(anatomy, body, "bright")
    dark = body & ~bright
    if not dark.any():
        return np.zeros(body.shape, dtype=bool)
    darkest = _phase(anatomy, dark, "dark")
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


def _phase(image: Image, region: Mask, phase: str) -> Mask:
    """Dark or bright phase of a region, by a level set in every slice."""
    grey = scaled_values(image, region)
    found = segment_regions(
        grey[..., np.newaxis], region, _PHASES, spacing=image.spacing, name=image.name
    )
    return wanted_phase(found, grey, phase)

"""From regions to muscles: by numbers of regions, by seeds, or by a reference label map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.errors import InputError
from myork.records import Image, Labels

__all__ = ["Muscle", "group_by_reference", "group_by_rules"]

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


@dataclass(frozen=True)
class Muscle:
    """Rule for a muscle.

    Attributes
    ----------
    name : str
        Name of the label.
    regions : tuple of int
        Numbers of the regions that are parts of it; empty: those the seeds lie in.
    seeds : NDArray
        World coordinates inside of it, shape `(nseed, 3)` [mm]; without one whole regions are
        taken, with some the connected pieces that hold a seed.
    """

    name: str
    regions: tuple[int, ...]
    seeds: F64

    def __post_init__(self) -> None:
        if not self.regions and not len(self.seeds):
            raise InputError(f"muscle.{self.name}: needs regions or seeds")


def group_by_rules(region: I32, image: Image, muscles: Sequence[Muscle]) -> tuple[I32, list[str]]:
    """Labels of muscles, 1 for the first one, by their rules.

    A voxel that the rules give to several muscles goes to the one with the nearest seed.

    Parameters
    ----------
    region : NDArray
        Region of each voxel, -1 for none, shape `(ni, nj, nk)`.
    image : Image
        Gives the grid.
    muscles : sequence
        Rules.

    Returns
    -------
    tuple
        Labels, shape `(ni, nj, nk)`, and warnings.
    """
    claims = np.stack([_claim(region, image, muscle) for muscle in muscles])
    label = np.where(claims.any(axis=0), 1 + claims.argmax(axis=0), 0).astype(np.int32)
    shared = claims.sum(axis=0) > 1
    if not shared.any():
        return label, []
    world = np.argwhere(shared) @ image.affine[:3, :3].T + image.affine[:3, 3]
    nearest = np.full((len(muscles), len(world)), np.inf)
    for number, muscle in enumerate(muscles):
        mine = claims[number][shared]
        for seed in muscle.seeds:
            distance = np.where(mine, np.linalg.norm(world - seed, axis=1), np.inf)
            nearest[number] = np.minimum(nearest[number], distance)
    seedless = [m.name for m, claim in zip(muscles, claims, strict=True)
                if not len(m.seeds) and (claim & shared).any()]  # fmt: skip
    if seedless:
        raise InputError(
            f"muscle.{seedless[0]}: its regions are also those of another muscle; give both seeds"
        )
    label[shared] = 1 + nearest.argmin(axis=0)
    names = [m.name for m, claim in zip(muscles, claims, strict=True) if (claim & shared).any()]
    return label, [
        f"{', '.join(names)} share pieces of regions ({int(shared.sum())} voxels), which were "
        "split by the nearest seed; raise image.regions or image.fiber_weight"
    ]


def group_by_reference(region: I32, reference: Labels) -> Labels:
    """Each connected piece of a region becomes the label that most of its voxels have.

    Parameters
    ----------
    region : NDArray
        Region of each voxel, -1 for none, shape `(ni, nj, nk)`.
    reference : Labels
        Label map on the same grid, for instance of a neighbour's or an atlas.
    """
    found = np.zeros(region.shape, np.int32)
    for number in np.unique(region[region >= 0]):
        pieces, count = ndimage.label(region == number)
        votes = np.zeros((count + 1, int(reference.data.max()) + 1), np.int64)
        np.add.at(votes, (pieces.ravel(), reference.data.ravel()), 1)
        winner = votes.argmax(axis=1).astype(np.int32)
        winner[0] = 0
        found += winner[pieces]
    return Labels(found, reference.affine, dict(reference.names), "segmentation")


def _claim(region: I32, image: Image, muscle: Muscle) -> NDArray[np.bool_]:
    """Voxels that the rule of a muscle gives to it."""
    unknown = [p for p in muscle.regions if p > region.max()]
    if unknown:
        raise InputError(
            f"muscle.{muscle.name}: there is no region {unknown[0]}; the regions are 0 to "
            f"{region.max()} (see regions.nii.gz)"
        )
    if not len(muscle.seeds):
        return np.isin(region, muscle.regions)
    claim = np.zeros(region.shape, bool)
    inverse = np.linalg.inv(image.affine[:3, :3]).T
    for seed in muscle.seeds:
        place = tuple(np.rint((seed - image.affine[:3, 3]) @ inverse).astype(int).tolist())
        where = f"muscle.{muscle.name}: the seed {seed.tolist()} mm (voxel {place})"
        if min(place) < 0 or any(p >= n for p, n in zip(place, region.shape, strict=True)):
            raise InputError(f"{where} lies outside of {image.name}, which has {region.shape}")
        here = int(region[place])
        if here < 0 or (muscle.regions and here not in muscle.regions):
            raise InputError(
                f"{where} lies in region {here}, not in one of its regions; move it, or look at "
                "regions.nii.gz"
            )
        pieces, _ = ndimage.label(np.isin(region, muscle.regions or (here,)))
        claim |= pieces == pieces[place]
    return claim

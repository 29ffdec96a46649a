"""From regions to muscles: by seeds, or by a reference label map."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.geometry import seed_voxel
from myork.records import Image, Labels
from myork.types import F64, I32, Mask


@dataclass(frozen=True)
class Muscle:
    """Rule for a muscle."""

    name: str  #: Name of the label
    #: World coordinates inside of it, shape `(nseed, 3)` [mm]: the connected pieces of regions that
    #: hold one are taken
    seeds: F64
    #: Thickness of the band along the edge of the segmented region that belongs to it, for walks
    #: [mm]
    rim: float = 0.0


def check_seeds(inside: Mask, image: Image, muscles: Sequence[Muscle]) -> None:
    """Refuse seeds outside of what is segmented.

    - `inside`: voxels to segment, shape `(ni, nj, nk)`
    - `image`: gives the grid
    - `muscles`: rules
    """
    for muscle in muscles:
        for place in _places(image, muscle):
            if not inside[place]:
                raise InputError(
                    f"muscle.{muscle.name}: the seed at voxel {place} does not lie in the region "
                    "to segment; move it"
                )


def group_by_rules(region: I32, image: Image, muscles: Sequence[Muscle]) -> tuple[I32, list[str]]:
    """Labels of muscles, 1 for the first one, by their rules.

    A voxel that the rules give to several muscles goes to the one with the nearest seed.

    - `region`: region of each voxel, -1 for none, shape `(ni, nj, nk)`
    - `image`: gives the grid
    - `muscles`: rules
    - returns labels, shape `(ni, nj, nk)`, and warnings
    """
    check_seeds(region >= 0, image, muscles)
    given = np.stack([_given_by(region, image, muscle) for muscle in muscles])
    label = np.where(given.any(axis=0), 1 + given.argmax(axis=0), 0).astype(np.int32)
    shared = given.sum(axis=0) > 1
    if not shared.any():
        return label, []
    world = image.world(np.argwhere(shared))
    nearest = np.full((len(muscles), len(world)), np.inf)
    for number, muscle in enumerate(muscles):
        mine = given[number][shared]
        for seed in muscle.seeds:
            distance = np.where(mine, np.linalg.norm(world - seed, axis=1), np.inf)
            nearest[number] = np.minimum(nearest[number], distance)
    label[shared] = 1 + nearest.argmin(axis=0)
    names = [m.name for m, own in zip(muscles, given, strict=True) if (own & shared).any()]
    return label, [
        f"{', '.join(names)} share pieces of regions ({int(shared.sum())} voxels), which were "
        "split by the nearest seed; raise image.regions"
    ]


def group_by_reference(region: I32, reference: Labels) -> Labels:
    """Each connected piece of a region becomes the label that most of its voxels have.

    - `region`: region of each voxel, -1 for none, shape `(ni, nj, nk)`
    - `reference`: label map on the same grid, for instance of a neighbour's or an atlas
    """
    found = np.zeros(region.shape, np.int32)
    known, place = np.unique(reference.data, return_inverse=True)
    for number in np.unique(region[region >= 0]):
        pieces, count = ndimage.label(region == number)
        votes = np.zeros((count + 1, len(known)), np.int64)
        np.add.at(votes, (pieces.ravel(), place.ravel()), 1)
        winner = known[votes.argmax(axis=1)]
        winner[0] = 0
        found += winner[pieces]
    names = {
        number: reference.label_name(number)
        for number in np.unique(reference.data[reference.data > 0]).tolist()
    }
    return Labels(found, reference.affine, names, "segmentation")


def rule_seeds(
    region: I32, image: Image, muscles: Sequence[Muscle], radius: float
) -> tuple[Mask, I32]:
    """Voxels that the rules part among muscles, and those whose label they determine.

    - `region`: region of each voxel, -1 for none, shape `(ni, nj, nk)`
    - `image`: gives the grid
    - `muscles`: rules
    - `radius`: of the disc around a seed that belongs to its muscle, in the slice [mm]
    - returns whether a voxel takes part, and its label, 1 for the first muscle, -1 where it is not
      known; both of shape `(ni, nj, nk)`
    """
    where = region >= 0
    check_seeds(where, image, muscles)
    known = np.full(region.shape, -1, np.int32)
    depth = np.zeros(region.shape)
    for k in range(region.shape[2]):
        inside = np.pad(region[:, :, k] >= 0, 1)
        distance = ndimage.distance_transform_edt(inside, sampling=image.spacing[:2])
        depth[:, :, k] = distance[1:-1, 1:-1]
    rows, columns = np.indices(region.shape[:2])
    for number, muscle in enumerate(muscles, start=1):
        known[where & (depth <= muscle.rim)] = number
    for number, muscle in enumerate(muscles, start=1):
        for place in _places(image, muscle):
            across = (rows - place[0]) * image.spacing[0], (columns - place[1]) * image.spacing[1]
            disc = (np.hypot(*across) <= radius) & where[..., place[2]]
            known[..., place[2]][disc] = number
    for number, muscle in enumerate(muscles, start=1):
        for place in _places(image, muscle):
            if known[place] != number:
                raise InputError(
                    f"muscle.{muscle.name}: the seed at voxel {place} lies beside one of "
                    f"muscle.{muscles[known[place] - 1].name}; lower image.seed_radius"
                )
    return where, known


def nearest_labels(where: Mask, known: I32, spacing: F64, margin: float) -> I32:
    """Label of the nearest voxel that has one, shape `(ni, nj, nk)`.

    - `where`: voxels that get one, shape `(ni, nj, nk)`
    - `known`: labels above zero where they are known, same shape
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    - `margin`: no label beyond this distance [mm]
    """
    if not (known > 0).any():
        return np.zeros(known.shape, np.int32)
    both: Any = ndimage.distance_transform_edt(known <= 0, sampling=spacing, return_indices=True)
    away, nearest = both
    return np.where(where & (away <= margin), known[tuple(nearest)], 0).astype(np.int32)


def _places(image: Image, muscle: Muscle) -> list[tuple[int, ...]]:
    """Voxels in which the seeds of a muscle lie."""
    return [seed_voxel(image, seed, f"muscle.{muscle.name}: a seed") for seed in muscle.seeds]


def _given_by(region: I32, image: Image, muscle: Muscle) -> Mask:
    """Voxels that the rule of a muscle gives to it."""
    given = np.zeros(region.shape, bool)
    for place in _places(image, muscle):
        pieces, _ = ndimage.label(region == region[place])
        given |= pieces == pieces[place]
    return given

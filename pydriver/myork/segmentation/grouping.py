"""From regions to labels: by the deck's rules, by a reference label map, or by grey value."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial.distance import cdist

from myork.errors import InputError
from myork.imaging.geometry import depth_in_slices, seed_voxel
from myork.records import Image, Labels
from myork.segmentation.channels import noise_level
from myork.segmentation.level_sets import Regions, wanted_phase
from myork.segmentation.regions import doubt_of_mixture, whole_voxels
from myork.segmentation.walk import heights_of, random_walk
from myork.types import F64, I32, Mask

# Muscle is less deep than this part of the depth of the other phase where phases are exchanged:
# 0.3 in water images of limbs, from 0.85 (lean limbs with marrow) to 5 where fat is bright
_SHALLOW = 0.4
# Part of the wanted phase that touches the other one in no slice: noise split by its mean has 0.02,
# phases that differ by twice the noise 0.3, cortex taken for muscle 0.35 or less, right ones 0.49;
# part of the region that is too small for muscle, but not for cortex
_WHOLE, _SHARE = 0.45, 0.1
#: Name of the seed label for voxels that belong to no tissue
BACKGROUND = "background"
# Its number while the others are separated
_LAST = np.iinfo(np.int32).max
# Part of the region, unlike all seeds, that is too large for vessels and walls between muscles
_REST = 0.1
# Distance from all seeds in units of scatter; least scatter, of logarithms and of scaled values
_UNLIKE, _LEAST_SCATTER = 5.0, 0.04


@dataclass(frozen=True)
class Muscle:
    """Rule for a muscle."""

    name: str  #: Name of the label
    #: World coordinates inside it, shape `(nseed, 3)` [mm]; the connected components of regions
    #: that contain one are taken
    seeds: F64
    #: Thickness of the band along the edge of the segmented region that belongs to it, for walks
    #: [mm]
    rim: float = 0.0


def check_seeds(inside: Mask, image: Image, muscles: Sequence[Muscle]) -> None:
    """Refuse seeds outside of the voxels that are segmented, shape `(ni, nj, nk)`."""
    for muscle in muscles:
        for place in _places(image, muscle):
            if not inside[place]:
                raise InputError(
                    f"muscle.{muscle.name}: the seed at voxel {place} does not lie in the region "
                    "to segment; move it"
                )


def group_by_rules(region: I32, image: Image, muscles: Sequence[Muscle]) -> tuple[I32, list[str]]:
    """Labels of muscles, 1 for the first one, by their rules.

    A voxel that the rules assign to several muscles goes to the one with the nearest seed.

    - `region`: region of each voxel, -1 for none, shape `(ni, nj, nk)`
    - returns labels, shape `(ni, nj, nk)`, and warnings
    """
    given = np.stack([_given_by(region, image, muscle) for muscle in muscles])
    label = np.where(given.any(axis=0), 1 + given.argmax(axis=0), 0).astype(np.int32)
    shared, warnings = given.sum(axis=0) > 1, []
    body = region >= 0
    stack, count = ndimage.label(body.any(axis=(0, 1)))
    lost = [n for n in range(1, count + 1) if not label[..., stack == n].any()]
    if lost:
        share = body[..., np.isin(stack, lost)].sum() / body.sum()
        warnings.append(
            f"{100.0 * share:.0f} % of the body has no label: empty slices separate it from all "
            "seeds of [[muscle]]; take another image, or give it seeds as well"
        )
    if not shared.any():
        return label, warnings
    world = image.world(np.argwhere(shared))
    nearest = [
        np.where(own[shared], cdist(world, muscle.seeds).min(axis=1, initial=np.inf), np.inf)
        for muscle, own in zip(muscles, given, strict=True)
    ]
    label[shared] = 1 + np.argmin(nearest, axis=0)
    names = [m.name for m, own in zip(muscles, given, strict=True) if (own & shared).any()]
    return label, [
        *warnings,
        f"{', '.join(names)} share pieces of regions ({int(shared.sum())} voxels), which were "
        "split by the nearest seed; raise image.regions",
    ]


def group_by_reference(region: I32, reference: Labels) -> Labels:
    """Assign to each connected component of a region the label that most of its voxels have.

    - `region`: region of each voxel, -1 for none, shape `(ni, nj, nk)`
    - `reference`: label map on the same grid, for instance of a neighbouring slice or an atlas
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
    return Labels(found, reference.affine, reference.present, "segmentation")


def rule_seeds(
    region: I32, image: Image, muscles: Sequence[Muscle], radius: float
) -> tuple[Mask, I32]:
    """Voxels that the rules divide among muscles, and those whose label they determine.

    - `region`: region of each voxel, -1 for none, shape `(ni, nj, nk)`
    - `radius`: radius of the in-slice disc around a seed that belongs to its muscle [mm]
    - returns whether a voxel takes part, and its label, 1 for the first muscle, -1 where unknown;
      both of shape `(ni, nj, nk)`
    """
    where = region >= 0
    known = np.full(region.shape, -1, np.int32)
    depth = depth_in_slices(where, image.spacing[:2])
    rows, columns = np.indices(region.shape[:2])
    for number, muscle in enumerate(muscles, start=1):
        known[where & (depth <= muscle.rim)] = number
    seeds = [(n, place) for n, one in enumerate(muscles, 1) for place in _places(image, one)]
    for number, place in seeds:
        across = (rows - place[0]) * image.spacing[0], (columns - place[1]) * image.spacing[1]
        disc = (np.hypot(*across) <= radius) & where[..., place[2]]
        known[..., place[2]][disc] = number
    for number, place in seeds:
        if known[place] != number:
            raise InputError(
                f"muscle.{muscles[number - 1].name}: the seed at voxel {place} lies beside one of "
                f"muscle.{muscles[known[place] - 1].name}; lower image.seed_radius"
            )
    return where, known


def nearest_labels(where: Mask, known: I32, spacing: F64, margin: float) -> I32:
    """Label of the nearest labelled voxel, shape `(ni, nj, nk)`.

    - `where`: voxels to be labelled, shape `(ni, nj, nk)`
    - `known`: labels above zero where known, same shape
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    - `margin`: distance beyond which no label is given [mm]
    """
    if not (known > 0).any():
        return np.zeros(known.shape, np.int32)
    both: Any = ndimage.distance_transform_edt(known <= 0, sampling=spacing, return_indices=True)
    away, nearest = both
    return np.where(where & (away <= margin), known[tuple(nearest)], 0).astype(np.int32)


def _places(image: Image, muscle: Muscle) -> list[tuple[int, ...]]:
    """Voxels that contain the seeds of a muscle."""
    return [seed_voxel(image, seed, f"muscle.{muscle.name}: a seed") for seed in muscle.seeds]


def _given_by(region: I32, image: Image, muscle: Muscle) -> Mask:
    """Voxels that the rule of a muscle assigns to it."""
    given = np.zeros(region.shape, bool)
    for place in _places(image, muscle):
        pieces, _ = ndimage.label(region == region[place])
        given |= pieces == pieces[place]
    return given


def label_by_rules(
    table: Mapping[str, Any],
    image: Image,
    result: Regions,
    muscles: Sequence[Muscle],
    others: F64 | None = None,
) -> tuple[Labels, list[str]]:
    """Labels by [[muscle]], and warnings; walks use the image and other channels."""
    names = {number: muscle.name for number, muscle in enumerate(muscles, start=1)}
    if table["split"] == "walk":
        where, known = rule_seeds(result.region, image, muscles, table["seed_radius"])
        heights = heights_of(image.data, result.region >= 0, others)
        label = random_walk(heights, where, known, image.spacing, table["edge_weight"])
        alone = (
            f"muscle.{muscles[0].name}: with split = walk all voxels go to the only label; give "
            f"fat and bone labels with seeds, or one named {BACKGROUND}"
        )
        doubts = [alone] if len(muscles) == 1 else []
        return Labels(np.maximum(label, 0), image.affine, names, "segmentation"), doubts
    label, warnings = group_by_rules(result.region, image, muscles)
    return Labels(label, image.affine, names, "segmentation"), warnings


def doubt_of_depth(labels: Labels, body: Mask, phase: str) -> str:
    """Doubt if the phase taken for muscle lies under the skin and the other one deep inside."""
    depth, muscle = depth_in_slices(body, labels.spacing[:2], cut=True), labels.data > 0
    rest = body & ~muscle
    own, deep = (float(np.median(depth[one])) if one.any() else 0.0 for one in (muscle, rest))
    if own >= _SHALLOW * deep:
        return ""
    other = "bright" if phase == "dark" else "dark"
    return (
        f"the {phase} phase, labelled muscle, lies {own:.0f} mm under the skin (median), the other "
        f"one {deep:.0f} mm, as if it were fat: check whether image.phase should be '{other}'"
    )


def doubt_of_separation(wanted: Mask, other: Mask, grey: F64, phase: str) -> str:
    """Doubt if noise or cortex was separated in place of muscle, or fat contains muscle.

    - `wanted`, `other`: voxels of the phase taken for muscle and of the other one, shape
      `(ni, nj, nk)`
    - `grey`: grey values, same shape [-]
    """
    if not (wanted.any() and other.any()):
        return ""
    whole = whole_voxels(wanted).sum() / wanted.sum()
    share = wanted.sum() / (wanted | other).sum()
    if whole >= _WHOLE and share >= _SHARE:
        mixed = doubt_of_mixture(grey, other, wanted)
        return mixed and f"the phase that is not muscle {mixed}"
    noise = max(noise_level(grey, wanted | other), 1e-300)
    ratio = abs(grey[wanted].mean() - grey[other].mean()) / noise
    return (
        f"the {phase} phase, labelled muscle, is {100 * share:.0f} % of the region, "
        f"{100 * whole:.0f} % of its voxels do not touch the other phase, and it differs from "
        f"that by {ratio:.1f} times the noise: muscle and fat may be equally bright, so that "
        "noise, bone or fat in muscle was separated; look at segmentation.png, use an image in "
        "which they differ (image.anatomy, image.channels), or seeds (image.split = 'walk')"
    )


def doubt_of_phase(labels: Labels, wanted: Mask, phase: str) -> str:
    """Doubt if most labelled voxels are in the other phase, such as fat in place of muscle.

    - `wanted`: voxels of the wanted phase, shape `(ni, nj, nk)`
    """
    known = labels.data > 0
    if not known.any() or wanted[known].mean() > 0.5:
        return ""
    other = "bright" if phase == "dark" else "dark"
    return (
        f"the seeds of [[muscle]] lie in the {other} phase, which with image.phase = {phase} is "
        "not muscle: move them, or set image.phase"
    )


def label_by_seeds(
    table: Mapping[str, Any],
    image: Image,
    result: Regions,
    seeds: Labels,
    others: F64 | None = None,
) -> tuple[Labels, list[str]]:
    """Labels by random walks to a label map of seeds, with its numbers and names, and warnings."""
    where = result.region >= 0
    drawn = seeds.data > 0
    outside = drawn & ~where
    warnings = []
    if outside.any():
        first = tuple(np.argwhere(outside)[0].tolist())
        warnings.append(
            f"{seeds.name}: {int(outside.sum())} of {int(drawn.sum())} seeds lie outside of the "
            f"region to segment, the first is {first}; they are left out (see image.body)"
        )
    known = np.where(drawn & where, seeds.data, -1).astype(np.int32)
    numbers = np.unique(known[known > 0]).tolist()
    names = {number: seeds.label_name(number) for number in numbers}
    heights = heights_of(image.data, where, others)
    rest = _unlike(heights, where, known)
    part = float(rest.sum() / max(int(where.sum()), 1))
    if BACKGROUND not in names.values() and part > _REST:
        known[rest] = _LAST
        warnings.append(
            f"{seeds.name}: {100.0 * part:.0f} % of the region to segment resembles none of the "
            f"seeds and becomes {BACKGROUND}, without a label; draw seeds in it (fat, bone) to "
            "have it labelled"
        )
    elif len(numbers) < 2:
        raise InputError(
            f"{seeds.name}: seeds of at least two labels are needed in the region to segment, "
            f"there are {numbers}; everything that is not muscle needs a label too"
        )
    # Voxels that walks hardly leave get the last label: single voxels, thin walls are no muscle.
    for number in [number for number, name in names.items() if name == BACKGROUND]:
        known[known == number] = _LAST
        del names[number]
    label = random_walk(heights, where, known, image.spacing, table["edge_weight"])
    label = np.maximum(label, 0)
    label[label == _LAST] = 0
    return Labels(label, image.affine, names, "segmentation"), warnings


def _unlike(heights: F64, where: Mask, known: I32) -> Mask:
    """Voxels whose values differ from those of all seeds, in patches of at least three pixels."""
    unlike = where & (known < 0)
    for number in np.unique(known[known > 0]):
        own = heights[known == number]
        middle = np.median(own, axis=0)
        scale = np.maximum(1.4826 * np.median(np.abs(own - middle), axis=0), _LEAST_SCATTER)
        unlike &= (np.abs(heights - middle) > _UNLIKE * scale).any(axis=-1)
    return np.asarray(ndimage.binary_opening(unlike, np.ones((3, 3, 1))), np.bool_)


def label_by_phase(table: Mapping[str, Any], image: Image, grey: F64, result: Regions) -> Labels:
    """The wanted one of two regions, or all of several regions, as labels."""
    if table["regions"] > 2:
        names = {number + 1: f"region_{number}" for number in range(table["regions"])}
        return Labels(result.region + 1, image.affine, names, "segmentation")
    inside = wanted_phase(result, grey, table["phase"])
    if not inside.any():
        raise InputError(
            f"{image.name}: the segmentation of the {table['phase']} phase is empty; check "
            "image.phase, image.box and image.mu"
        )
    return Labels(inside.astype(np.int32), image.affine, {1: "muscle"}, "segmentation")


def label_by_reference(
    table: Mapping[str, Any], image: Image, grey: F64, result: Regions, reference: Labels
) -> Labels:
    """Labels by a reference label map."""
    if table["split"] == "pieces":
        return group_by_reference(result.region, reference)
    wanted = result.region >= 0
    if table["regions"] == 2:
        wanted = wanted_phase(result, grey, table["phase"])
    label = nearest_labels(wanted, reference.data, image.spacing, table["margin"])
    names = Labels(label, image.affine, reference.names).present
    return Labels(label, image.affine, names, "segmentation")

"""From regions to labels: by the deck's rules, by a reference label map, or by grey value."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.records import Image, Labels
from myork.segmentation.grouping import (
    Muscle,
    group_by_reference,
    group_by_rules,
    nearest_labels,
    rule_seeds,
)
from myork.segmentation.level_sets import Regions, wanted_phase
from myork.segmentation.outlines import pull_of_outlines
from myork.segmentation.regions import piece_with_seed
from myork.segmentation.walk import heights_of, random_walk
from myork.types import F64, I32, Mask

#: Name of the label of seeds that is no tissue
BACKGROUND = "background"
# Its number while others are parted
_LAST = np.iinfo(np.int32).max
# Part of the region, like none of the seeds, that is more than vessels and walls between muscles
_REST = 0.1
# So many scatters off all seeds; the least scatter, of logarithms and of scaled values
_UNLIKE, _LEAST_SCATTER = 5.0, 0.04


def label_by_rules(
    table: Mapping[str, Any],
    image: Image,
    result: Regions,
    muscles: Sequence[Muscle],
    others: F64 | None = None,
) -> tuple[Labels, list[str]]:
    """Labels by [[muscle]], and warnings; walks see the image and other channels."""
    names = {number: muscle.name for number, muscle in enumerate(muscles, start=1)}
    if table["split"] == "walk":
        where, known = rule_seeds(result.region, image, muscles, table["seed_radius"])
        heights = heights_of(image.data, result.region >= 0, others)
        label = random_walk(heights, where, known, image.spacing, table["edge_weight"])
        return Labels(np.maximum(label, 0), image.affine, names, "segmentation"), []
    label, warnings = group_by_rules(result.region, image, muscles)
    return Labels(label, image.affine, names, "segmentation"), warnings


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
            f"{seeds.name}: {100.0 * part:.0f} % of the region to segment is like none of the "
            f"seeds and becomes {BACKGROUND}, without a label; draw seeds in it (fat, bone) to "
            "have it labelled"
        )
    elif len(numbers) < 2:
        raise InputError(
            f"{seeds.name}: seeds of two labels at least are needed in the region to segment, "
            f"there are {numbers}; what is no muscle needs a label too"
        )
    # What hardly any walk leaves goes to the last label: lone voxels and thin walls are no muscle.
    for number in [number for number, name in names.items() if name == BACKGROUND]:
        known[known == number] = _LAST
        del names[number]
    pull = pull_of_outlines(known, image.spacing)
    label = random_walk(heights, where, known, image.spacing, table["edge_weight"], pull)
    label = np.maximum(label, 0)
    label[label == _LAST] = 0
    return Labels(label, image.affine, names, "segmentation"), warnings


def _unlike(heights: F64, where: Mask, known: I32) -> Mask:
    """Voxels whose values none of the seeds has, patches of three pixels at least."""
    unlike = where & (known < 0)
    for number in np.unique(known[known > 0]):
        own = heights[known == number]
        middle = np.median(own, axis=0)
        scale = np.maximum(1.4826 * np.median(np.abs(own - middle), axis=0), _LEAST_SCATTER)
        unlike &= (np.abs(heights - middle) > _UNLIKE * scale).any(axis=-1)
    return np.asarray(ndimage.binary_opening(unlike, np.ones((3, 3, 1))), np.bool_)


def label_by_phase(table: Mapping[str, Any], image: Image, grey: F64, result: Regions) -> Labels:
    """The wanted one of two regions, or all of more regions, as labels."""
    if table["regions"] > 2:
        names = {number + 1: f"region_{number}" for number in range(table["regions"])}
        return Labels(result.region + 1, image.affine, names, "segmentation")
    inside = wanted_phase(result, grey, table["phase"])
    if "seed" in table:
        inside = piece_with_seed(inside, image, table["seed"])
    if not inside.any():
        raise InputError(
            f"{image.name}: the segmentation of the {table['phase']} phase is empty; check "
            "image.phase, image.box and image.mu"
        )
    return Labels(inside.astype(np.int32), image.affine, {1: table["label"]}, "segmentation")


def label_by_reference(
    table: Mapping[str, Any], image: Image, grey: F64, result: Regions, reference: Labels
) -> Labels:
    """Labels by a reference label map."""
    if table["split"] == "pieces":
        return group_by_reference(result.region, reference)
    wanted = result.region >= 0
    if table["regions"] == 2:
        wanted = wanted_phase(result, grey, table["phase"])
    label = nearest_labels(wanted, reference.data, image.spacing, table["reference_margin"])
    names = {n: reference.label_name(n) for n in np.unique(label[label > 0]).tolist()}
    return Labels(label, image.affine, names, "segmentation")

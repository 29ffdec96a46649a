"""Regions of an image by active contours without edges: any number of regions and channels.

n level sets make up to 2**n regions; bit k of a region's number is set where it lies inside level
set k. Regions from clusters or a threshold are initially in ascending order of the first channel.
The evolution itself is computed by the compiled core.

References: Chan, Vese, IEEE Trans. Image Process. 10 (2001), doi:10.1109/83.902291; Vese, Chan,
Int. J. Comput. Vis. 50 (2002), doi:10.1023/A:1020874308076
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from myork.core.level_sets import evolve_level_sets
from myork.errors import InputError
from myork.segmentation.regions import otsu
from myork.segmentation.starts import (
    kmeans,
    level_sets_for,
    level_sets_of,
    regions_of,
)
from myork.types import F64, I32, Mask

# Weight of the areas inside, width of the step function (3.16), and the largest time step, which is
# halved where the energy would increase [-]
_NU, _EPSILON, _STEP = 0.0, 0.5, 500.0


@dataclass(frozen=True)
class LevelSets:
    """Settings of a segmentation; values without a default here have it in decks."""

    regions: int  #: Number of regions, 2 to 64
    mu: float | Sequence[float]  #: Weight of the length of each contour, or one for all [-]
    #: At rest, at most this part of the voxels changes its region in ten iterations
    tolerance: float
    #: `otsu` (threshold of the first channel, two regions) or `kmeans`, without a map to start from
    start: str = "kmeans"
    iterations: int = 300  #: Largest number of iterations

    @classmethod
    def of_table(cls, table: Mapping[str, Any], **changes: Any) -> "LevelSets":
        """Settings of the `[image]` table of a deck, with some fields changed."""
        own = {field.name: table[field.name] for field in fields(cls) if field.name in table}
        return cls(**own | changes)


@dataclass(frozen=True)
class Regions:
    """Result of a segmentation into regions."""

    region: I32  #: Number of the region, -1 for excluded voxels, shape `(ni, nj, nk)`
    iterations: I32  #: Iterations of each slice, shape `(nk,)`
    #: Energy (3.29) of all slices together after each iteration, shape `(iterations,)` [-]
    energy: F64
    unrest: int  #: Slices whose regions still changed in the last iteration


def segment_regions(
    channels: F64,
    region: Mask,
    choice: LevelSets,
    *,
    spacing: ArrayLike,
    channel_weights: Sequence[float] | None = None,
    labels: I32 | None = None,
    name: str = "image",
) -> Regions:
    """Divide a region of an image into regions that are uniform in every channel.

    - `channels`: values of order one, shape `(ni, nj, nk, nchannel)`; slices along the
      third axis [-]
    - `region`: voxels that take part, shape `(ni, nj, nk)`
    - `choice`: settings
    - `spacing`: voxel sizes, shape `(3,)` [any length]
    - `channel_weights`: weight of each channel [-]; ones if absent
    - `labels`: map to start from, shape `(ni, nj, nk)`
    """
    if not region.any():
        raise InputError(
            f"{name}: the region to segment is empty; check image.box and image.region"
        )
    inside = np.where(region[..., None], channels, 0.0)
    if not np.isfinite(inside).all():
        bad = np.argwhere(~np.isfinite(inside))[0]
        raise InputError(
            f"{name}: channel {bad[3]} is not finite at voxel {tuple(bad[:3].tolist())}, inside "
            "of the region to segment; replace the value or leave it out by image.region"
        )
    if not (np.ptp(channels[region], axis=0) > 0).any():
        raise InputError(f"{name}: the region to segment has one grey value only")
    weights = np.ones(channels.shape[3]) if channel_weights is None else np.array(channel_weights)
    first = _first_level_sets(inside, region, choice, weights, labels)
    result = evolve_level_sets(
        inside,
        region,
        first,
        spacing=tuple((np.asarray(spacing) / np.min(spacing)).tolist()[:2]),
        mu=_contour_weights(choice.mu, choice.regions),
        nu=_NU,
        epsilon=_EPSILON,
        dt=_STEP,
        tolerance=choice.tolerance,
        iterations=choice.iterations,
        lambdas=np.broadcast_to(weights, (choice.regions, weights.size)).T,
    )
    found = np.where(region, regions_of(result["phi"], choice.regions), -1).astype(np.int32)
    done = result["iterations"]
    return Regions(
        region=found,
        iterations=done,
        energy=result["energy"][1 : 1 + done.max()].sum(axis=1),
        unrest=int((result["ended"] == 0).sum()),
    )


def wanted_phase(result: Regions, values: F64, phase: str) -> Mask:
    """Voxels of the darker or the brighter one of two regions.

    - `result`: with two regions
    - `values`: grey values, shape `(ni, nj, nk)` [-]
    - `phase`: `dark` or `bright`
    """
    one, two = result.region == 0, result.region == 1
    if one.any() and two.any() and values[one].mean() > values[two].mean():
        one, two = two, one
    return one if phase == "dark" else two


def _contour_weights(mu: float | Sequence[float], regions: int) -> F64:
    """Weights of the contours' lengths, shape `(levels,)` [-]."""
    given, levels = np.atleast_1d(np.asarray(mu, float)), level_sets_for(regions)
    if given.size not in (1, levels):
        raise InputError(
            f"image.mu has {given.size} weights; give one for all level sets or one for each: "
            f"{regions} regions need {levels} level sets"
        )
    return np.broadcast_to(given, levels)


def _first_level_sets(
    channels: F64,
    region: Mask,
    choice: LevelSets,
    weights: F64,
    labels: I32 | None,
) -> F64:
    """Initial level sets."""
    if labels is not None:
        first = np.unique(labels, return_inverse=True)[1].reshape(labels.shape).astype(np.int32)
    elif choice.start == "otsu":
        if choice.regions > 2:
            raise InputError(f"'otsu' makes two regions, not {choice.regions}: use 'kmeans'")
        first = (channels[..., 0] > otsu(channels[region, 0])).astype(np.int32)
    else:
        first = np.zeros(region.shape, np.int32)
        first[region] = kmeans(channels[region] * np.sqrt(weights), choice.regions)[0]
    return level_sets_of(first, choice.regions)

"""Shapes between the slices in which they are drawn: outlines by their signed distances.

Reference: Herman, Zheng, Bucholtz, IEEE Comput. Graph. Appl. 12 (1992), doi:10.1109/38.135915
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.imaging.geometry import depth_in_slices
from myork.types import F64, I32, Mask

# Chosen on `benchmarks/runner.py outlines tuned`: rate of a walk's end where outlines predict a
# label, against steps of rate 1 where there is no edge [-],
_RATE = 3e-4
# and how far predicted outlines are off: at drawn slices [mm], and more by this part of the way [-]
_OFF = 2.0
_DRIFT = 0.2


def pull_of_outlines(known: I32, spacing: F64) -> NDArray[np.float32] | None:
    """Rates at which walks between drawn slices end in the labels that outlines predict there.

    Seeds of a label in several slices predict its shape in those between them. What is drawn thin,
    or elsewhere in the next slice, predicts nothing.

    - `known`: labels that are known, -1 where they are not, shape `(ni, nj, nk)`
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    - returns for the labels in their order, shape `(nlabel, ni, nj, nk)` [-]; None: nothing is
      predicted
    """
    thickness, size = spacing[2], spacing[:2]
    names = np.unique(known[known >= 0])
    depth = np.full((len(names), *known.shape), -np.inf, np.float32)
    for number, name in enumerate(names):
        here = known == name
        drawn = np.flatnonzero(here.any(axis=(0, 1)))
        between = np.setdiff1d(np.arange(drawn[0], drawn[-1]), drawn)
        if len(between):
            distance = signed_distances(here[..., drawn], size)
            # Outlines do not move with their middles: strokes in two places predict no third one.
            above = np.searchsorted(drawn, between)
            share = (between - drawn[above - 1]) / (drawn[above] - drawn[above - 1])
            depth[number][..., between] = (
                distance[..., above - 1] * (1.0 - share) + distance[..., above] * share
            )
    predicted = depth.max(axis=0) > 0
    if not predicted.any():
        return None
    drawn = np.flatnonzero((known >= 0).any(axis=(0, 1)))
    way = thickness * np.abs(drawn[:, np.newaxis] - np.arange(known.shape[2])).min(axis=0)
    width = (_OFF + _DRIFT * way).astype(np.float32)
    pull = np.exp((depth - np.where(predicted, depth.max(axis=0), 0.0)) / width)
    pull *= _RATE * predicted / pull.sum(axis=0, where=predicted, initial=1e-30)
    return pull


def signed_distances(here: Mask, size: F64) -> F64:
    """Distance to the outline of a label in each slice; where it is missing a shrunken one.

    - `here`: where the label is, in one slice at least, shape `(ni, nj, nk)`
    - `size`: of the pixels, shape `(2,)` [mm]
    - returns positive inside, shape `(ni, nj, nk)` [mm]
    """
    rim = 0.5 * float(size.min())
    result = depth_in_slices(here, size) - rim
    there = np.flatnonzero(here.any(axis=(0, 1)))
    for k in there:
        outside = ndimage.distance_transform_edt(~here[..., k], sampling=size)
        result[..., k] = np.where(here[..., k], result[..., k], rim - outside)
    for k in np.setdiff1d(np.arange(here.shape[2]), there):
        nearest = result[..., there[np.argmin(np.abs(there - k))]]
        # Halfway to a slice without the label its deepest place is at zero.
        result[..., k] = nearest - 2.0 * nearest.max()
    return result

"""Tracts: lines along a field of fiber directions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.records import Image

__all__ = ["follow", "tract_lengths"]

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Smallest cosine between two steps: a tract that turns by more than 30 degrees ends.
_LEAST_COSINE = np.cos(np.radians(30.0))


def follow(
    fibers: Image, inside: Mask, seeds: NDArray[Any], step: float, reach: float
) -> tuple[list[F64], F64]:
    """Follow a field from seeds in both directions, as far as it goes on.

    Parameters
    ----------
    fibers : Image
        Unit vectors in the world frame, of either sign, shape `(ni, nj, nk, 3)`.
    inside : NDArray
        Voxels in which a tract may run, shape `(ni, nj, nk)`.
    seeds : NDArray
        Voxel indices, whole or between voxels, shape `(n, 3)`.
    step : float
        Length of a step [mm].
    reach : float
        Greatest length in each direction [mm].

    Returns
    -------
    tuple
        The tracts, world coordinates of shape `(m, 3)` each [mm], and their lengths [mm].
    """
    to_voxels = np.linalg.inv(fibers.affine[:3, :3])
    starts = _field(fibers.data, inside, seeds, None)
    halves = []
    for sign in (1.0, -1.0):
        place, heading = seeds.astype(float).copy(), sign * starts
        going = np.linalg.norm(starts, axis=1) > 0
        path = [place.copy()]
        length = np.zeros(len(seeds))
        for _ in range(int(reach / step)):
            if not going.any():
                break
            # Midpoint rule: the direction half a step ahead
            ahead = place[going] + 0.5 * step * heading[going] @ to_voxels.T
            turned = _field(fibers.data, inside, ahead, heading[going])
            on = (turned * heading[going]).sum(axis=1) > _LEAST_COSINE
            alive = np.flatnonzero(going)[on]
            heading[alive] = turned[on]
            place[alive] += step * turned[on] @ to_voxels.T
            length[alive] += step
            going[:] = False
            going[alive] = True
            path.append(place.copy())
        halves.append((np.array(path), length))
    tracts = []
    origin = fibers.affine[:3, 3]
    for seed in range(len(seeds)):
        back, forth = (path[: 1 + round(length[seed] / step), seed] for path, length in halves)
        tracts.append(np.vstack([forth[:0:-1], back]) @ fibers.affine[:3, :3].T + origin)
    return tracts, halves[0][1] + halves[1][1]


def tract_lengths(fibers: Image, inside: Mask, count: int = 150, seed: int = 1) -> F64:
    """Lengths of tracts from voxels picked at random, shape `(count,)` at most [mm].

    Parameters
    ----------
    fibers : Image
        Unit vectors in the world frame, shape `(ni, nj, nk, 3)`.
    inside : NDArray
        Voxels in which a tract may run, shape `(ni, nj, nk)`.
    count : int
        Number of tracts.
    seed : int
        Start of the random numbers that pick the seeds.
    """
    voxels = np.argwhere(inside)
    random = np.random.default_rng(seed)
    some = voxels[random.permutation(len(voxels))[:count]]
    size = float(np.linalg.norm(np.ptp(voxels, axis=0) * fibers.spacing))
    return follow(fibers, inside, some, 0.5 * float(np.cbrt(fibers.spacing.prod())), size)[1]


def _field(data: F64, inside: Mask, place: F64, heading: F64 | None) -> F64:
    """Direction at places between voxels, zero outside; its sign follows a heading."""
    shape = np.array(inside.shape)
    nearest = np.rint(place).astype(int)
    within = ((nearest >= 0) & (nearest < shape)).all(axis=1)
    clipped = np.clip(nearest, 0, shape - 1)
    within &= inside[tuple(clipped.T)]
    if heading is None:
        heading = data[tuple(clipped.T)]
    low = np.clip(np.floor(place).astype(int), 0, np.maximum(shape - 2, 0))
    part = np.clip(place - low, 0.0, 1.0)
    total = np.zeros(place.shape)
    for corner in np.ndindex(2, 2, 2):
        at = np.minimum(low + corner, shape - 1)
        weight = np.where(corner, part, 1.0 - part).prod(axis=1) * inside[tuple(at.T)]
        vector = data[tuple(at.T)]
        # A direction and its opposite are one fiber: each corner counts with the nearer sign.
        sign = np.where((vector * heading).sum(axis=1) < 0, -1.0, 1.0)
        total += (weight * sign)[:, np.newaxis] * vector
    length = np.linalg.norm(total, axis=1)
    usable = within & (length > 1e-9)
    return np.where(usable[:, np.newaxis], total / np.maximum(length, 1e-9)[:, np.newaxis], 0.0)

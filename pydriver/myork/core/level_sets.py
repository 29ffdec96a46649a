"""Evolution of level sets: checks and conversions around the compiled core."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from myork import _core, errors
from myork.core.calls import called


def evolve_level_sets(
    channels: ArrayLike,
    weight: ArrayLike,
    start: ArrayLike,
    *,
    spacing: tuple[float, float],
    mu: ArrayLike,
    nu: float,
    epsilon: float,
    dt: float,
    tolerance: float,
    iterations: int,
    lambdas: ArrayLike,
) -> dict[str, NDArray[Any]]:
    """Evolve level sets slice by slice by the scheme of Appendix A, energy (3.29).

    - `channels`: values, shape `(ni, nj, nk, nchannel)` [-]
    - `weight`: weights of the voxels' misfit; zero excludes a voxel, whatever its value, shape
      `(ni, nj, nk)` [-]
    - `start`: initial level sets, shape `(ni, nj, nk, nlevel)` [-]
    - `spacing`: voxel sizes along the first two axes [-]
    - `mu`: weights of the contours' lengths, shape `(nlevel,)`, or one for all [-]
    - `nu`, `epsilon`, `dt`, `tolerance`, `iterations`: weight of the area, width of the step (3.16)
      and largest time step, fraction of the voxels that may change region in ten iterations at
      rest, and the largest number of iterations
    - `lambdas`: weights of the misfit of each channel in each region, shape `(nchannel, nregion)`,
      with more than half of `2**nlevel` regions
    - returns `phi` like `start`; `energy` at the start and after each iteration, shape
      `(iterations + 1, nk)`; `means`, shape `(nchannel, nregion, nk)`; `iterations` and `ended`
      (0 limit, 1 regions at rest, 2 no step lowers the energy), shape `(nk,)`
    """
    values = np.asfortranarray(channels, dtype=float)
    part = np.asfortranarray(weight, dtype=float)
    first = np.asfortranarray(start, dtype=float)
    if values.ndim != 4 or first.ndim != 4 or {values.shape[:3], first.shape[:3]} != {part.shape}:
        raise errors.InputError(
            "channels and start must be 4-D on the grid of weight, not "
            f"{values.shape}, {first.shape} and {part.shape}"
        )
    if (part == 0).any() and not np.isfinite(values).all():
        values = np.asfortranarray(np.where(part[..., None] > 0, values, 0.0))
    names = ("phi", "energy", "means", "iterations", "ended")
    found = called(
        _core.evolve_level_sets,
        (nu, epsilon, dt, tolerance),
        np.broadcast_to(np.asarray(mu, float), first.shape[3:]),
        np.asarray(lambdas, float),
        spacing,
        iterations,
        values,
        part,
        first,
    )
    return dict(zip(names, found, strict=True))

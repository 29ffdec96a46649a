"""Evolution of level sets: checks and conversions around the compiled core."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from myork import _core, errors

__all__ = ["evolve_two_phase"]


def evolve_two_phase(
    image: ArrayLike,
    mask: ArrayLike,
    start: ArrayLike,
    *,
    spacing: tuple[float, float],
    mu: float,
    nu: float,
    lambda1: float,
    lambda2: float,
    epsilon: float,
    dt: float,
    tolerance: float,
    iterations: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """Evolve a two-phase level set in every slice by the scheme (A.1), (A.2).

    Parameters
    ----------
    image, mask, start : ArrayLike
        Grey values [-], pixels that take part, first level set [-], shape `(ni, nj, nk)` each.
    spacing : tuple
        Pixel sizes along the first two axes [pixel].
    mu, nu, lambda1, lambda2, epsilon, dt, tolerance, iterations
        Weights of (3.12), width of the step (3.16), time step, the part of the pixels that may
        change sides in ten iterations at rest, and the largest number of iterations.

    Returns
    -------
    tuple
        Level set, shape `(ni, nj, nk)`; energy (3.12) before each iteration, shape
        `(iterations, nk)`; iterations done in each slice, shape `(nk,)`.
    """
    arrays = [np.asfortranarray(a, dtype=float) for a in (image, start)]
    inside = np.asfortranarray(mask, dtype=np.int32)
    shapes = {a.shape for a in (*arrays, inside)}
    if len(shapes) > 1 or inside.ndim != 3:
        raise errors.InputError(f"image, mask and start must be 3-D of one shape, not {shapes}")
    weights = (mu, nu, lambda1, lambda2, epsilon, dt, tolerance)
    if iterations < 1:
        raise errors.InputError(f"iterations must be at least 1, not {iterations}")
    phi, energy, done, stat, message = _core.evolve_two_phase(
        weights, spacing, iterations, arrays[0], inside, arrays[1]
    )
    errors.check(stat, message)
    return phi, energy, done

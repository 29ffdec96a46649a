"""Two-phase segmentation by active contours without edges, slice by slice.

Not here: more phases, more channels, bias of the coil's field. The evolution itself is handed in
(the compiled core's, in the pipeline), so this file needs no compiler.

References
----------
Chan, Vese, IEEE Trans. Image Process. 10 (2001), doi:10.1109/83.902291
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.errors import InputError
from myork.records import Image
from myork.segmentation.regions import otsu

__all__ = ["TwoPhase", "two_phase"]

Evolve = Callable[..., tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]]


@dataclass(frozen=True)
class TwoPhase:
    """Result of a two-phase segmentation.

    Attributes
    ----------
    inside : NDArray
        Wanted phase, shape `(ni, nj, nk)`.
    iterations : NDArray
        Iterations of each slice, shape `(nk,)`.
    energy : NDArray
        Energy (3.12) of all slices together before each iteration, shape `(iterations,)` [-].
    converged : bool
        Whether the labels of every slice came to rest.
    """

    inside: NDArray[np.bool_]
    iterations: NDArray[np.int32]
    energy: NDArray[np.float64]
    converged: bool


def two_phase(
    image: Image,
    region: NDArray[np.bool_],
    evolve: Evolve,
    weights: Mapping[str, Any],
    *,
    phase: str = "dark",
    start: str = "otsu",
) -> TwoPhase:
    """Part a region into a dark and a bright phase.

    Parameters
    ----------
    image : Image
        MR image, shape `(ni, nj, nk)`; slices lie along the last axis.
    region : NDArray
        Pixels that take part, same shape.
    evolve : callable
        Evolution of the level sets, as `myork.core_image.evolve_two_phase`.
    weights : mapping
        mu, nu, lambda1, lambda2, epsilon, dt, tolerance and iterations for `evolve`.
    phase : str
        `dark` or `bright`: the wanted phase, where the level set is positive.
    start : str
        `otsu` (threshold of the whole region) or `circles`.
    """
    if not region.any():
        raise InputError(
            f"{image.name}: the region to segment is empty; check image.box and image.region"
        )
    low, high = np.percentile(image.data[region], (1.0, 99.0))
    if not high > low:
        raise InputError(f"{image.name}: the region to segment has one grey value only, {low:g}")
    grey = (image.data - low) / (high - low)
    sign = -1.0 if phase == "dark" else 1.0
    first = sign * (grey - otsu(grey[region])) if start == "otsu" else _circles(grey.shape)
    pixel = image.spacing[:2] / image.spacing[:2].min()
    phi, energy, iterations = evolve(grey, region, first, spacing=tuple(pixel.tolist()), **weights)
    inside = (phi > 0) & region
    if start == "circles":
        inside = _wanted_side(grey, region, inside, sign)
    return TwoPhase(
        inside=inside,
        iterations=iterations,
        energy=energy[: iterations.max()].sum(axis=1),
        converged=bool((iterations < weights["iterations"]).all()),
    )


def _circles(shape: tuple[int, ...], pitch: float = 16.0) -> NDArray[np.float64]:
    """Cones with zero on circles in a square grid of a pitch [pixel], positive inside."""
    i, j = (np.abs((np.arange(n) + 0.5) % pitch - 0.5 * pitch) for n in shape[:2])
    cone = 0.35 * pitch - np.hypot(i[:, None], j[None, :])
    return np.repeat(cone[:, :, None], shape[2], axis=2)


def _wanted_side(
    grey: NDArray[np.float64],
    region: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    sign: float,
) -> NDArray[np.bool_]:
    """Turn the slices in which a start from circles ended with the phases swapped."""
    inside = inside.copy()
    for k in range(grey.shape[2]):
        a, b = inside[:, :, k], region[:, :, k] & ~inside[:, :, k]
        if a.any() and b.any() and sign * (grey[a, k].mean() - grey[b, k].mean()) < 0:
            inside[:, :, k] = b
    return inside

"""Moving a label map that nearly fits onto an image: one similarity a slice and a limb.

Outlines of a neighbour slice, an earlier visit or an atlas are a few millimetres off. They are
shifted, turned and scaled within a reach so that their borders lie on edges of the image and
their inside in the tissue that is wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import minimize

from myork.records import Labels
from myork.types import F64, I32, Mask

__all__ = ["align_labels"]


# Edges above this percentile count alike, or the strongest (skin, bone) would decide alone.
_STRONG = 95.0
# Weight of labelled pixels outside of the wanted tissue, and of the motion, against edges.
_OUTSIDE = 2.0
_MOTION = 0.1
# Slope of the logarithm of grey values below which there is no edge but rounding, of values in
# single precision as well [1/pixel].
_FLAT = 1e-6
# Blurring of the maps from coarse to fine, in parts of the reach.
_COARSE_TO_FINE = (0.5, 0.25, 0.125)


def align_labels(labels: Labels, edges: F64, tissue: Mask, body: Mask, reach: float) -> Labels:
    """Move labels onto an image.

    Parameters
    ----------
    labels : Labels
        That nearly fit, on the grid of the image.
    edges : NDArray
        Strength of the image's edges, shape `(ni, nj, nk)` [1/pixel].
    tissue : NDArray
        Voxels of the wanted tissue, same shape.
    body : NDArray
        Inside of the body, same shape; each of its pieces in a slice (a leg) moves on its own.
    reach : float
        Longest shift; also that of a typical place by turning, and by scaling [mm].

    Returns
    -------
    Labels
        On the same grid; nothing moves from slice to slice, nor in a slice without an edge.
    """
    data = labels.data.copy()
    strong = max(float(np.percentile(edges[body], _STRONG)), _FLAT)
    pixel = float(np.sqrt(labels.spacing[0] * labels.spacing[1]))
    for k in range(data.shape[2]):
        most = edges[:, :, k].max(initial=0.0, where=body[:, :, k])
        if not data[:, :, k].any() or most < _FLAT:
            continue
        maps = []
        for fraction in _COARSE_TO_FINE:
            blur = fraction * reach / pixel
            edge = np.where(body[:, :, k], np.minimum(edges[:, :, k] / strong, 1.0), 0.0)
            edge = ndimage.gaussian_filter(edge, blur)
            outside = ndimage.gaussian_filter((~tissue[:, :, k]).astype(float), blur)
            maps.append((edge / edge.max(), outside))
        pieces, count = ndimage.label(body[:, :, k])
        nearest = ndimage.distance_transform_edt(
            pieces == 0, return_distances=False, return_indices=True
        )
        of_piece = pieces[tuple(nearest)]
        moved = np.zeros_like(data[:, :, k])
        for piece in range(1, count + 1):
            part = np.where(of_piece == piece, data[:, :, k], 0)
            if part.any():
                part = _fitted(part, maps, reach / pixel)
                moved = np.where(part > 0, part, moved)
        data[:, :, k] = moved
    return replace(labels, data=data)


def _fitted(label: I32, maps: Sequence[tuple[F64, F64]], reach: float) -> NDArray:
    """Labels of a limb moved by the similarity that fits best, shape `(ni, nj)`."""
    inner = np.argwhere(label > 0).astype(float)
    border = _border(label)
    centre = inner.mean(axis=0)
    # A turn by x/arm moves a typical place by x pixels, a scale exp(x/arm) as well.
    arm = max(float(np.sqrt(((inner - centre) ** 2).sum(axis=1).mean())), 1.0)

    def turn(x: F64) -> F64:
        cosine, sine = np.cos(x[2] / arm), np.sin(x[2] / arm)
        return np.exp(x[3] / arm) * np.array([[cosine, -sine], [sine, cosine]])

    def misfit(x: F64, edge: F64, outside: F64) -> float:
        def mean(values: F64, places: F64) -> float:
            moved = (places - centre) @ turn(x).T + centre + x[:2]
            return float(ndimage.map_coordinates(values, moved.T, order=1, mode="nearest").mean())

        return (
            _OUTSIDE * mean(outside, inner)
            - mean(edge, border)
            + _MOTION * float((x**2).sum()) / reach**2
        )

    x, step = np.zeros(4), 0.5 * reach
    for edge, outside in maps:
        simplex = np.clip(np.vstack([x - step / 4, x + step * np.eye(4)]), -reach, reach)
        x = minimize(
            misfit,
            x,
            args=(edge, outside),
            method="Nelder-Mead",
            bounds=[(-reach, reach)] * 4,
            options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-5},
        ).x
        step *= 0.5
    back = np.linalg.inv(turn(x))
    return ndimage.affine_transform(label, back, offset=centre - back @ (centre + x[:2]), order=0)


def _border(label: I32) -> F64:
    """Places between neighbouring pixels of different labels, shape `(n, 2)` [pixel]."""
    along = np.argwhere(label[1:] != label[:-1]) + [0.5, 0.0]
    across = np.argwhere(label[:, 1:] != label[:, :-1]) + [0.0, 0.5]
    return np.vstack([along, across])

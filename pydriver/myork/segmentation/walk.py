"""Muscles of equal grey value separated by random walks from seeds that avoid edges of the image.

Steps across edges (fascia, the dark lines of chemical shift) are rare, so that borders close over
gaps. Edges are steps of the logarithm of the grey value, which slow shading does not change, and
its slope, which also shows blurred edges.

References
----------
Grady, IEEE Trans. Pattern Anal. Mach. Intell. 28 (2006), doi:10.1109/TPAMI.2006.233
"""

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import LinearOperator, cg, splu

from myork.errors import InputError
from myork.imaging.geometry import neighbours
from myork.segmentation.channels import noise_level
from myork.types import F64, I32, Index, Mask

# Standard deviation of the derivative of a Gaussian that finds edges [pixel]: lines of one or two
# pixels must be kept.
_BLUR = 0.5
# Grey values below this part of the median are noise, whose logarithm fluctuates strongly.
_FLOOR = 0.1
# Weight of the slopes relative to the steps: they fix borders where an edge is blurred over pixels;
# a larger weight moves borders off the lines that mark them.
_SLOPE = 0.25
# Steps are damped beyond this many times the noise, so that thin walls whose steps partial
# volume halves still stand out, within these bounds: walls as dark as those of bone would isolate
# their inside, and nearly decoupled equations are not solved accurately enough for a label.
_STEEP = 10.0
_STEEPEST = 0.5, 1.0
# The smallest conductance keeps the system regular where an edge is very sharp.
_LEAST = 1e-6
# Tolerance of the probabilities; the most likely label is known long before.
_TOLERANCE = 1e-3


def heights_of(values: F64, where: Mask, others: F64 | None = None) -> F64:
    """Heights whose steps are edges: the logarithm of the grey values, then other channels.

    - `values`: grey values, not negative in `where`, shape `(ni, nj, nk)`
    - `where`: voxels that count, same shape
    - `others`: channels from about 0 to 1, each times the square root of its weight, shape
      `(ni, nj, nk, nchannel)` [-]
    - returns shape `(ni, nj, nk, 1 + nchannel)` [-]
    """
    if not where.any():
        raise InputError("edges: the region is empty; check image.region and image.body")
    floor = _FLOOR * float(np.median(values[where]))
    if not floor > 0:
        raise InputError("edges: half of the voxels have no signal; check image.region")
    height = np.log(np.maximum(values, 0.0) + floor)[..., np.newaxis]
    return height if others is None else np.concatenate([height, others], axis=3)


def random_walk(heights: F64, where: Mask, seeds: I32, spacing: F64, shyness: float) -> I32:
    """Label voxels by the seeds that random walks from them reach first.

    - `heights`: see `heights_of`, shape `(ni, nj, nk, nchannel)` [-]
    - `where`: voxels that take part, shape `(ni, nj, nk)`
    - `seeds`: labels where known, otherwise -1, same shape
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    - `shyness`: a step over the height d near a slope s is `exp(-shyness (d / (1 + d/n) + s/4))`
      times as likely, n being ten times the noise of the first channel, 0.5 to 1 [pixel]
    - returns labels, -1 where no seed can be reached, same shape
    """
    pieces, _ = ndimage.label(where)
    inside = where & np.isin(pieces, np.unique(pieces[where & (seeds >= 0)]))
    found = np.full(where.shape, -1, np.int32)
    if not inside.any():
        return found
    known = seeds[inside]
    laplacian = _laplacian(heights, inside, spacing, shyness)
    free = known < 0
    names = np.unique(seeds[where & (seeds >= 0)])
    result = known.copy()
    if free.any():
        system = laplacian[free][:, free]
        coupling = laplacian[free][:, ~free]
        slices = np.nonzero(inside)[2][free]
        inverse = _slice_by_slice(system, slices)
        # The last probability is the complement of the others.
        likely = np.zeros((len(names), int(free.sum())))
        for number, name in enumerate(names[:-1]):
            right = -(coupling @ (known[~free] == name).astype(float))
            likely[number], info = cg(system, right, rtol=_TOLERANCE, M=inverse)
            if info != 0:
                raise InputError(
                    f"the random walks from label {name} were not solved to {_TOLERANCE} "
                    f"(conjugate gradients end with {info}); lower image.edge_weight = {shyness}"
                )
        likely[-1] = 1.0 - likely[:-1].sum(axis=0)
        result[free] = names[likely.argmax(axis=0)]
    found[inside] = result
    return found


def _slopes(heights: F64) -> F64:
    """Slope of the heights in each slice, over all channels [1/pixel]."""
    slopes = [
        ndimage.gaussian_filter(height, (_BLUR, _BLUR, 0.0), order=order)
        for height in np.moveaxis(heights, 3, 0)
        for order in ((1, 0, 0), (0, 1, 0))
    ]
    return np.asarray(np.hypot.reduce(slopes))


def _laplacian(heights: F64, inside: Mask, spacing: F64, shyness: float) -> sparse.csr_matrix:
    """Graph Laplacian of voxels that share a face."""
    slopes = _slopes(heights)
    steep = np.clip(_STEEP * noise_level(heights[..., 0], inside), *_STEEPEST)
    slopes, heights = slopes[inside], heights[inside]
    pairs, weight = [], []
    for axis, size in enumerate(spacing / spacing.min()):
        low, high = neighbours(inside, axis)
        step = np.linalg.norm(heights[high] - heights[low], axis=-1)
        edge = step / (1.0 + step / steep) + _SLOPE * np.maximum(slopes[low], slopes[high])
        pairs.append((low, high))
        weight.append((np.exp(-shyness * edge) + _LEAST) / size**2)
    places = tuple(np.concatenate(pairs, axis=1))
    one = sparse.coo_matrix((np.concatenate(weight), places), 2 * (len(slopes),)).tocsr()
    both_ways = one + one.T
    return (sparse.diags(np.asarray(both_ways.sum(axis=1)).ravel()) - both_ways).tocsr()


def _slice_by_slice(system: sparse.csr_matrix, slices: Index) -> LinearOperator:
    """Preconditioner: each slice is solved separately; steps between slices are few and weak."""
    parts = [np.flatnonzero(slices == k) for k in np.unique(slices)]
    solvers = [splu(system[part][:, part].tocsc()) for part in parts]

    def apply(x: F64) -> F64:
        y = np.empty_like(x)
        for part, solver in zip(parts, solvers, strict=True):
            y[part] = solver.solve(x[part])
        return y

    return LinearOperator(system.shape, apply, dtype=float)

"""Fibers without measurements: along a potential flow through the muscle, from end to end.

The potential is 0 in the first slice of a muscle and 1 in the last, with no flux through its sides:
fibers run along the walls and converge where the muscle becomes thin. It is a guess for muscles
whose fibers run from end to end, and does not describe pennate ones.

Reference: Choi, Blemker, PLoS ONE 8 (2013), doi:10.1371/journal.pone.0077576
"""

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import cg

from myork.errors import ConvergenceError
from myork.imaging.geometry import boxes_of, canonical, frame, neighbours, with_axis_at
from myork.records import Image, Labels
from myork.types import F64, Mask

_TOLERANCE = 1e-5  # relative residual of the potential; directions are then accurate to a degree
_LEAST = 1e-12  # smallest flow with a defined direction, relative to the largest


def flow_fibers(labels: Labels, axis: int = 2) -> Image:
    """Fiber vectors of all voxels with a label, by connected component of each label.

    - `labels`: label map, in any orientation
    - `axis`: world axis along which slices are stacked, 0 to 2
    - returns unit vectors in the world frame on the grid of the labels with its axes reordered to
      the nearest world axes (`canonical`), zero outside, shape `(ni, nj, nk, 3)`
    - raises ConvergenceError: the potential of a component did not converge
    """
    whole = with_axis_at(canonical(labels), axis, 2)
    flow = np.zeros((*whole.data.shape, 3))
    for number in whole.present:
        pieces, _ = ndimage.label(whole.data == number)
        for box, here in boxes_of(pieces):
            flow[box][here] = _flow(here, whole.spacing)
    length = np.linalg.norm(flow, axis=-1, keepdims=True)
    still = (whole.data > 0) & (length[..., 0] <= _LEAST * length.max(initial=0.0))
    flow[still] = [0.0, 0.0, 1.0]  # a dead end without flow
    length[still] = 1.0
    unit = np.divide(flow, length, out=np.zeros_like(flow), where=length > 0)
    fibers = Image(unit @ frame(whole.affine).T, whole.affine, "fibers of the flow")
    return with_axis_at(fibers, 2, axis)


def _flow(here: Mask, spacing: F64) -> F64:
    """Flow through the voxels of a component, in their order, shape `(n, 3)` [1/mm].

    Between neighbours it is the difference of the potential over their distance; in a voxel it
    is the mean of its two faces in each direction, with zero at a wall.
    """
    count = int(here.sum())
    layer = np.argwhere(here)[:, 2]
    ends = [np.flatnonzero(layer == k) for k in (0, here.shape[2] - 1)]
    diagonal, load = np.zeros(count), np.zeros(count)
    pairs = [neighbours(here, d) for d in range(3)]
    for d, pair in enumerate(pairs):
        for one in pair:
            np.add.at(diagonal, one, spacing[d] ** -2)
    # the ends lie on the outer faces, half a voxel from the centres
    for points, value in zip(ends, (0.0, 1.0), strict=True):
        diagonal[points] += 2.0 * spacing[2] ** -2
        load[points] += 2.0 * value * spacing[2] ** -2
    rows = np.concatenate([np.concatenate(pair) for pair in pairs])
    columns = np.concatenate([np.concatenate(pair[::-1]) for pair in pairs])
    weights = np.repeat(spacing**-2.0, [2 * len(pair[0]) for pair in pairs])
    matrix = sparse.csr_matrix((-weights, (rows, columns)), (count, count))
    matrix += sparse.diags(diagonal)
    height = (layer + 0.5) / here.shape[2]
    potential, unsolved = cg(
        matrix, load, height, rtol=_TOLERANCE, maxiter=20 * max(here.shape) + 1000,
        M=sparse.diags(1.0 / diagonal),
    )  # fmt: skip
    if unsolved:
        raise ConvergenceError(
            f"build.flow: the flow through a component of {count} voxels did not converge in "
            f"{unsolved} iterations; cut off long winding parts by build.slices or in the labels, "
            "or give build.fibers"
        )
    flow = np.zeros((count, 3))
    for d, (first, second) in enumerate(pairs):
        slope = 0.5 * (potential[second] - potential[first]) / spacing[d]
        np.add.at(flow[:, d], first, slope)
        np.add.at(flow[:, d], second, slope)
    flow[ends[0], 2] += potential[ends[0]] / spacing[2]
    flow[ends[1], 2] += (1.0 - potential[ends[1]]) / spacing[2]
    return flow

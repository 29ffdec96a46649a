"""Masks for a segmentation: the body, boxes, grown label maps; connected components to keep."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.geometry import depth_in_slices
from myork.records import Image, Labels
from myork.types import F64, Mask

# Drop connected components of the body smaller than this part of the largest.
_LEAST_PIECE = 0.1
# Signal beyond the body is that of a lost part if it exceeds the air by this many times the spread
# of its darkest quarter, and this part of the body's signal, at this distance from the body [pixel]
# in a piece of more than this part of the body. Right images gave 0, oil tubes 0.02, ghosts 0.08,
# arms and dark legs 0.1 and more.
_CLEAR, _LEAST_SIGNAL, _AWAY, _LOST = 7.0, 0.05, 6, 0.04
# A slice has only noise if its 99th percentile under a Gaussian of this many pixels is below this
# part of that of the brightest slice, and the Gaussian leaves less than this part of the scatter
# where it is not zero: noise keeps 0.1 (0.28 interpolated twofold), limbs at SNR 3 and more 0.4.
_SLOW, _DIM, _LIKE_NOISE = 3.0, 0.5, 0.35
# A tissue of this many voxels or more contains two if two classes explain more than this part of
# the variance of its grey values (marrow in fat up to 0.84, muscle half of fat 0.89 or more) and
# the one closer to muscle has more than this part of the muscle's size (marrow 0.05), or if it
# scatters by this part of the difference to muscle (fat 0.2). Below the last part it is uniform.
_ENOUGH, _TWO, _PARTLY, _MIXED, _EVEN = 20, 0.86, 0.07, 0.22, 0.01
# Bright spots of an image stay below this many times its 99th percentile.
_OUTLIER = 1e6


def otsu(values: ArrayLike) -> float:
    """Threshold that separates values into two classes with the largest variance between them.

    Reference: Otsu, IEEE Trans. Syst. Man Cybern. 9 (1979), doi:10.1109/TSMC.1979.4310076
    """
    count, edges = np.histogram(np.asarray(values), 256)
    middle = 0.5 * (edges[1:] + edges[:-1])
    low, total = np.cumsum(count)[:-1], np.cumsum(count * middle)[:-1]
    n, everything = int(count.sum()), float((count * middle).sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (everything * low - total * n) ** 2 / (low * (n - low))
    return float(edges[1 + int(np.nanargmax(between))])


def body_mask(image: Image, rim: float = 2.0) -> Mask:
    """Inside of the body (both legs if there are two), without the skin.

    Slice by slice, a third of Otsu's threshold separates the body from air even where muscle is
    much darker than fat or the coil signal is weak; holes are filled. Air is zero, or the lowest
    value if that is negative.

    - `image`: MR image, shape `(ni, nj, nk)`
    - `rim`: width removed at the skin, where pixels are a mixture of fat and air [pixel]
    """
    positive = image.data[image.data > 0]
    if not positive.size:
        raise InputError(
            f"{image.name}: no value is above zero, the largest is {image.data.max():g}; a "
            "magnitude image is needed, bright where there is signal"
        )
    typical, largest = np.percentile(positive, 99.0), positive.max()
    if largest > _OUTLIER * typical:
        place = tuple(np.argwhere(image.data == largest)[0].tolist())
        raise InputError(
            f"{image.name}: the value {largest:g} at voxel {place} is {largest / typical:.0e} "
            "times that of the image; the file is damaged there"
        )
    smooth = ndimage.gaussian_filter(image.data, (1.0, 1.0, 0.0))
    full = np.zeros(smooth.shape, dtype=bool)
    for k in np.flatnonzero(seen_slices(image.data)):
        section = smooth[:, :, k]
        if np.ptp(section) > 0:
            air = min(float(section.min()), 0.0)
            bright = section > air + (otsu(section) - air) / 3.0
            full[:, :, k] = ndimage.binary_fill_holes(bright)
    return large_pieces(depth_in_slices(full) > rim, image.name)


def seen_slices(data: F64) -> Mask:
    """Slices with more than noise, shape `(nk,)`; ends of a stack may lie beyond a limb."""
    slow = ndimage.gaussian_filter(data, (_SLOW, _SLOW, 0.0))
    peak = np.percentile(slow, 99.0, axis=(0, 1))
    seen = peak >= _DIM * peak.max()
    for k in np.flatnonzero(~seen & (peak > 0)):
        there = data[:, :, k] != 0  # zeros were set, not measured
        share = ndimage.gaussian_filter(there.astype(float), _SLOW)[there]
        kept = np.std(slow[:, :, k][there] / share)
        seen[k] = kept > _LIKE_NOISE * np.std(data[:, :, k][there])
    return np.asarray(seen, np.bool_)


def whole_voxels(tissue: Mask) -> Mask:
    """Voxels that touch no other tissue in their slice."""
    return np.asarray(ndimage.binary_erosion(tissue, np.ones((3, 3, 1))))


def doubt_of_mixture(values: F64, tissue: Mask, muscle: Mask) -> str:
    """Doubt if a tissue contains a second one that is closer to muscle in grey value; else empty.

    - `values`: grey values, shape `(ni, nj, nk)`
    - `tissue`, `muscle`: their voxels, same shape
    """
    inside = ndimage.uniform_filter(values, (3, 3, 1))[whole_voxels(tissue)]
    if inside.size < _ENOUGH or not muscle.any():
        return ""
    away = np.abs(inside - values[muscle].mean())
    if away.std() < _EVEN * away.mean():
        return ""
    far = away > otsu(away)
    near = float((~far).sum() / muscle.sum())
    between = far.mean() * (~far).mean() * (away[far].mean() - away[~far].mean()) ** 2
    two = between > _TWO * away.var() and near > _PARTLY
    if not two and away.std() < _MIXED * away.mean():
        return ""
    return (
        f"contains two tissues: a part, {100 * near:.0f} % of the size of muscle, is closer to "
        "muscle in grey value. It may be muscle infiltrated by fat, which is then missing from the "
        "volume of muscle; compare the labels with the image, and label such muscle by seeds "
        "(image.split = 'walk')"
    )


def large_pieces(mask: Mask, name: str) -> Mask:
    """Connected components of a body, shape `(ni, nj, nk)`, from a tenth of the largest on."""
    pieces, n = ndimage.label(mask)
    if not n:
        raise InputError(f"{name}: no body found, the image has almost no contrast")
    size = np.bincount(pieces.ravel())[1:]
    return np.isin(pieces, 1 + np.flatnonzero(size >= _LEAST_PIECE * size.max()))


def lost_part(image: Image, body: Mask) -> str:
    """A warning if there is signal beyond a body that was found by its brightness; else empty."""
    smooth = ndimage.gaussian_filter(image.data, (1.0, 1.0, 0.0))
    beyond = ~ndimage.binary_dilation(body, np.ones((3, 3, 1)), iterations=_AWAY)
    beyond &= seen_slices(image.data)
    # low percentiles: most of what lies beyond may be a lost part; zeros were set, not measured
    air = smooth[beyond & (image.data != 0)]
    if not air.size:
        return ""
    low, high = np.percentile(air, (5.0, 25.0))
    least = max(high + _CLEAR * (high - low), _LEAST_SIGNAL * np.median(smooth[body]))
    seen = ndimage.binary_opening(beyond & (smooth > least), np.ones((5, 5, 1)))
    pieces, _ = ndimage.label(seen)
    share = np.bincount(pieces.ravel(), minlength=2)[1:].max() / body.sum()
    if share <= _LOST:
        return ""
    return (
        f"{image.name}: signal of {100 * share:.0f} % of the area of the body lies beyond what was "
        "taken for the body: an arm, or a second leg far from the coil, may have been lost; name "
        "all that is inside in image.body, or what you need in image.region"
    )


def box_mask(image: Image, box: Sequence[float]) -> Mask:
    """Voxels whose centres lie in a box of world coordinates.

    - `box`: lower and upper bounds of x, y, z, shape `(6,)` [mm]
    """
    low, high = np.reshape(np.asarray(box, float), (3, 2)).T
    if not (low < high).all():
        raise InputError(f"image.box: each low end must be below its high end, not {list(box)}")
    index = np.stack(np.meshgrid(*map(np.arange, image.data.shape[:3]), indexing="ij"), -1)
    world = image.world(index)
    return ((world >= low) & (world <= high)).all(-1)


def grown_mask(labels: Labels, margin: float) -> Mask:
    """Labels above zero, grown by a margin [mm]."""
    inside = labels.data > 0
    if not inside.any():
        raise InputError(f"{labels.name}: the region is empty, no label is above zero")
    return ndimage.distance_transform_edt(~inside, sampling=labels.spacing) <= margin

"""Bias field of an image: slow shading of the coils, which multiplies the true values.

Regions and field together by local clustering with level sets, equations (3.30) to (3.45).

Reference: Li, Huang, Ding, Gatenby, Metaxas, Gore, IEEE Trans. Image Process. 20 (2011),
doi:10.1109/TIP.2011.2146190
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from myork.core.level_sets import evolve_level_sets
from myork.errors import InputError
from myork.records import Image
from myork.segmentation.level_sets import contour_weights
from myork.segmentation.regions import otsu
from myork.segmentation.starts import kmeans, level_sets_of, regions_of
from myork.types import F64, Mask

# Width of the step function (3.16). With the wide one of a segmentation every mean holds a part of
# the other regions, and the field takes up the difference.
_EPSILON = 0.02
_DT = 5000.0  # largest time step of the level sets
_STEPS = 5  # of the level sets between two improvements of the field
_ROUNDS = 100  # improvements of the field
_AT_REST = 1e-4  # root mean square change of the field in a round at rest
_SIGMA = 12.0  # standard deviation of the Gaussian neighbourhood (3.36) [mm]
_EDGE = 0.05  # relative change from pixel to pixel that makes an edge; noise of 1/25 makes 0.01
_NEGATIVE = 0.01  # part of the body's voxels that ringing of a resampled image makes negative
_SEAM = (3.0, 3.0, 0.0)  # width of the smoothing beyond the mask [pixel]
_DARK = 0.3  # of the median value: what is darker is mostly noise
_RISE = 1.1  # a field that raises the coefficient by less is no worse than none
# Coefficient of joint variation of one normal distribution that is cut in the middle: an image that
# has as much shows no two tissues, and the coefficient says nothing of it.
_ONE_TISSUE = float(np.sqrt(0.5 * np.pi - 1.0))


@dataclass(frozen=True)
class BiasField:
    """Estimate of a bias field."""

    #: Factor on the true values, mean one inside the mask and going on beyond it without a step,
    #: shape `(ni, nj, nk)` [-]
    field: F64
    #: Energy (3.38) of each round of the second estimate, before the field is improved, shape
    #: `(rounds,)` [-]
    energy: F64
    converged: bool  #: Whether the field came to rest


def check_positive(image: Image, mask: Mask) -> None:
    """Refuse an image of which a good part is negative: a factor explains no change of sign.

    - `image`: MR image, shape `(ni, nj, nk)`
    - `mask`: voxels of the body, same shape
    """
    share = float((image.data[mask] < 0).mean())
    if share > _NEGATIVE:
        raise InputError(
            f"{image.name}: {share:.0%} of the values in the body are negative, which no bias "
            "field makes; give the magnitude image, or set bias.method = 'none'"
        )


def joint_variation(values: F64, mask: Mask) -> float:
    """Coefficient of joint variation: scatter of bright and of dark tissue over their difference.

    Both are those of Otsu's threshold in the mask.

    - `values`: image, shape `(ni, nj, nk)` [-]
    - `mask`: voxels of the body, same shape
    """
    inside = values[mask]
    if not np.ptp(inside) > 0:
        return 0.0
    bright = inside > otsu(inside)
    high, low = inside[bright], inside[~bright]
    return float((high.std() + low.std()) / (high.mean() - low.mean()))


def variation_doubt(values: F64, field: F64, mask: Mask) -> str:
    """What to say where tissues scatter more without a field than with it, else empty.

    An image without two tissues is not doubted by it.

    - `values`, `mask`: as of `joint_variation`
    - `field`: factor on the true values, shape `(ni, nj, nk)` [-]
    """
    before, after = (joint_variation(one, mask) for one in (values, values / field))
    if after <= _RISE * before or before >= _ONE_TISSUE:
        return ""
    return (
        "the bias field raises the coefficient of joint variation of bright and dark tissue from "
        f"{before:.3g} to {after:.3g}; look at bias.nii.gz, or set bias.method = 'none'"
    )


def clustered_bias(
    values: F64,
    mask: Mask,
    *,
    spacing: ArrayLike,
    regions: int,
    mu: float | Sequence[float] = 0.01,
) -> BiasField:
    """Bias field by local clustering, (3.30) to (3.45), for any number of regions.

    Multiplied out, (3.43) is (K*1) I^2 - 2 c I (b*K) + c^2 (b^2*K): the misfit of a region is
    w (J - c)^2 with w = b^2*K and J = I (b*K)/w, and a part that is the same for all regions. So
    the level sets evolve on the image J with voxel weights w, and their means are (3.40). Field
    and level sets are improved in turn; neither raises the energy (3.38).

    - `values`: image, shape `(ni, nj, nk)`; its slices are one volume [-]
    - `mask`: voxels that take part, same shape
    - `spacing`: voxel sizes, shape `(3,)` [mm]
    - `regions`: number of regions
    - `mu`: weight of the contours' length, one for all level sets or one for each; the grey values
      are scaled to about one [-]
    """
    if not mask.any():
        raise InputError("bias: no voxel to estimate the field from; check the mask")
    size, image = np.asarray(spacing, float), np.where(mask, values, 0.0)
    bright = np.percentile(image[mask], 99.0)
    if not bright > 0:
        raise InputError("bias: the body has no signal, its 99th percentile is not above zero")
    image /= bright
    trust = _trust(image, mask)
    counts = trust > 0
    if not counts.any():
        raise InputError("bias: every voxel lies at an edge: no signal above the noise level")
    # Wider than ten images it is flat over the image, and longer to compute.
    widths = [
        min(_SIGMA / h, 10.0 * n) if n > 1 else 0.0 for h, n in zip(size, mask.shape, strict=True)
    ]

    def blurred(a: F64) -> F64:
        # The same discrete kernel stands in every convolution, so cutting it off costs nothing.
        return ndimage.gaussian_filter(a, widths, mode="constant", truncate=3.0)

    whole = blurred(mask.astype(float))
    pixel = size / size.min()
    cell = float(np.prod(pixel if mask.shape[2] > 1 else pixel[:2]))
    # Clusters of a shaded image mix bright muscle with dark fat; those of the image without a first
    # estimate of its field do so less.
    field = mask.astype(float)
    for _ in range(2):
        clusters = np.zeros(mask.shape, np.int32)
        clusters[mask] = kmeans((image / np.maximum(field, 1e-6))[mask][:, None], regions)[0]
        phi = level_sets_of(clusters, regions, True)
        energy: list[float] = []
        converged = False
        while len(energy) < _ROUNDS and not converged:
            near, square = blurred(field), blurred(field**2)
            flat = np.divide(image * near, square, out=np.zeros_like(image), where=counts)
            found = evolve_level_sets(
                flat[..., None],
                trust * square,
                phi,
                spacing=tuple(pixel.tolist()),
                mu=contour_weights("bias.mu", mu, regions),
                nu=0.0,
                epsilon=_EPSILON,
                dt=_DT,
                tolerance=0.0,
                iterations=_STEPS,
                lambdas=np.ones((1, regions)),
                volume=True,
            )
            phi = found["phi"]
            common = trust * image * (image * whole - near * flat)
            energy.append(float(found["energy"][-1, 0]) + cell * float(common.sum()))
            true, true_squared = _piecewise(phi, found["means"][0, :, 0])
            before, below = field, blurred(trust * true_squared)
            field = np.divide(
                blurred(trust * image * true), below, out=np.zeros_like(image), where=mask
            )
            mean = field[mask].mean()
            if not (mean > 0 and np.isfinite(field).all()):
                raise InputError(
                    f"bias: too few of the {int(mask.sum())} voxels lie away from edges to find a "
                    "field; set bias.method = 'none'"
                )
            field /= mean
            converged = float(np.sqrt(np.mean((field - before)[mask] ** 2))) <= _AT_REST
    return BiasField(of_mean_one(field, mask), np.array(energy), converged)


def of_mean_one(field: F64, mask: Mask) -> F64:
    """Field with the mean one inside a mask, going on beyond; refused where it is no factor.

    - `field`: factor on the true values; looked at inside the mask only, shape `(ni, nj, nk)` [-]
    - `mask`: voxels of the body, same shape
    """
    if not (np.isfinite(field[mask]) & (field[mask] > 0)).all():
        raise InputError("bias: the field is not positive everywhere; set bias.method = 'none'")
    found = field / field[mask].mean()
    if mask.all():
        return found
    # No data speaks beyond the mask: the field stays as it is at its rim, seams smoothed.
    nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    spread = found[tuple(nearest)]
    return np.where(mask, found, ndimage.gaussian_filter(spread, _SEAM, mode="nearest"))


def _trust(image: F64, inside: Mask) -> F64:
    """Weights of voxels: errors relative to the value count, voxels at edges do not.

    A voxel at an edge is a mixture, of no region's value; left in, mixtures of muscle and thin
    fat look like shading. Absolute errors would let fat, bright and uneven, outvote muscle.
    """
    near = inside.astype(float)
    blur = (1.0, 1.0, 0.0)
    smooth = ndimage.gaussian_filter(image * inside, blur) / np.maximum(
        ndimage.gaussian_filter(near, blur), 1e-3
    )
    slope = np.hypot(*np.gradient(smooth, axis=(0, 1)))
    scale = np.maximum(smooth, _DARK * np.median(image[inside]))
    return np.where(inside & (slope < _EDGE * scale), 1.0 / scale**2, 0.0)


def _piecewise(phi: F64, means: F64) -> tuple[F64, F64]:
    """Sum of c M and of c^2 M over the regions, (3.41)."""
    step = 0.5 + np.arctan(phi / _EPSILON) / np.pi
    linear, square = np.zeros(phi.shape[:3]), np.zeros(phi.shape[:3])
    for signs in product((0, 1), repeat=phi.shape[3]):
        part = np.ones(phi.shape[:3])
        for level, sign in enumerate(signs):
            part *= step[..., level] if sign else 1.0 - step[..., level]
        mean = means[regions_of(np.array(signs, float), len(means))]
        linear += mean * part
        square += mean**2 * part
    return linear, square

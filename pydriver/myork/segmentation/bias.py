"""Bias field of an image: slow shading of the coils, which multiplies the true values.

Two ways: regions and field together by local clustering with level sets, equations (3.30) to
(3.45), and N4 of SimpleITK. Not here: the term P of (3.38), which keeps level sets near distance
functions; the scheme of Appendix A does without.

References
----------
Li, Huang, Ding, Gatenby, Metaxas, Gore, IEEE Trans. Image Process. 20 (2011),
doi:10.1109/TIP.2011.2146190; Tustison et al., IEEE Trans. Med. Imaging 29 (2010),
doi:10.1109/TMI.2010.2046908
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from myork.errors import InputError, InstallationError
from myork.records import Image
from myork.segmentation.level_sets import Evolve
from myork.segmentation.starts import kmeans, level_sets_of, regions_of
from myork.types import F64, Mask

__all__ = ["BiasField", "check_positive", "clustered_bias", "n4_bias", "of_mean_one"]


# Width of the step function (3.16). With the wide one of a segmentation every mean holds a part of
# the other regions, and the field takes up the difference.
_EPSILON = 0.02
_DT = 5000.0  # largest time step of the level sets
_STEPS = 5  # of the level sets between two improvements of the field
_EDGE = 0.05  # relative change from pixel to pixel that makes an edge; noise of 1/25 makes 0.01
_NEGATIVE = 0.01  # part of the body's voxels that ringing of a resampled image makes negative
_SEAM = (3.0, 3.0, 0.0)  # width of the smoothing beyond the mask [pixel]
_DARK = 0.3  # of the median value: what is darker is mostly noise


@dataclass(frozen=True)
class BiasField:
    """Estimate of a bias field.

    Attributes
    ----------
    field : NDArray
        Factor on the true values, mean one inside the mask and going on beyond it without a step,
        shape `(ni, nj, nk)` [-].
    energy : NDArray
        Energy (3.38) of each round of the second estimate, before the field is improved, shape
        `(rounds,)`; empty for N4 [-].
    converged : bool
        Whether the field came to rest.
    """

    field: F64
    energy: F64
    converged: bool


def check_positive(image: Image, mask: Mask) -> None:
    """Refuse an image of which a good part is negative: a factor explains no change of sign.

    Parameters
    ----------
    image : Image
        MR image, shape `(ni, nj, nk)`.
    mask : NDArray
        Voxels of the body, same shape.
    """
    share = float((image.data[mask] < 0).mean())
    if share > _NEGATIVE:
        raise InputError(
            f"{image.name}: {share:.0%} of the values in the body are negative, which no bias "
            "field makes; give the magnitude image, or set bias.method = 'none'"
        )


def clustered_bias(
    values: F64,
    mask: Mask,
    evolve: Evolve,
    *,
    spacing: ArrayLike,
    regions: int,
    sigma: float = 12.0,
    mu: float = 0.01,
    shrink: int = 1,
    rounds: int = 100,
    tolerance: float = 1e-4,
) -> BiasField:
    """Bias field by local clustering, (3.30) to (3.45), for any number of regions.

    Multiplied out, (3.43) is (K*1) I^2 - 2 c I (b*K) + c^2 (b^2*K): the misfit of a region is
    w (J - c)^2 with w = b^2*K and J = I (b*K)/w, and a part that is the same for all regions. So
    the level sets evolve on the image J with voxel weights w, and their means are (3.40). Field
    and level sets are improved in turn; neither raises the energy (3.38).

    Parameters
    ----------
    values : NDArray
        Image, shape `(ni, nj, nk)`; its slices are one volume [-].
    mask : NDArray
        Voxels that take part, same shape.
    evolve : callable
        Evolution of the level sets, as `myork.core.level_sets.evolve_level_sets`.
    spacing : ArrayLike
        Voxel sizes, shape `(3,)` [mm].
    regions : int
        Number of regions.
    sigma : float
        Standard deviation of the Gaussian neighbourhood (3.36) [mm].
    mu : float
        Weight of the contours' length; grey values are scaled to about one [-].
    shrink : int
        Pixels along both in-plane axes that are averaged before the field is estimated.
    rounds : int
        Largest number of improvements of the field.
    tolerance : float
        At rest, a round changes the field by this at most (root mean square) [-].
    """
    if not mask.any():
        raise InputError("bias: no voxel to estimate the field from; check the mask")
    small = _mean_of_blocks(np.where(mask, values, 0.0), shrink)
    share = _mean_of_blocks(mask.astype(float), shrink)
    inside = share > 0.5
    if min(inside.shape[:2]) < 2 or not inside.any():
        raise InputError(
            f"bias: blocks of {shrink} x {shrink} pixels leave no image of the body; lower "
            "bias.shrink, or set bias.method = 'none'"
        )
    size = np.asarray(spacing) * (shrink, shrink, 1)
    image = np.where(inside, small / np.where(inside, share, 1.0), 0.0)
    bright = np.percentile(image[inside], 99.0)
    if not bright > 0:
        raise InputError("bias: the body has no signal, its 99th percentile is not above zero")
    image /= bright
    trust = _trust(image, inside)
    counts = trust > 0
    if not counts.any():
        raise InputError("bias: every voxel lies at an edge; the image is all noise")
    # Clusters of a shaded image mix bright muscle with dark fat; those of the image without a first
    # estimate of its field do so less.
    field = inside.astype(float)
    for _ in range(2):
        field, energy, converged = _improved(
            image, inside, trust, field, evolve, size, regions, sigma, mu, rounds, tolerance
        )
    full = _spread_out(field, inside, values.shape, shrink)
    return BiasField(of_mean_one(full, mask), np.array(energy), converged)


def _improved(
    image: F64,
    inside: Mask,
    trust: F64,
    field: F64,
    evolve: Evolve,
    size: F64,
    regions: int,
    sigma: float,
    mu: float,
    rounds: int,
    tolerance: float,
) -> tuple[F64, list[float], bool]:
    """Field from a first one, energy of every round, and whether it rests."""
    counts = trust > 0
    # Wider than ten images it is flat over the image, and longer to compute.
    widths = [
        min(sigma / h, 10.0 * n) if n > 1 else 0.0 for h, n in zip(size, image.shape, strict=True)
    ]

    def blurred(a: F64) -> F64:
        # The same discrete kernel stands in every convolution, so cutting it off costs nothing.
        return ndimage.gaussian_filter(a, widths, mode="constant", truncate=3.0)

    clusters = np.zeros(inside.shape, np.int32)
    clusters[inside] = kmeans((image / np.maximum(field, 1e-6))[inside][:, None], regions)[0]
    phi = level_sets_of(clusters, regions, True)
    whole = blurred(inside.astype(float))
    pixel = size / size.min()
    cell = float(np.prod(pixel if image.shape[2] > 1 else pixel[:2]))
    energy: list[float] = []
    converged = False
    while len(energy) < rounds and not converged:
        near, square = blurred(field), blurred(field**2)
        flat = np.divide(image * near, square, out=np.zeros_like(image), where=counts)
        found = evolve(
            flat[..., None],
            trust * square,
            phi,
            spacing=tuple(pixel.tolist()),
            mu=mu,
            nu=0.0,
            epsilon=_EPSILON,
            dt=_DT,
            tolerance=0.0,
            iterations=_STEPS,
            lambdas=np.ones(regions),
            channel_weights=[1.0],
            volume=True,
        )
        phi = found["phi"]
        common = trust * image * (image * whole - near * flat)
        energy.append(float(found["energy"][-1, 0]) + cell * float(common.sum()))
        true, true_squared = _piecewise(phi, found["means"][0, :, 0])
        before = field
        below = blurred(trust * true_squared)
        field = np.divide(
            blurred(trust * image * true), below, out=np.zeros_like(image), where=inside
        )
        mean = field[inside].mean()
        if not (mean > 0 and np.isfinite(field).all()):
            raise InputError(
                f"bias: too few of the {int(inside.sum())} voxels lie away from edges to tell a "
                "field; lower bias.shrink, or set bias.method = 'none'"
            )
        field /= mean
        converged = float(np.sqrt(np.mean((field - before)[inside] ** 2))) <= tolerance
    return field, energy, converged


def n4_bias(values: F64, mask: Mask, *, spacing: ArrayLike, shrink: int = 1) -> BiasField:
    """Bias field by N4 of SimpleITK.

    Its default threshold of convergence stops in the first iterations on strong fields, and its
    default width of the sharpening hardly sharpens; both are set here.

    Parameters
    ----------
    values : NDArray
        Image, shape `(ni, nj, nk)` [-].
    mask : NDArray
        Voxels that take part, same shape.
    spacing : ArrayLike
        Voxel sizes, shape `(3,)` [mm].
    shrink : int
        Pixels along both in-plane axes that are averaged before the field is estimated.
    """
    try:
        sitk = import_module("SimpleITK")
    except ImportError:
        raise InstallationError(
            "bias.method = 'n4' needs SimpleITK, which is not installed: "
            "pip install 'myork[seg]', or take bias.method = 'level-sets'"
        ) from None
    if not mask.any():
        raise InputError("bias: no voxel to estimate the field from; check the mask")
    # N4 works on logarithms; splines across a single slice would have no support.
    axes = 2 if values.shape[2] == 1 else 3
    cut = (slice(None),) * 2 + ((0,) if axes == 2 else ())
    positive = np.where(mask, np.maximum(values, 1e-6 * values[mask].max()), 1.0)
    image = sitk.GetImageFromArray(positive[cut].T.astype(np.float32))
    inside = sitk.GetImageFromArray(mask[cut].T.astype(np.uint8))
    for picture in (image, inside):
        picture.SetSpacing([float(h) for h in np.asarray(spacing)[:axes]])
    small = [
        sitk.Shrink(picture, [shrink, shrink, 1][:axes]) if shrink > 1 else picture
        for picture in (image, inside)
    ]
    filter_ = sitk.N4BiasFieldCorrectionImageFilter()
    filter_.SetConvergenceThreshold(1e-6)
    filter_.SetBiasFieldFullWidthAtHalfMaximum(0.3)
    filter_.SetMaximumNumberOfIterations([100] * 4)
    try:
        filter_.Execute(*small)
    except RuntimeError as reason:
        raise InputError(
            f"bias: N4 finds no field ({str(reason).strip().splitlines()[-1].strip()}); lower "
            "bias.shrink, or set bias.method = 'none'"
        ) from None
    field = np.exp(sitk.GetArrayFromImage(filter_.GetLogBiasFieldAsImage(image))).T
    field = field.reshape(values.shape)
    return BiasField(of_mean_one(field.astype(float), mask), np.array([]), True)


def of_mean_one(field: F64, mask: Mask) -> F64:
    """Field with the mean one inside a mask, going on beyond; refused where it is no factor.

    Parameters
    ----------
    field : NDArray
        Factor on the true values; looked at inside the mask only, shape `(ni, nj, nk)` [-].
    mask : NDArray
        Voxels of the body, same shape.
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


def _mean_of_blocks(values: F64, shrink: int) -> F64:
    """Means of in-plane blocks; zeros fill up the last ones."""
    if shrink == 1:
        return values
    ni, nj, nk = values.shape
    padded = np.pad(values, ((0, -ni % shrink), (0, -nj % shrink), (0, 0)))
    blocks = padded.reshape(-(-ni // shrink), shrink, -(-nj // shrink), shrink, nk)
    return blocks.mean(axis=(1, 3))


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


def _spread_out(field: F64, inside: Mask, shape: tuple[int, ...], shrink: int) -> F64:
    """Field on all voxels: that of the nearest block inside, smoothly between blocks."""
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    full = field[tuple(nearest)]
    if shrink == 1:
        return full
    # Centres of voxels in units of blocks
    i, j = ((np.arange(n) + 0.5) / shrink - 0.5 for n in shape[:2])
    places = np.stack(np.meshgrid(i, j, indexing="ij"))
    return np.stack(
        [
            ndimage.map_coordinates(full[:, :, k], places, order=1, mode="nearest")
            for k in range(shape[2])
        ],
        axis=-1,
    )

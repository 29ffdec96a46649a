"""Deforming a label map onto an image by registration of images: B-splines of SimpleITK.

An affine map, then B-splines whose mesh is halved twice, increase the mutual information of the
two images (Mattes), which may differ in sequence and shading. Every muscle follows the image
around it, whereas a similarity moves a limb as a whole.

References: Rueckert et al., IEEE Trans. Med. Imaging 18 (1999), doi:10.1109/42.796284; Mattes et
al., IEEE Trans. Med. Imaging 22 (2003), doi:10.1109/TMI.2003.809072
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.errors import InputError, optional
from myork.records import Image, Labels
from myork.types import F64, Mask

# Mesh size of the last B-splines, a quarter of the first [mm]
_MESH = 30.0
# Gaussian blur of both images for the affine map, and for B-splines from coarse to fine [mm]
_FIRST_BLUR = 8.0
_BLUR = (4.0, 2.0, 1.0)
# Margin around the body, whose edge matters most [mm]
_RIM = 5.0
# Approximate number of voxels compared in each evaluation
_SAMPLES = 20_000
_BINS = 32
# Least number of slices of a stack; fewer do not show motion along it
_FEWEST = 4


def bend_labels(labels: Labels, drawn_in: Image, image: Image, body: Mask) -> Labels:
    """Deform labels onto an image.

    - `labels`: on the grid of the image in which they were drawn
    - `drawn_in`: that image, of an earlier visit, on any grid near the image
    - `image`: image onto which they are deformed
    - `body`: its body mask, shape `(ni, nj, nk)`
    - returns labels on the grid of the image
    """
    itk = optional("SimpleITK", "seg", "image.reference_anatomy")
    flat = image.data.shape[2] == 1
    for one in () if flat else (image, drawn_in):
        if one.data.shape[2] < _FEWEST:
            raise InputError(
                f"{one.name}: stacks of {one.data.shape[2]} slices cannot be bent by "
                f"image.reference_anatomy; it takes {_FEWEST} slices or more, or single ones"
            )
    place = np.diag([*image.spacing, 1.0]) @ np.linalg.inv(image.affine)
    if flat:
        _check_flat(drawn_in, place)
    axes = 2 if flat else 3
    around = _around(body, image.spacing, axes)
    fixed = _picture(itk, image.data, place @ image.affine, axes, np.float32)[around]
    inside = ndimage.binary_dilation(body, _ball(image.spacing))
    mask = _picture(itk, inside, place @ image.affine, axes, np.uint8)[around]
    moving = _picture(itk, drawn_in.data, place @ drawn_in.affine, axes, np.float32)
    threads = itk.ProcessObject.GetGlobalDefaultNumberOfThreads()
    # sums over several threads differ from run to run
    itk.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    try:
        bend = _found(itk, fixed, moving, mask)
    except RuntimeError as reason:
        raise InputError(
            f"{drawn_in.name}: it cannot be bent onto {image.name} "
            f"({str(reason).strip().splitlines()[-1].strip()}); do both show the same part of the "
            "body at about the same place?"
        ) from None
    finally:
        itk.ProcessObject.SetGlobalDefaultNumberOfThreads(threads)
    grid = _picture(itk, body, place @ image.affine, axes, np.uint8)
    numbers = _picture(itk, labels.data, place @ labels.affine, axes, np.int32)
    found = itk.GetArrayFromImage(itk.Resample(numbers, grid, bend, itk.sitkNearestNeighbor, 0)).T
    if not found.any():
        raise InputError(
            f"{labels.name}: none of its labels lies in {image.name} after the registration; do "
            "both images show the same part of the body at about the same place?"
        )
    data = np.ascontiguousarray(found.reshape(image.data.shape))
    return Labels(data, image.affine, labels.names, labels.name)


def _found(itk: Any, fixed: Any, moving: Any, mask: Any) -> Any:
    """Map from positions in the image to those in the other one."""
    axes = fixed.GetDimension()
    whole = itk.AffineTransform(axes)
    middle = [0.5 * (count - 1) for count in fixed.GetSize()]
    whole.SetCenter(fixed.TransformContinuousIndexToPhysicalPoint(middle))
    way = _method(itk, fixed, mask)
    way.SetInitialTransform(whole, inPlace=True)
    way.SetOptimizerScalesFromPhysicalShift()
    way.SetOptimizerAsRegularStepGradientDescent(2.0, 0.01, 100)
    way.SetShrinkFactorsPerLevel([1])
    way.SetSmoothingSigmasPerLevel([_FIRST_BLUR])
    way.Execute(fixed, moving)
    way = _method(itk, fixed, mask)
    extent = np.multiply(fixed.GetSize(), fixed.GetSpacing())
    coarse = np.maximum(np.round(extent / (4.0 * _MESH)), 1).astype(int)
    bend = itk.BSplineTransformInitializer(fixed, coarse.tolist(), 3)
    way.SetMovingInitialTransform(whole)
    way.SetInitialTransformAsBSpline(bend, inPlace=True, scaleFactors=[1, 2, 4])
    way.SetOptimizerAsLBFGS2(
        numberOfIterations=30,
        solutionAccuracy=1e-4,
        deltaConvergenceTolerance=1e-4,
        lineSearchMaximumEvaluations=5,
    )
    way.SetShrinkFactorsPerLevel([1] * 3)
    way.SetSmoothingSigmasPerLevel(_BLUR)
    way.Execute(fixed, moving)
    return itk.CompositeTransform([whole, bend])


def _method(itk: Any, fixed: Any, mask: Any) -> Any:
    """Settings common to both steps: how images are compared."""
    way = itk.ImageRegistrationMethod()
    way.SetMetricAsMattesMutualInformation(_BINS)
    way.SetMetricFixedMask(mask)
    share = _SAMPLES / max(int(itk.GetArrayViewFromImage(mask).sum()), 1)
    if share < 1.0:
        way.SetMetricSamplingStrategy(way.REGULAR)
        way.SetMetricSamplingPercentage(share, seed=1)  # positions are perturbed a little at random
    way.SetInterpolator(itk.sitkLinear)
    return way


def _picture(itk: Any, data: NDArray, affine: F64, axes: int, kind: type) -> Any:
    """Values as an image of SimpleITK; a single slice has two axes."""
    cut = (slice(None),) * 2 + ((0,) if axes == 2 else ())
    picture = itk.GetImageFromArray(np.ascontiguousarray(data[cut].T.astype(kind)))
    columns = affine[:axes, :axes]
    spacing = np.linalg.norm(columns, axis=0)
    picture.SetSpacing(spacing.tolist())
    picture.SetOrigin(affine[:axes, 3].tolist())
    picture.SetDirection((columns / spacing).ravel().tolist())
    return picture


def _around(body: Mask, spacing: F64, axes: int) -> tuple[slice, ...]:
    """The part of the image that contains the body and its margin, in all slices."""
    room = np.append(np.ceil(2.0 * _RIM / spacing[:2]).astype(int), body.shape[2])
    parts = zip(ndimage.find_objects(body.astype(np.int8))[0], room, body.shape, strict=True)
    return tuple(
        slice(max(part.start - more, 0), min(part.stop + more, count))
        for part, more, count in parts
    )[:axes]


def _ball(spacing: F64) -> Mask:
    """Voxels within the margin around a voxel."""
    reach = np.floor(_RIM / spacing).astype(int)
    places = np.indices((2 * reach + 1).tolist()).T - reach
    return (((places * spacing) ** 2).sum(axis=-1) <= _RIM**2).T


def _check_flat(drawn_in: Image, place: F64) -> None:
    """Refuse an image that is not a slice parallel to the other image's."""
    across = (place @ drawn_in.affine)[:3, :3]
    askew = np.abs(across[2, :2]).max() > 1e-2 * np.abs(across[:2, :2]).max()
    if drawn_in.data.shape[2] != 1 or askew:
        raise InputError(
            f"{drawn_in.name}: the image is a single slice, so that image.reference_anatomy must "
            f"be one parallel to it; this one has shape {drawn_in.data.shape}"
        )

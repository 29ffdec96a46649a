"""Diffusion gradients: files of b values and directions, and the frames they are given in.

In the convention of FSL's files, directions are components along the voxel axes of the image, and
the first component changes sign where the affine has a positive determinant. Inside this package
directions are in the world frame.
"""

from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from myork.errors import InputError
from myork.files import read_text
from myork.imaging.geometry import frame
from myork.types import F64, Mask

# Below this value an image counts as having no gradient, and its direction may be zero [s/mm^2]
STILL = 50.0

# Largest weighting of any scanner; b values in s/m^2 lie far above [s/mm^2].
_LARGEST_B = 1e6


@dataclass(frozen=True)
class GradientTable:
    """Diffusion weighting of each image of a series."""

    b: F64  #: Weighting, shape `(n,)` [s/mm^2]
    direction: F64  #: Unit vectors in the world frame, zero without gradient, shape `(n, 3)` [-]

    def __post_init__(self) -> None:
        b = self.b
        if self.direction.shape != (len(b), 3):
            raise InputError(
                f"{len(b)} b values need directions of shape ({len(b)}, 3), not "
                f"{self.direction.shape}"
            )
        if not (b >= 0).all():
            raise InputError(
                f"b values must not be negative or not finite, the lowest is {b.min():g}"
            )
        if (b > _LARGEST_B).any():
            raise InputError(
                f"the b value {b.max():g} is implausible; its unit is s/mm^2, values are from 0 to "
                "some 5000"
            )
        if self.still.all():
            raise InputError(
                f"no b value is above {STILL:g} s/mm^2, the highest is {b.max(initial=0.0):g}: "
                "diffusion-weighted images are needed; 1 ms/um^2 is 1000 s/mm^2"
            )
        with np.errstate(over="ignore"):
            length = np.linalg.norm(self.direction, axis=1)
        lost = np.flatnonzero(~self.still & ~(np.abs(length - 1.0) <= 0.05))
        if len(lost):
            raise InputError(
                f"direction {lost[0] + 1} has length {length[lost[0]]:.3g} with b = "
                f"{b[lost[0]]:g}; directions must be unit vectors (for scaled ones, scale b "
                "instead)"
            )

    @property
    def still(self) -> Mask:
        """Mask of the images without gradient, shape `(n,)`."""
        return self.b <= STILL

    def design(self) -> F64:
        """Factors of xx, yy, zz, xy, xz, yz in the exponent b g.D g, shape `(n, 6)` [s/mm^2]."""
        x, y, z = self.direction.T
        terms = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=1)
        return self.b[:, np.newaxis] * terms


def read_gradients(bval: Path, bvec: Path, affine: F64, volumes: int) -> GradientTable:
    """Read b values and directions in FSL's convention.

    - `bval`, `bvec`: text files: a row of values; three rows of components (or a row per image)
    - `affine`: affine of the diffusion images, shape `(4, 4)` [mm]
    - `volumes`: number of diffusion images
    """
    b = _numbers(bval).ravel()
    vector = _numbers(bvec)
    if vector.ndim != 2 or 3 not in vector.shape:
        raise InputError(f"{bvec}: three rows of components are needed, not {vector.shape}")
    if vector.shape[0] == 3:
        vector = vector.T
    if not len(b) == len(vector) == volumes:
        raise InputError(
            f"{bval} has {len(b)} values and {bvec} {len(vector)} directions, but there are "
            f"{volumes} diffusion images; use the files that were written with the images"
        )
    try:
        table = GradientTable(b, vector)
    except InputError as reason:
        raise InputError(f"{bval} and {bvec.name}: {reason}") from None
    length = np.linalg.norm(vector, axis=1)
    vector = vector / np.maximum(length, 1e-9)[:, np.newaxis] * ~table.still[:, np.newaxis]
    return GradientTable(b, vector @ fsl_axes(affine).T)


def fsl_axes(affine: F64) -> F64:
    """World directions of the axes of FSL's directions, as columns, shape `(3, 3)` [-]."""
    axes = frame(affine)
    if np.linalg.det(affine[:3, :3]) > 0:
        axes = axes * [-1.0, 1.0, 1.0]
    return axes


def _numbers(path: Path) -> F64:
    """Numbers of a text file as rows."""
    text = read_text(path)
    if not any(line.split("#")[0].strip() for line in text.splitlines()):
        raise InputError(f"{path}: is empty; rows of numbers are needed")
    try:
        found = np.loadtxt(StringIO(text), dtype=float, ndmin=2)
    except ValueError as reason:
        raise InputError(f"{path}: rows of numbers are needed: {reason}") from None
    if not np.isfinite(found).all():
        raise InputError(
            f"{path}: a number is not finite; images without gradient have b = 0 and the direction "
            "0 0 0"
        )
    return found

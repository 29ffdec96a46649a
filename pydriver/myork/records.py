"""Plain records passed from station to station: image, labels, points.

Each is frozen, contains arrays only, and can be written to a file and read back.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from myork.errors import InputError
from myork.types import F64, I32


def check_regular(affine: F64, name: str) -> None:
    """Refuse an affine that does not give each voxel its place."""
    known = affine.shape == (4, 4) and np.isfinite(affine).all()
    if not known or np.linalg.matrix_rank(affine[:3, :3]) < 3:
        size = np.linalg.norm(affine[:3, :3], axis=0)
        raise InputError(
            f"{name}: the affine is singular, not finite or not 4 x 4 (voxel size {size}); set "
            "sform or qform of the file from the scanner's geometry"
        )


class _Grid:
    """Voxels with an affine."""

    data: NDArray[Any]
    affine: F64
    name: str
    _dimensions: tuple[int, ...] = (3,)

    def __post_init__(self) -> None:
        if self.data.ndim not in self._dimensions:
            raise InputError(
                f"{self.name}: an array of {' or '.join(map(str, self._dimensions))} dimensions is "
                f"needed, its shape is {self.data.shape}"
            )
        check_regular(self.affine, self.name)

    @property
    def spacing(self) -> F64:
        """Voxel size, shape `(3,)` [mm]."""
        return np.linalg.norm(self.affine[:3, :3], axis=0)

    def world(self, voxels: ArrayLike) -> F64:
        """World coordinates of voxel indices, both of shape `(..., 3)` [mm]."""
        return np.asarray(voxels) @ self.affine[:3, :3].T + self.affine[:3, 3]


@dataclass(frozen=True)
class Image(_Grid):
    """Values on a regular grid of voxels."""

    _dimensions = (3, 4)
    data: F64  #: Values, shape `(ni, nj, nk)`, or `(ni, nj, nk, nvalue)` for tensors and vectors
    #: Voxel indices to world coordinates (right, anterior, superior), shape `(4, 4)` [mm]
    affine: F64
    name: str = "image"  #: Its origin, for messages


@dataclass(frozen=True)
class Labels(_Grid):
    """A whole number for each voxel; zero is background."""

    data: I32  #: Labels, shape `(ni, nj, nk)`
    affine: F64  #: Voxel indices to world coordinates, shape `(4, 4)` [mm]
    #: Name of each label above zero that has one
    names: dict[int, str] = field(default_factory=dict)
    name: str = "labels"  #: Its origin, for messages

    @property
    def present(self) -> dict[int, str]:
        """Labels above zero that occur in the map, ascending, and their names."""
        found = np.unique(self.data[self.data > 0]).tolist()
        return {label: self.label_name(label) for label in found}

    def label_name(self, label: int) -> str:
        """Name of a label; a default for a label without a name."""
        return self.names.get(label, f"label {label}")


@dataclass(frozen=True)
class Voxels:
    """Regular grid of the voxels from which a model was made."""

    index: I32  #: Grid indices of each collocation point's voxel, shape `(npoint, 3)`
    size: F64  #: Edges of a voxel, shape `(3,)` [length]
    origin: F64  #: Centre of the voxel with indices 0, 0, 0, shape `(3,)` [length]


@dataclass(frozen=True)
class PointCloud:
    """Points of a model; names are the same in `model.h5` and the core."""

    source: F64  #: Source points, shape `(nsource, 3)` [length]
    #: Distance of neighbouring source points per direction, the unit of their supports, shape
    #: `(3,)`, or `(nsource, 3)` where it varies [length]
    spacing: F64
    #: Collocation points, those from voxels in their lexicographic order, shape `(npoint, 3)`
    #: [length]
    points: F64
    label: I32  #: Label of each collocation point, shape `(npoint,)`
    #: Unit fiber vectors, zero rows where the label has no fibers, shape `(npoint, 3)` [-]
    fiber: F64
    volume: F64  #: Volume of each collocation point, shape `(npoint,)` [length^3]
    #: Collocation point of each boundary point (a point is listed once in every set it belongs to),
    #: shape `(nboundary,)`
    boundary_point: I32
    boundary_set: I32  #: Index into `set_names`, shape `(nboundary,)`
    normal: F64  #: Outward unit normals, shape `(nboundary, 3)` [-]
    area: F64  #: Area of each boundary point, shape `(nboundary,)` [length^2]
    set_names: tuple[str, ...]  #: Names of the boundary sets
    label_names: dict[int, str]  #: Name of each label
    length_unit: str  #: Unit of all lengths
    source_images: str  #: Source images of the points: one line each, file name and SHA-256
    #: Voxels of the collocation points; None for bodies that are not made of voxels.
    #: Points of surface voxels lie on the surface, not in the centres of these.
    voxels: Voxels | None = None
    #: Fraction of each point's volume filled by each label of `label_names`, in ascending order of
    #: the labels, shape `(npoint, nlabel)` [-]; None where each point has one label
    fraction: F64 | None = None
    #: Fraction of its muscle's activation at each point, from 0 to 1, shape `(npoint,)` [-]; None
    #: where it is 1 everywhere
    activation: F64 | None = None

    def label_volumes(self) -> dict[int, float]:
        """Volume of each label [length^3]."""
        labels = sorted(self.label_names)
        if self.fraction is None:
            return {label: float(self.volume[self.label == label].sum()) for label in labels}
        return dict(zip(labels, (self.volume @ self.fraction).tolist(), strict=True))

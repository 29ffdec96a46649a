"""Models from a closed surface and fiber lines instead of images.

Coordinates are world coordinates (right, anterior, superior).
"""

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from myork.errors import FileError, InputError, optional
from myork.imaging.diffusion import lead_vector, tensor_components
from myork.records import Image, Labels
from myork.types import F64

# Segments of tracts that determine the direction of a voxel: about ten tracts at usual density
_NEAREST = 24


def voxelise(path: Path, to_mm: float, spacing: Sequence[float], name: str) -> Labels:
    """Voxels whose centres lie inside a closed surface.

    - `path`: surface (STL, PLY, OBJ, VTK) or structured grid (VTS), whose skin is taken
    - `to_mm`: millimetres in the unit of the file
    - `spacing`: voxel size along x, y and z [mm]
    """
    skin = _read_mesh(path)[1]
    if not skin.n_cells:
        raise InputError(f"{path}: contains no surface")
    if skin.n_open_edges:
        raise InputError(
            f"{path}: the surface is not closed ({skin.n_open_edges} open edges); close its holes "
            "first"
        )
    size = np.asarray(spacing, float)
    corners = skin.points.astype(float) * to_mm
    low, high = corners.min(axis=0), corners.max(axis=0)
    wanted = np.ceil((high - low) / size) + 2
    if np.prod(wanted) > 5e7:
        raise InputError(
            f"{path}: {' x '.join(f'{n:.0f}' for n in wanted)} voxels; the surface is "
            f"{np.round(high - low)} mm large: check build.surface_unit, or raise build.voxel"
        )
    count = wanted.astype(int)
    origin = 0.5 * (low + high) - 0.5 * (count - 1) * size
    place = np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), -1)
    points = (place.reshape(-1, 3) * size + origin) / to_mm
    modeling = importlib.import_module("vtkmodules.vtkFiltersModeling")
    pyvista = importlib.import_module("pyvista")
    inside = modeling.vtkSelectEnclosedPoints()
    inside.SetInputData(pyvista.PolyData(points))
    inside.SetSurfaceData(skin)
    inside.Update()
    data = np.asarray(pyvista.wrap(inside.GetOutput())["SelectedPoints"]).astype(np.int32)
    if not data.any():
        raise InputError(f"{path}: no voxel of {tuple(spacing)} mm lies inside; lower build.voxel")
    affine = np.diag([*size, 1.0])
    affine[:3, 3] = origin
    return Labels(data.reshape(count), affine, {1: name}, str(path))


def _read_mesh(path: Path) -> tuple[Any, Any]:
    """A mesh of any format that VTK reads, and its surface of triangles."""
    pyvista = optional("pyvista", "viz", f"{path}: a surface")
    if not path.is_file():
        raise FileError(f"{path}: there is no such file")
    try:
        with pyvista.VtkErrorCatcher(raise_errors=True):  # else VTK continues with partial data
            mesh = pyvista.read(path)
        if not np.isfinite(mesh.points).all():
            raise ValueError("a point is not finite")
        skin = mesh.extract_surface(algorithm="dataset_surface").triangulate().clean()
    except Exception as reason:  # VTK's readers raise any exception
        said = " ".join(str(reason).split()) or type(reason).__name__
        raise FileError(
            f"{path}: cannot be read: {said}; the file is damaged or not a mesh: write it again"
        ) from None
    return mesh, skin


def read_tracts(path: Path, to_mm: float) -> list[F64]:
    """Lines along fibers.

    - `path`: NumPy archive with `points` (n, 3) and `offsets` (where each line starts, or also
      where the last ends), or a structured grid (VTS) whose third index runs along the fibers
    - `to_mm`: millimetres in the unit of the file
    - returns points of each line, shape `(m, 3)`, at least two [mm]
    """
    if path.suffix == ".npz":
        lines = _archived_lines(path)
    else:
        mesh = _read_mesh(path)[0]
        if not hasattr(mesh, "dimensions"):
            raise InputError(f"{path}: fibers must be a structured grid or an archive .npz")
        ni, nj, nk = mesh.dimensions
        lines = list(mesh.points.astype(float).reshape(nk, nj * ni, 3).swapaxes(0, 1))
    lines = [line * to_mm for line in lines if len(line) > 1]
    if not lines or not all(np.isfinite(line).all() for line in lines):
        raise InputError(f"{path}: contains no lines, or a point that is not finite")
    if not any(np.ptp(line, axis=0).any() for line in lines):
        raise InputError(f"{path}: all points of each line coincide; write the lines again")
    return lines


def _archived_lines(path: Path) -> list[F64]:
    """Lines of a NumPy archive, of any number of points."""
    if not path.is_file():
        raise FileError(f"{path}: there is no such file")
    try:
        with np.load(path) as archive:
            points, offsets = (
                archive[key].astype(float, casting="same_kind") for key in ("points", "offsets")
            )
    except Exception as reason:  # zip, zlib and NumPy each raise their own errors
        raise InputError(
            f"{path}: needs the arrays points and offsets of numbers: "
            f"{' '.join(str(reason).split())}; write it again"
        ) from None
    sized = points.ndim == 2 and points.shape[1] == 3 and offsets.ndim == 1
    rising = np.concatenate([[0.0], offsets.ravel(), points.shape[:1]])
    if not (sized and len(offsets) and (np.diff(rising) >= 0).all() and (rising % 1 == 0).all()):
        raise InputError(
            f"{path}: points must be (n, 3) and offsets integers that rise from 0 to n, not "
            f"{points.shape} and {offsets.shape}"
        )
    starts = offsets.astype(np.int64)
    return np.split(points, starts[(starts > 0) & (starts < len(points))])


def tract_fibers(tracts: Sequence[F64], labels: Labels, name: str = "tracts") -> Image:
    """Fiber vectors of all voxels of a label map from the nearest line segments.

    Directions are averaged as dyads: a line has no sign. Weights decrease with the distance, so
    that a voxel between lines takes the mean direction of those around it.

    - `tracts`: points of each line, shape `(m, 3)` [mm]
    - `labels`: the body
    """
    start = np.vstack([line[:-1] for line in tracts])
    step = np.vstack([np.diff(line, axis=0) for line in tracts])
    length = np.linalg.norm(step, axis=1)
    usable = length > 0
    direction = step[usable] / length[usable][:, np.newaxis]
    tree = cKDTree((start + 0.5 * step)[usable])
    low, high = start.min(axis=0), start.max(axis=0)
    voxels = np.argwhere(labels.data > 0)
    place = labels.world(voxels)
    least, most = place.min(axis=0), place.max(axis=0)
    if (low > most).any() or (high < least).any():
        ends = [np.round(corner, 1) for corner in (low, high, least, most)]
        raise InputError(
            f"{name}: the lines lie outside of the body of {labels.name}: they run from {ends[0]} "
            f"to {ends[1]} mm, the body from {ends[2]} to {ends[3]} mm; both files must have one "
            "unit and one origin"
        )
    number = min(_NEAREST, len(direction))
    away, near = (a.reshape(len(place), number) for a in tree.query(place, k=number))
    # At least a voxel wide: a line through the voxel must not decide alone.
    width = np.maximum(0.5 * away[:, -1:], float(np.linalg.norm(labels.spacing)))
    weight = np.exp(-0.5 * (away / width) ** 2)
    vector = direction[near]
    dyad = (weight[..., np.newaxis, np.newaxis] * vector[..., :, np.newaxis] *
            vector[..., np.newaxis, :]).sum(axis=1)  # fmt: skip
    fibers = np.zeros((*labels.data.shape, 3))
    fibers[tuple(voxels.T)] = lead_vector(tensor_components(dyad))
    return Image(fibers, labels.affine, "fibers of tracts")

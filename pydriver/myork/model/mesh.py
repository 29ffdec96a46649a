"""Models from a closed surface and the lines of its fibers instead of images.

Coordinates are taken as world coordinates (right, anterior, superior).
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from myork.errors import FileError, InputError, InstallationError
from myork.imaging.diffusion import tensor_components
from myork.model.fibers import lead_vector
from myork.records import Image, Labels

__all__ = ["read_tracts", "tract_fibers", "voxelise"]

F64 = NDArray[np.float64]

# Segments of tracts that make the direction of a voxel: about ten tracts at their usual density
_NEAREST = 24


def voxelise(path: Path, to_mm: float, spacing: Sequence[float], name: str) -> Labels:
    """Voxels whose centres lie inside a closed surface.

    Parameters
    ----------
    path : Path
        Surface (STL, PLY, OBJ, VTK) or structured grid (VTS), whose skin is taken.
    to_mm : float
        Millimetres in the unit of the file.
    spacing : sequence
        Voxel size along x, y and z [mm].
    name : str
        Name of the label.
    """
    mesh = _mesh(path)
    surface = mesh.extract_surface(algorithm="dataset_surface").triangulate().clean()
    if surface.n_points == 0:
        raise InputError(f"{path}: holds no surface")
    if not np.isfinite(surface.points).all():
        raise InputError(f"{path}: a point of the surface is not finite")
    if surface.n_open_edges:
        raise InputError(
            f"{path}: the surface is not closed ({surface.n_open_edges} open edges); close its "
            "holes first"
        )
    size = np.asarray(spacing, float)
    low, high = np.reshape(surface.bounds, (3, 2)).T * to_mm
    count = np.ceil((high - low) / size).astype(int) + 2
    origin = 0.5 * (low + high) - 0.5 * (count - 1) * size
    if np.prod(count.astype(float)) > 5e7:
        raise InputError(
            f"{path}: {' x '.join(map(str, count))} voxels; the surface is {np.round(high - low)} "
            "mm large: check build.surface_unit, or raise build.voxel"
        )
    place = np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), -1)
    points = (place.reshape(-1, 3) * size + origin) / to_mm
    modeling = importlib.import_module("vtkmodules.vtkFiltersModeling")
    pyvista = importlib.import_module("pyvista")
    inside = modeling.vtkSelectEnclosedPoints()
    inside.SetInputData(pyvista.PolyData(points))
    inside.SetSurfaceData(surface)
    inside.Update()
    data = np.asarray(pyvista.wrap(inside.GetOutput())["SelectedPoints"]).astype(np.int32)
    if not data.any():
        raise InputError(f"{path}: no voxel of {tuple(spacing)} mm lies inside; lower build.voxel")
    affine = np.diag([*size, 1.0])
    affine[:3, 3] = origin
    return Labels(data.reshape(count), affine, {1: name}, str(path))


def read_tracts(path: Path, to_mm: float) -> list[F64]:
    """Lines along fibers.

    Parameters
    ----------
    path : Path
        NumPy archive with `points` (n, 3) and `offsets` (where each line starts, or also where
        the last ends), or a structured grid (VTS) whose third index runs along the fibers.
    to_mm : float
        Millimetres in the unit of the file.

    Returns
    -------
    list
        Points of each line, shape `(m, 3)`, two at least [mm].
    """
    if path.suffix == ".npz":
        if not path.is_file():
            raise FileError(f"{path}: there is no such file")
        try:
            with np.load(path) as archive:
                points, offsets = archive["points"].astype(float), archive["offsets"].astype(int)
        except (OSError, KeyError, ValueError) as reason:
            raise InputError(f"{path}: needs the arrays points and offsets: {reason}") from None
        if points.ndim != 2 or points.shape[1] != 3 or offsets.ndim != 1:
            raise InputError(f"{path}: points must be (n, 3), offsets (m,), not {points.shape}")
        if (np.diff(offsets) < 0).any() or offsets.min() < 0 or offsets.max() > len(points):
            raise InputError(f"{path}: offsets must rise from 0 to the number of points")
        lines = np.split(points, offsets[(offsets > 0) & (offsets < len(points))])
    else:
        grid = _mesh(path)
        if not hasattr(grid, "dimensions"):
            raise InputError(f"{path}: fibers must be a structured grid or an archive .npz")
        ni, nj, nk = grid.dimensions
        lines = list(np.asarray(grid.points, float).reshape(nk, nj * ni, 3).swapaxes(0, 1))
    lines = [line * to_mm for line in lines if len(line) > 1]
    if not lines or not all(np.isfinite(line).all() for line in lines):
        raise InputError(f"{path}: holds no line, or a point that is not finite")
    return lines


def tract_fibers(tracts: Sequence[F64], labels: Labels) -> Image:
    """Fiber vectors of all voxels of a label map from the nearest pieces of lines.

    Directions are averaged as dyads: a line has no sign. Weights fall off with the distance, so
    that a voxel between lines gets the direction of all around it.
    """
    start = np.vstack([line[:-1] for line in tracts])
    step = np.vstack([np.diff(line, axis=0) for line in tracts])
    length = np.linalg.norm(step, axis=1)
    usable = length > 0
    direction = step[usable] / length[usable][:, np.newaxis]
    tree = cKDTree((start + 0.5 * step)[usable])
    voxels = np.argwhere(labels.data > 0)
    place = voxels @ labels.affine[:3, :3].T + labels.affine[:3, 3]
    number = min(_NEAREST, len(direction))
    away, near = (a.reshape(len(place), number) for a in tree.query(place, k=number))
    # Never narrower than a voxel: a line through the voxel must not decide alone.
    width = np.maximum(0.5 * away[:, -1:], float(np.linalg.norm(labels.spacing)))
    weight = np.exp(-0.5 * (away / width) ** 2)
    vector = direction[near]
    dyad = (weight[..., np.newaxis, np.newaxis] * vector[..., :, np.newaxis] *
            vector[..., np.newaxis, :]).sum(axis=1)  # fmt: skip
    fibers = np.zeros((*labels.data.shape, 3))
    fibers[tuple(voxels.T)] = lead_vector(tensor_components(dyad))
    return Image(fibers, labels.affine, "fibers of tracts")


def _mesh(path: Path) -> Any:
    """Mesh of any kind that VTK reads."""
    try:
        pyvista = importlib.import_module("pyvista")
    except ImportError:
        raise InstallationError(
            f"{path}: surfaces need pyvista: pip install 'myork[viz]'"
        ) from None
    if not path.is_file():
        raise FileError(f"{path}: there is no such file")
    try:
        return pyvista.read(path)
    except Exception as reason:  # VTK's readers raise what they like
        raise FileError(f"{path}: cannot be read: {reason}") from None

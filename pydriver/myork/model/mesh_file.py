"""Surfaces and grids from files, read in a process of their own.

VTK's readers end the process that calls them on many damaged files, by a signal or by taking all
memory; here that is one more error with the name of the file.
"""

import importlib
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from myork.errors import FileError, InputError, optional
from myork.types import F64, I64

# What the reader may take beside the file's size [bytes]: most is its libraries' address space.
_MEMORY = 4 << 30
_PER_BYTE = 64
# Time to read [s], and bytes that are read in a second at the least
_SECONDS = 60.0
_PER_SECOND = 1e6


class Mesh(NamedTuple):
    """What a file of VTK holds."""

    points: F64  #: Corners of the skin, shape `(npoint, 3)`
    triangles: I64  #: Three corners of each triangle of the skin, shape `(ntriangle, 3)`
    open_edges: int  #: Edges of one triangle only: a closed surface has none
    #: Points of a structured grid, the first index running fastest, shape `(ni*nj*nk, 3)`; empty
    #: for other meshes
    grid: F64
    dimensions: tuple[int, int, int]  #: Its numbers of points ni, nj and nk, zeros for other meshes


def read_mesh(path: Path) -> Mesh:
    """Read a mesh of any kind that VTK reads: STL, PLY, OBJ, VTK, VTP, VTS."""
    optional("pyvista", "viz", f"{path}: a surface")
    if not path.is_file():
        raise FileError(f"{path}: there is no such file")
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "VTK_SMP_MAX_THREADS"), "1")
    places = {"PYTHONPATH": os.pathsep.join(place for place in sys.path if place)}
    with tempfile.TemporaryDirectory() as folder:
        arrays = Path(folder, "mesh.npz")
        call = "from myork.model.mesh_file import main; main()"
        try:
            subprocess.run(
                [sys.executable, "-c", call, os.path.abspath(path), arrays],
                env={**os.environ, **one, **places},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=_SECONDS + path.stat().st_size / _PER_SECOND,
                check=True,
            )
        except subprocess.SubprocessError as ended:
            said = (getattr(ended, "stderr", None) or b"").decode("utf-8", "replace").strip()
            status = getattr(ended, "returncode", "no answer in time")
            reason = said.split("\n")[-1] if status == 2 else f"the reader ended with {status}"
            raise FileError(
                f"{path}: cannot be read: {reason}; the file is damaged or not a mesh: "
                "write it again"
            ) from None
        with np.load(arrays) as found:
            mesh = Mesh(**found)
    if mesh.triangles.size and not 0 <= mesh.triangles.min() <= mesh.triangles.max() < len(
        mesh.points
    ):
        raise InputError(
            f"{path}: a triangle refers to a point that does not exist; the file is damaged"
        )
    return mesh


def main() -> None:
    """Read the file named first and write its arrays to the file named second."""
    path, arrays = sys.argv[1:3]
    room = _MEMORY + _PER_BYTE * os.path.getsize(path)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    if hard == resource.RLIM_INFINITY or room < hard:
        resource.setrlimit(resource.RLIMIT_AS, (room, hard))
    try:
        pyvista = importlib.import_module("pyvista")
        with pyvista.VtkErrorCatcher(raise_errors=True):  # it goes on with what it could read
            mesh = pyvista.read(path)
        if not np.isfinite(mesh.points).all():
            raise ValueError("a point is not finite")
        skin = mesh.extract_surface(algorithm="dataset_surface").triangulate().clean()
        structured = hasattr(mesh, "dimensions")
        triangles = np.reshape(skin.faces, (-1, 4))[:, 1:].astype(np.int64)
        grid = mesh.points if structured else np.zeros((0, 3))
        dimensions = mesh.dimensions if structured else (0, 0, 0)
        found = Mesh(skin.points, triangles, skin.n_open_edges, grid, dimensions)
        np.savez(arrays, **found._asdict())
    except Exception as reason:  # VTK's readers raise what they like
        print(" ".join(str(reason).split()) or type(reason).__name__, file=sys.stderr)
        sys.exit(2)

"""Pictures of a surface by VTK without a screen, in a process of their own.

Where VTK finds no way to draw it may end the process or write to its streams: neither may cost a
report. ``python -m myork.report.off_screen JOB PICTURES`` is that process.
"""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from myork.report.sketch import NO_VALUE
from myork.types import F64, I32

__all__ = ["NoPictureError", "Panel", "draw"]


#: Seconds after which a picture is given up
_PATIENCE = 180.0
#: Points of the longer side of a picture
_SIDE = 640
#: Facets that meet at a larger angle have an edge there [degree]
_EDGE_ANGLE = 50.0
_WITHOUT_PYVISTA = 7


class NoPictureError(Exception):
    """VTK cannot draw here; the text says why."""


class Panel(NamedTuple):
    """What is drawn of a body in all views.

    Attributes
    ----------
    positions : NDArray
        Places of the points, shape `(n, 3)` [length].
    values : NDArray
        What colours them, shape `(n,)`.
    limits : tuple of float
        Values at the ends of the colours.
    colours : str
        Name of a colour map of matplotlib, or colours between commas.
    strokes : NDArray
        Ends of strokes on the body, shape `(m, 2, 3)` [length]; may be empty.
    """

    positions: F64
    values: F64
    limits: tuple[float, float]
    colours: str
    strokes: F64


def draw(
    panels: list[Panel],
    triangles: I32,
    rest: F64,
    views: list[F64],
    middle: F64,
    half: F64,
) -> list[list[NDArray[np.uint8]]]:
    """Pictures of each panel in each view, by parallel projection about a common centre.

    Parameters
    ----------
    panels : list of Panel
        What is drawn.
    triangles : NDArray
        Surface of the body, shape `(m, 3)`.
    rest : F64
        Undeformed points, whose edges are drawn grey, shape `(n, 3)` [length].
    views : list of F64
        Directions to the right and upwards in the picture and towards the reader, each of
        shape `(3, 3)`.
    middle : F64
        Place in the middle of all pictures, shape `(3,)` [length].
    half : F64
        Half the width and height of a picture [length].

    Returns
    -------
    list of list of NDArray
        Pictures by panel and view, each of shape `(height, width, 3)`.

    Raises
    ------
    NoPictureError
        PyVista is missing, or VTK ended without a picture.
    """
    with TemporaryDirectory() as folder:
        job, found = Path(folder, "job.npz"), Path(folder, "pictures.npz")
        content: dict[str, Any] = {
            "triangles": triangles, "rest": rest, "views": np.array(views),
            "middle": middle, "half": half,
        }  # fmt: skip
        for number, panel in enumerate(panels):
            content |= {f"{name}{number}": value for name, value in panel._asdict().items()}
        np.savez(job, **content)
        call = [sys.executable, "-m", __name__, str(job), str(found)]
        try:
            ended = subprocess.run(call, capture_output=True, timeout=_PATIENCE, check=False)
        except (OSError, subprocess.TimeoutExpired) as reason:
            raise NoPictureError(f"VTK drew nothing: {reason}") from None
        if ended.returncode == _WITHOUT_PYVISTA:
            raise NoPictureError("pictures of the surface need PyVista: pip install 'myork[viz]'")
        if ended.returncode != 0 or not found.exists():
            raise NoPictureError(
                f"VTK could not draw without a screen (exit status {ended.returncode}); "
                "Mesa's libraries for EGL or off-screen drawing help: apt install libegl1"
            )
        with np.load(found) as pictures:
            return [
                [pictures[f"{number}_{view}"] for view in range(len(views))]
                for number in range(len(panels))
            ]


def _main(job: str, found: str) -> int:
    """Draw what a file asks for."""
    from matplotlib.colors import ListedColormap

    try:
        pyvista: Any = import_module("pyvista")
    except ImportError:
        return _WITHOUT_PYVISTA
    pictures: dict[str, Any] = {}
    with np.load(job) as content:
        faces = np.insert(content["triangles"], 0, 3, axis=1).ravel()
        middle, half = content["middle"], content["half"]
        size = np.maximum(np.round(_SIDE * half / half.max()), 80).astype(int)
        outline = pyvista.PolyData(content["rest"], faces).extract_feature_edges(
            _EDGE_ANGLE, boundary_edges=True, manifold_edges=False, non_manifold_edges=False
        )
        ends = outline.points[outline.lines.reshape(-1, 3)[:, 1:]]
        ends = _long_parts(ends, float(half.min()))
        number = 0
        while f"positions{number}" in content:
            own = {name: content[f"{name}{number}"] for name in Panel._fields}
            body = pyvista.PolyData(own["positions"], faces)
            colours: Any = str(own["colours"])
            if colours.startswith("#"):
                # Between two tissues lies none of the colours between theirs.
                colours = ListedColormap(colours.split(","))
                corners = own["values"][content["triangles"]]
                body.cell_data["value"] = np.median(corners, axis=1)
            else:
                body.point_data["value"] = own["values"]
            for view, (_, up, towards) in enumerate(content["views"]):
                plotter = pyvista.Plotter(off_screen=True, window_size=[int(s) for s in size])
                plotter.set_background("white")
                plotter.enable_anti_aliasing("ssaa")
                plotter.add_mesh(
                    body, scalars="value", clim=own["limits"].tolist(), cmap=colours,
                    smooth_shading=True, split_sharp_edges=True, show_scalar_bar=False,
                    ambient=0.35, diffuse=0.7, specular=0.0, nan_color=NO_VALUE,
                )  # fmt: skip
                if len(ends):
                    edges = pyvista.line_segments_from_points(ends.reshape(-1, 3))
                    plotter.add_mesh(edges, color="#888888", line_width=1.5)
                if len(own["strokes"]):
                    # a little towards the reader, so that strokes are not half inside
                    lift = 0.01 * np.linalg.norm(half) * towards
                    lines = pyvista.line_segments_from_points(own["strokes"].reshape(-1, 3) + lift)
                    plotter.add_mesh(lines, color="#222222", line_width=2)
                distance = 20.0 * np.linalg.norm(half)
                plotter.camera_position = [middle + distance * towards, middle, up]
                plotter.enable_parallel_projection()
                plotter.camera.parallel_scale = float(half[1])
                plotter.camera.clipping_range = (0.1 * distance, 2.0 * distance)
                pictures[f"{number}_{view}"] = plotter.screenshot(return_img=True)
                plotter.close()
            number += 1
    np.savez(found, **pictures)
    return 0


def _long_parts(ends: F64, least: float) -> F64:
    """Strokes that hang together over a length; short ones are folds of a rough surface.

    Parameters
    ----------
    ends : F64
        Ends of the strokes, shape `(m, 2, 3)` [length].
    least : float
        That length [length].
    """
    places, at = np.unique(ends.reshape(-1, 3), axis=0, return_inverse=True)
    at = at.reshape(-1, 2)
    graph = coo_array((np.ones(len(at)), at.T), shape=(len(places), len(places)))
    part = connected_components(graph, directed=False)[1]
    sides = [np.ptp(places[part == own], axis=0) for own in range(part.max(initial=-1) + 1)]
    long = np.array([np.linalg.norm(side) >= least for side in sides], dtype=bool)
    return ends[long[part[at[:, 0]]]] if len(ends) else ends


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))

"""Pictures of a deformed body: its surface by VTK, plane bodies and planes through it as maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from myork.report.numbers import unit_of
from myork.report.sketch import (
    draw_bar,
    draw_ruler,
    draw_triad,
    frame_of,
    limits_of,
    rim_of,
    shade_plane,
    views_of,
)
from myork.report.sources import Deformation
from myork.report.surface import Panel, show
from myork.types import F64, I32

__all__ = [
    "plane_figure",
    "slices_figure",
    "surface_figure",
]


#: Colours of tissues: those of Okabe and Ito, then darker ones and a light one
_TISSUES = (
   "#D55E00", "#56B4E9", "#F0E442", "#009E73", "#CC79A7", "#E69F00", "#0072B2",
   "#7A3600", "#9A8F10", "#00543D", "#7C3F62", "#9FD9B8",
)  # fmt: skip
_PLAIN = "#D8D8D8"
_TENSION, _PRESSURE = "#FFFFFF", "#000000"
#: Strokes across the longer side of a body or plane
_ACROSS = 16
#: A body this much wider than high is drawn in rows, not in columns
_WIDE = 1.6


def surface_figure(
    deformation: Deformation, units: Mapping[str, str], tissues: Sequence[str] = ()
) -> Figure:
    """Surface of a body in space: displacement, stress, fibers or volume ratio, two views.

    Parameters
    ----------
    deformation : Deformation
        Last state.
    units : Mapping
        Units of the summary, keys `length` and `stress`.
    tissues : sequence of str
        Names of the labels of the points, in their order.

    Returns
    -------
    Figure
        A picture a field and a view, with one scale for all; of points where there is no surface.
    """
    length = units.get("length", "?")
    points, moved = deformation.points, deformation.points + deformation.displacement
    body = Panel(points, moved, deformation.surface)
    size = np.linalg.norm(deformation.displacement, axis=1)
    titles = [
        "displacement |u| " + f"[{length}]",
        f"largest principal stress [{unit_of(units, 'stress')}]",
    ]
    panels = [
        body._replace(values=values, limits=limits_of(values[body.seen]))
        for values in (size, deformation.stress, deformation.volume_ratio)
    ]
    labels = _labels(deformation)
    fibers = deformation.fiber is not None and bool(np.any(deformation.fiber))
    if fibers or len(labels) > 1:
        panels[2] = Panel(
            points, points, deformation.surface, _tissues(deformation),
            (-0.5, max(len(labels), 1) - 0.5, "neither"), _tissue_map(len(labels)),
            _strokes(deformation, body.seen) if fibers else body.strokes,
        )  # fmt: skip
        titles.append("fibers and tissue, undeformed" if fibers else "tissue, undeformed")
    else:
        titles.append("volume ratio J [-]")
    both = np.vstack([points, moved])
    views = views_of(np.ptp(both, axis=0))
    middle, half = frame_of(both, views)
    figure, grid = _board(panels, titles, views, middle, half)
    draw_ruler(grid[0, 0], half, length)
    for panel, axes, title in zip(panels, grid, titles, strict=True):
        if title.endswith("undeformed"):
            names = [tissues[k] if k < len(tissues) else f"label {k}" for k in range(len(labels))]
            if len(labels) > 1:
                patches = [
                    Patch(color=_TISSUES[k % len(_TISSUES)], label=name)
                    for k, name in enumerate(names)
                ]
                axes[-1].legend(
                    handles=patches, loc="upper center", bbox_to_anchor=(0.5, -0.01),
                    frameon=False, fontsize="small", ncols=2,
                )  # fmt: skip
            continue
        draw_bar(figure, list(axes), panel.limits, wide=half[0] > _WIDE * half[1])
    return figure


def _labels(deformation: Deformation) -> list[int]:
    return [] if deformation.label is None else np.unique(deformation.label).tolist()


def _tissues(deformation: Deformation) -> F64:
    """Place of the label of each point among all labels."""
    if deformation.label is None:
        return np.zeros(len(deformation.points))
    return np.searchsorted(_labels(deformation), deformation.label).astype(float)


def _tissue_map(count: int) -> str:
    """Name of a colour map with a colour a tissue."""
    return _PLAIN if count < 2 else ",".join(_TISSUES[k % len(_TISSUES)] for k in range(count))


def _strokes(deformation: Deformation, seen: NDArray[Any]) -> F64:
    """Fibers of points on the surface, thinned to an even distance."""
    assert deformation.fiber is not None
    reach = float(np.ptp(deformation.points, axis=0).max()) / _ACROSS
    own = seen[np.any(deformation.fiber[seen] != 0.0, axis=1)]
    cells = np.floor(deformation.points[own] / reach).astype(int)
    _, first = np.unique(cells, axis=0, return_index=True)
    own = own[first]
    along = 0.4 * reach * deformation.fiber[own]
    return np.stack([deformation.points[own] - along, deformation.points[own] + along], axis=1)


def _board(
    panels: Sequence[Panel], titles: Sequence[str], views: Sequence[F64], middle: F64, half: F64
) -> tuple[Figure, NDArray[np.object_]]:
    """Pictures side by side, with the coordinate axes in the first; axes by panel and view."""
    kinds, count, tall = len(panels), len(views), float(half[1] / half[0])
    if half[0] > _WIDE * half[1]:
        figure = Figure(figsize=(11.0, kinds * (5.0 * tall + 0.5) + 0.3), layout="constrained")
        grid = figure.subplots(kinds, count, squeeze=False)
    else:
        high = min(5.4 * tall / max(1.0, tall), 4.6)
        figure = Figure(figsize=(11.0, count * high + 1.0), layout="constrained")
        grid = figure.subplots(count, kinds, squeeze=False).T
    for panel, row, title in zip(panels, grid, titles, strict=True):
        row[0].set_title(title, fontsize=10)
        for axes, view in zip(row, views, strict=True):
            show(axes, panel, view, middle, half)
    for axes, view in zip(grid[0], views, strict=True):
        draw_triad(axes, view, half)
    return figure, grid


def plane_figure(deformation: Deformation, units: Mapping[str, str]) -> Figure:
    """A plane body, deformed: displacement with its arrows, stress with its crosses, J.

    Parameters
    ----------
    deformation : Deformation
        Last state.
    units : Mapping
        Units of the summary, keys `length` and `stress`.

    Returns
    -------
    Figure
        Three panels with equal scales; the undeformed outline is grey.
    """
    length = units.get("length", "?")
    points = deformation.points[:, :2]
    moved = points + deformation.displacement[:, :2]
    triangles = deformation.surface
    size = np.linalg.norm(deformation.displacement, axis=1)
    both = np.ptp(np.vstack([points, moved]), axis=0)
    wide = both[0] > _WIDE * both[1]
    tall = float(both[1] / both[0])
    shape = (3, 1) if wide else (1, 3)
    high = 3 * (8.0 * tall + 0.9) if wide else min(3.4 * tall + 1.4, 8.0)
    figure = Figure(figsize=(11.0, high), layout="constrained")
    panels = figure.subplots(*shape)
    titles = (
        f"displacement [{length}]",
        f"largest principal stress [{unit_of(units, 'stress')}]",
        "volume ratio J [-]",
    )
    fields = (size, deformation.stress, deformation.volume_ratio)
    for axes, title, values in zip(panels, titles, fields, strict=True):
        rim = rim_of(triangles)
        axes.plot(*points[rim].transpose(2, 1, 0), color="#999999", linewidth=0.8)
        _map(figure, axes, moved, triangles, values)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel(f"x [{length}]")
    panels[0].set_ylabel(f"y [{length}]")
    few = _thinned(moved)
    _arrows(panels[0], moved[few], deformation.displacement[few, :2])
    if deformation.cauchy is not None:
        _crosses(panels[1], moved[few], deformation.cauchy[few, :2, :2])
    return figure


def slices_figure(deformation: Deformation, units: Mapping[str, str]) -> Figure:
    """Three planes through the middle of a body: displacement, fibers, principal stresses.

    Parameters
    ----------
    deformation : Deformation
        Last state.
    units : Mapping
        Units of the summary, keys `length` and `stress`.

    Returns
    -------
    Figure
        A row a plane, on the undeformed body.
    """
    length = units.get("length", "?")
    fibers = deformation.fiber is not None and bool(np.any(deformation.fiber))
    columns = 3 if fibers else 2
    sides = np.ptp(deformation.points, axis=0)
    heights = [min(3.4 * sides[b] / sides[a], 4.6) + 0.8 for a, b, _ in _PLANES]
    figure = Figure(figsize=(3.7 * columns, sum(heights)), layout="constrained")
    grid = figure.subplots(3, columns, height_ratios=heights, squeeze=False)
    size = np.linalg.norm(deformation.displacement, axis=1)
    for row, (a, b, normal) in zip(grid, _PLANES, strict=True):
        kept, triangles = _plane(deformation.lattice, normal)
        flat = deformation.points[kept][:, [a, b]]
        level = float(np.median(deformation.points[kept, normal]))
        few = _thinned(flat)
        moves = deformation.displacement[kept][:, [a, b]]
        _map(figure, row[0], flat, triangles, size[kept])
        _arrows(row[0], flat[few], moves[few])
        _map(figure, row[-1], flat, triangles, deformation.stress[kept])
        if deformation.cauchy is not None:
            stress = deformation.cauchy[kept][:, [a, b]][:, :, [a, b]]
            _crosses(row[-1], flat[few], stress[few])
        if fibers:
            assert deformation.fiber is not None
            _tissue(row[1], flat, triangles, _tissues(deformation)[kept])
            _headless(row[1], flat[few], deformation.fiber[kept][few][:, [a, b]])
        for axes in row:
            axes.set_xlabel(f"{'xyz'[a]} [{length}]")
        row[0].set_ylabel(f"plane {'xyz'[normal]} = {level:.4g} {length}\n{'xyz'[b]} [{length}]")
    titles = [f"displacement [{length}]", f"largest principal stress [{unit_of(units, 'stress')}]"]
    if fibers:
        titles.insert(1, "fibers and tissue")
    for axes, title in zip(grid[0], titles, strict=True):
        axes.set_title(title, fontsize=10)
    return figure


#: Across, upwards and normal of the transverse, coronal and sagittal planes
_PLANES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))


def _plane(lattice: I32, normal: int) -> tuple[NDArray[np.intp], I32]:
    """Points of the middle plane of a lattice, and triangles between them."""
    layer = lattice[:, normal]
    kept = np.flatnonzero(layer == (int(layer.min()) + int(layer.max())) // 2)
    places = np.delete(lattice[kept], normal, axis=1)
    places = places - places.min(axis=0)
    at = np.full(places.max(axis=0) + 1, -1, np.int32)
    at[tuple(places.T)] = np.arange(len(kept))
    square = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=-1).reshape(-1, 4)
    lost = square < 0
    # halves of squares, or what is left of those that lack a corner
    cut = [square[:, [0, 1, 2]], square[:, [0, 2, 3]],
           square[lost[:, 2]][:, [0, 1, 3]], square[lost[:, 0]][:, [1, 2, 3]]]  # fmt: skip
    triangles = np.concatenate(cut)
    return kept, triangles[(triangles >= 0).all(axis=1)]


def _map(figure: Figure, axes: Axes, places: F64, triangles: I32, values: F64) -> None:
    """Values on triangles, their bar beside them."""
    limits = limits_of(values)
    shade = shade_plane(axes, places, triangles, values, limits)
    # beside the picture however wide it is
    place = axes.inset_axes((1.03, 0.0, 0.05, 1.0))
    bar = figure.colorbar(shade, cax=place, extend=limits[2])
    bar.ax.ticklabel_format(useOffset=False)
    bar.ax.locator_params(nbins=6)


def _tissue(axes: Axes, places: F64, triangles: I32, tissues: F64) -> None:
    """Triangles in the colour of their tissue."""
    if len(triangles):
        count = len(_TISSUES)
        colours = ListedColormap(_TISSUES if tissues.max() > 0.0 else [_PLAIN] * count)
        shape = Triangulation(places[:, 0], places[:, 1], triangles)
        own = np.median(tissues[triangles], axis=1) % count
        axes.tripcolor(shape, facecolors=own, cmap=colours, vmin=-0.5, vmax=count - 0.5, alpha=0.8)
    axes.set_aspect("equal")


def _thinned(places: F64) -> NDArray[np.intp]:
    """Points at an even distance, about `_ACROSS` along the longer side."""
    reach = max(float(np.ptp(places, axis=0).max()), 1e-300) / _ACROSS
    _, first = np.unique(np.floor(places / reach), axis=0, return_index=True)
    return first


def _arrows(axes: Axes, places: F64, moves: F64) -> None:
    """Arrows of the displacement, the longest as long as their distance."""
    reach = float(np.ptp(places, axis=0).max()) / _ACROSS
    most = float(np.linalg.norm(moves, axis=1).max(initial=0.0))
    if most > 0.0:
        axes.quiver(
            *places.T, *moves.T, angles="xy", scale_units="xy", scale=most / reach,
            width=0.006, color="white", edgecolor="black", linewidth=0.4,
        )  # fmt: skip


def _headless(axes: Axes, places: F64, fibers: F64) -> None:
    reach = float(np.ptp(places, axis=0).max()) / _ACROSS
    axes.quiver(
        *places.T, *fibers.T, angles="xy", scale_units="xy", scale=1.2 / reach, width=0.008,
        headwidth=0, headlength=0, headaxislength=0, pivot="mid", color="#222222",
    )  # fmt: skip


def _crosses(axes: Axes, places: F64, stress: F64) -> None:
    """Principal stresses in the plane: white pulls, black presses, as long as they are large."""
    known = np.isfinite(stress).all(axis=(1, 2))
    places, stress = places[known], stress[known]
    values, vectors = np.linalg.eigh(0.5 * (stress + stress.transpose(0, 2, 1)))
    most = float(np.percentile(np.abs(values), 98.0)) if values.size else 0.0
    if not most > 0.0:
        return
    reach = float(np.ptp(places, axis=0).max()) / _ACROSS
    for k in range(2):
        long = np.clip(values[:, k] / most, -1.0, 1.0) * 0.9 * reach
        for sign, colour in ((1.0, _TENSION), (-1.0, _PRESSURE)):
            own = sign * long > 0.02 * reach
            if not own.any():
                continue
            strokes = vectors[own, :, k] * np.abs(long[own, None])
            axes.quiver(
                *places[own].T, *strokes.T, angles="xy", scale_units="xy", scale=1.0,
                width=0.009, headwidth=0, headlength=0, headaxislength=0, pivot="mid",
                color=colour, edgecolor="#555555", linewidth=0.3,
            )  # fmt: skip

"""Pictures of bodies: surfaces in space, plane bodies, sections through bodies.

A `Deformation` is the last state of a run; `units` are those of its summary, with keys `length` and
`stress`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from myork.report.figures import GREY, draw_strokes, label_colours
from myork.report.numbers import unit_of
from myork.report.sources import Deformation
from myork.types import F64, I32, Index

#: Colour of a body of one tissue
_PLAIN = "#D8D8D8"
#: Colour of places without a value; it occurs in none of the colour maps used
NO_VALUE = "#FF00C8"
_COLOURS = colormaps["viridis"].with_extremes(bad=NO_VALUE)
#: Colours reach the largest value unless it lies this many spans of the middle 99 % beyond them
_BEYOND = 1.0
#: Number of fibers drawn across the longer side of a plane
_ACROSS = 16
#: A body this much wider than high is drawn in rows, not in columns
_WIDE = 1.6
#: Height of titles and numbers of a plane, and least height of a colour bar [inch]
_ROOM, _BAR = 0.9, 0.6
#: The view is onto the broad side, from these angles to the side and above; the third angle is for
#: bodies whose ratio of height to length is below the last number [degree], [-]
_ASIDE, _ABOVE, _DOWN, _LOW = 28.0, 18.0, 45.0, 0.3


def limits_of(values: F64) -> tuple[float, float, str]:
    """Limits of the colours, and which of them values exceed: "neither", "min", "max" or "both".

    The whole range is shown, except for single values so far out (at an edge with a singular
    stress) that all others would have one colour.
    """
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0, "neither"
    least, most = float(values.min()), float(values.max())
    low, high = (float(v) for v in np.percentile(values, [0.5, 99.5]))
    room = _BEYOND * (high - low)
    below, above = low - least > room, most - high > room
    low, high = low if below else least, high if above else most
    margin = 1e-6 * max(abs(low), abs(high), 1e-12)
    ends = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}
    return low - margin, high + margin, ends[below, above]


def surface_figure(deformation: Deformation, units: Mapping[str, str]) -> Figure:
    """Surface of a deformed body in space: displacement, stress and volume ratio, from two sides.

    One column per field, one row per field for wide bodies; points where there is no surface.
    """
    moved, triangles = deformation.moved, deformation.surface
    seen = np.unique(triangles) if len(triangles) else np.arange(len(moved))
    sides = np.ptp(moved, axis=0)
    towards = (0.0 if sides[0] < sides[1] else -90.0) + _ASIDE
    above = _ABOVE if sides[2] > _LOW * sides.max() else _DOWN
    kinds = ("size", "stress", "volume_ratio")
    wide = sides[:2].max() > _WIDE * sides[2]
    figure = Figure(figsize=(11.0, 9.0), layout="constrained")
    grid = figure.subplots(
        *((3, 2) if wide else (2, 3)), subplot_kw={"projection": "3d", "proj_type": "ortho"}
    )
    for both, kind in zip(grid if wide else grid.T, kinds, strict=True):
        values = getattr(deformation, kind)
        low, high, ends = limits_of(values[seen])
        shade = ScalarMappable(Normalize(low, high), _COLOURS)
        for axes, azimuth in zip(both, (towards, towards + 180.0), strict=True):
            if len(triangles):
                colours = shade.to_rgba(np.ma.masked_invalid(values[triangles].mean(axis=1)))
                light = LightSource(90.0 - azimuth, 60.0)
                faces = Poly3DCollection(
                    moved[triangles], facecolors=colours, shade=True, lightsource=light,
                    antialiased=False, clip_on=False,  # long bodies are wider than the square frame
                )  # fmt: skip
                axes.add_collection3d(faces)
            else:
                axes.scatter(
                    *moved.T, c=shade.to_rgba(np.ma.masked_invalid(values)), s=6, clip_on=False
                )
            for axis, places in zip("xyz", moved.T, strict=True):
                room = 1e-3 * sides.max()
                axes.set(**{f"{axis}lim": (places.min() - room, places.max() + room)})
                axes.set(**{f"{axis}label": f"{axis} [{unit_of(units, 'length')}]"})
                nbins = max(1, round(4.0 * float(np.ptp(places) / sides.max())))
                axes.locator_params(axis=axis, nbins=nbins)
            # equal scales
            axes.set_box_aspect(sides + 2e-3 * sides.max(), zoom=1.4 if wide else 0.9)
            axes.view_init(above, azimuth)
            axes.tick_params(labelsize=7)
        both[0].set_title(_titles(units)[kind], fontsize=10)
        side = "right" if wide else "bottom"
        bar = figure.colorbar(
            shade,
            ax=list(both),
            extend=ends,
            location=side,
            shrink=0.7,
            aspect=25,
            pad=0.1 if wide else 0.05,
        )
        bar.ax.locator_params(nbins=5)
        bar.ax.ticklabel_format(scilimits=(-3, 5), useOffset=False)
    return figure


def _titles(units: Mapping[str, str]) -> dict[str, str]:
    """Title of each field of a body, by the name in `Deformation`."""
    return {
        "size": f"displacement |u| [{unit_of(units, 'length')}]",
        "stress": f"largest principal stress [{unit_of(units, 'stress')}]",
        "volume_ratio": "volume ratio J [-]",
        "fiber": "fibers and tissue",
    }


def plane_figure(deformation: Deformation, units: Mapping[str, str]) -> Figure:
    """A plane body, deformed: displacement, stress, volume ratio.

    Three panels with equal scales; the undeformed outline is grey.
    """
    points, moved = deformation.points[:, :2], deformation.moved[:, :2]
    across, up = np.ptp(np.vstack([points, moved]), axis=0)
    wide, tall = across > _WIDE * up, float(up / across)
    width = 8.0 if wide else min(3.4, 6.6 / tall)
    high = 3 * (width * tall + 0.9) if wide else width * tall + 1.4
    figure = Figure(figsize=(11.0, high), layout="constrained")
    panels = figure.subplots(*((3, 1) if wide else (1, 3)))
    outline = points[_rim_of(deformation.surface)].transpose(2, 1, 0)
    for axes, kind in zip(panels, ("size", "stress", "volume_ratio"), strict=True):
        axes.plot(*outline, color="#999999", linewidth=0.8)
        _map(axes, moved, deformation.surface, getattr(deformation, kind), width * tall)
        axes.set_title(_titles(units)[kind], fontsize=10)
        axes.set_xlabel(f"x [{unit_of(units, 'length')}]")
    panels[0].set_ylabel(f"y [{unit_of(units, 'length')}]")
    return figure


def _rim_of(triangles: I32) -> I32:
    """Edges that belong to one triangle only, shape `(m, 2)`."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    found, counts = np.unique(edges, axis=0, return_counts=True)
    return found[counts == 1]


def slices_figure(
    deformation: Deformation, units: Mapping[str, str], tissues: Sequence[str] = ()
) -> Figure:
    """Three planes through the middle of an undeformed body, one row each.

    Displacement, fibers and tissues (where known), stress. `tissues` are names of the labels
    of the points, in their order.
    """
    length = unit_of(units, "length")
    labels, tissue = np.unique(deformation.label, return_inverse=True)
    inside = deformation.fiber.any() or len(labels) > 1
    kinds = ("size", "fiber", "stress") if inside else ("size", "stress")
    sides = np.ptp(deformation.points, axis=0)
    colours = list(label_colours(labels.tolist()).values()) if len(labels) > 1 else [_PLAIN]
    heights = [min(3.4 * sides[b] / sides[a], 4.6) for a, b, _ in _PLANES]
    room = 3 * _ROOM + 0.25 * -(-len(labels) // 4)
    figure = Figure(figsize=(3.7 * len(kinds), sum(heights) + room), layout="constrained")
    grid = figure.subplots(
        3, len(kinds), height_ratios=[high + _ROOM for high in heights], squeeze=False
    )
    for row, (a, b, normal), high in zip(grid, _PLANES, heights, strict=True):
        across = float(sides[a] / sides[b])
        kept, triangles = _plane(deformation.lattice, normal)
        flat = deformation.points[kept][:, [a, b]]
        level = float(np.median(deformation.points[kept, normal]))
        for axes, kind in zip(row, kinds, strict=True):
            if kind == "fiber":
                fibers = deformation.fiber[kept][:, [a, b]]
                _tissue(axes, flat, triangles, tissue[kept], fibers, colours)
            else:
                _map(axes, flat, triangles, getattr(deformation, kind)[kept], high)
            axes.set_xlabel(f"{'xyz'[a]} [{length}]")
            for axis, size in (("x", 0.5 * high * across), ("y", high)):
                nbins = max(1, min(6, round(4.0 * size)))
                axes.locator_params(axis=axis, nbins=nbins, min_n_ticks=1)
        row[0].set_ylabel(f"{'xyz'[b]} [{length}]")
        plane = f"plane {'xyz'[normal]} = {level:.4g} {length}"
        row[0].annotate(
            plane, (0.0, 1.0), (0, 5), xycoords="axes fraction", textcoords="offset points",
            fontsize=9, color=GREY,
        )  # fmt: skip
    for axes, kind in zip(grid[0], kinds, strict=True):
        axes.set_title(f"{_titles(units)[kind]}\n", fontsize=10)  # above the title of the plane
    if len(labels) > 1:
        names = [*tissues[: len(labels)], *(f"label {k}" for k in range(len(tissues), len(labels)))]
        shown = [Patch(color=own, label=name) for own, name in zip(colours, names, strict=True)]
        figure.legend(handles=shown, loc="outside lower center", ncols=4, frameon=False)
    return figure


#: Horizontal, vertical and normal axes of the transverse, coronal and sagittal planes
_PLANES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))


def _plane(lattice: I32, normal: int) -> tuple[Index, I32]:
    """Points of the plane of a lattice with the most points, and triangles between them.

    Among equal planes the one nearest to the middle; the middle itself may lie between two limbs.
    """
    layer = lattice[:, normal] - int(lattice[:, normal].min())
    count = np.bincount(layer)
    full = np.flatnonzero(count == count.max())
    kept = np.flatnonzero(layer == full[np.abs(full - (len(count) - 1) // 2).argmin()])
    places = np.delete(lattice[kept], normal, axis=1)
    places = places - places.min(axis=0)
    at = np.full(places.max(axis=0) + 1, -1, np.int32)
    at[tuple(places.T)] = np.arange(len(kept))
    square = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=-1).reshape(-1, 4)
    lost = square < 0
    # halves of squares, or the remaining triangle of squares that lack a corner
    cut = [square[:, [0, 1, 2]], square[:, [0, 2, 3]],
           square[lost[:, 2]][:, [0, 1, 3]], square[lost[:, 0]][:, [1, 2, 3]]]  # fmt: skip
    triangles = np.concatenate(cut)
    return kept, triangles[(triangles >= 0).all(axis=1)]


def _map(axes: Axes, places: F64, triangles: I32, values: F64, tall: float) -> None:
    """Values on triangles of a plane, or at its points if none; crosses mark missing values.

    - `tall`: height of the picture [inch]
    """
    low, high, ends = limits_of(values)
    look: dict[str, Any] = {"vmin": low, "vmax": high, "cmap": _COLOURS}
    if len(triangles):
        shape = Triangulation(places[:, 0], places[:, 1], triangles)
        axes.tripcolor(shape, values, shading="gouraud", **look)
    else:
        axes.scatter(places[:, 0], places[:, 1], c=values, s=12, **look)
    missing = places[~np.isfinite(values)]
    if len(missing):
        axes.plot(*missing.T, "x", color=NO_VALUE, markersize=6, clip_on=False)
    axes.set_aspect("equal")
    # a colour bar beside the picture, whatever its width, and high enough for its numbers
    part = max(1.0, _BAR / tall)
    beside = axes.inset_axes((1.03, 0.5 - 0.5 * part, 0.05, part))
    bar = axes.figure.colorbar(ScalarMappable(Normalize(low, high)), cax=beside, extend=ends)
    bar.ax.ticklabel_format(useOffset=False)
    bar.ax.locator_params(nbins=min(6, round(3.0 * part * tall)))


def _tissue(
    axes: Axes,
    places: F64,
    triangles: I32,
    tissues: Index,
    fibers: F64,
    colours: Sequence[str],
) -> None:
    """Triangles in the colour of their tissue, numbered from 0, and fibers at even distances."""
    if len(triangles):
        axes.tripcolor(
            Triangulation(places[:, 0], places[:, 1], triangles),
            facecolors=np.median(tissues[triangles], axis=1), cmap=ListedColormap(colours),
            vmin=-0.5, vmax=len(colours) - 0.5, alpha=0.8,
        )  # fmt: skip
    axes.set_aspect("equal")
    reach = max(float(np.ptp(places, axis=0).max()), 1e-300) / _ACROSS
    few = np.unique(np.floor(places / reach), axis=0, return_index=True)[1]
    draw_strokes(
        axes, places[few], fibers[few], reach / 1.2, places[triangles] if len(triangles) else None,
        width=0.008, color="#222222",
    )  # fmt: skip

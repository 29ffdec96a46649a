"""Pictures of a deformed body: its surface by VTK, plane bodies and planes through it as maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from myork.report.off_screen import Panel, draw
from myork.report.skin import outer_triangles, spacing_of
from myork.report.sources import Deformation

__all__ = [
    "compared_figure",
    "limits_of",
    "plane_figure",
    "slices_figure",
    "surface_figure",
]

F64 = NDArray[np.float64]

#: Colours of tissues: Okabe and Ito's palette
_TISSUES = ("#D55E00", "#56B4E9", "#F0E442", "#009E73", "#CC79A7", "#E69F00", "#0072B2")
_PLAIN = "#D8D8D8"
_TENSION, _PRESSURE = "#FFFFFF", "#000000"
#: Colours reach the largest value unless it lies this many spans of the middle 99 % beyond them
_BEYOND = 1.0
#: Strokes across the longer side of a body or plane
_ACROSS = 16
#: A body this much wider than high is drawn in rows, not in columns
_WIDE = 1.6
#: The reader looks from this much to the side and from above [degree]
_AZIMUTH, _ELEVATION = 28.0, 18.0
#: Share of the body that a length stroke may take
_RULER = 0.35


def limits_of(values: F64) -> tuple[float, float, str]:
    """Ends of the colours, and which of them values pass: "neither", "min", "max" or "both".

    The whole range is shown, but for single values so far out (at an edge where the stress has no
    bound) that all others would share one colour.
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


def surface_figure(
    deformation: Deformation, units: Mapping[str, str], tissues: Sequence[str] = ()
) -> Figure:
    """Surface of a body in space: displacement, stress, fibers or volume ratio, two views.

    Parameters
    ----------
    deformation : Deformation
        Last state.
    units : Mapping
        Units of the deck, keys `force` and `length`.
    tissues : sequence of str
        Names of the materials, in the order of the labels of the points.

    Returns
    -------
    Figure
        A picture a field and a view, with one scale for all.

    Raises
    ------
    NoPictureError
        VTK cannot draw here.
    """
    force, length = units.get("force", "?"), units.get("length", "?")
    points, moved = deformation.points, deformation.points + deformation.displacement
    spacing = spacing_of(points)
    triangles = outer_triangles(points, spacing)
    seen = np.unique(triangles)
    size = np.linalg.norm(deformation.displacement, axis=1)
    none = np.empty((0, 2, 3))
    titles = ["displacement |u| " + f"[{length}]", f"largest principal stress [{force}/{length}²]"]
    limits = [limits_of(values[seen]) for values in (size, deformation.stress)]
    panels = [
        Panel(moved, values, own[:2], "viridis", none)
        for values, own in zip((size, deformation.stress), limits, strict=True)
    ]
    labels = _labels(deformation)
    fibers = deformation.fiber is not None and bool(np.any(deformation.fiber))
    if fibers or len(labels) > 1:
        strokes = _strokes(deformation, seen) if fibers else none
        ends = (-0.5, max(len(labels), 1) - 0.5)
        panels.append(Panel(points, _tissues(deformation), ends, _tissue_map(len(labels)), strokes))
        titles.append("fibers and tissue, undeformed" if fibers else "tissue, undeformed")
    else:
        limits.append(limits_of(deformation.volume_ratio[seen]))
        panels.append(Panel(moved, deformation.volume_ratio, limits[-1][:2], "viridis", none))
        titles.append("volume ratio J [-]")
    both = np.vstack([points, moved])
    views = _views(np.ptp(both, axis=0))
    middle = 0.5 * (both.min(axis=0) + both.max(axis=0))
    spread = np.abs(np.array([view[:2] @ (both - middle).T for view in views])).max(axis=(0, 2))
    half = 1.06 * np.maximum(spread, 0.15 * spread.max())
    pictures = draw(panels, triangles, points, views, middle, half)
    figure = _board(pictures, titles, half, views, length)
    for number, title in enumerate(titles):
        axes = [a for a in figure.axes if a.get_gid() == f"panel {number}"]
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
        _bar(figure, axes, limits[number], wide=half[0] > _WIDE * half[1])
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


def _views(sides: F64) -> list[F64]:
    """Two opposite views of a body: on its broad side, what is long across or upwards."""
    towards = int(np.argmin(sides[:2])) if sides[2] >= sides[:2].min() else 2
    if towards == 2 and sides[2] > 0.6 * sides[:2].min():
        # a bar along x or y lies on the ground
        towards = int(np.argmin(sides[:2]))
    up = 1 if towards == 2 else 2
    across = 3 - towards - up
    axes = np.zeros((3, 3))
    axes[0, across], axes[1, up] = 1.0, 1.0
    axes[2] = np.cross(axes[0], axes[1])
    found = []
    for turn in (_AZIMUTH, _AZIMUTH + 180.0):
        a, e = np.radians([turn, _ELEVATION])
        look = np.cos(e) * (np.cos(a) * axes[2] + np.sin(a) * axes[0]) + np.sin(e) * axes[1]
        right = np.cos(a) * axes[0] - np.sin(a) * axes[2]
        found.append(np.array([right, np.cross(look, right), look]))
    return found


def _board(
    pictures: list[list[NDArray[np.uint8]]],
    titles: Sequence[str],
    half: F64,
    views: Sequence[F64],
    length: str,
) -> Figure:
    """Pictures side by side, with the axes and a length in the first."""
    wide = half[0] > _WIDE * half[1]
    kinds, count = len(pictures), len(views)
    tall = float(half[1] / half[0])
    if wide:
        figure = Figure(figsize=(11.0, kinds * (5.0 * tall + 0.5) + 0.3), layout="constrained")
        grid = figure.subplots(kinds, count, squeeze=False)
    else:
        high = min(5.4 * tall / max(1.0, tall), 4.6)
        figure = Figure(figsize=(11.0, count * high + 1.0), layout="constrained")
        grid = figure.subplots(count, kinds, squeeze=False).T
    extent = (-half[0], half[0], -half[1], half[1])
    for number, row in enumerate(pictures):
        for view, picture in enumerate(row):
            axes = grid[number, view]
            axes.imshow(picture, extent=extent, interpolation="antialiased")
            axes.set_axis_off()
            axes.set_gid(f"panel {number}")
            if view == 0:
                axes.set_title(titles[number], fontsize=10)
            if number == 0:
                _triad(axes, views[view], half)
    _ruler(grid[0, 0], half, length)
    return figure


def _triad(axes: Axes, view: F64, half: F64) -> None:
    """The coordinate axes as the reader sees them, in the lower left corner."""
    arm = 0.14 * float(half.min())
    origin = -np.asarray(half) + 1.2 * arm
    for name, tip in zip("xyz", (arm * view[:2].T), strict=True):
        if np.linalg.norm(tip) > 0.15 * arm:
            end, far = (tuple((origin + part * tip).tolist()) for part in (1.0, 1.35))
            look = {"arrowstyle": "-|>", "lw": 1.0, "shrinkB": 0}
            axes.annotate("", end, tuple(origin.tolist()), arrowprops=look)
            axes.text(far[0], far[1], name, fontsize=8, ha="center", va="center")


def _ruler(axes: Axes, half: F64, length: str) -> None:
    """A stroke of a round length in the lower right corner."""
    most = _RULER * 2.0 * float(half[0])
    power = 10.0 ** np.floor(np.log10(most))
    long = max(f * power for f in (1.0, 2.0, 5.0) if f * power <= most)
    right, y = 0.98 * half[0], -0.97 * half[1]
    axes.plot([right - long, right], [y, y], color="black", linewidth=2)
    axes.text(
        right - long / 2, y + 0.02 * half[1], f"{long:g} {length}",
        fontsize=8, ha="center", va="bottom",
    )  # fmt: skip


def _bar(figure: Figure, axes: list[Any], limits: tuple[float, float, str], wide: bool) -> Colorbar:
    low, high, ends = limits
    shade = ScalarMappable(Normalize(low, high), colormaps["viridis"])
    side = "right" if wide else "bottom"
    bar = figure.colorbar(
        shade, ax=axes, extend=ends, pad=0.02, aspect=25, location=side, shrink=0.8
    )
    bar.ax.locator_params(nbins=5)
    bar.ax.ticklabel_format(useOffset=False)
    return bar


def plane_figure(deformation: Deformation, units: Mapping[str, str]) -> Figure:
    """A plane body, deformed: displacement with its arrows, stress with its crosses, J.

    Parameters
    ----------
    deformation : Deformation
        Last state.
    units : Mapping
        Units of the deck, keys `force` and `length`.

    Returns
    -------
    Figure
        Three panels with equal scales; the undeformed outline is grey.
    """
    force, length = units.get("force", "?"), units.get("length", "?")
    points = deformation.points[:, :2]
    moved = points + deformation.displacement[:, :2]
    triangles = outer_triangles(points, spacing_of(points))
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
        f"largest principal stress [{force}/{length}²]",
        "volume ratio J [-]",
    )
    fields = (size, deformation.stress, deformation.volume_ratio)
    for axes, title, values in zip(panels, titles, fields, strict=True):
        rim = _rim(triangles)
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


def compared_figure(
    deformations: Sequence[Deformation], names: Sequence[str], units: Mapping[str, str]
) -> Figure:
    """Bodies side by side: displacement and stress, one view and one scale for all.

    Parameters
    ----------
    deformations : sequence of Deformation
        Last states, all plane or all in space.
    names : sequence of str
        Of the runs.
    units : Mapping
        Units of the decks, keys `force` and `length`.

    Returns
    -------
    Figure
        A column a run.

    Raises
    ------
    NoPictureError
        VTK cannot draw here.
    """
    force, length = units.get("force", "?"), units.get("length", "?")
    moved = [own.points + own.displacement for own in deformations]
    triangles = [
        outer_triangles(points, spacing_of(points))
        for points in (_places(own.points) for own in deformations)
    ]
    fields = [
        [np.linalg.norm(own.displacement, axis=1) for own in deformations],
        [own.stress for own in deformations],
    ]
    limits = [
        limits_of(np.concatenate([v[np.unique(t)] for v, t in zip(row, triangles, strict=True)]))
        for row in fields
    ]
    every = np.vstack([*moved, *(own.points for own in deformations)])
    flat = not np.ptp(every[:, 2])
    views = [np.eye(3)] if flat else _views(np.ptp(every, axis=0))[:1]
    middle = 0.5 * (every.min(axis=0) + every.max(axis=0))
    half = 1.06 * np.abs(views[0][:2] @ (every - middle).T).max(axis=1)
    half = np.maximum(half, 0.15 * half.max())
    count, tall = len(deformations), float(half[1] / half[0])
    width = 10.0 / count
    figure = Figure(figsize=(11.0, 2.0 * width * tall + 1.2), layout="constrained")
    grid = figure.subplots(2, count, squeeze=False)
    for column, own in enumerate(deformations):
        shapes = [row[column] for row in fields]
        if flat:
            for axes, values, ends in zip(grid[:, column], shapes, limits, strict=True):
                place = moved[column][:, :2] - middle[:2]
                shape = Triangulation(place[:, 0], place[:, 1], triangles[column])
                axes.tripcolor(shape, values, shading="gouraud", vmin=ends[0], vmax=ends[1])
                rest = (own.points[:, :2] - middle[:2])[_rim(triangles[column])]
                axes.plot(*rest.transpose(2, 1, 0), color="#999999", linewidth=0.8)
        else:
            none = np.empty((0, 2, 3))
            panels = [
                Panel(moved[column], values, ends[:2], "viridis", none)
                for values, ends in zip(shapes, limits, strict=True)
            ]
            drawn = draw(panels, triangles[column], own.points, views, middle, half)
            for axes, pictures in zip(grid[:, column], drawn, strict=True):
                extent = (-half[0], half[0], -half[1], half[1])
                axes.imshow(pictures[0], extent=extent, interpolation="antialiased")
        grid[0, column].set_title(names[column], fontsize=10)
    for axes in grid.ravel():
        axes.set(xlim=(-half[0], half[0]), ylim=(-half[1], half[1]), aspect="equal")
        axes.set_axis_off()
    if not flat:
        _triad(grid[0, 0], views[0], half)
    _ruler(grid[0, 0], half, length)
    titles = (f"displacement |u| [{length}]", f"largest principal stress [{force}/{length}²]")
    for row, ends, title in zip(grid, limits, titles, strict=True):
        _bar(figure, list(row), ends, wide=True).set_label(title)
    return figure


def _places(points: F64) -> F64:
    """Points as triangles are made of them: those of a plane body without z."""
    return points if np.ptp(points[:, 2]) else points[:, :2]


def slices_figure(deformation: Deformation, units: Mapping[str, str]) -> Figure:
    """Three planes through the middle of a body: displacement, fibers, principal stresses.

    Parameters
    ----------
    deformation : Deformation
        Last state.
    units : Mapping
        Units of the deck, keys `force` and `length`.

    Returns
    -------
    Figure
        A row a plane, on the undeformed body.
    """
    force, length = units.get("force", "?"), units.get("length", "?")
    fibers = deformation.fiber is not None and bool(np.any(deformation.fiber))
    columns = 3 if fibers else 2
    sides = np.ptp(deformation.points, axis=0)
    heights = [min(3.4 * sides[b] / sides[a], 4.6) + 0.8 for a, b, _ in _PLANES]
    figure = Figure(figsize=(3.7 * columns, sum(heights)), layout="constrained")
    grid = figure.subplots(3, columns, height_ratios=heights, squeeze=False)
    size = np.linalg.norm(deformation.displacement, axis=1)
    for row, (a, b, normal) in zip(grid, _PLANES, strict=True):
        kept, level = _plane(deformation.points, normal)
        flat = deformation.points[kept][:, [a, b]]
        try:
            triangles = outer_triangles(flat, spacing_of(flat))
        except ValueError:
            triangles = np.empty((0, 3), np.int32)
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
    titles = [f"displacement [{length}]", f"largest principal stress [{force}/{length}²]"]
    if fibers:
        titles.insert(1, "fibers and tissue")
    for axes, title in zip(grid[0], titles, strict=True):
        axes.set_title(title, fontsize=10)
    return figure


#: Across, upwards and normal of the transverse, coronal and sagittal planes
_PLANES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))


def _plane(points: F64, normal: int) -> tuple[NDArray[np.intp], float]:
    """Points of the plane of points that is nearest to the middle, and where it is."""
    spacing = spacing_of(points)[normal]
    places = points[:, normal]
    middle = 0.5 * (places.min() + places.max())
    levels, counts = np.unique(np.round(places, 9), return_counts=True)
    many = levels[counts > 0.2 * counts.max()]
    level = float(many[np.argmin(np.abs(many - middle))])
    return np.flatnonzero(np.abs(places - level) < 0.5 * spacing), level


def _rim(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Edges of one triangle only, shape `(m, 2)`."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]],
                                    triangles[:, [2, 0]]]), axis=1)  # fmt: skip
    found, counts = np.unique(edges, axis=0, return_counts=True)
    return found[counts == 1]


def _map(
    figure: Figure, axes: Axes, places: F64, triangles: NDArray[np.int32], values: F64
) -> None:
    """Values on triangles, their bar beside them."""
    low, high, ends = limits_of(values)
    if len(triangles):
        shape = Triangulation(places[:, 0], places[:, 1], triangles)
        shade: Any = axes.tripcolor(shape, values, shading="gouraud", vmin=low, vmax=high)
    else:
        shade = axes.scatter(places[:, 0], places[:, 1], c=values, s=12, vmin=low, vmax=high)
    axes.set_aspect("equal")
    # beside the picture however wide it is
    place = axes.inset_axes((1.03, 0.0, 0.05, 1.0))
    bar = figure.colorbar(shade, cax=place, extend=ends)
    bar.ax.ticklabel_format(useOffset=False)
    bar.ax.locator_params(nbins=6)


def _tissue(axes: Axes, places: F64, triangles: NDArray[np.int32], tissues: F64) -> None:
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
